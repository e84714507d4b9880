"""Limits that a person has found by hand, as values of a face YAML: pulses in us, and degrees."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Final, Literal, get_args

from firmware_bridge.joints import LONGEST_FOUND_US, SHORTEST_FOUND_US, JointPulse
from lipservo.settings.edited_yaml import EditedYaml, Place, edited, read_face_text
from lipservo.settings.settings import parse_face
from lipservo.settings.strict_yaml import SettingsError
from lipsync.errors import UserError

#: What a person may set to the pulse that a servo is at.
PulseLimit = Literal["min", "max", "neutral"]
PULSE_LIMITS: Final[tuple[PulseLimit, ...]] = get_args(PulseLimit)
#: What a first move beyond the limits may do; said before it.
WARNING: Final = (
    "Beyond its limits a servo may push against its own stop or against the skin: it then hums, "
    "is hot within seconds, and strips gears or tears what it pulls at. Have the supply's switch "
    "in reach, go step by step, and go back at the first hum."
)
#: A joint stays so far inside of where a hand could turn it.
INSIDE_DEG: Final = 2.0
#: A joint that was turned less was not turned.
_LEAST_TURN_DEG: Final = 4.0
#: An end this close to neutral is neutral: a hand and an encoder are no more exact.
_SAME_DEG: Final = 0.5
#: Joint limits are written with one decimal, inside of what was found.
_TENTHS: Final = 10.0


def with_pulse_limit(path: Path, servo: str, limit: PulseLimit, pulse_us: float) -> EditedYaml:
    """Return the face YAML with a hobby servo's `limit` at `pulse_us`, not written yet.

    limit: `min`, `max` or `neutral`. The joint's `min_deg` and `max_deg` become those that the
    pulses then allow. Raises SettingsError for a servo without pulses or a pulse that cannot be
    this limit, and what `edited` raises.
    """
    settings = parse_face(read_face_text(path), path.name).servos.get(servo)
    if settings is None or settings.pulse is None:
        raise SettingsError(f"{path.name}: no hobby servo is called {servo!r}")
    return with_ranges(path, {servo: pulse_values(settings.pulse, limit, pulse_us)})


def pulse_values(pulse: JointPulse, limit: PulseLimit, pulse_us: float) -> dict[str, float]:
    """Return a servo's pulse and angle limits, by YAML key, after `limit` is set to `pulse_us`.

    limit: `min`, `max` or `neutral`. Raises SettingsError for a pulse out of range, or one that
    leaves neutral outside the limits or no range between them.
    """
    if not SHORTEST_FOUND_US <= pulse_us <= LONGEST_FOUND_US:
        raise SettingsError(
            f"{limit}: {pulse_us:g} us is outside {SHORTEST_FOUND_US:g}..{LONGEST_FOUND_US:g} us"
        )
    new = {"min": pulse.min_us, "max": pulse.max_us, "neutral": pulse.neutral_us}
    new[limit] = float(round(pulse_us))
    if not new["min"] <= new["neutral"] <= new["max"]:
        other = "min or max" if limit == "neutral" else "neutral"
        raise SettingsError(
            f"{limit}: {pulse_us:.0f} us would put neutral outside the limits (min "
            f"{new['min']:g}, neutral {new['neutral']:g}, max {new['max']:g} us); set "
            f"{other} first"
        )
    if new["min"] == new["max"]:
        raise SettingsError(f"{limit}: {pulse_us:.0f} us makes min equal max; take another")
    ends_deg = sorted((new[end] - new["neutral"]) / pulse.us_per_deg for end in ("min", "max"))
    low_deg, high_deg = _rounded_inwards(*ends_deg)
    return {
        "min_us": new["min"],
        "max_us": new["max"],
        "neutral_us": new["neutral"],
        "min_deg": low_deg,
        "max_deg": high_deg,
    }


def range_values(least_deg: float, most_deg: float) -> dict[str, float]:
    """Return `min_deg` and `max_deg` for a joint that a hand turned to both extreme angles.

    The limits are `INSIDE_DEG` inside, but never beyond neutral, 0, which may be at an end. Raises
    UserError for a joint that was not turned, or whose range does not include its neutral.
    """
    if not most_deg - least_deg >= _LEAST_TURN_DEG:
        raise UserError("was not turned; turn it to both ends")
    low_deg, high_deg = _rounded_inwards(least_deg + INSIDE_DEG, most_deg - INSIDE_DEG)
    if not least_deg - _SAME_DEG <= 0.0 <= most_deg + _SAME_DEG:
        raise UserError(
            f"was turned from {least_deg:.1f} to {most_deg:.1f} deg, but its neutral, 0, must lie "
            "between; change zero_offset_deg"
        )
    return {"min_deg": min(low_deg, 0.0), "max_deg": max(high_deg, 0.0)}


def turned_values(
    least_deg: float, most_deg: float, neutral_deg: float, zero_offset_deg: float
) -> dict[str, float]:
    """Return a turned joint's new `min_deg`, `max_deg`, and `zero_offset_deg` if it changes.

    least_deg, most_deg: extreme angles; neutral_deg: the angle that becomes 0. zero_offset_deg: of
    the YAML so far. Raises UserError for a joint that was not turned, or whose range does not
    include its neutral.
    """
    limits = range_values(least_deg - neutral_deg, most_deg - neutral_deg)
    offset_deg = round(zero_offset_deg + neutral_deg, 1)
    return limits if offset_deg == zero_offset_deg else {**limits, "zero_offset_deg": offset_deg}


def with_ranges(path: Path, ranges: Mapping[str, Mapping[str, float]]) -> EditedYaml:
    """Return the face YAML with values of servos, {servo: {key: value}}, set; not written yet."""
    places: dict[Place, float] = {}
    for servo, values in ranges.items():
        places |= {("servos", servo, key): value for key, value in values.items()}
    return edited(path, places)


def pose_file(path: Path, step: str = "by_eye") -> Path:
    """Return the file of poses that a `step` of the first hour captured and did not yet fit.

    path: of the face's YAML.
    """
    return path.with_suffix(f".{step}.json")


def forget_poses(path: Path) -> None:
    """Delete captured poses of the face YAML `path`: their degrees are of its former neutral."""
    for step in ("by_eye", "measure"):
        pose_file(path, step).unlink(missing_ok=True)


def own_yaml(config: str) -> Path:
    """Return the path of a user's face YAML; raise UserError if `config` names a shipped face."""
    if not (config.endswith((".yaml", ".yml")) or "/" in config):
        raise UserError(
            f"{config} is shipped with lipservo and stays as it is; make one of your own with "
            "`lipservo new-face`, and start that"
        )
    return Path(config)


def what_next(edit: EditedYaml) -> str:
    """Return words on when the limits in `edit` become valid, and whether to calibrate again."""
    before, after = (parse_face(text, edit.path.name) for text in (edit.before, edit.text))
    then = "counts from the next start"
    if before.calibration is not None and before.checksum != after.checksum:
        then += f"; {before.calibration} was made for other limits: calibrate again"
    return then


def _rounded_inwards(low_deg: float, high_deg: float) -> tuple[float, float]:
    """Return limits rounded inwards to 0.1 deg, and cut to -180..180."""
    low_deg, high_deg = max(low_deg, -180.0), min(high_deg, 180.0)
    tolerance = 1e-9  # 10.0 may be 9.999999999 of a division
    low_deg = math.ceil(low_deg * _TENTHS - tolerance) / _TENTHS + 0.0
    high_deg = math.floor(high_deg * _TENTHS + tolerance) / _TENTHS + 0.0
    return low_deg, high_deg
