"""`lipservo calibrate show`: what a calibration file says, for people and as JSON."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict

import numpy as np
from rich.table import Table

from calibration.calibration import Calibration
from calibration.fit.report import report_lines
from calibration.grade import lips_off_mm
from lipservo.settings.gate_settings import PreventSettings
from lipsync.phonemes import VISEME_CLASSES

#: Columns of the table, by the names of `servo_values`.
_COLUMNS = {
    "range_deg": "range deg",
    "hold_out_rms_deg": "error deg",
    "lag_ms": "lag ms",
    "backlash_deg": "backlash deg",
    "top_speed_deg_s": "speed deg/s",
    "bandwidth_hz": "bandwidth Hz",
}
#: Columns of the table of viseme classes, by the names of `coverage_values`; shares or millimetres.
_VISEME_COLUMNS = {
    "reachable": ("reach", "%"),
    "off_mm": ("off, estimated", "mm"),
    "measured_mm": ("measured", "mm"),
    "gap_slope": ("opens", "%"),
    "small_gaps_kept": ("small kept", "%"),
    "closed_gap_mm": ("closed apart", "mm"),
    "at_limit": ("at limit", "%"),
}
Value = str | float | Sequence[float] | None


def following_values(calibration: Calibration) -> dict[str, dict[str, float | None]]:
    """How each servo follows its goal, by its name; None where the file does not know."""
    following = calibration.following
    keys = ("lag_ms", "backlash_deg", "top_speed_deg_s", "bandwidth_hz")
    if following is None:
        return {name: dict.fromkeys(keys) for name in calibration.servo_names}
    columns = (
        np.round(following.lag_s * 1e3, 3),
        following.backlash_deg,
        following.top_speed_deg_s,
        following.bandwidth_hz,
    )
    return {
        name: {key: _known(column[i]) for key, column in zip(keys, columns, strict=True)}
        for i, name in enumerate(calibration.servo_names)
    }


def servo_values(calibration: Calibration) -> dict[str, dict[str, Value]]:
    """Range, error and following of each servo, by its name."""
    models = calibration.origin.servo_models or (None,) * len(calibration.servo_names)
    follows = following_values(calibration)
    return {
        name: {
            "model": models[i],
            "range_deg": [float(calibration.min_deg[i]), float(calibration.max_deg[i])],
            "hold_out_rms_deg": calibration.errors.joint_rms_deg[i],
            **follows[name],
        }
        for i, name in enumerate(calibration.servo_names)
    }


def grade_values(calibration: Calibration) -> dict[str, object] | None:
    """What was measured, and `lips_off_mm`, which is printed first; None where nothing was."""
    grade, lips = calibration.grade, calibration.learnt_lips
    return None if grade is None else {"lips_off_mm": lips_off_mm(grade, lips), **asdict(grade)}


def shown_values(
    calibration: Calibration, rules: Sequence[PreventSettings] | None
) -> dict[str, object]:
    """Everything for JSON but the map itself. rules: of the face's YAML, None: not asked for."""
    origin, errors = calibration.origin, asdict(calibration.errors)
    lips = calibration.learnt_lips
    errors.pop("joint_rms_deg")
    told: dict[str, object] = {
        "method": origin.method,
        "date": origin.date,
        "poses": origin.poses,
        "not_measured": origin.not_measured,
        "model_checksum": calibration.model_checksum,
        "face_checksum": calibration.face_checksum,
        "servos": servo_values(calibration),
        "hold_out": errors,
        "grade": grade_values(calibration),
        "learnt_lips": None if lips is None else asdict(lips),
        "coverage": coverage_values(calibration),
        "trim": trim_values(calibration),
    }
    if rules is not None:
        told["rules"] = [rule.model_dump() for rule in rules]
    return told


def trim_values(calibration: Calibration) -> dict[str, dict[str, float]]:
    """Degrees that are added for a viseme class, by its first phoneme and the servo; no zeros."""
    trims = {
        viseme: {
            name: float(added)
            for name, added in zip(calibration.servo_names, degrees, strict=True)
            if added
        }
        for viseme, degrees in calibration.trim.items()
    }
    return {viseme: added for viseme, added in trims.items() if added}


def trim_lines(calibration: Calibration) -> list[str]:
    """A line for each trim, or that there are none."""
    lines = [
        f"{viseme}: {servo} {added_deg:+g} deg"
        for viseme, added in trim_values(calibration).items()
        for servo, added_deg in added.items()
    ]
    return lines or ["no trims"]


def servo_table(calibration: Calibration) -> Table:
    """One row a servo; a dash where the file does not know."""
    table = Table(box=None, pad_edge=False)
    table.add_column("servo", no_wrap=True)
    for title in _COLUMNS.values():
        table.add_column(title, justify="right")
    for name, values in servo_values(calibration).items():
        table.add_row(name, *(_cell(values[key]) for key in _COLUMNS))
    return table


def shown_lines(
    calibration: Calibration, file: str, rules: Sequence[PreventSettings] | None
) -> list[str]:
    """What is not of one servo or viseme class: origin, errors of the lips, trims and rules."""
    origin = calibration.origin
    made = f", {origin.poses} poses" if origin.poses else ""
    dated = f", {origin.date}" if origin.date else ""
    lines = [
        *report_lines(calibration, file, None, with_servos=False),
        f"method: {origin.method}{made}{dated}; model {calibration.model_checksum}, "
        f"face {calibration.face_checksum}",
        f"trims: {'; '.join(trim_lines(calibration))}",
    ]
    if rules is not None:
        lines += [f"rule: {_rule_text(rule.joints, rule.above)} ({rule.because})" for rule in rules]
        lines += [] if rules else ["rules: none in the face's YAML"]
    return lines


def coverage_values(calibration: Calibration) -> dict[str, dict[str, float | None]]:
    """What is known of each viseme class, by its first phoneme; None where nobody can say."""
    return {viseme: asdict(reach) for viseme, reach in calibration.coverage.items()}


def coverage_table(calibration: Calibration) -> Table:
    """One row a viseme class; a dash where nobody can say."""
    table = Table(box=None, pad_edge=False)
    table.add_column("class", no_wrap=True)
    for title, _ in _VISEME_COLUMNS.values():
        table.add_column(title, justify="right")
    phonemes = {viseme[0]: " ".join(viseme) for viseme in VISEME_CLASSES}
    for viseme, values in coverage_values(calibration).items():
        cells = (_measured(values[key], unit) for key, (_, unit) in _VISEME_COLUMNS.items())
        table.add_row(phonemes[viseme], *cells)
    return table


def _measured(value: float | None, unit: str) -> str:
    if value is None:
        return "-"
    return f"{value:.0%}" if unit == "%" else f"{value:.2f}"


def _rule_text(factors: Mapping[str, float], above_deg: float) -> str:
    terms = " + ".join(f"{factor:g} x {name}" for name, factor in factors.items())
    return f"{terms} <= {above_deg:g} deg"


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _cell(value: Value) -> str:
    if value is None:
        return "-"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "..".join(f"{each:g}" for each in value)
    return value if isinstance(value, str) else f"{value:.3g}"
