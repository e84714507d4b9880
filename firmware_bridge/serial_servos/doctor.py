"""What `doctor` finds at the servos of a chain, of whichever family; nothing here sends packets."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from firmware_bridge.bus import describe_errors
from firmware_bridge.bus_kinds import Finding, Severity
from firmware_bridge.errors import ServoError
from firmware_bridge.joints import Joint
from firmware_bridge.serial_servos.mounting import SETUP
from firmware_bridge.serial_servos.provisioning import Difference

#: A servo is reported as warm this close to its temperature limit, degC.
_WARM_DEGC: Final = 10


@dataclass(frozen=True, slots=True)
class ServoCondition:
    """The condition of one servo, read from its registers. errors: bits of `HardwareError`.

    differences: between its EEPROM and what the face needs.
    """

    firmware: str
    volts: float
    least_v: float
    most_v: float
    warmth_degc: int
    hottest_degc: int
    errors: int
    torque_on: bool
    differences: Sequence[Difference]


def servo_findings(
    joint: Joint,
    model: str,
    seen: tuple[int, str] | None,
    wanted_rate: int,
    condition: Callable[[], ServoCondition],
) -> Iterator[Finding]:
    """Yield findings for `lipservo doctor` about the servo of `joint`, which should be a `model`.

    seen: (baud rate, model) with which the servo answered; None: it did not answer. wanted_rate:
    the YAML's baud rate. condition: called only for the right model at the right rate, to read the
    servo's condition; raises ServoError if the servo stops answering.
    """
    name = f"{joint.name} (id {joint.servo_id})"
    if seen is None:
        remedy = f"check its cable and power, or {SETUP}"
        yield Finding(Severity.BAD, f"{name} does not answer", remedy)
        return
    rate, found = seen
    if rate != wanted_rate:
        what = f"{name} answers at {rate:,} baud, the YAML says {wanted_rate:,}"
        yield Finding(Severity.BAD, what, SETUP)
        return
    if found != model:
        what = f"{name} is {found}, the YAML says {model}"
        yield Finding(Severity.BAD, what, "correct the YAML")
        return
    try:
        now = condition()
    except ServoError as error:
        yield Finding(Severity.BAD, str(error), "check its cable")
        return
    what = f"{name}: {model}, firmware {now.firmware}, {now.volts:.1f} V, {now.warmth_degc} degC"
    yield Finding(Severity.GOOD, what)
    if not now.least_v <= now.volts <= now.most_v:
        what = f"{name} has {now.volts:.1f} V, needs {now.least_v:g}..{now.most_v:g}"
        yield Finding(Severity.BAD, what, "check the supply")
    if now.warmth_degc > now.hottest_degc - _WARM_DEGC:
        what = f"{name} is at {now.warmth_degc} degC, switches off at {now.hottest_degc}"
        yield Finding(Severity.WARNING, what, "let it cool, and look for a joint that binds")
    if now.errors:
        what = f"{name} reports {describe_errors(now.errors)}"
        yield Finding(Severity.BAD, what, "remove the cause, then power it off and on")
    if now.torque_on:
        what = f"{name} has torque on"
        yield Finding(Severity.WARNING, what, "is another program driving the face?")
    for difference in now.differences:
        yield Finding(Severity.BAD, f"{name}: {difference}", SETUP)


def shared_id(name: str) -> Finding:
    """Return the finding that two servos seem to have one id. name: of servo or id."""
    what = f"answers of {name} are spoilt: two servos may have this id"
    return Finding(Severity.BAD, what, f"connect one of them alone and {SETUP}")


def strangers(seen: Mapping[int, tuple[int, str]], ids: Sequence[int]) -> Iterator[Finding]:
    """Yield a finding for each servo, by id, that answers and is not one of the face's `ids`."""
    for each in sorted(set(seen) - set(ids)):
        what = f"id {each} ({seen[each][1]}) is on the bus but not in the YAML"
        yield Finding(Severity.WARNING, what, "add it to the YAML, or unplug it")
