"""Setting servos up: what each should hold in its EEPROM, what differs, and writing just that.

The only place that writes EEPROM: torque off, only differences, all of it read back.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from firmware_bridge.bus import ServoError
from firmware_bridge.dynamixel.control_table import ServoModel, baud_rates
from firmware_bridge.dynamixel.mounting import MountedServo
from firmware_bridge.dynamixel.units import PULSES_PER_DEG, PULSES_PER_TURN
from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.joints import SERVO_LIMIT_MARGIN_DEG

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
