"""Calibrations on disk: YAML that a person can read, written whole or not at all."""

import os
import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from calibration.calibration import Calibration, CalibrationError
from calibration.hold_out import HoldOutErrors

Array = NDArray[np.float64]

#: Raised whenever the meaning of a field changes; older files are refused, not guessed at.
CALIBRATION_VERSION = 1

_MAX = sys.float_info.max
#: libyaml's reader where PyYAML has it: 7 ms for a calibration instead of 70.
_SAFE_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

_HEADER = """\
# From a talker's mouth to this robot's servos, made by `lipservo calibrate`.
# Degrees of a servo = weights . (coefficients - rest), kept between min_deg and max_deg.
# The coefficients are the principal components of the model named below, in millimetres; at its
# rest, the closed mouth, all servos are at 0. Fitted by ridge regression to the angles that bring
# the simulated face nearest to the talker's; hold_out tells how far off it is on motion left out.
# Made for one model and one face: change either, and lipservo asks for a new calibration.
"""


def save_calibration(calibration: Calibration, path: Path) -> None:
    """Write the file whole or not at all; the same calibration gives the same bytes.

    Weights are kept to 6 significant digits, errors to 4, the rest exactly.
    Raises CalibrationError where it cannot be written.
    """
    partial = path.with_name(path.name + ".partial")
    try:
        partial.write_text(calibration_text(calibration), encoding="utf-8")
        os.replace(partial, path)
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be written: {error.strerror}") from error


def calibration_text(calibration: Calibration) -> str:
    """The whole file as text."""
    errors = calibration.errors
    lines = [
        f"version: {CALIBRATION_VERSION}",
        f'model_checksum: "{calibration.model_checksum}"',
        f'face_checksum: "{calibration.face_checksum}"',
        f"rest: [{', '.join(_exact(c) for c in calibration.rest)}]",
        "servos:",
    ]
    for i, name in enumerate(calibration.servo_names):
        lines += [
            f"  {name}:",
            f"    min_deg: {_exact(calibration.min_deg[i])}",
            f"    max_deg: {_exact(calibration.max_deg[i])}",
            f"    weights: [{', '.join(_rounded(w, 6) for w in calibration.weights[i])}]",
            f"    hold_out_rms_deg: {_rounded(errors.joint_rms_deg[i], 4)}",
        ]
    return _HEADER + "\n".join(lines + _hold_out_lines(errors)) + "\n"


def _hold_out_lines(errors: HoldOutErrors) -> list[str]:
    about = {
        "nearest_lip_rms_mm": "the best this face can do",
        "n_closures": "frames with the talker's lips closed",
        "closed_gap_mm": "the robot's gap in 95 % of them, at most",
    }
    lines = ["hold_out:"]
    for field in fields(errors):
        value = getattr(errors, field.name)
        if isinstance(value, tuple):  # one for each servo, and written there
            continue
        note = f"  # {about[field.name]}" if field.name in about else ""
        shown = str(value) if isinstance(value, int) else _rounded(value, 4)
        lines.append(f"  {field.name}: {shown}{note}")
    return lines


def _exact(value: float) -> str:
    return _yaml_float(repr(float(value)))


def _rounded(value: float, digits: int) -> str:
    return _yaml_float(f"{value:.{digits}g}")


def _yaml_float(text: str) -> str:
    """YAML 1.1 takes 1e-05 for a word; 1.0e-05 is a number."""
    return text if "." in text else text.replace("e", ".0e")


def load_calibration(path: Path) -> Calibration:
    """Read a calibration file. Raises CalibrationError for a missing, damaged or foreign one."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise CalibrationError(
            f"{path}: no such calibration; run `lipservo calibrate --config FACE -o {path.name}`"
        ) from None
    except UnicodeDecodeError as error:
        raise CalibrationError(f"{path}: not a text file") from error
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be read: {error.strerror}") from error
    return parse_calibration(text, str(path))


def parse_calibration(text: str, source: str) -> Calibration:
    """The calibration that `text` holds; `source` names it in errors.

    Raises CalibrationError, one line: where, what is wrong, what was expected.
    """
    try:
        content = yaml.load(text, Loader=_SAFE_LOADER)
    except (yaml.YAMLError, ValueError) as error:  # ValueError: a date such as 2024-13-01
        where = getattr(error, "problem_mark", None)
        line = f", line {where.line + 1}" if where else ""
        raise CalibrationError(f"{source}{line}: not readable as YAML") from error
    try:
        return _parse(_Place(content, ""))
    except CalibrationError as error:
        raise CalibrationError(f"{source}: {error}; run `lipservo calibrate` again") from error


class _Place:
    """One value of the file and the keys that led to it; every read is checked and names them."""

    def __init__(self, value: object, path: str) -> None:
        self._value = value
        self.path = path

    def keys(self) -> tuple[str, ...]:
        if not isinstance(self._value, dict) or not self._value:
            raise CalibrationError(f"{self.path or 'the file'} should hold `key: value` lines")
        return tuple(map(str, self._value))

    def at(self, key: str) -> "_Place":
        path = f"{self.path}.{key}" if self.path else key
        if key not in self.keys() or not isinstance(self._value, dict):
            raise CalibrationError(f"{path} is missing")
        return _Place(self._value[key], path)

    def text(self) -> str:
        if not isinstance(self._value, str):
            raise CalibrationError(f"{self.path} is {self._value!r}, expected text in quotes")
        return self._value

    def number(self) -> float:
        value = self._value
        if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= _MAX:
            return float(value)
        raise CalibrationError(f"{self.path} is {value!r}, expected a finite number")

    def count(self) -> int:
        if isinstance(self._value, bool) or not isinstance(self._value, int) or self._value < 0:
            raise CalibrationError(f"{self.path} is {self._value!r}, expected a whole number >= 0")
        return self._value

    def numbers(self, n: int | None = None) -> Array:
        """(n,), or at least one where n is None."""
        values = self._value
        if not isinstance(values, list) or not values:
            raise CalibrationError(f"{self.path} should be a list of numbers")
        if n is not None and len(values) != n:
            raise CalibrationError(f"{self.path} holds {len(values)} numbers, expected {n}")
        return np.array([_Place(v, f"{self.path}[{i}]").number() for i, v in enumerate(values)])


def _parse(file: _Place) -> Calibration:
    version = file.at("version").count()
    if version != CALIBRATION_VERSION:
        raise CalibrationError(
            f"version {version}, this lipservo reads version {CALIBRATION_VERSION}"
        )
    rest = file.at("rest").numbers()
    names = file.at("servos").keys()
    servos = [file.at("servos").at(name) for name in names]
    for servo in servos:
        if not servo.at("min_deg").number() <= 0.0 <= servo.at("max_deg").number():
            raise CalibrationError(f"{servo.path}: needs min_deg <= 0 <= max_deg")
    return Calibration(
        servo_names=names,
        weights=np.array([servo.at("weights").numbers(len(rest)) for servo in servos]),
        rest=rest,
        min_deg=np.array([servo.at("min_deg").number() for servo in servos]),
        max_deg=np.array([servo.at("max_deg").number() for servo in servos]),
        errors=_parse_errors(file.at("hold_out"), servos),
        model_checksum=file.at("model_checksum").text(),
        face_checksum=file.at("face_checksum").text(),
    )


def _parse_errors(hold_out: _Place, servos: list[_Place]) -> HoldOutErrors:
    return HoldOutErrors(
        n_frames=hold_out.at("n_frames").count(),
        marker_rms_mm=hold_out.at("marker_rms_mm").number(),
        lip_rms_mm=hold_out.at("lip_rms_mm").number(),
        nearest_lip_rms_mm=hold_out.at("nearest_lip_rms_mm").number(),
        gap_rms_mm=hold_out.at("gap_rms_mm").number(),
        gap_correlation=hold_out.at("gap_correlation").number(),
        n_closures=hold_out.at("n_closures").count(),
        closed_gap_mm=hold_out.at("closed_gap_mm").number(),
        clipped_share=hold_out.at("clipped_share").number(),
        joint_rms_deg=tuple(servo.at("hold_out_rms_deg").number() for servo in servos),
    )
