"""Setting Feetech servos up: what each should store, with its EEPROM unlocked and locked again."""

from collections.abc import Mapping
from typing import Final

from firmware_bridge.errors import ServoError
from firmware_bridge.feetech.bus import FeetechBus
from firmware_bridge.feetech.control_table import (
    EEPROM_SIZE,
    MULTI_TURN,
    STATE,
    ServoModel,
    baud_rates,
    model_name,
    servo_models,
)
from firmware_bridge.feetech.line import Line
from firmware_bridge.feetech.mounting import MountedServo, identify, mounted_servos
from firmware_bridge.feetech.torque import torque_verified
from firmware_bridge.joints import SERVO_LIMIT_MARGIN_DEG, Joint
from firmware_bridge.serial_servos.provisioning import (
    ChainSetup,
    Difference,
    chain_is_complete,
    differences,
)
from firmware_bridge.serial_servos.torque import write_verified

__all__ = ["chain_is_complete"]

_TRIES: Final = 3
#: New servos may have position limits so close to the ends, such as 20 and 1003 of 0 to 1023.
_FACTORY_MARGIN: Final = 20
#: Reads; how many must be answered, and how many of the answers damaged, for two servos at one id.
_REQUESTED, _HEARD, _SPOILT = 6, 5, 4


def wanted_settings(
    servo: MountedServo, baud_rate: int, found: Mapping[str, int]
) -> dict[str, int]:
    """Return the EEPROM values, by register name, that a mounted servo should have.

    Position limits are a margin outside the joint's, within the servo's range. found: the servo's
    present values; of `phase` all bits but the one for many turns are kept.
    """
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
        wanted |= {"operating_mode": 0, "phase": found["phase"] & ~MULTI_TURN}
    return wanted


def read_eeprom(line: Line, servo_id: int, model: ServoModel) -> dict[str, int]:
    """Read a servo's EEPROM registers, by name. Raises ServoError if the servo does not answer."""
    for _ in range(_TRIES):
        answer = line.read(servo_id, 0, EEPROM_SIZE)
        if answer is not None:
            return model.dialect.decode_all(answer.data)
    raise ServoError(f"servo id {servo_id} stopped answering; check its power and cable")


def shares_id(line: Line, servo_id: int) -> bool:
    """Return whether several servos seem to answer to `servo_id`; False if none answers.

    Reads position, load and the like, in which two servos of one model differ, so that they spoil
    each other's answers; answers with the same bytes may arrive whole.
    """
    n_heard = n_spoilt = 0
    for _ in range(_REQUESTED):
        answer = line.read(servo_id, STATE, 8)
        n_heard += answer is not None or line.heard_noise
        n_spoilt += answer is None and line.heard_noise
    return n_heard >= _HEARD and n_spoilt >= _SPOILT


def _lacking(line: Line, servo: MountedServo, servo_id: int, baud_rate: int) -> list[Difference]:
    held = read_eeprom(line, servo_id, servo.model)
    return differences(held, wanted_settings(servo, baud_rate, held))


def _unlock(line: Line, servo_id: int, model: ServoModel) -> None:
    """Switch torque off and unlock the EEPROM. Raises ServoError unless reads confirm both."""
    if not torque_verified(line, servo_id, on=False):
        raise ServoError(f"servo id {servo_id} keeps its torque on; switch its power off and on")
    if not write_verified(line, servo_id, model.dialect.registers["lock"].address, b"\0"):
        raise ServoError(
            f"servo id {servo_id} keeps its EEPROM locked, so no setting would last; switch its "
            "power off and on, then run this command again"
        )


def _lock(line: Line, servo_id: int, model: ServoModel) -> None:
    write_verified(line, servo_id, model.dialect.registers["lock"].address, b"\1")


def _write(line: Line, servo_id: int, model: ServoModel, name: str, value: int) -> None:
    address = model.dialect.registers[name].address
    line.write(servo_id, address, model.dialect.encode(name, value))


def _foreign(line: Line, servo_id: int, model: ServoModel) -> list[Difference]:
    """Return what differs in operating mode, counting over many turns, and position limits.

    Of the limits only those over 20 steps from the ends of the range.
    """
    held, highest = read_eeprom(line, servo_id, model), model.n_positions - 1
    low, high, plain = held["min_position_limit"], held["max_position_limit"], {}
    if low > _FACTORY_MARGIN or high < highest - _FACTORY_MARGIN:
        plain = {"min_position_limit": 0, "max_position_limit": highest}
    if "operating_mode" in held:
        plain |= {"operating_mode": 0, "phase": held["phase"] & ~MULTI_TURN}
    return differences(held, plain)


def _position_and_limits(line: Line, joint: Joint, model: ServoModel) -> dict[str, int]:
    found = identify(line, MountedServo(joint, model))
    if found is None or found.doubled:
        raise ServoError(f"servo id {joint.servo_id} stopped answering; check its power and cable")
    return {**found.eeprom, "present_position": found.place}


_CHAIN: Final = ChainSetup(
    kind="feetech",
    models=servo_models,
    make_line=Line,
    make_bus=FeetechBus,
    mounted_servos=mounted_servos,
    rates=tuple(baud_rates().values()),
    factory_rate=next(iter(baud_rates().values())),
    slowest_rate=None,
    rate_of=baud_rates,
    answers=lambda line: {each: models[0] for each, models in line.scan().items()},
    shares_id=shares_id,
    model_name=model_name,
    lacking=_lacking,
    foreign=_foreign,
    position_and_limits=_position_and_limits,
    unlock=_unlock,
    write=_write,
    read=lambda line, servo_id, model, name: read_eeprom(line, servo_id, model)[name],
    lock=_lock,
)
servos_by_joint, unhurried_line = _CHAIN.servos_by_joint, _CHAIN.unhurried_line
locate, find_servos = _CHAIN.locate, _CHAIN.find_servos
plan_chain, plan_alone, set_up = _CHAIN.plan_chain, _CHAIN.plan_alone, _CHAIN.set_up
find_unknown, lone_servo = _CHAIN.find_unknown, _CHAIN.lone_servo
foreign_settings = _CHAIN.foreign_settings
clear_foreign_settings = _CHAIN.clear_foreign_settings
#: Whether `clear_foreign_settings` also moves the middle of the range: here it does not.
CLEARS_MIDDLE: Final = False
