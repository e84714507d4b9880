"""Setting Feetech servos up: what each should hold in its EEPROM, what differs, writing just that.

The only place that writes EEPROM: torque off, unlocked and locked again, only differences, all of
it read back.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final

from firmware_bridge.bus_kinds import Wiring
from firmware_bridge.dynamixel.provisioning import Difference, chain_is_complete, differences
from firmware_bridge.dynamixel.wire.serial_transport import SameAdapter, open_port
from firmware_bridge.errors import ServoError
from firmware_bridge.feetech.bus import FeetechBus
from firmware_bridge.feetech.control_table import (
    EEPROM_SIZE,
    MANY_TURNS,
    STATE,
    ServoModel,
    baud_rates,
    model_name,
    servo_models,
)
from firmware_bridge.feetech.line import Line
from firmware_bridge.feetech.mounting import MountedServo, identify, mounted_servos
from firmware_bridge.feetech.torque import torque_verified, write_verified
from firmware_bridge.joints import SERVO_LIMIT_MARGIN_DEG, Joint

__all__ = ["Difference", "chain_is_complete"]

#: An answer that comes this late is still waited for, outside the loop: setting up, examining.
UNHURRIED_S: Final = 0.06
_TRIES: Final = 3
#: Of a servo that is moved to see which it is.
_CAREFUL_DEG_S: Final = 60.0
#: What changes how a servo is spoken to is written last, in this order.
_LAST: Final = {"id": 1, "baud_rate": 2}
#: So many questions of each kind; so many of one kind whole and of the other spoilt.
_ASKED, _WHOLE, _SPOILT = 6, 5, 4

#: Servos by id: the rate at which each answered, and the bytes of its model; more than one where
#: several did.
Found = Mapping[int, Sequence[tuple[int, bytes]]]


@dataclass(frozen=True, slots=True)
class Plan:
    """What one servo, found at an id and a rate, lacks to be the joint's."""

    servo: MountedServo
    servo_id: int
    baud_rate: int
    changes: tuple[Difference, ...]


@contextmanager
def unhurried_line(port: str, baud_rate: int) -> Iterator[Line]:
    """An open port that is waited for longer than a loop could. Raises PortError."""
    transport = open_port(port, baud_rate)
    try:
        yield Line(transport, extra_wait_s=UNHURRIED_S)
    finally:
        transport.close()


def servos_by_joint(wiring: Wiring) -> dict[str, MountedServo]:
    """Every servo of a face in its place, by the name of its joint."""
    return {servo.joint.name: servo for servo in mounted_servos(wiring)}


def wanted_settings(
    servo: MountedServo, baud_rate: int, found: Mapping[str, int]
) -> dict[str, int]:
    """EEPROM values by register name for a servo in its place; found: what it holds now."""
    low, high = servo.pulse_range()
    dialect = servo.model.dialect
    margin = round(SERVO_LIMIT_MARGIN_DEG * dialect.positions_per_deg)
    wanted = {
        "id": servo.joint.servo_id,
        "baud_rate": next(code for code, rate in baud_rates().items() if rate == baud_rate),
        "return_delay_time": 0,
        "response_status_level": 1,
        "min_position_limit": max(low - margin, 0),
        "max_position_limit": min(high + margin, dialect.n_positions - 1),
    }
    if "operating_mode" in dialect.registers:
        wanted |= {"operating_mode": 0, "phase": found["phase"] & ~MANY_TURNS}
    return wanted


def read_eeprom(line: Line, servo_id: int, model: ServoModel) -> dict[str, int]:
    """Its registers by name. Raises ServoError when the servo does not answer."""
    for _ in range(_TRIES):
        answer = line.read(servo_id, 0, EEPROM_SIZE)
        if answer is not None:
            return model.dialect.decode_all(answer.data)
    raise ServoError(f"servo id {servo_id} does not answer as it did")


def set_up(
    line: Line, servo_id: int, model: ServoModel, changes: Sequence[Difference]
) -> Iterator[Difference]:
    """Write `changes` to the servo at `servo_id`, and yield each once the servo holds it.

    Torque goes off first and stays off. The id and then the baud rate come last, and the line
    follows to the new rate. Whoever stops between two leaves nothing half-written, and the EEPROM
    locked. Raises ServoError when the servo does not keep a value, or its lock.
    """
    if not changes:
        return
    lock = model.dialect.registers["lock"].address
    if not torque_verified(line, servo_id, on=False):
        raise ServoError(f"servo id {servo_id} does not switch its torque off")
    if not write_verified(line, servo_id, lock, b"\0"):
        raise ServoError(
            f"servo id {servo_id} keeps its EEPROM locked: nothing that is written would last; "
            "switch its power off and on, and run it again"
        )
    try:
        for change in sorted(changes, key=lambda each: _LAST.get(each.name, 0)):
            address = model.dialect.registers[change.name].address
            line.write(servo_id, address, model.dialect.encode(change.name, change.wanted))
            if change.name == "id":
                servo_id = change.wanted
            elif change.name == "baud_rate":
                line.baud_rate = baud_rates()[change.wanted]
            kept = read_eeprom(line, servo_id, model)[change.name]
            if kept != change.wanted:
                raise ServoError(
                    f"servo id {servo_id}: {change.name} stays at {kept} although "
                    f"{change.wanted} was written"
                )
            yield change
    finally:
        write_verified(line, servo_id, lock, b"\1")


def find_servos(line: Line, ids: Sequence[int], baud_rate: int) -> Found:
    """Who answers at the face's rate and the factory's; at the others while one of `ids` lacks."""
    found: dict[int, list[tuple[int, bytes]]] = {}
    factory = next(iter(baud_rates().values()))
    rates = list(dict.fromkeys([baud_rate, factory, *baud_rates().values()]))
    for rate, models in scan(line, rates):
        for servo_id, answers in models.items():
            found.setdefault(servo_id, []).append((rate, answers[0]))
        if set(ids) <= set(found) and rates.index(rate) >= rates.index(factory):
            break
    return found


def scan(line: Line, rates: Iterable[int]) -> Iterator[tuple[int, dict[int, list[bytes]]]]:
    """Every rate in turn with the servos found at it. Stop when content."""
    for rate in dict.fromkeys(rates):
        line.baud_rate = rate
        yield rate, line.scan()


def shares_id(line: Line, servo_id: int) -> bool:
    """Whether several servos seem to answer to `servo_id`; False for one that is silent.

    Two of one model say the same of themselves, and not of where they stand.
    """
    n_heard = n_spoilt = 0
    for _ in range(_ASKED):
        answer = line.read(servo_id, STATE, 8)
        n_heard += answer is not None or line.spoilt
        n_spoilt += answer is None and line.spoilt
    return n_heard >= _WHOLE and n_spoilt >= _SPOILT


def plan_chain(
    line: Line, servos: Sequence[MountedServo], found: Found, baud_rate: int
) -> list[Plan]:
    """A plan for every servo in its place. Raises ServoError with a line for each that is not."""
    lines = []
    for servo in servos:
        servo_id, name = servo.joint.servo_id, servo.joint.name
        line.baud_rate = found[servo_id][0][0]
        if len(found[servo_id]) > 1 or shares_id(line, servo_id):
            lines.append(f"{name}: two servos answer to id {servo_id}: {_alone(name)}")
        else:
            lines += _other_model(servo, found[servo_id][0][1])
    if lines:
        raise ServoError("\n".join(lines))
    return [
        _plan(line, servo, servo.joint.servo_id, found[servo.joint.servo_id][0][0], baud_rate)
        for servo in servos
    ]


def plan_alone(line: Line, servo: MountedServo, found: Found, baud_rate: int) -> Plan:
    """A plan for the one servo there is, whatever its id. Raises ServoError unless it is one."""
    name = servo.joint.name
    answers = [(servo_id, *each) for servo_id, all_of_it in found.items() for each in all_of_it]
    if not answers:
        raise ServoError("no servo answers at any rate; check its power and cable")
    if len(answers) > 1:
        raise ServoError(
            f"{len(answers)} servos answer (ids {sorted(each[0] for each in answers)}); "
            f"connect one at a time: {_alone(name)}"
        )
    ((servo_id, rate, model),) = answers
    line.baud_rate = rate
    if shares_id(line, servo_id):
        raise ServoError(f"two servos answer to id {servo_id}: {_alone(name)}")
    other = _other_model(servo, model)
    if other:
        raise ServoError(other[0])
    return _plan(line, servo, servo_id, rate, baud_rate)


def _plan(line: Line, servo: MountedServo, servo_id: int, rate: int, baud_rate: int) -> Plan:
    line.baud_rate = rate
    held = read_eeprom(line, servo_id, servo.model)
    lacking = differences(held, wanted_settings(servo, baud_rate, held))
    return Plan(servo, servo_id, rate, tuple(lacking))


def _other_model(servo: MountedServo, model: bytes) -> list[str]:
    it_is, wanted = model_name(model), servo.model.name
    if it_is == wanted:
        return []
    return [
        f"the servo found for {servo.joint.name!r} is {it_is}, the YAML says {wanted}; "
        "connect the right one, or correct the YAML"
    ]


def _alone(name: str) -> str:
    return f"connect the servo of {name!r} alone and run `lipservo setup-servos {name}`"


#: What is taken back of a servo that another program has set up leaves its middle as it is.
CLEARS_MIDDLE: Final = False


def find_unknown(port: str, first_rate: int) -> tuple[int, dict[int, str]]:
    """The first rate at which anybody answers, and the model of every id there."""
    rates = dict.fromkeys([first_rate, *baud_rates().values()])
    with unhurried_line(port, first_rate) as line:
        for rate in rates:
            line.baud_rate = rate
            found = line.scan()
            if found:
                doubled = [servo_id for servo_id in found if shares_id(line, servo_id)]
                break
        else:
            raise ServoError(f"{port}: no servo answers at any rate; check power and cable")
    if doubled:
        raise ServoError(
            f"two servos answer to id {doubled[0]}: connect one at a time and give each an id of "
            "its own (`lipservo setup-servos`)"
        )
    models = {servo_id: model_name(answers[0]) for servo_id, answers in sorted(found.items())}
    for servo_id, name in models.items():
        if name not in servo_models():
            raise ServoError(f"id {servo_id} is of {name}")
    return rate, models


def foreign_settings(port: str, rate: int, found: Mapping[int, str]) -> dict[int, list[Difference]]:
    """What differs, by id, of servos found with their models; those that are plain are left out.

    Raises PortError, and ServoError for a servo that falls silent.
    """
    differing = {}
    with unhurried_line(port, rate) as line:
        for servo_id, name in found.items():
            held = read_eeprom(line, servo_id, servo_models()[name])
            if "operating_mode" in held:
                plain = {"operating_mode": 0, "phase": held["phase"] & ~MANY_TURNS}
                differing[servo_id] = differences(held, plain)
    return {servo_id: each for servo_id, each in differing.items() if each}


def clear_foreign_settings(
    port: str, rate: int, found: Mapping[int, str], foreign: Mapping[int, Sequence[Difference]]
) -> None:
    """Write what `foreign_settings` found, torque off. Raises PortError, ServoError."""
    with unhurried_line(port, rate) as line:
        for servo_id, changes in foreign.items():
            for _ in set_up(line, servo_id, servo_models()[found[servo_id]], changes):
                pass  # each is read back


def lone_servo(
    port: str, rate: int, servo_id: int, name: str, reach_deg: float
) -> tuple[FeetechBus, Joint, int]:
    """A bus of one servo whose joint has 0 where it stands now; and that place, in ticks."""
    model = servo_models()[name]
    joint = Joint(f"id_{servo_id}", servo_id, -reach_deg, reach_deg, _CAREFUL_DEG_S)
    with unhurried_line(port, rate) as line:
        found = identify(line, MountedServo(joint, model))
    if found is None or found.doubled:
        raise ServoError(f"servo id {servo_id} does not answer as it did")
    dialect = model.dialect
    zero_offset_deg = (found.place - dialect.center) / dialect.positions_per_deg
    servo = MountedServo(joint, model, 1, zero_offset_deg)
    return FeetechBus([servo], SameAdapter(port, rate)), joint, found.place
