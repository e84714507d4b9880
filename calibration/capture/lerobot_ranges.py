"""Range files of LeRobot, which contain the recorded range of each servo in ticks.

A file contains, for each joint, `id, drive_mode, homing_offset, range_min, range_max` in ticks
(4,096 per turn). Joint degrees need the tick of the neutral besides: without it, the middle of the
range is taken.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from calibration.calibration import CalibrationError
from lipsync.errors import shown

TICKS_A_TURN = 4096
_KEYS = ("id", "drive_mode", "homing_offset", "range_min", "range_max")


@dataclass(frozen=True, slots=True)
class RecordedRange:
    """One joint's recorded range, in encoder ticks, 4,096 per turn, as LeRobot writes them."""

    name: str
    servo_id: int
    reversed: bool
    homing_offset_ticks: int
    least_tick: int
    most_tick: int

    def limits_deg(self, neutral_tick: int | None = None) -> tuple[float, float]:
        """Return both ends of the range in joint degrees from neutral, ascending.

        neutral_tick: the encoder's value at neutral; None: the middle of the range. A reversed
        drive changes both signs, so the ends change places.
        """
        neutral = (self.least_tick + self.most_tick) / 2 if neutral_tick is None else neutral_tick
        ends = [
            (tick - neutral) * 360.0 / TICKS_A_TURN for tick in (self.least_tick, self.most_tick)
        ]
        return (-ends[1], -ends[0]) if self.reversed else (ends[0], ends[1])


def read_ranges(path: Path) -> Mapping[str, RecordedRange]:
    """Return the recorded ranges in a LeRobot JSON file, by joint.

    Raises CalibrationError, with joint and key, for a missing, unreadable or malformed file.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise CalibrationError(f"{path}: no such file") from None
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise CalibrationError(f"{path}: not readable as JSON") from error
    if not isinstance(content, dict) or not content:
        raise CalibrationError(f"{path}: should hold one entry for each joint")
    return {name: _parse(f"{path}: {name}", name, entry) for name, entry in content.items()}


def by_id(ranges: Mapping[str, RecordedRange]) -> dict[int, RecordedRange]:
    """Return the ranges by servo id. Raises CalibrationError where two joints have one id."""
    found: dict[int, RecordedRange] = {}
    for recorded in ranges.values():
        other = found.setdefault(recorded.servo_id, recorded)
        if other is not recorded:
            raise CalibrationError(
                f"{other.name} and {recorded.name} both have id {recorded.servo_id} in the range "
                "file; every servo needs its own"
            )
    return found


def _parse(place: str, name: str, entry: object) -> RecordedRange:
    if not isinstance(entry, dict):
        raise CalibrationError(f"{place}: should hold {', '.join(_KEYS)}")
    values: dict[str, int] = {}
    for key in _KEYS:
        value = entry.get(key)
        if isinstance(value, bool) or not isinstance(value, int):
            raise CalibrationError(f"{place}.{key} is {shown(value)}, expected a whole number")
        values[key] = value
    if not 0 <= values["range_min"] < values["range_max"] < TICKS_A_TURN:
        raise CalibrationError(
            f"{place}: needs 0 <= range_min < range_max <= {TICKS_A_TURN - 1}, got "
            f"{values['range_min']} and {values['range_max']}; record the range again"
        )
    return RecordedRange(
        name,
        values["id"],
        bool(values["drive_mode"]),
        values["homing_offset"],
        values["range_min"],
        values["range_max"],
    )


def check_within_recorded(
    ranges: Mapping[str, RecordedRange], limits_deg: Mapping[str, tuple[float, float]]
) -> None:
    """Raise CalibrationError for a joint without a recorded range, or with limits wider than it.

    limits_deg: of the face, by joint. Only widths are compared: the face's YAML defines the
    neutral.
    """
    for name, (low, high) in limits_deg.items():
        if name not in ranges:
            raise CalibrationError(f"servo {name!r} is not in the range file; record its range")
        least, most = ranges[name].limits_deg()
        if high - low > most - least:
            raise CalibrationError(
                f"servo {name!r}: its limits span {high - low:.0f} deg, its recorded range "
                f"{most - least:.0f}; narrow min_deg and max_deg in the face YAML"
            )
