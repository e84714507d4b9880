"""Range files of LeRobot, which contain the recorded range of each servo in ticks.

A file contains, for each joint, `id, drive_mode, homing_offset, range_min, range_max` in ticks,
which are the steps of the servo's own position register: the model of the servo says how many there
are, and how many make a degree.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from calibration.calibration import CalibrationError
from lipsync.errors import shown

#: Of Feetech; Dynamixels have one less.
_HIGHEST_ID = 253
_WHOLE_SHARE = 0.99
_KEYS = ("id", "drive_mode", "homing_offset", "range_min", "range_max")


@dataclass(frozen=True, slots=True)
class RecordedRange:
    """One joint's recorded range, in steps of its servo, as LeRobot writes them."""

    name: str
    servo_id: int
    homing_offset_ticks: int
    least_tick: int
    most_tick: int

    def is_whole(self, n_positions: int) -> bool:
        """Return whether the range is all positions of its servo: it was not recorded by hand."""
        return self.most_tick - self.least_tick >= _WHOLE_SHARE * (n_positions - 1)


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
        raise CalibrationError(f"{path}: must have one entry for each joint")
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
    """Return the recorded range in one joint's `entry` of the JSON file.

    place: file and joint, for messages. Raises CalibrationError for a missing key or a value that
    is out of range or no whole number.
    """
    if not isinstance(entry, dict):
        raise CalibrationError(f"{place}: must have the keys {', '.join(_KEYS)}")
    values: dict[str, int] = {}
    for key in _KEYS:
        value = entry.get(key)
        if isinstance(value, bool) or not isinstance(value, int):
            raise CalibrationError(f"{place}.{key} is {shown(value)}, expected a whole number")
        values[key] = value
    if not 0 <= values["range_min"] < values["range_max"]:
        raise CalibrationError(
            f"{place}: needs 0 <= range_min < range_max, got {values['range_min']} and "
            f"{values['range_max']}; record the range again"
        )
    if not 0 <= values["id"] <= _HIGHEST_ID:
        raise CalibrationError(f"{place}.id is {values['id']}; ids are 0 to {_HIGHEST_ID}")
    del values["drive_mode"]
    return RecordedRange(name, *values.values())
