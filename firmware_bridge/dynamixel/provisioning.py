"""Setting Dynamixels up: what each should store in its EEPROM, and how it is written.

Also: servos that belong to no face yet are found, taken over from another program, and moved.
"""

from collections.abc import Iterable, Mapping
from typing import Final

from firmware_bridge.dynamixel.bus import DynamixelBus
from firmware_bridge.dynamixel.control_table import (
    ServoModel,
    baud_rates,
    model_by_number,
    model_name,
    register,
    servo_models,
)
from firmware_bridge.dynamixel.mounting import MountedServo, mounted_servos
from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.errors import ServoError
from firmware_bridge.joints import SERVO_LIMIT_MARGIN_DEG, Joint
from firmware_bridge.serial_servos.provisioning import (
    ChainSetup,
    Difference,
    chain_is_complete,
    differences,
)
from firmware_bridge.serial_servos.serial_transport import SameAdapter

__all__ = ["chain_is_complete"]

#: Baud rates worth trying, the likely ones first.
SCANNED_RATES: Final = (
    57_600, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000, 115_200, 9_600,
)  # fmt: skip
#: A new servo answers here, whatever rate the chain has.
_FACTORY_RATE: Final = 57_600
#: How much longer to wait for the answer to a write of EEPROM. Not in the manual; generous.
_EEPROM_WRITE_S: Final = 0.05
_TRIES: Final = 3


def wanted_settings(servo: MountedServo, baud_rate: int) -> dict[str, int]:
    """Return the EEPROM values, by register name, that a mounted servo should have.

    Position limits are a margin outside the joint's, within the servo's range. Operating mode 5,
    with `current_limit`, only for a servo with max_current_ma, else mode 3.
    """
    low, high = servo.pulse_range()
    margin = round(SERVO_LIMIT_MARGIN_DEG * servo.model.pulses_per_deg)
    code = next(code for code, rate in baud_rates().items() if rate == baud_rate)
    cap = servo.current_cap
    return {
        "id": servo.joint.servo_id,
        "baud_rate": code,
        "return_delay_time": 0,
        "drive_mode": 0,
        "operating_mode": 3 if cap is None else 5,
        "homing_offset": 0,
        "max_position_limit": min(high + margin, servo.model.n_positions - 1),
        "min_position_limit": max(low - margin, 0),
        "startup_configuration": 0,
        "shutdown": servo.model.defaults["shutdown"],
        **({} if cap is None else {"current_limit": cap}),
    }


def read_settings(
    line: Line, servo_id: int, model: ServoModel, names: Iterable[str]
) -> dict[str, int]:
    """Read the registers `names` of a servo of this model; return their values by name.

    Raises ServoError when the servo does not answer.
    """
    found = {}
    for name in names:
        entry = model.registers[name]
        for _ in range(_TRIES):
            answer = line.read(servo_id, entry.address, entry.size)
            if answer is not None and len(answer.data) == entry.size:
                found[name] = entry.decode(answer.data)
                break
        else:
            raise ServoError(f"servo id {servo_id} stopped answering; check power and cable")
    return found


def duplicates(line: Line, ids: Iterable[int]) -> list[int]:
    """Return those of `ids` from which only damaged answers arrive: two servos may have the id.

    Pings each id up to three times; an id without any answer is not returned.
    """
    doubtful = []
    for servo_id in ids:
        n_bad = line.n_bad
        silent = all(line.ping(servo_id) is None for _ in range(_TRIES))
        if silent and (line.n_bad > n_bad or line.heard_noise):
            doubtful.append(servo_id)
    return doubtful


def _write(line: Line, servo_id: int, model: ServoModel, name: str, value: int) -> None:
    """Write `value` to register `name` of one servo.

    Raises ServoError when the servo refuses, or does not answer three times. Silence is accepted
    for id and baud rate: the servo may no longer answer at the old one.
    """
    entry = model.registers[name]
    for _ in range(_TRIES):
        status = line.write(servo_id, entry.address, entry.encode(value), _EEPROM_WRITE_S)
        if status is not None:
            if status.error & 0x7F:
                raise ServoError(
                    f"servo id {servo_id} rejects {name} = {value} (error {status.error & 0x7F})"
                )
            return
    if name not in ("id", "baud_rate"):
        raise ServoError(f"servo id {servo_id} did not confirm {name}; check power and cable")


#: realtime_tick to present_temperature: values that differ between two servos of one model.
_PRESENT: Final = register("realtime_tick").address
_PRESENT_SIZE: Final = register("present_temperature").end - _PRESENT
#: Requests of each kind; answers to pings that must be whole, and to reads that must be spoilt, to
#: conclude that two servos have one id.
_REQUESTED, _WHOLE, _SPOILT = 6, 5, 4


def shares_id(line: Line, servo_id: int) -> bool:
    """Return whether several servos seem to answer to `servo_id`; False if none answers.

    Two servos of one model answer a ping with the same bytes, which may arrive whole, but spoil
    each other's answers to a read of their present values.
    """
    pongs = line.ping_each(servo_id)
    if len(pongs) > 1:
        return True
    n_whole = n_spoilt = 0
    for _ in range(_REQUESTED):
        n_whole += line.ping(servo_id) is not None
        n_bad = line.n_bad
        answer = line.read(servo_id, _PRESENT, _PRESENT_SIZE)
        n_spoilt += answer is None and (line.n_bad > n_bad or line.heard_noise)
    return n_whole >= _WHOLE and n_spoilt >= _SPOILT


def _lacking(line: Line, servo: MountedServo, servo_id: int, baud_rate: int) -> list[Difference]:
    wanted = wanted_settings(servo, baud_rate)
    return differences(read_settings(line, servo_id, servo.model, wanted), wanted)


def _answers(line: Line) -> dict[int, int]:
    line.transport.discard_input()
    return {s.servo_id: int.from_bytes(s.data[:2], "little") for s in line.ping_all()}


_CHAIN: Final = ChainSetup(
    make_line=Line,
    mounted_servos=mounted_servos,
    rates=SCANNED_RATES,
    factory_rate=_FACTORY_RATE,
    slowest_rate=SCANNED_RATES[-1],
    rate_of=baud_rates,
    answers=_answers,
    shares_id=lambda line, each: bool(duplicates(line, [each])) or shares_id(line, each),
    model_name=model_name,
    lacking=_lacking,
    unlock=lambda line, servo_id, model: _write(line, servo_id, model, "torque_enable", 0),
    write=_write,
    read=lambda line, servo_id, model, name: read_settings(line, servo_id, model, [name])[name],
    lock=lambda *_: None,
)
servos_by_joint, unhurried_line = _CHAIN.servos_by_joint, _CHAIN.unhurried_line
scan, find_servos = _CHAIN.scan, _CHAIN.find_servos
plan_chain, plan_alone, set_up = _CHAIN.plan_chain, _CHAIN.plan_alone, _CHAIN.set_up


#: Values that a servo of no face yet needs before it is moved for the first time. LeRobot sets
#: a homing offset and drives servos in mode 4; lipservo uses neither.
_PLAIN = {
    "drive_mode": 0, "operating_mode": 3, "homing_offset": 0, "startup_configuration": 0,
    "min_position_limit": 0, "max_position_limit": 4095,
}  # fmt: skip


#: Whether `clear_foreign_settings` also moves the middle of the range, by the homing offset.
CLEARS_MIDDLE: Final = True


def find_unknown(port: str, first_rate: int) -> tuple[int, dict[int, str]]:
    """Return the first baud rate at which servos answer, and their model names by id.

    For servos that belong to no face yet. first_rate: the rate to try first. Raises ServoError
    where no servo answers or a model is unknown, and PortError.
    """
    with unhurried_line(port, first_rate) as line:
        scanned = scan(line, [first_rate, *SCANNED_RATES])
        rate, found = next((each for each in scanned if each[1]), (0, {}))
    if not found:
        raise ServoError(
            f"{port}: no Dynamixel answers at any baud rate; check power and cable; for servos of "
            "another kind give --bus, such as --bus feetech"
        )
    models = {each: model_by_number(number) for each, number in sorted(found.items())}
    unknown = [each for each, model in models.items() if model is None]
    if unknown:
        raise ServoError(f"servo id {unknown[0]}: model {found[unknown[0]]} is not supported")
    return rate, {each: model.name for each, model in models.items() if model is not None}


def foreign_settings(port: str, rate: int, found: Mapping[int, str]) -> dict[int, list[Difference]]:
    """Return, by id, registers set by another program that must be reset before a servo is moved.

    They are drive mode, operating mode, homing offset, startup configuration and position limits;
    {} if all have their factory values. found: model name by id. Raises PortError, and ServoError
    for a servo that falls silent.
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
    """Reset the registers in `foreign`, returned by `foreign_settings`; torque goes off.

    found: model name by id. Raises PortError, ServoError. A servo in reverse drive mode raises
    ServoError: a range recorded of it would be mirrored.
    """
    for servo_id, changes in foreign.items():
        if any(each.name == "drive_mode" and each.found & 1 for each in changes):
            raise ServoError(
                f"servo id {servo_id} runs in reverse drive mode; set drive mode 0 with Dynamixel "
                "Wizard and record its range again"
            )
    with unhurried_line(port, rate) as line:
        for servo_id, changes in foreign.items():
            for _ in set_up(line, servo_id, servo_models()[found[servo_id]], changes):
                pass  # each is read back


def lone_servo(
    port: str, rate: int, servo_id: int, model_name: str, reach_deg: float
) -> tuple[DynamixelBus, Joint, int]:
    """Return an unopened bus of one servo, its joint, and its present position in encoder steps.

    For moving a servo of no face yet. The joint's 0 degrees are the present position. reach_deg:
    how far the joint may move to each side. rate: baud rate. Raises PortError, ServoError.
    """
    model = servo_models()[model_name]
    with unhurried_line(port, rate) as line:
        place = read_settings(line, servo_id, model, ["present_position"])["present_position"]
    joint = Joint(f"id_{servo_id}", servo_id, -reach_deg, reach_deg, 60.0)
    offset_deg = (place - model.center_pulse) / model.pulses_per_deg
    servo = MountedServo(joint, model, 1, offset_deg)
    return DynamixelBus([servo], SameAdapter(port, rate)), joint, place
