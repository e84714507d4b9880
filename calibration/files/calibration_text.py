"""The text of a calibration file: YAML that a person can read.

Its last line is a checksum of the contents, so that a changed digit is noticed. Comments and spaces
do not count, and neither do trims (degrees added for a viseme), which a person may write by hand.
"""

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, fields
from typing import Final

import numpy as np
import yaml

from calibration.calibration import Calibration, CalibrationError, Following, Touch
from calibration.closure import Closure
from calibration.grade import Closing, Grade, HoldOutErrors, LearntLips, VisemeReach
from lipsync.arrays import Array
from lipsync.phonemes import VISEME_CLASSES

#: libyaml's reader where PyYAML has it: ten times as fast.
SAFE_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_KEY: Final = "checksum"
#: What a hand may change.
_NOT_COUNTED: Final = (_KEY, "trim")


def with_checksum(text: str) -> str:
    """Return the file's text with a last line added that contains its checksum."""
    checksum = _checksum(yaml.load(text, Loader=SAFE_LOADER))
    return f'{text}{_KEY}: "{checksum}"  # over all but trims, which may be changed by hand\n'


def check_checksum(content: object, source: str) -> None:
    """Raise CalibrationError if a file's contents, trims excepted, differ from its checksum.

    content: the parsed YAML; source: names the file in the error. A file without a checksum, as
    older ones are, passes.
    """
    if not isinstance(content, dict) or _KEY not in content:
        return
    if content[_KEY] != _checksum(content):
        raise CalibrationError(
            f"{source}: has changed since it was written, and not in its trims: its checksum does "
            f"not fit. Go back to a copy of it, or calibrate again; a change that is meant counts "
            f"once the line `{_KEY}:` is deleted"
        )


def _checksum(content: object) -> str:
    """Return a hash of parsed YAML, `content`, as 16 hex digits, without trims and checksum."""
    counted = content
    if isinstance(content, dict):
        counted = {key: value for key, value in content.items() if key not in _NOT_COUNTED}
    text = json.dumps(counted, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


#: Raised whenever the meaning of a field changes; a file of another version is refused.
CALIBRATION_VERSION = 5

_HEADER = """\
# From a speaker's mouth to this robot's servos, made by `lipservo calibrate`.
# With x = coefficients - rest, kept within x_least .. x_most, the degrees of a servo are
# rest_deg + weights . x + quadratic_weights . (x_i x_j, i <= j, row by row), kept between min_deg
# and max_deg. Where the file has centres, centre_weights . |x - centre| are added before that.
# The coefficients are the principal components of the model named below, in millimetres; rest is
# the closed mouth. Where lips are near, closure corrects it so that they meet.
# hold_out tells how far off the map is on motion left out of the fit.
# Made for one model and one face: change either, and lipservo asks for a new calibration.
"""
_HOLD_OUT_NOTES = {
    "n_frames": "0: nothing was measured in millimetres",
    "nearest_lip_rms_mm": "the best this face can do",
    "n_closures": "frames with the speaker's lips closed",
    "closed_gap_mm": "the robot's gap in 95 % of them, at most",
}
#: One for each servo, and written there; one for each marker.
_WRITTEN_APART = ("joint_rms_deg", "each_marker_rms_mm")


def calibration_text(calibration: Calibration) -> str:
    """Return the file's text: weights with 6 significant digits, errors with 4, limits exactly."""
    origin = calibration.origin
    lines = [
        f"version: {CALIBRATION_VERSION}",
        f"method: {origin.method}",
        f'date: "{origin.date}"',
        f"poses: {origin.poses}",
        *([f"not_measured: {origin.not_measured}"] if origin.not_measured else []),
        f'model_checksum: "{calibration.model_checksum}"',
        f'face_checksum: "{calibration.face_checksum}"',
        f"rest: {_list(calibration.rest, _exact)}",
    ]
    if np.isfinite(calibration.x_range).all():
        lines += [
            f"x_least: {_list(calibration.x_range[0], _six)}",
            f"x_most: {_list(calibration.x_range[1], _six)}",
        ]
    if len(calibration.centres):
        lines.append("centres:")
        lines += [f"- {_list(centre, _six)}" for centre in calibration.centres]
    lines.append("servos:")
    for i in range(len(calibration.servo_names)):
        lines += _servo_lines(calibration, i)
    lines += _touch_lines(calibration.touch, calibration.servo_names)
    lines += _hold_out_lines(calibration.errors)
    lines += learnt_lips_lines(calibration.learnt_lips)
    lines += _closing_lines(calibration.closing)
    lines += _closure_lines(calibration.closure)
    lines += grade_lines(calibration.grade)
    lines += coverage_lines(calibration.coverage)
    lines += _trim_lines(calibration)
    lines += _hand_pose_lines(calibration)
    return with_checksum(_HEADER + "\n".join(lines) + "\n")


def _servo_lines(calibration: Calibration, i: int) -> list[str]:
    origin = calibration.origin
    model = origin.servo_models[i] if origin.servo_models else ""
    lines = [f"  {calibration.servo_names[i]}:"]
    lines += [f"    model: {model}"] if model else []
    if origin.servo_memories:
        memory = asdict(origin.servo_memories[i])
        lines.append(f"    memory: {{{', '.join(f'{k}: {v}' for k, v in memory.items())}}}")
    lines += [
        f"    min_deg: {_exact(calibration.min_deg[i])}",
        f"    max_deg: {_exact(calibration.max_deg[i])}",
        f"    rest_deg: {_six(calibration.rest_deg[i])}",
        f"    weights: {_list(calibration.weights[i], _six)}",
    ]
    if calibration.quadratic_weights.shape[1]:
        lines.append(f"    quadratic_weights: {_list(calibration.quadratic_weights[i], _six)}")
    if len(calibration.centres):
        lines.append(f"    centre_weights: {_list(calibration.centre_weights[i], _six)}")
    lines += _following_lines(calibration.following, i)
    return [*lines, f"    hold_out_rms_deg: {_four(calibration.errors.joint_rms_deg[i])}"]


def _following_lines(following: Following | None, i: int) -> list[str]:
    """Return the YAML lines of how servo number `i` follows goals; unknown values are left out."""
    if following is None:
        return []
    lines = [
        f"    lag_s: {_four(following.lag_s[i])}",
        f"    backlash_deg: {_four(following.backlash_deg[i])}",
    ]
    if np.isfinite(following.top_speed_deg_s[i]):
        lines.append(f"    top_speed_deg_s: {_four(following.top_speed_deg_s[i])}")
    if np.isfinite(following.bandwidth_hz[i]):
        lines.append(f"    bandwidth_hz: {_four(following.bandwidth_hz[i])}")
    return lines


def _touch_lines(touch: Touch | None, servo_names: tuple[str, ...]) -> list[str]:
    if touch is None:
        return []
    degrees = zip(servo_names, touch.positions_deg, strict=True)
    return [
        "touch:  # the lips just meet; press no harder than this",
        f"  current_cap_ma: {_exact(touch.current_cap_ma)}",
        f"  positions_deg: {{{', '.join(f'{name}: {_four(deg)}' for name, deg in degrees)}}}",
    ]


def _closing_lines(closing: Closing | None) -> list[str]:
    if closing is None:
        return []
    if closing.closes:
        return [f"closing: {{evidence: {closing.evidence}}}"]
    return [
        f"closing: {{evidence: {closing.evidence}, apart_mm: {_four(closing.apart_mm)}, "
        f'joint: "{closing.joint}", missing_deg: {_four(closing.missing_deg)}}}'
    ]


def _closure_lines(closure: Closure | None) -> list[str]:
    """Return the YAML lines of a closure, the model of how lips meet; [] for None.

    Two-dimensional arrays are row by row.
    """
    if closure is None:
        return []
    lines = ["closure:  # how far the lips are apart, by the joints, so that they meet"]
    for field in fields(closure):
        if not field.init:
            continue
        value = getattr(closure, field.name)
        if isinstance(value, float):
            lines.append(f"  {field.name}: {_six(value)}")
            continue
        shown = [_list(row, _six) for row in value] if value.ndim == 2 else None
        lines.append(f"  {field.name}: " + (_list(value, _six) if shown is None else ""))
        lines += [f"  - {row}" for row in shown or ()]
    return lines


def _hold_out_lines(errors: HoldOutErrors) -> list[str]:
    lines = ["hold_out:"]
    for field in fields(errors):
        value = getattr(errors, field.name)
        if field.name in _WRITTEN_APART or value is None:
            continue
        note = _HOLD_OUT_NOTES.get(field.name)
        shown = str(value) if isinstance(value, int) else _four(value)
        lines.append(f"  {field.name}: {shown}" + (f"  # {note}" if note else ""))
    each = errors.each_marker_rms_mm
    lines.append(f"  n_markers: {len(each)}")
    if each:
        lines.append("  each_marker_rms_mm:")
        lines += [f"    {name}: {_four(rms_mm)}" for name, rms_mm in each.items()]
    return lines


def _trim_lines(calibration: Calibration) -> list[str]:
    """Return the YAML lines of the trims, without zeros; [] where no trim changes a servo."""
    lines = []
    for viseme, degrees in calibration.trim.items():
        parts = [
            f"{name}: {_six(deg)}"
            for name, deg in zip(calibration.servo_names, degrees, strict=True)
            if deg != 0.0
        ]
        if parts:
            lines.append(f"  {viseme}: {{{', '.join(parts)}}}")
    return ["trim:  # degrees to add while a viseme class is spoken", *lines] if lines else []


def _hand_pose_lines(calibration: Calibration) -> list[str]:
    if not calibration.hand_poses:
        return []
    lines = ["hand_poses:  # made with the fingers, torque off"]
    for pose, positions_deg in calibration.hand_poses.items():
        places = zip(calibration.servo_names, positions_deg, strict=True)
        lines.append(f"  {pose}: {{{', '.join(f'{name}: {_four(deg)}' for name, deg in places)}}}")
    return lines


def _list(values: Array, shown: Callable[[float], str]) -> str:
    return f"[{', '.join(shown(v) for v in values)}]"


def _exact(value: float) -> str:
    return _yaml_float(repr(float(value)))


def _six(value: float) -> str:
    return _yaml_float(f"{value:.6g}")


def _four(value: float) -> str:
    return _yaml_float(f"{value:.4g}")


def _yaml_float(text: str) -> str:
    """Return a number's `text` changed so that YAML 1.1 parses it as a number: 1e-05 to 1.0e-05."""
    return text if "." in text else text.replace("e", ".0e")


_HEAD: Final = "coverage:  # of each viseme class, on the face as learnt; measured_mm on the robot"


def learnt_lips_lines(lips: LearntLips | None) -> list[str]:
    """Return the YAML line of what was learnt of the lips; [] for None."""
    if lips is None:
        return []
    parts = ", ".join(f"{name}: {_shown(value)}" for name, value in _known(lips))
    return [f"learnt_lips: {{{parts}}}"]


def grade_lines(grade: Grade | None) -> list[str]:
    """Return the YAML lines of a grade; [] for None."""
    if grade is None:
        return []
    head = "grade:  # measured on the robot, at poses of speech that were never fitted"
    return [head, *(f"  {name}: {_shown(value)}" for name, value in _known(grade))]


def coverage_lines(coverage: Mapping[str, VisemeReach]) -> list[str]:
    """Return the YAML lines of the coverage, one per viseme class; [] without any."""
    if not coverage:
        return []
    phonemes = {viseme[0]: " ".join(viseme) for viseme in VISEME_CLASSES}
    lines = [_HEAD]
    for viseme, reach in coverage.items():
        parts = [(n, v) for n, v in _known(reach) if reach.n_measured or n != "n_measured"]
        listed = ", ".join(f"{name}: {_shown(value)}" for name, value in parts)
        lines.append(f"  {viseme}: {{{listed}}}  # {phonemes.get(viseme, '')}")
    return lines


def _known(part: Grade | LearntLips | VisemeReach) -> Iterable[tuple[str, float]]:
    for field in fields(part):
        value = getattr(part, field.name)
        if value is not None:
            yield field.name, value


def _shown(value: float) -> str:
    """Return a value as YAML text, numbers with 4 significant digits: 1.0e-05, not 1e-05."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int):
        return str(value)
    text = f"{value:.4g}"
    return text if "." in text else text.replace("e", ".0e")
