"""Setting Feetech servos up: what each should store, with its EEPROM unlocked and locked again."""

from collections.abc import Mapping, Sequence
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
from firmware_bridge.serial_servos.serial_transport import SameAdapter
from firmware_bridge.serial_servos.torque import write_verified

__all__ = ["chain_is_complete"]

_TRIES: Final = 3
#: Top speed of a servo that is moved to see which joint it drives.
_CAREFUL_DEG_S: Final = 60.0
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


_CHAIN: Final = ChainSetup(
    make_line=Line,
    mounted_servos=mounted_servos,
    rates=tuple(baud_rates().values()),
    factory_rate=next(iter(baud_rates().values())),
    slowest_rate=None,
    rate_of=baud_rates,
    answers=lambda line: {each: models[0] for each, models in line.scan().items()},
    shares_id=shares_id,
    model_name=model_name,
    lacking=_lacking,
    unlock=_unlock,
    write=_write,
    read=lambda line, servo_id, model, name: read_eeprom(line, servo_id, model)[name],
    lock=_lock,
)
servos_by_joint, unhurried_line = _CHAIN.servos_by_joint, _CHAIN.unhurried_line
scan, find_servos = _CHAIN.scan, _CHAIN.find_servos
plan_chain, plan_alone, set_up = _CHAIN.plan_chain, _CHAIN.plan_alone, _CHAIN.set_up


#: New servos may have position limits so close to the ends, such as 20 and 1003 of 0 to 1023.
_FACTORY_MARGIN: Final = 20
#: Whether `clear_foreign_settings` also moves the middle of the range: here it does not.
CLEARS_MIDDLE: Final = False


def find_unknown(port: str, first_rate: int) -> tuple[int, dict[int, str]]:
    """Return the first baud rate at which servos answer, and their model names by id.

    For servos that belong to no face yet. first_rate: the rate to try first. If no servo answers,
    all rates are tried once more, since a computer that stalled misses answers. Raises ServoError
    where no servo answers, two have one id or a model is unknown, and PortError.
    """
    rates = list(dict.fromkeys([first_rate, *baud_rates().values()]))
    with unhurried_line(port, first_rate) as line:
        for rate in rates * 2:
            line.baud_rate = rate
            found = line.scan()
            if found:
                doubled = [servo_id for servo_id in found if shares_id(line, servo_id)]
                break
        else:
            raise ServoError(f"{port}: no servo answers at any baud rate; check power and cable")
    if doubled:
        raise ServoError(
            f"two servos answer to id {doubled[0]}: connect one at a time and give each an id of "
            "its own (`lipservo setup-servos`)"
        )
    models = {servo_id: model_name(answers[0]) for servo_id, answers in sorted(found.items())}
    for servo_id, name in models.items():
        if name not in servo_models():
            raise ServoError(f"servo id {servo_id} is of {name}, which is not supported")
    return rate, models


def foreign_settings(port: str, rate: int, found: Mapping[int, str]) -> dict[int, list[Difference]]:
    """Return, by id, registers set by another program that must be reset before a servo is moved.

    They are operating mode, position counts over many turns, and position limits over 20 steps
    from the ends; {} if none is set. found: model name by id. Raises PortError, and ServoError for
    a servo that falls silent.
    """
    differing = {}
    with unhurried_line(port, rate) as line:
        for servo_id, name in found.items():
            held = read_eeprom(line, servo_id, servo_models()[name])
            highest, plain = servo_models()[name].n_positions - 1, {}
            low, high = held["min_position_limit"], held["max_position_limit"]
            if low > _FACTORY_MARGIN or high < highest - _FACTORY_MARGIN:
                plain = {"min_position_limit": 0, "max_position_limit": highest}
            if "operating_mode" in held:
                plain |= {"operating_mode": 0, "phase": held["phase"] & ~MULTI_TURN}
            differing[servo_id] = differences(held, plain)
    return {servo_id: each for servo_id, each in differing.items() if each}


def clear_foreign_settings(
    port: str, rate: int, found: Mapping[int, str], foreign: Mapping[int, Sequence[Difference]]
) -> None:
    """Reset the registers in `foreign`, returned by `foreign_settings`; torque goes off.

    found: model name by id. Raises PortError, ServoError.
    """
    with unhurried_line(port, rate) as line:
        for servo_id, changes in foreign.items():
            for _ in set_up(line, servo_id, servo_models()[found[servo_id]], changes):
                pass  # each is read back


def lone_servo(
    port: str, rate: int, servo_id: int, name: str, reach_deg: float
) -> tuple[FeetechBus, Joint, int]:
    """Return an unopened bus of one servo, its joint, and its present position in encoder steps.

    For moving a servo of no face yet. The joint's 0 degrees are the present position. reach_deg:
    how far the joint may move to each side. name: the servo's model. rate: baud rate. Raises
    PortError, ServoError.
    """
    model = servo_models()[name]
    joint = Joint(f"id_{servo_id}", servo_id, -reach_deg, reach_deg, _CAREFUL_DEG_S)
    with unhurried_line(port, rate) as line:
        found = identify(line, MountedServo(joint, model))
    if found is None or found.doubled:
        raise ServoError(f"servo id {servo_id} stopped answering; check its power and cable")
    dialect = model.dialect
    zero_offset_deg = (found.place - dialect.center) / dialect.positions_per_deg
    servo = MountedServo(joint, model, 1, zero_offset_deg)
    return FeetechBus([servo], SameAdapter(port, rate)), joint, found.place
