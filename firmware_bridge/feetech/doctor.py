"""Checks of everything that can be wrong between a computer and its Feetech servos; only reads."""

from collections.abc import Iterator, Sequence
from typing import Final

from firmware_bridge.bus import describe_errors
from firmware_bridge.bus_kinds import Finding, Severity, other_kind_at
from firmware_bridge.feetech.bus import budget
from firmware_bridge.feetech.control_table import (
    CONTROL,
    STATE,
    TORQUE_ENABLE,
    baud_rates,
    model_name,
)
from firmware_bridge.feetech.line import Line
from firmware_bridge.feetech.mounting import MountedServo
from firmware_bridge.feetech.present_state import hardware_errors
from firmware_bridge.feetech.provisioning import read_eeprom, scan, shares_id, wanted_settings
from firmware_bridge.serial_servos.mounting import SETUP
from firmware_bridge.serial_servos.provisioning import differences

_WARM_DEGC: Final = 10
_DEAD_COMPUTER: Final = (
    "these servos have no watchdog: when the computer dies they hold at the goal sent last"
)


def examine(line: Line, servos: Sequence[MountedServo], rate_hz: float) -> Iterator[Finding]:
    """Yield findings about port and servos in the order of the checks; write to no servo.

    line: one that waits `UNHURRIED_S` for late answers. rate_hz: ticks a second that the bus should
    manage.
    """
    wanted_rate = line.baud_rate
    ids = [servo.joint.servo_id for servo in servos]
    at_rate: dict[int, tuple[int, bytes]] = {}
    rates = [wanted_rate, *baud_rates().values()]
    spoilt = False
    for rate, found in scan(line, rates):
        at_rate |= {each: (rate, model) for each, model in found.items() if each not in at_rate}
        spoilt |= line.heard_noise
        if set(ids) <= set(at_rate):
            break
    line.baud_rate = wanted_rate
    if not at_rate and not spoilt:
        other = other_kind_at(line.transport, "feetech")
        tried = ", ".join(f"{rate:,}" for rate in dict.fromkeys(rates))
        what = other or f"no servo answers at any of {tried} baud"
        yield Finding(Severity.BAD, what, "" if other else "check power and data cable")
        return
    for servo in servos:
        yield from _servo(line, servo, at_rate.get(servo.joint.servo_id), wanted_rate)
    for each in sorted(set(at_rate) - set(ids)):
        what = f"id {each} ({model_name(at_rate[each][1])}) is on the bus but not in the YAML"
        yield Finding(Severity.WARNING, what, "add it to the YAML, or unplug it")
    slow = budget(servos, wanted_rate, rate_hz)
    can = f"{len(servos)} servos at {wanted_rate:,} baud can do {rate_hz:g} Hz with feedback"
    yield Finding(Severity.BAD, slow) if slow else Finding(Severity.GOOD, can)
    yield Finding(Severity.WARNING, _DEAD_COMPUTER, "have a switch in the servos' supply at hand")


def _servo(
    line: Line, servo: MountedServo, seen: tuple[int, bytes] | None, wanted_rate: int
) -> Iterator[Finding]:
    servo_id, model = servo.joint.servo_id, servo.model
    name = f"{servo.joint.name} (id {servo_id})"
    if shares_id(line, servo_id):
        what = f"answers of {name} are spoilt: two servos may have this id"
        remedy = f"connect one of them alone and {SETUP} {servo.joint.name}"
        yield Finding(Severity.BAD, what, remedy)
        return
    if seen is None:
        remedy = f"check its cable and power, or {SETUP}"
        yield Finding(Severity.BAD, f"{name} does not answer", remedy)
        return
    rate, number = seen
    if rate != wanted_rate:
        what = f"{name} answers at {rate:,} baud, the YAML says {wanted_rate:,}"
        yield Finding(Severity.BAD, what, SETUP)
        return
    if model_name(number) != model.name:
        what = f"{name} is {model_name(number)}, the YAML says {model.name}"
        yield Finding(Severity.BAD, what, "correct the YAML")
        return
    dialect, eeprom = model.dialect, read_eeprom(line, servo_id, model)
    state = line.read(servo_id, STATE, dialect.state_size)
    torque = line.read(servo_id, TORQUE_ENABLE, dialect.control_size)
    if state is None or torque is None:
        yield Finding(Severity.BAD, f"{name} fell silent", "check its cable")
        return
    now = {each: dialect.decode(each, state.data, STATE) for each in _PRESENT}
    volts, warmth = now["present_voltage"] / 10.0, now["present_temperature"]
    firmware = f"{eeprom['firmware_major']}.{eeprom['firmware_minor']}"
    what = f"{name}: {model.name}, firmware {firmware}, {volts:.1f} V, {warmth} degC"
    yield Finding(Severity.GOOD, what)
    low, high = eeprom["min_voltage"] / 10.0, eeprom["max_voltage"] / 10.0
    if not low <= volts <= high:
        what = f"{name} has {volts:.1f} V, needs {low:g}..{high:g}"
        yield Finding(Severity.BAD, what, "check the supply")
    if warmth > eeprom["max_temperature"] - _WARM_DEGC:
        what = f"{name} is at {warmth} degC, switches off at {eeprom['max_temperature']}"
        yield Finding(Severity.WARNING, what, "let it cool, and look for a joint that binds")
    errors = hardware_errors(now["status"])
    if errors:
        what = f"{name} reports {describe_errors(errors)}"
        yield Finding(Severity.BAD, what, "remove the cause, then power it off and on")
    if dialect.decode("torque_enable", torque.data, CONTROL):
        what = f"{name} has torque on"
        yield Finding(Severity.WARNING, what, "is another program driving the face?")
    for difference in differences(eeprom, wanted_settings(servo, line.baud_rate, eeprom)):
        yield Finding(Severity.BAD, f"{name}: {difference}", SETUP)


_PRESENT: Final = ("present_voltage", "present_temperature", "status")
