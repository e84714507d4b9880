"""Setting Dynamixels up: what each should store in its EEPROM, and how it is written."""

from collections.abc import Iterable, Mapping
from typing import Final

from firmware_bridge.dynamixel.bus import DynamixelBus
from firmware_bridge.dynamixel.control_table import (
    ServoModel,
    baud_rates,
    model_name,
    register,
    servo_models,
)
from firmware_bridge.dynamixel.mounting import MountedServo, mounted_servos
from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.errors import ServoError
from firmware_bridge.joints import SERVO_LIMIT_MARGIN_DEG
from firmware_bridge.serial_servos.provisioning import (
    ChainSetup,
    Difference,
    Foreign,
    chain_is_complete,
    differences,
)

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

    Two servos of one model answer a ping with the same bytes, which may arrive whole or damaged.
    If whole, they spoil each other's answers to a read of their present values.
    """
    n_bad = line.n_bad
    if all(line.ping(servo_id) is None for _ in range(_TRIES)):
        return line.n_bad > n_bad or line.heard_noise
    if len(line.ping_each(servo_id)) > 1:
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


#: Values that a servo of no face yet needs before it is moved for the first time. LeRobot sets
#: a homing offset and drives servos in mode 4; lipservo uses neither.
_PLAIN: Final = {
    "drive_mode": 0, "operating_mode": 3, "homing_offset": 0, "startup_configuration": 0,
    "min_position_limit": 0, "max_position_limit": 4095,
}  # fmt: skip
_POSITION_AND_LIMITS: Final = ("present_position", "min_position_limit", "max_position_limit")


def _foreign(line: Line, servo_id: int, model: ServoModel) -> list[Difference]:
    return differences(read_settings(line, servo_id, model, _PLAIN), _PLAIN)


_CHAIN: Final = ChainSetup(
    kind="dynamixel",
    models=servo_models,
    make_line=Line,
    make_bus=DynamixelBus,
    mounted_servos=mounted_servos,
    rates=SCANNED_RATES,
    factory_rate=_FACTORY_RATE,
    slowest_rate=SCANNED_RATES[-1],
    rate_of=baud_rates,
    answers=_answers,
    shares_id=shares_id,
    model_name=model_name,
    lacking=_lacking,
    foreign=_foreign,
    position_and_limits=lambda line, joint, model: read_settings(
        line, joint.servo_id, model, _POSITION_AND_LIMITS
    ),
    unlock=lambda line, servo_id, model: _write(line, servo_id, model, "torque_enable", 0),
    write=_write,
    read=lambda line, servo_id, model, name: read_settings(line, servo_id, model, [name])[name],
    lock=lambda *_: None,
)
servos_by_joint, unhurried_line = _CHAIN.servos_by_joint, _CHAIN.unhurried_line
scan, locate, find_servos = _CHAIN.scan, _CHAIN.locate, _CHAIN.find_servos
plan_chain, plan_alone, set_up = _CHAIN.plan_chain, _CHAIN.plan_alone, _CHAIN.set_up
find_unknown, lone_servo = _CHAIN.find_unknown, _CHAIN.lone_servo
foreign_settings = _CHAIN.foreign_settings
#: Whether `clear_foreign_settings` also moves the middle of the range, by the homing offset.
CLEARS_MIDDLE: Final = True


def clear_foreign_settings(
    port: str, rate: int, found: Mapping[int, str], foreign: Foreign
) -> None:
    """Do as `ChainSetup.clear_foreign_settings`; refuse a servo in reverse drive mode.

    A range recorded of it would be mirrored. Raises PortError, ServoError.
    """
    for servo_id, changes in foreign.items():
        if any(each.name == "drive_mode" and each.found & 1 for each in changes):
            raise ServoError(
                f"servo id {servo_id} runs in reverse drive mode; set drive mode 0 with Dynamixel "
                "Wizard and record its range again"
            )
    _CHAIN.clear_foreign_settings(port, rate, found, foreign)
