"""Setting servos up: what each should hold in its EEPROM, what differs, and writing just that.

The only place that writes EEPROM: torque off, only differences, all of it read back. Servos that
belong to no face yet are found, taken over from another program, and moved a little, here too.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final

from firmware_bridge.bus_kinds import Wiring
from firmware_bridge.dynamixel.bus import DynamixelBus
from firmware_bridge.dynamixel.control_table import (
    CENTER_PULSE,
    PULSES_PER_DEG,
    PULSES_PER_TURN,
    ServoModel,
    baud_rates,
    model_by_number,
    register,
    servo_models,
)
from firmware_bridge.dynamixel.mounting import MountedServo, mounted_servos
from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.dynamixel.wire.serial_transport import SameAdapter, open_port
from firmware_bridge.errors import ServoError
from firmware_bridge.joints import SERVO_LIMIT_MARGIN_DEG, Joint

#: Rates worth trying, the likely ones first: asked for, factory, usual ones.
SCANNED_RATES: Final = (57_600, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 115_200, 9_600)
#: Not in the manual; generous.
_EEPROM_WRITE_S: Final = 0.05
_TRIES: Final = 3
#: An answer that comes this late is still waited for, outside the loop: setting up, examining.
UNHURRIED_S: Final = 0.06
#: What changes how a servo is spoken to is written last, in this order.
_LAST: Final = {"id": 1, "baud_rate": 2}
_LOW, _HIGH = "min_position_limit", "max_position_limit"


@dataclass(frozen=True, slots=True)
class Difference:
    """One register that does not hold what it should."""

    name: str
    found: int
    wanted: int

    def __str__(self) -> str:
        return f"{self.name} is {self.found}, should be {self.wanted}"


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


def wanted_settings(servo: MountedServo, baud_rate: int) -> dict[str, int]:
    """EEPROM values by register name for a servo in its place."""
    low, high = servo.pulse_range()
    margin = round(SERVO_LIMIT_MARGIN_DEG * PULSES_PER_DEG)
    code = next(code for code, rate in baud_rates().items() if rate == baud_rate)
    cap = servo.current_cap
    return {
        "id": servo.joint.servo_id,
        "baud_rate": code,
        "return_delay_time": 0,
        "drive_mode": 0,
        "operating_mode": 3 if cap is None else 5,
        "homing_offset": 0,
        "max_position_limit": min(high + margin, PULSES_PER_TURN - 1),
        "min_position_limit": max(low - margin, 0),
        "startup_configuration": 0,
        "shutdown": servo.model.defaults["shutdown"],
        **({} if cap is None else {"current_limit": cap}),
    }


def differences(found: Mapping[str, int], wanted: Mapping[str, int]) -> list[Difference]:
    """What must be written, in the order of `wanted`."""
    return [
        Difference(name, found[name], value)
        for name, value in wanted.items()
        if found[name] != value
    ]


def read_settings(
    line: Line, servo_id: int, model: ServoModel, names: Iterable[str]
) -> dict[str, int]:
    """The values of these registers. Raises ServoError when the servo does not answer."""
    found = {}
    for name in names:
        entry = model.registers[name]
        for _ in range(_TRIES):
            answer = line.read(servo_id, entry.address, entry.size)
            if answer is not None and len(answer.data) == entry.size:
                found[name] = entry.decode(answer.data)
                break
        else:
            raise ServoError(f"servo id {servo_id} fell silent while {name} was read")
    return found


def set_up(
    line: Line, servo_id: int, model: ServoModel, changes: Sequence[Difference]
) -> Iterator[Difference]:
    """Write `changes` to the servo at `servo_id`, and yield each once the servo holds it.

    Torque goes off first and stays off. Of both position limits the one comes first that keeps them
    in order: servos refuse a lower limit above the upper one. The id and then the baud rate come
    last, and the line follows to the new rate. Whoever stops between two leaves nothing
    half-written. Raises ServoError when the servo refuses or does not keep a value.
    """
    if changes:
        _write(line, servo_id, model, "torque_enable", 0)
    for change in sorted(_limits_in_order(changes), key=lambda each: _LAST.get(each.name, 0)):
        _write(line, servo_id, model, change.name, change.wanted)
        if change.name == "id":
            servo_id = change.wanted
        elif change.name == "baud_rate":
            line.baud_rate = baud_rates()[change.wanted]
        kept = read_settings(line, servo_id, model, [change.name])[change.name]
        if kept != change.wanted:
            raise ServoError(
                f"servo id {servo_id}: {change.name} stays at {kept} although "
                f"{change.wanted} was written"
            )
        yield change


def _limits_in_order(changes: Sequence[Difference]) -> list[Difference]:
    """The same, the lower limit before the upper one where the range moves down.

    Upwards the upper limit makes way, downwards the lower one.
    """
    by_name = {change.name: change for change in changes}
    low, high = by_name.get(_LOW), by_name.get(_HIGH)
    if low is None or high is None:
        return list(changes)
    first, second = (low, high) if high.wanted < low.found else (high, low)
    others = [change for change in changes if change not in (low, high)]
    return [*others, first, second]


def scan(line: Line, rates: Iterable[int] = SCANNED_RATES) -> Iterator[tuple[int, dict[int, int]]]:
    """Every rate in turn with the servos found at it, {id: model number}. Stop when content."""
    for rate in dict.fromkeys(rates):
        line.baud_rate = rate
        line.transport.discard_input()
        found = {s.servo_id: int.from_bytes(s.data[:2], "little") for s in line.ping_all()}
        yield rate, found


def duplicates(line: Line, ids: Iterable[int]) -> list[int]:
    """Ids on which answers come spoilt, again and again: two servos speak at once."""
    doubtful = []
    for servo_id in ids:
        n_bad = line.n_bad
        silent = all(line.ping(servo_id) is None for _ in range(_TRIES))
        if silent and (line.n_bad > n_bad or line.heard_noise):
            doubtful.append(servo_id)
    return doubtful


def _write(line: Line, servo_id: int, model: ServoModel, name: str, value: int) -> None:
    """One register. A servo whose id or rate has changed may answer to the old one no more."""
    entry = model.registers[name]
    for _ in range(_TRIES):
        status = line.write(servo_id, entry.address, entry.encode(value), _EEPROM_WRITE_S)
        if status is not None:
            if status.error & 0x7F:
                raise ServoError(
                    f"servo id {servo_id} refuses {name} = {value} (error {status.error & 0x7F})"
                )
            return
    if name not in _LAST:
        raise ServoError(f"servo id {servo_id} does not answer to a write of {name}")


#: realtime_tick .. present_temperature: what differs between two motors.
_PRESENT: Final = register("realtime_tick").address
_PRESENT_SIZE: Final = register("present_temperature").end - _PRESENT
#: So many questions of each kind; so many of one kind whole and of the other spoilt.
_ASKED, _WHOLE, _SPOILT = 6, 5, 4


def shares_id(line: Line, servo_id: int) -> bool:
    """Whether several servos seem to answer to `servo_id`; False for one that is silent."""
    pongs = line.ping_each(servo_id)
    if len(pongs) > 1:
        return True
    n_whole = n_spoilt = 0
    for _ in range(_ASKED):
        n_whole += line.ping(servo_id) is not None
        n_bad = line.n_bad
        answer = line.read(servo_id, _PRESENT, _PRESENT_SIZE)
        n_spoilt += answer is None and (line.n_bad > n_bad or line.heard_noise)
    return n_whole >= _WHOLE and n_spoilt >= _SPOILT


#: A new servo answers here, whatever rate the chain has.
_FACTORY_RATE: Final = 57_600
#: Servos by id: the rate at which each answered, and its model number; more than one when two do.
Found = Mapping[int, Sequence[tuple[int, int]]]


@dataclass(frozen=True, slots=True)
class Plan:
    """What one servo, found at an id and a rate, lacks to be the joint's."""

    servo: MountedServo
    servo_id: int
    baud_rate: int
    changes: tuple[Difference, ...]


def find_servos(line: Line, ids: Sequence[int], baud_rate: int) -> Found:
    """Who answers at the face's rate and the factory's; at the others while one of `ids` lacks.

    The slowest, which takes four seconds, only while nobody answers.
    """
    found: dict[int, list[tuple[int, int]]] = {}
    rates = list(dict.fromkeys([baud_rate, _FACTORY_RATE, *SCANNED_RATES]))
    for rate, numbers in scan(line, rates):
        for servo_id, number in numbers.items():
            found.setdefault(servo_id, []).append((rate, number))
        complete = set(ids) <= set(found) and rates.index(rate) >= rates.index(_FACTORY_RATE)
        if complete or (found and rate == rates[-2]):
            break
    return found


def chain_is_complete(servos: Sequence[MountedServo], found: Found) -> bool:
    """Whether every servo answers at its own id, so that nobody needs to be unplugged."""
    return all(servo.joint.servo_id in found for servo in servos)


def plan_chain(
    line: Line, servos: Sequence[MountedServo], found: Found, baud_rate: int
) -> list[Plan]:
    """A plan for every servo in its place. Raises ServoError with a line for each that is not."""
    lines = []
    for servo in servos:
        servo_id, name = servo.joint.servo_id, servo.joint.name
        answers = found[servo_id]
        line.baud_rate = answers[0][0]
        if len(answers) > 1:
            rates = " and at ".join(f"{rate:,}" for rate, _ in answers)
            lines.append(f"{name}: id {servo_id} answers at {rates} baud: {_alone(name)}")
        elif shares_id(line, servo_id):
            lines.append(f"{name}: two servos answer to id {servo_id}: {_alone(name)}")
        else:
            lines.extend(_other_model(servo, answers[0][1]))
    if lines:
        raise ServoError("\n".join(lines))
    return [
        _plan(line, servo, servo.joint.servo_id, found[servo.joint.servo_id][0][0], baud_rate)
        for servo in servos
    ]


def plan_alone(line: Line, servo: MountedServo, found: Found, baud_rate: int) -> Plan:
    """A plan for the one servo there is, whatever its id. Raises ServoError unless it is one."""
    name = servo.joint.name
    if not found:
        raise ServoError("no servo answers at any rate; check its power and cable")
    answers = [(servo_id, *each) for servo_id, all_of_it in found.items() for each in all_of_it]
    if len(answers) > 1:
        missing = f"{name} (id {servo.joint.servo_id}) does not answer; "
        raise ServoError(
            f"{'' if servo.joint.servo_id in found else missing}{len(answers)} servos answer "
            f"(ids {sorted(each[0] for each in answers)}); connect one at a time: {_alone(name)}"
        )
    ((servo_id, rate, number),) = answers
    line.baud_rate = rate
    spoilt = duplicates(line, [servo.joint.servo_id]) if servo_id != servo.joint.servo_id else []
    if spoilt or shares_id(line, servo_id):
        each = spoilt[0] if spoilt else servo_id
        raise ServoError(f"two servos answer to id {each}: {_alone(name)}")
    other = _other_model(servo, number)
    if other:
        raise ServoError(other[0])
    return _plan(line, servo, servo_id, rate, baud_rate)


def _plan(line: Line, servo: MountedServo, servo_id: int, rate: int, baud_rate: int) -> Plan:
    line.baud_rate = rate
    wanted = wanted_settings(servo, baud_rate)
    lacking = differences(read_settings(line, servo_id, servo.model, wanted), wanted)
    return Plan(servo, servo_id, rate, tuple(lacking))


def _other_model(servo: MountedServo, number: int) -> list[str]:
    if number == servo.model.model_number:
        return []
    known = model_by_number(number)
    it_is = known.name if known else f"of unknown model {number}"
    return [
        f"the servo found for {servo.joint.name!r} is {it_is}, the YAML says {servo.model.name}; "
        "connect the right one, or correct the YAML"
    ]


def _alone(name: str) -> str:
    return f"connect the servo of {name!r} alone and run `lipservo setup-servos {name}`"


#: What a servo of no face yet must hold before it is moved for the first time: LeRobot homes it by
#: its homing offset and drives it in mode 4; a face of ours uses neither.
_PLAIN = {"drive_mode": 0, "operating_mode": 3, "homing_offset": 0, "startup_configuration": 0}


#: What is taken back of a servo that another program has set up is its middle, too.
CLEARS_MIDDLE: Final = True


def find_unknown(port: str, first_rate: int) -> tuple[int, dict[int, str]]:
    """The first rate at which anybody answers, and the model of every id there."""
    with unhurried_line(port, first_rate) as line:
        scanned = scan(line, [first_rate, *SCANNED_RATES])
        rate, found = next((each for each in scanned if each[1]), (0, {}))
    if not found:
        raise ServoError(
            f"{port}: no Dynamixel answers at any rate; check power and cable; servos of another "
            "kind: say so: --bus feetech"
        )
    models = {each: model_by_number(number) for each, number in sorted(found.items())}
    unknown = [each for each, model in models.items() if model is None]
    if unknown:
        raise ServoError(f"id {unknown[0]} is of unknown model {found[unknown[0]]}")
    return rate, {each: model.name for each, model in models.items() if model is not None}


def foreign_settings(port: str, rate: int, found: Mapping[int, str]) -> dict[int, list[Difference]]:
    """What differs, by id, of servos found with their models; those that are plain are left out.

    Raises PortError, and ServoError for a servo that falls silent.
    """
    with unhurried_line(port, rate) as line:
        held = {
            servo_id: read_settings(line, servo_id, servo_models()[name], _PLAIN)
            for servo_id, name in found.items()
        }
    differing = {servo_id: differences(each, _PLAIN) for servo_id, each in held.items()}
    return {servo_id: each for servo_id, each in differing.items() if each}


def clear_foreign_settings(
    port: str, rate: int, found: Mapping[int, str], foreign: Mapping[int, list[Difference]]
) -> None:
    """Write what `foreign_settings` found, torque off. Raises PortError, ServoError.

    Refuses a servo that turns the other way: what was recorded of it would be mirrored.
    """
    for servo_id, changes in foreign.items():
        if any(each.name == "drive_mode" and each.found & 1 for each in changes):
            raise ServoError(
                f"id {servo_id} runs in reverse drive mode; set drive mode 0 with Dynamixel Wizard "
                "and record its range again"
            )
    with unhurried_line(port, rate) as line:
        for servo_id, changes in foreign.items():
            for _ in set_up(line, servo_id, servo_models()[found[servo_id]], changes):
                pass  # each is read back


def lone_servo(
    port: str, rate: int, servo_id: int, model_name: str, reach_deg: float
) -> tuple[DynamixelBus, Joint, int]:
    """A bus of one servo whose joint has 0 where it stands now; and that place, in ticks."""
    model = servo_models()[model_name]
    with unhurried_line(port, rate) as line:
        place = read_settings(line, servo_id, model, ["present_position"])["present_position"]
    joint = Joint(f"id_{servo_id}", servo_id, -reach_deg, reach_deg, 60.0)
    servo = MountedServo(joint, model, 1, (place - CENTER_PULSE) / PULSES_PER_DEG)
    return DynamixelBus([servo], SameAdapter(port, rate)), joint, place
