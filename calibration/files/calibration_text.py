"""The text of a calibration file: YAML that a person can read.

Its last line is a checksum of the contents, so that a changed digit is noticed. Comments and spaces
do not count, and neither do trims (degrees added for a viseme), which a person may write by hand.
"""

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import Field, asdict, fields
from typing import Any, ClassVar, Final, Protocol

import numpy as np
import yaml

from calibration.calibration import Calibration, CalibrationError
from calibration.closure import Closure
from calibration.grade import HoldOutErrors, VisemeReach
from lipsync.arrays import Array
from lipsync.phonemes import VISEME_CLASSES


class Record(Protocol):
    """A dataclass that is a part of a calibration."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]


#: libyaml's reader where PyYAML has it: ten times as fast.
SAFE_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_SUM_KEY: Final = "checksum"
#: What a hand may change.
_NOT_COUNTED: Final = (_SUM_KEY, "trim")


def with_checksum(text: str) -> str:
    """Return the file's text with a last line added that contains its checksum."""
    checksum = _checksum(yaml.load(text, Loader=SAFE_LOADER))
    return f'{text}{_SUM_KEY}: "{checksum}"  # over all but trims, which may be changed by hand\n'


def check_checksum(content: object, source: str) -> None:
    """Raise CalibrationError if a file's contents, trims excepted, differ from its checksum.

    content: the parsed YAML; source: names the file in the error. A file without a checksum, as
    older ones are, passes.
    """
    if not isinstance(content, dict) or _SUM_KEY not in content:
        return
    if content[_SUM_KEY] != _checksum(content):
        raise CalibrationError(
            f"{source}: was edited outside its trims since it was written (its checksum differs). "
            "Go back to a copy, or calibrate again; to use an edit that you meant, delete the "
            f"line `{_SUM_KEY}:`"
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
# and max_deg.
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
_WRITTEN_ELSEWHERE = ("joint_rms_deg", "each_marker_rms_mm")


def calibration_text(calibration: Calibration) -> str:
    """Return the file's text: weights with 6 significant digits, errors with 4, limits exactly."""
    origin, names = calibration.origin, calibration.servo_names
    lines = [
        f"version: {CALIBRATION_VERSION}",
        f"method: {origin.method}",
        f'date: "{origin.date}"',
        f"poses: {origin.poses}",
        *([f"not_measured: {origin.not_measured}"] if origin.not_measured else []),
        f'model_checksum: "{calibration.model_checksum}"',
        f'face_checksum: "{calibration.face_checksum}"',
        f"rest: {_yaml_list(calibration.rest, _exact)}",
    ]
    if np.isfinite(calibration.x_range).all():
        lines += [
            f"x_least: {_yaml_list(calibration.x_range[0], _six)}",
            f"x_most: {_yaml_list(calibration.x_range[1], _six)}",
        ]
    lines.append("servos:")
    for i in range(len(names)):
        lines += _servo_lines(calibration, i)
    if (touch := calibration.touch) is not None:
        lines += [
            "touch:  # the lips just meet; press no harder than this",
            f"  current_cap_ma: {_exact(touch.current_cap_ma)}",
            f"  positions_deg: {_by_servo(names, touch.positions_deg, _four)}",
        ]
    lines += _hold_out_lines(calibration.errors)
    if calibration.learnt_lips is not None:
        lines.append(f"learnt_lips: {_yaml_mapping(_known_fields(calibration.learnt_lips))}")
    if (closing := calibration.closing) is not None:
        details = {} if closing.closes else _known_fields(closing) | {"joint": f'"{closing.joint}"'}
        known = {"evidence": closing.evidence, **details}
        lines.append(f"closing: {_yaml_mapping(known)}")
    lines += _closure_lines(calibration.closure)
    if calibration.grade is not None:
        lines.append("grade:  # measured on the robot, at poses of speech that were never fitted")
        lines += [f"  {name}: {value}" for name, value in _known_fields(calibration.grade).items()]
    lines += _coverage_lines(calibration.coverage)
    trims = {
        viseme: {name: deg for name, deg in zip(names, degrees, strict=True) if deg != 0.0}
        for viseme, degrees in calibration.trim.items()
    }
    if any(trims.values()):
        lines.append("trim:  # degrees to add while a viseme class is spoken")
        lines += [
            f"  {viseme}: {_by_servo(added, added.values(), _six)}"
            for viseme, added in trims.items()
            if added
        ]
    if calibration.hand_poses:
        lines.append("hand_poses:  # made with the fingers, torque off")
        lines += [
            f"  {pose}: {_by_servo(names, degrees, _four)}"
            for pose, degrees in calibration.hand_poses.items()
        ]
    return with_checksum(_HEADER + "\n".join(lines) + "\n")


def _servo_lines(calibration: Calibration, i: int) -> list[str]:
    """Return the YAML lines of servo number `i`: model, memory, limits, map, following and error.

    Left out is what the calibration lacks, and a speed or bandwidth that is infinite (not known).
    """
    origin, following = calibration.origin, calibration.following
    model = origin.servo_models[i] if origin.servo_models else ""
    lines = [f"  {calibration.servo_names[i]}:"]
    lines += [f"    model: {model}"] if model else []
    if origin.servo_memories:
        lines.append(f"    memory: {_yaml_mapping(asdict(origin.servo_memories[i]))}")
    lines += [
        f"    min_deg: {_exact(calibration.min_deg[i])}",
        f"    max_deg: {_exact(calibration.max_deg[i])}",
        f"    rest_deg: {_six(calibration.rest_deg[i])}",
        f"    weights: {_yaml_list(calibration.weights[i], _six)}",
    ]
    if calibration.quadratic_weights.shape[1]:
        lines.append(f"    quadratic_weights: {_yaml_list(calibration.quadratic_weights[i], _six)}")
    for field in () if following is None else fields(following):
        value = getattr(following, field.name)[i]
        lines += [f"    {field.name}: {_four(value)}"] if np.isfinite(value) else []
    return [*lines, f"    hold_out_rms_deg: {_four(calibration.errors.joint_rms_deg[i])}"]


def _closure_lines(closure: Closure | None) -> list[str]:
    """Return the YAML lines of a closure, the model of how lips meet; [] for None.

    Numbers have 6 digits.
    """
    if closure is None:
        return []
    lines = ["closure:  # how far the lips are apart, by the joints, so that they meet"]
    for name in (field.name for field in fields(closure) if field.init):
        value = getattr(closure, name)
        if np.ndim(value) == 2:
            lines += [f"  {name}: ", *(f"  - {_yaml_list(row, _six)}" for row in value)]
        else:
            text = _yaml_list(value, _six) if np.ndim(value) else _six(value)
            lines.append(f"  {name}: {text}")
    return lines


def _hold_out_lines(errors: HoldOutErrors) -> list[str]:
    """Return the YAML lines of the errors on held-out motion, except each joint's own error."""
    lines = ["hold_out:"]
    for name, value in _known_fields(errors).items():
        note = _HOLD_OUT_NOTES.get(name)
        lines.append(f"  {name}: {value}" + (f"  # {note}" if note else ""))
    rms_of_marker = errors.each_marker_rms_mm
    lines.append(f"  n_markers: {len(rms_of_marker)}")
    lines += ["  each_marker_rms_mm:"] if rms_of_marker else []
    return lines + [f"    {name}: {_four(rms_mm)}" for name, rms_mm in rms_of_marker.items()]


def _coverage_lines(coverage: Mapping[str, VisemeReach]) -> list[str]:
    """Return the YAML lines of the coverage, one per viseme class; [] without any."""
    phonemes = {viseme[0]: " ".join(viseme) for viseme in VISEME_CLASSES}
    head = "coverage:  # of each viseme class, on the face as learnt; measured_mm on the robot"
    lines = [head] if coverage else []
    for viseme, reach in coverage.items():
        known = _known_fields(reach)
        if not reach.n_measured:
            del known["n_measured"]
        lines.append(f"  {viseme}: {_yaml_mapping(known)}  # {phonemes.get(viseme, '')}")
    return lines


def _known_fields(part: Record) -> dict[str, str]:
    """Return a record's fields that are not None, as YAML text by their names."""
    values = {field.name: getattr(part, field.name) for field in fields(part)}
    return {
        name: _yaml_value(value)
        for name, value in values.items()
        if value is not None and name not in _WRITTEN_ELSEWHERE
    }


def _yaml_value(value: str | float) -> str:
    """Return a value as YAML text, numbers that are not whole with 4 significant digits."""
    if isinstance(value, bool):
        return str(value).lower()
    return str(value) if isinstance(value, int | str) else _four(value)


def _yaml_mapping(parts: Mapping[str, object]) -> str:
    return f"{{{', '.join(f'{name}: {value}' for name, value in parts.items())}}}"


def _by_servo(names: Iterable[str], degrees: Iterable[float], text: Callable[[float], str]) -> str:
    return _yaml_mapping({name: text(deg) for name, deg in zip(names, degrees, strict=True)})


def _yaml_list(values: Array, shown: Callable[[float], str]) -> str:
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
