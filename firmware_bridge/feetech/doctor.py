"""Checks of everything that can be wrong between a computer and its Feetech servos; only reads."""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import Final

from firmware_bridge.bus_kinds import Finding, Severity
from firmware_bridge.errors import ServoError
from firmware_bridge.feetech.bus import budget
from firmware_bridge.feetech.control_table import (
    CONTROL,
    STATE,
    TORQUE_ENABLE,
)
from firmware_bridge.feetech.line import Line
from firmware_bridge.feetech.mounting import MountedServo
from firmware_bridge.feetech.present_state import hardware_errors
from firmware_bridge.feetech.provisioning import locate, read_eeprom, shares_id, wanted_settings
from firmware_bridge.serial_servos.doctor import (
    ServoCondition,
    servo_findings,
    shared_id,
    strangers,
)
from firmware_bridge.serial_servos.provisioning import differences

_DEAD_COMPUTER: Final = (
    "these servos have no watchdog: when the computer dies they hold at the goal sent last"
)


def examine(line: Line, servos: Sequence[MountedServo], rate_hz: float) -> Iterator[Finding]:
    """Yield findings about port and servos in the order of the checks; write to no servo.

    line: open at the YAML's baud rate, and with longer waits than a control loop allows. rate_hz:
    ticks a second that the bus should manage.
    """
    wanted_rate = line.baud_rate
    ids = [servo.joint.servo_id for servo in servos]
    at_rate, no_answer = locate(line, ids)
    if no_answer is not None:
        yield no_answer
        return
    for servo in servos:
        joint = servo.joint
        if shares_id(line, joint.servo_id):
            yield shared_id(f"{joint.name} (id {joint.servo_id})")
            continue
        seen, condition = at_rate.get(joint.servo_id), partial(_condition, line, servo)
        yield from servo_findings(joint, servo.model.name, seen, wanted_rate, condition)
    yield from strangers(at_rate, ids)
    slow = budget(servos, wanted_rate, rate_hz)
    can = f"{len(servos)} servos at {wanted_rate:,} baud can do {rate_hz:g} Hz with feedback"
    yield Finding(Severity.BAD, slow) if slow else Finding(Severity.GOOD, can)
    yield Finding(Severity.WARNING, _DEAD_COMPUTER, "have a switch in the servos' supply at hand")


def _condition(line: Line, servo: MountedServo) -> ServoCondition:
    """Read and return a servo's condition. Raises ServoError if the servo stops answering."""
    servo_id, model = servo.joint.servo_id, servo.model
    dialect, eeprom = model.dialect, read_eeprom(line, servo_id, model)
    state = line.read(servo_id, STATE, dialect.state_size)
    torque = line.read(servo_id, TORQUE_ENABLE, dialect.control_size)
    if state is None or torque is None:
        raise ServoError(f"servo id {servo_id} stopped answering; check its power and cable")
    now = {each: dialect.decode(each, state.data, STATE) for each in _PRESENT}
    return ServoCondition(
        firmware=f"{eeprom['firmware_major']}.{eeprom['firmware_minor']}",
        volts=now["present_voltage"] / 10.0,
        least_v=eeprom["min_voltage"] / 10.0,
        most_v=eeprom["max_voltage"] / 10.0,
        warmth_degc=now["present_temperature"],
        hottest_degc=eeprom["max_temperature"],
        errors=hardware_errors(now["status"]),
        torque_on=bool(dialect.decode("torque_enable", torque.data, CONTROL)),
        differences=differences(eeprom, wanted_settings(servo, line.baud_rate, eeprom)),
    )


_PRESENT: Final = ("present_voltage", "present_temperature", "status")
