"""Output of a calibration: lines and tables for people, JSON values, and a picture.

The picture shows for each viseme class what part of its shapes the robot can make. It needs
matplotlib, the extra `plots`.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.table import Table

from calibration.calibration import Calibration, CalibrationError
from calibration.fit.servo_response import CHIRP_END_HZ, chirp_amplitude_deg
from calibration.grade import PASSED, LearntLips, lips_off_mm
from calibration.mouth_servos import JointRange
from lipservo.settings.sections import PreventSettings
from lipservo.terminal.pictures import save_picture, without_screen
from lipsync.phonemes import VISEME_CLASSES

if TYPE_CHECKING:  # loads scikit-learn, and `calibrate show` does without it
    from matplotlib.axes import Axes

    from calibration.fit.measured import MeasuredFit

#: The phonemes of each viseme class, by the first of them.
_PHONEMES_OF = {viseme[0]: " ".join(viseme) for viseme in VISEME_CLASSES}
#: A viseme class with fewer of its shapes in reach than this is warned of.
_WELL_REACHED = 0.9


def report_lines(
    calibration: Calibration, written: str, fit: "MeasuredFit | None", *, with_servos: bool = True
) -> list[str]:
    """Return lines for a person: the calibration's errors, each joint's, and what is out of reach.

    written: the calibration's file. fit: of a measured calibration; None: not measured, or read
    from a file. with_servos: include a line for each servo.
    """
    lines = [f"{written}: {_summary_text(calibration)}"]
    lips = calibration.learnt_lips
    if lips is not None:
        lines.append(
            f"learnt face: poses left out {lips.left_out_rms_mm:.2f} mm off in each axis, of "
            f"which the tracker's noise is about {lips.noise_mm:.2f}"
        )
        lines.append(_closing_line(calibration, lips))
    if fit is not None:
        lines.append(f"the mouth moves {fit.retargeting.scale:.2f} times as much as the speaker's")
    if calibration.origin.not_measured:
        lines.append(
            f"not measured: {calibration.origin.not_measured}, for one camera sees no depth; no "
            "figure here knows how far the lips are off forward"
        )
    lines += _worst_markers_line(calibration.errors.each_marker_rms_mm)
    if with_servos:
        lines += following_lines(calibration)
    # Hobby servos have no model here, and no current that could be limited.
    if calibration.touch is not None and any(calibration.origin.servo_models):
        lines.append(
            "so that lips which meet are not pressed hard, give the mouth's servos max_current_ma: "
            f"{calibration.touch.current_cap_ma:.0f} in the YAML, then run `lipservo setup-servos`"
        )
    return lines + (_reach_lines(calibration) if fit is not None else [])


def _closing_line(calibration: Calibration, lips: LearntLips) -> str:
    """Return a line on how lip contact was found: dots that passed, a stop in mm, or not at all.

    lips: of the calibration, as learnt from its measurement.
    """
    closing, closure = calibration.closing, calibration.closure
    pressed = "" if closure is None else f"; closures go {closure.press_mm:.1f} mm past it"
    if closing is not None and not closing.closes:
        why = closing.description
        return f"contact: none; the mouth {why}: widen that limit, or close it by its horn"
    if closing is not None and closing.evidence == PASSED:
        return f"contact: the dots of both lips pass one another{pressed}"
    if closing is not None or lips.stop:
        stops = f"contact: closing stops at a gap of {lips.own_gap_mm:.1f} mm between the dots"
        return f"{stops}{pressed}"
    return (
        "contact: not observed; closed is taken as the narrowest gap seen, "
        f"{lips.own_gap_mm:.1f} mm between the dots{pressed}"
    )


def _summary_text(calibration: Calibration) -> str:
    """Return a sentence on a calibration's errors, in mm or degrees, for a person.

    The method decides which errors there are: `guided`, `jaw alone`, graded by poses that were
    measured afterwards, `measured` without such a grade, or any other.
    """
    errors, origin = calibration.errors, calibration.origin
    if origin.method == "guided":
        off_deg, servo = max(zip(errors.joint_rms_deg, calibration.servo_names, strict=True))
        return (
            f"from {origin.poses} poses made by eye. A pose left out is {off_deg:.1f} deg off at "
            f"most (rms, {servo}). On simulated robots such a map was 1.2 mm off in the median, a "
            "measured one 0.3 (docs/benchmarks.md)"
        )
    if origin.method == "jaw alone":
        return (
            f"on {errors.n_frames} frames left out the jaw line is {errors.marker_rms_mm:.2f} mm "
            "from where the speaker's would be; lips were not seen"
        )
    grade = calibration.grade
    if grade is not None:
        lips = calibration.learnt_lips
        doubt_mm = 0.0 if lips is None else lips.doubt_mm
        off_mm = lips_off_mm(grade, calibration.learnt_lips)
        return (
            f"measured at {grade.n_poses} poses of speech that were never fitted, the lips are "
            f"{off_mm:.2f} mm from the shapes of speech ({grade.lip_rms_mm:.2f} from those asked "
            f"for, which may be {doubt_mm:.2f} off themselves), the lip gap "
            f"{grade.gap_rms_mm:.2f} mm (noise included); {max(grade.gap_slope, 0.0):.0%} of an "
            f"opening is made{_small_openings_text(grade.small_gaps_kept)}, closed lips are "
            f"{max(grade.closed_gap_mm, 0.0):.1f} mm apart; {errors.clipped_share:.0%} of the "
            "frames reach a limit"
        )
    if origin.method == "unit by eye":
        return (
            f"a design's map, turned to this unit by {origin.poses} poses made by eye; nothing was "
            "measured in mm, and the errors shown are the design's"
        )
    if origin.method in ("measured", "unit"):
        small, slope = _small_openings_text(errors.small_gaps_kept), errors.gap_slope
        made = "" if slope is None else f"{max(slope, 0.0):.0%} of an opening is made{small}, "
        return (
            f"estimated, not measured: on {errors.n_frames} frames left out the map is "
            f"{errors.lip_rms_mm:.2f} mm from the wanted shapes, on the face as it was learnt; "
            f"{made}closed lips are {errors.closed_gap_mm:.1f} mm apart; "
            f"{errors.clipped_share:.0%} of the frames reach a limit"
        )
    return (
        f"on {errors.n_frames} frames left out the lips are {errors.lip_rms_mm:.2f} mm off (the "
        f"nearest poses of this face: {errors.nearest_lip_rms_mm:.2f}), the lip gap "
        f"{errors.gap_rms_mm:.2f} mm; {errors.clipped_share:.1%} of the frames reach a limit"
    )


def _small_openings_text(small_gaps_kept: float | None) -> str:
    return "" if small_gaps_kept is None else f", {small_gaps_kept:.0%} of small openings stay open"


def _reach_lines(calibration: Calibration) -> list[str]:
    """Return a line on the viseme classes of which over a tenth of the shapes are out of reach."""
    poor = {v: r for v, r in calibration.coverage.items() if r.reachable < _WELL_REACHED}
    if not poor:
        return ["every viseme class is within reach"]
    shares = ", ".join(f"{_PHONEMES_OF[v]} {1 - reach.reachable:.0%}" for v, reach in poor.items())
    return [f"out of reach of the shapes of each class: {shares}; wider limits may help"]


def following_lines(calibration: Calibration) -> list[str]:
    """Return a line for each joint: its error, backlash, delay behind its goal, and bandwidth."""
    lines = []
    following = calibration.following
    for i, name in enumerate(calibration.servo_names):
        parts = [f"{calibration.errors.joint_rms_deg[i]:.1f} deg off the best pose"]
        if following is not None:
            parts.append(f"backlash {following.backlash_deg[i]:.1f} deg")
            if following.lag_s[i] or np.isfinite(following.bandwidth_hz[i]):
                parts.append(f"{following.lag_s[i] * 1e3:.0f} ms late")
            if np.isfinite(following.bandwidth_hz[i]):
                low, high = calibration.min_deg[i], calibration.max_deg[i]
                degrees = chirp_amplitude_deg(JointRange(name, float(low), float(high)))
                bandwidth_hz = float(following.bandwidth_hz[i])
                beyond = " or more" if bandwidth_hz >= CHIRP_END_HZ else ""
                parts.append(f"follows up to {bandwidth_hz:.1f} Hz{beyond} at {degrees:.0f} deg")
        lines.append(f"  {name}: {', '.join(parts)}")
    return lines


def _worst_markers_line(each_rms_mm: Mapping[str, float]) -> list[str]:
    """Return a line about the three markers with the largest errors; no line without markers."""
    worst = sorted(each_rms_mm.items(), key=lambda item: -item[1])[:3]
    listed = ", ".join(f"{name} {rms_mm:.2f} mm" for name, rms_mm in worst)
    return [f"farthest off: {listed}"] if worst else []


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
    """Return each servo's lag, backlash, speed and bandwidth, by name; None where not measured."""
    following = calibration.following
    if following is None:
        names = ("lag_ms", "backlash_deg", "top_speed_deg_s", "bandwidth_hz")
        return {servo: dict.fromkeys(names) for servo in calibration.servo_names}
    columns = {
        "lag_ms": np.round(following.lag_s * 1e3, 3),
        "backlash_deg": following.backlash_deg,
        "top_speed_deg_s": following.top_speed_deg_s,
        "bandwidth_hz": following.bandwidth_hz,
    }
    return {
        servo: {name: _finite_or_none(column[i]) for name, column in columns.items()}
        for i, servo in enumerate(calibration.servo_names)
    }


def servo_values(calibration: Calibration) -> dict[str, dict[str, Value]]:
    """Return the model, range, error, lag, backlash, speed and bandwidth of each servo, by name."""
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
    """Return the measured grade and `lips_off_mm`, for JSON; None if there is no grade."""
    grade, lips = calibration.grade, calibration.learnt_lips
    return None if grade is None else {"lips_off_mm": lips_off_mm(grade, lips), **asdict(grade)}


def closing_values(calibration: Calibration) -> dict[str, object] | None:
    """Return whether lips touch, and how far past contact they are pressed, for JSON.

    None: closing was not observed.
    """
    closing, closure = calibration.closing, calibration.closure
    if closing is None:
        return None
    press_mm = None if closure is None else closure.press_mm
    return {"closes": closing.closes, **asdict(closing), "press_mm": press_mm}


def measured_values(calibration: Calibration) -> dict[str, object]:
    """Return what was measured of lips and viseme classes, for JSON; None for what was not."""
    lips = calibration.learnt_lips
    return {
        "grade": grade_values(calibration),
        "learnt_lips": None if lips is None else asdict(lips),
        "closing": closing_values(calibration),
        "coverage": coverage_values(calibration),
    }


def shown_values(
    calibration: Calibration, rules: Sequence[PreventSettings] | None
) -> dict[str, object]:
    """Return a calibration as JSON values, without the map itself.

    rules: the `prevent` rules of the face's YAML; None: they are left out.
    """
    origin, errors = calibration.origin, asdict(calibration.errors)
    errors.pop("joint_rms_deg")
    values: dict[str, object] = {
        "method": origin.method,
        "date": origin.date,
        "poses": origin.poses,
        "not_measured": origin.not_measured,
        "model_checksum": calibration.model_checksum,
        "face_checksum": calibration.face_checksum,
        "servos": servo_values(calibration),
        "hold_out": errors,
        **measured_values(calibration),
        "trim": trim_values(calibration),
    }
    if rules is not None:
        values["rules"] = [rule.model_dump() for rule in rules]
    return values


def trim_values(calibration: Calibration) -> dict[str, dict[str, float]]:
    """Return the degrees added in each viseme class, by its first phoneme and the servo, if any."""
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
    """Return a line for each trim of a servo in a viseme class, or the line "no trims"."""
    lines = [
        f"{viseme}: {servo} {added_deg:+g} deg"
        for viseme, added in trim_values(calibration).items()
        for servo, added_deg in added.items()
    ]
    return lines or ["no trims"]


def servo_table(calibration: Calibration) -> Table:
    """Return a table of range, error, lag, ..., a row for each servo, a dash if unknown."""
    rows = {
        name: [_cell_text(values[key]) for key in _COLUMNS]
        for name, values in servo_values(calibration).items()
    }
    return _table("servo", _COLUMNS.values(), rows)


def _table(head: str, titles: Iterable[str], rows: Mapping[str, Sequence[str]]) -> Table:
    """Return a table of `rows`, cells by row name; `head` titles the column of names."""
    table = Table(box=None, pad_edge=False)
    table.add_column(head, no_wrap=True)
    for title in titles:
        table.add_column(title, justify="right")
    for name, cells in rows.items():
        table.add_row(name, *cells)
    return table


def shown_lines(
    calibration: Calibration, file: str, rules: Sequence[PreventSettings] | None
) -> list[str]:
    """Return lines about the whole calibration: errors of the lips, origin, trims and rules.

    file: its name. rules: the `prevent` rules of the face's YAML; None: they are left out.
    """
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
    """Return the fields of `VisemeReach` (shares, mm; None: unknown) of each viseme, as dicts."""
    return {viseme: asdict(reach) for viseme, reach in calibration.coverage.items()}


def coverage_table(calibration: Calibration) -> Table:
    """Return a table of reach and errors, a row for each viseme class, a dash if unknown."""
    rows = {
        _PHONEMES_OF[viseme]: [
            _figure_text(values[key], unit) for key, (_, unit) in _VISEME_COLUMNS.items()
        ]
        for viseme, values in coverage_values(calibration).items()
    }
    return _table("class", (title for title, _ in _VISEME_COLUMNS.values()), rows)


def _figure_text(value: float | None, unit: str) -> str:
    if value is None:
        return "-"
    return f"{value:.0%}" if unit == "%" else f"{value:.2f}"


def _rule_text(factors: Mapping[str, float], above_deg: float) -> str:
    terms = " + ".join(f"{factor:g} x {name}" for name, factor in factors.items())
    return f"{terms} <= {above_deg:g} deg"


def _finite_or_none(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _cell_text(value: Value) -> str:
    if value is None:
        return "-"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "..".join(f"{each:g}" for each in value)
    return value if isinstance(value, str) else f"{value:.3g}"


#: The picture's name in its folder.
PICTURE = "coverage.png"


def draw_reach(folder: Path, calibration: Calibration) -> Path:
    """Write `coverage.png`, the reach of each viseme class, to `folder`; return its path.

    Raises CalibrationError if the calibration measured none.
    """
    if not calibration.coverage:
        raise CalibrationError(
            f"--plots needs a measured calibration; this one is {calibration.origin.method}"
        )
    without_screen()
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(5.5, 4.6))
    _draw_classes(axes, calibration)
    figure.tight_layout()
    save_picture(figure, folder / PICTURE)
    plt.close(figure)
    return folder / PICTURE


def _draw_classes(axes: "Axes", calibration: Calibration) -> None:
    """Draw a bar for each viseme class: the part of its shapes within reach."""
    classes = [viseme for viseme in VISEME_CLASSES if viseme[0] in calibration.coverage]
    reach = [calibration.coverage[viseme[0]] for viseme in classes]
    rows = np.arange(len(classes))
    axes.barh(rows, [each.reachable for each in reach], color="tab:blue", height=0.6)
    for row, each in enumerate(reach):
        axes.text(1.01, row, f"{each.off_mm:.2f} mm", va="center", fontsize=8)
    axes.set_yticks(rows, [" ".join(viseme) for viseme in classes], fontsize=8)
    axes.invert_yaxis()
    axes.set_xlim(0.0, 1.0)
    axes.set_xlabel("part within reach; beside it, how far off this map is")
