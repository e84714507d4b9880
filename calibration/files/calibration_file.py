"""Reading and writing of calibrations as YAML files, which are written whole or not at all.

A file is parsed value by value, so that every error names the value's keys.
"""

import sys
from dataclasses import fields
from pathlib import Path

import numpy as np
import yaml

from calibration.calibration import (
    Calibration,
    CalibrationError,
    Following,
    Origin,
    ServoMemory,
    Touch,
    linear_calibration_parts,
)
from calibration.closure import Closure, pairs
from calibration.files.calibration_text import (
    CALIBRATION_VERSION,
    SAFE_LOADER,
    calibration_text,
    check_checksum,
)
from calibration.grade import (
    CONTACT,
    LIMITS,
    PASSED,
    Closing,
    Grade,
    HoldOutErrors,
    LearntLips,
    VisemeReach,
)
from lipsync.arrays import Array
from lipsync.errors import shown
from lipsync.output_file import write_whole
from lipsync.phonemes import VISEME_CLASSES
from lipsync.yaml_depth import is_nested_deeper

_MAX = sys.float_info.max


class Place:
    """One value in a calibration file, with the keys that lead to it.

    Its methods raise CalibrationError, which names the keys, for a value of another type.
    """

    def __init__(self, value: object, path: str) -> None:
        self._value = value
        self.path = path

    @property
    def _where(self) -> str:
        return self.path or "the file"

    @property
    def names(self) -> tuple[str, ...]:
        """The keys of this mapping. Raises CalibrationError for no mapping or a key not text."""
        if not isinstance(self._value, dict) or not self._value:
            raise CalibrationError(f"{self._where} should hold `key: value` lines")
        for key in self._value:
            if not isinstance(key, str):
                raise CalibrationError(f"{self._where}: the key {shown(key)} is no text")
        return tuple(self._value)

    def at(self, key: str) -> "Place":
        """Return the value under a key of this mapping. Raises CalibrationError if missing."""
        path = f"{self.path}.{key}" if self.path else key
        if key not in self.names or not isinstance(self._value, dict):
            raise CalibrationError(f"{path} is missing")
        return Place(self._value[key], path)

    def text(self) -> str:
        """Return the value, which must be text; CalibrationError names its keys otherwise."""
        if not isinstance(self._value, str):
            raise CalibrationError(f"{self.path} is {shown(self._value)}, expected text in quotes")
        return self._value

    def number(self) -> float:
        """Return the value, which must be a finite number; CalibrationError otherwise."""
        value = self._value
        if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= _MAX:
            return float(value)
        raise CalibrationError(f"{self.path} is {shown(value)}, expected a finite number")

    def has(self, key: str) -> bool:
        """Return whether this mapping contains `key`. Raises CalibrationError for no mapping."""
        return key in self.names

    def count(self) -> int:
        """Return the value, which must be a whole number >= 0; CalibrationError otherwise."""
        if isinstance(self._value, bool) or not isinstance(self._value, int) or self._value < 0:
            raise CalibrationError(
                f"{self.path} is {shown(self._value)}, expected a whole number >= 0"
            )
        return self._value

    def flag(self) -> bool:
        """Return the value, which must be true or false; CalibrationError otherwise."""
        if not isinstance(self._value, bool):
            raise CalibrationError(f"{self.path} is {shown(self._value)}, expected true or false")
        return self._value

    def whole(self) -> int:
        """Return the value, which must be a whole number; CalibrationError otherwise."""
        if isinstance(self._value, bool) or not isinstance(self._value, int):
            raise CalibrationError(f"{self.path} is {shown(self._value)}, expected a whole number")
        return self._value

    def places(self) -> list["Place"]:
        """Return the values of this list as places, at least one; CalibrationError otherwise."""
        values = self._value
        if not isinstance(values, list) or not values:
            raise CalibrationError(f"{self.path} should be a list")
        return [Place(value, f"{self.path}[{i}]") for i, value in enumerate(values)]

    def numbers(self, n: int | None = None) -> Array:
        """Return this list of `n` numbers, None: of any number; CalibrationError otherwise."""
        values = self._value
        if not isinstance(values, list) or not values:
            raise CalibrationError(f"{self.path} should be a list of numbers")
        if n is not None and len(values) != n:
            raise CalibrationError(f"{self.path} holds {len(values)} numbers, expected {n}")
        return np.array([Place(v, f"{self.path}[{i}]").number() for i, v in enumerate(values)])


#: A calibration needs five levels.
_DEEPEST = 20
#: What the previous file is kept as.
PREVIOUS_SUFFIX = ".previous"


def save_calibration(calibration: Calibration, path: Path, *, keeps_previous: bool = True) -> None:
    """Write a calibration whole or not at all, and keep an existing file as `.previous`.

    keeps_previous: False where the file there is an unfinished form of the same calibration. Equal
    calibrations give equal bytes. Raises OutputError if the file cannot be written, and
    CalibrationError for a calibration that could not be read again, with NaN for instance.
    """
    text = calibration_text(calibration)
    try:
        parse_calibration(text, str(path))
    except CalibrationError as error:
        raise CalibrationError(
            f"nothing is written, for it could not be used: {error}; look at the markers"
        ) from error
    if keeps_previous and path.exists():
        write_whole(path.with_name(path.name + PREVIOUS_SUFFIX), path.read_bytes())
    write_whole(path, text)


def load_calibration(path: Path) -> Calibration:
    """Return the calibration in a file. Raises CalibrationError if missing, damaged or foreign."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise CalibrationError(
            f"{path}: no such calibration; run "
            f"`lipservo calibrate fit --config FACE -o {path.name}`"
        ) from None
    except UnicodeDecodeError as error:
        raise CalibrationError(f"{path}: not a text file") from error
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be read: {error.strerror}") from error
    return parse_calibration(text, str(path))


def parse_calibration(text: str, source: str) -> Calibration:
    """Return the calibration that the YAML in `text` contains; `source` names it in errors.

    Raises CalibrationError, one line: which value, what is wrong, what was expected.
    """
    try:
        if is_nested_deeper(text, _DEEPEST):
            raise CalibrationError(f"{source}: is nested too deep to be a calibration")
        content = yaml.load(text, Loader=SAFE_LOADER)
    except CalibrationError:
        raise
    except (yaml.YAMLError, ValueError) as error:  # ValueError: a date such as 2024-13-01
        where = getattr(error, "problem_mark", None)
        line = f", line {where.line + 1}" if where else ""
        raise CalibrationError(f"{source}{line}: not readable as YAML") from error
    try:
        calibration = _parse(Place(content, ""))
    except CalibrationError as error:
        raise CalibrationError(f"{source}: {error}; run `lipservo calibrate` again") from error
    # Last, so that what is plainly wrong is named.
    check_checksum(content, source)
    return calibration


def _parse(file: Place) -> Calibration:
    version = file.at("version").count()
    if version != CALIBRATION_VERSION:
        raise CalibrationError(
            f"version {version}, this lipservo reads version {CALIBRATION_VERSION}"
        )
    rest = file.at("rest").numbers()
    names = file.at("servos").names
    servos = [file.at("servos").at(name) for name in names]
    for servo in servos:
        if not servo.at("min_deg").number() <= 0.0 <= servo.at("max_deg").number():
            raise CalibrationError(f"{servo.path}: needs min_deg <= 0 <= max_deg")
    weights = np.array([servo.at("weights").numbers(len(rest)) for servo in servos])
    quadratic_weights, _, x_range = linear_calibration_parts(*weights.shape)
    key = "quadratic_weights"
    if any(servo.has(key) for servo in servos):
        n_pairs = len(pairs(len(rest))[0])
        quadratic_weights = np.array([servo.at(key).numbers(n_pairs) for servo in servos])
        x_range = np.array([file.at(key).numbers(len(rest)) for key in ("x_least", "x_most")])
    centres, centre_weights = _parse_centres(file, servos, len(rest))
    return Calibration(
        servo_names=names,
        weights=weights,
        quadratic_weights=quadratic_weights,
        rest=rest,
        rest_deg=np.array([servo.at("rest_deg").number() for servo in servos]),
        x_range=x_range,
        min_deg=np.array([servo.at("min_deg").number() for servo in servos]),
        max_deg=np.array([servo.at("max_deg").number() for servo in servos]),
        errors=_parse_errors(file.at("hold_out"), servos),
        model_checksum=file.at("model_checksum").text(),
        face_checksum=file.at("face_checksum").text(),
        origin=_parse_origin(file, servos),
        following=_parse_following(servos),
        touch=_parse_touch(file, names),
        coverage=parse_coverage(file),
        trim=_parse_trim(file, names),
        centres=centres,
        centre_weights=centre_weights,
        grade=parse_grade(file),
        learnt_lips=parse_learnt_lips(file),
        hand_poses=_parse_hand_poses(file, names),
        closure=_parse_closure(file, len(names), len(rest)),
        closing=_parse_closing(file),
    )


def _parse_closure(file: Place, n_servos: int, n_components: int) -> Closure | None:
    if not file.has("closure"):
        return None
    closure = file.at("closure")

    def rows(key: str, n: int) -> Array:
        return np.array([row.numbers(n) for row in closure.at(key).places()])

    gaps_mm = closure.at("gaps_mm").numbers()
    parsed = Closure(
        speaker_mm=rows("speaker_mm", n_components),
        speaker_rest_mm=closure.at("speaker_rest_mm").numbers(3),
        opens_mm=rows("opens_mm", n_components),
        at_deg=closure.at("at_deg").numbers(n_servos),
        gaps_mm=gaps_mm,
        slopes=rows("slopes", n_servos),
        bends=rows("bends", len(pairs(n_servos)[0])),
        turns_deg=rows("turns_deg", len(gaps_mm)),
        press_mm=closure.at("press_mm").number(),
    )
    counts = {
        "speaker_mm": 3,
        "opens_mm": len(gaps_mm),
        "slopes": len(gaps_mm),
        "bends": len(gaps_mm),
        "turns_deg": n_servos,
    }
    for key, n in counts.items():
        if len(getattr(parsed, key)) != n:
            raise CalibrationError(f"closure.{key}: needs {n} lists")
    return parsed


def _parse_closing(file: Place) -> Closing | None:
    if not file.has("closing"):
        return None
    closing = file.at("closing")
    evidence = closing.at("evidence").text()
    if evidence not in (CONTACT, PASSED, LIMITS):
        known = ", ".join((CONTACT, PASSED, LIMITS))
        raise CalibrationError(f"{closing.path}.evidence is {shown(evidence)}, expected {known}")
    if evidence != LIMITS:
        return Closing(evidence)
    return Closing(
        evidence,
        closing.at("apart_mm").number(),
        closing.at("joint").text(),
        closing.at("missing_deg").number(),
    )


def _parse_centres(file: Place, servos: list[Place], n_components: int) -> tuple[Array, Array]:
    """Return centres and weights of bends that are not quadratic; empty arrays without `centres`.

    servos: one mapping per servo, each with `centre_weights`.
    """
    if not file.has("centres"):
        return np.zeros((0, n_components)), np.zeros((len(servos), 0))
    centres = np.array([centre.numbers(n_components) for centre in file.at("centres").places()])
    weights = [servo.at("centre_weights").numbers(len(centres)) for servo in servos]
    return centres, np.array(weights)


def _parse_origin(file: Place, servos: list[Place]) -> Origin:
    named = any(servo.has("model") for servo in servos)
    return Origin(
        method=file.at("method").text(),
        date=file.at("date").text(),
        poses=file.at("poses").count(),
        servo_models=tuple(s.at("model").text() for s in servos) if named else (),
        servo_memories=_parse_memories(servos),
        not_measured=file.at("not_measured").text() if file.has("not_measured") else "",
    )


def _parse_memories(servos: list[Place]) -> tuple[ServoMemory, ...]:
    """Return each servo's registers as they were at the calibration; () if the file has none."""
    if not any(servo.has("memory") for servo in servos):
        return ()
    keys = [field.name for field in fields(ServoMemory)]
    return tuple(
        ServoMemory(*(servo.at("memory").at(key).whole() for key in keys)) for servo in servos
    )


def _parse_following(servos: list[Place]) -> Following | None:
    """Return how servos follow goals; None without `lag_s`; CalibrationError if some lack it."""
    if not any(servo.has("lag_s") for servo in servos):
        return None

    def known(key: str) -> Array:
        return np.array([s.at(key).number() if s.has(key) else np.inf for s in servos])

    return Following(
        lag_s=np.array([servo.at("lag_s").number() for servo in servos]),
        backlash_deg=np.array([servo.at("backlash_deg").number() for servo in servos]),
        top_speed_deg_s=known("top_speed_deg_s"),
        bandwidth_hz=known("bandwidth_hz"),
    )


def _parse_touch(file: Place, names: tuple[str, ...]) -> Touch | None:
    if not file.has("touch"):
        return None
    degrees = file.at("touch").at("positions_deg")
    return Touch(
        np.array([degrees.at(name).number() for name in names]),
        file.at("touch").at("current_cap_ma").number(),
    )


def _parse_trim(file: Place, names: tuple[str, ...]) -> dict[str, Array]:
    """Return the trims by viseme class; names are checked, because people write trims by hand."""
    if not file.has("trim"):
        return {}
    trim = file.at("trim")
    classes = [viseme[0] for viseme in VISEME_CLASSES]
    for viseme in trim.names:
        if viseme not in classes:
            raise CalibrationError(f"trim.{viseme}: no viseme class; known: {' '.join(classes)}")
        for name in trim.at(viseme).names:
            if name not in names:
                raise CalibrationError(f"trim.{viseme}.{name}: no such servo in this file")
    return {
        viseme: np.array(
            [trim.at(viseme).at(n).number() if trim.at(viseme).has(n) else 0.0 for n in names]
        )
        for viseme in trim.names
    }


def _parse_hand_poses(file: Place, names: tuple[str, ...]) -> dict[str, Array]:
    if not file.has("hand_poses"):
        return {}
    poses = file.at("hand_poses")
    return {
        pose: np.array([poses.at(pose).at(name).number() for name in names]) for pose in poses.names
    }


def _parse_errors(hold_out: Place, servos: list[Place]) -> HoldOutErrors:
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
        each_marker_rms_mm=_parse_each_marker(hold_out),
        **{
            key: hold_out.at(key).number()
            for key in ("gap_slope", "small_gaps_kept")
            if hold_out.has(key)
        },
    )


def _parse_each_marker(hold_out: Place) -> dict[str, float]:
    """Return each marker's rms error in mm, by its name; {} if `n_markers` is 0.

    Raises CalibrationError if there are not `n_markers` errors.
    """
    n_markers = hold_out.at("n_markers").count()
    if n_markers == 0:
        return {}
    each = hold_out.at("each_marker_rms_mm")
    if len(each.names) != n_markers:
        raise CalibrationError(f"{each.path} holds {len(each.names)} markers, expected {n_markers}")
    return {name: each.at(name).number() for name in each.names}


def parse_learnt_lips(file: Place) -> LearntLips | None:
    """Return how the lips were learnt; None if not in the file; CalibrationError if malformed."""
    if not file.has("learnt_lips"):
        return None
    lips = file.at("learnt_lips")
    return LearntLips(
        left_out_rms_mm=lips.at("left_out_rms_mm").number(),
        noise_mm=lips.at("noise_mm").number(),
        own_gap_mm=lips.at("own_gap_mm").number(),
        stop=lips.at("stop").flag(),
        held_back_mm=lips.at("held_back_mm").number() if lips.has("held_back_mm") else 0.0,
    )


def parse_grade(file: Place) -> Grade | None:
    """Return the grade; None if the file has none. Raises CalibrationError for a malformed one."""
    if not file.has("grade"):
        return None
    grade = file.at("grade")
    return Grade(
        n_poses=grade.at("n_poses").count(),
        lip_rms_mm=grade.at("lip_rms_mm").number(),
        gap_rms_mm=grade.at("gap_rms_mm").number(),
        closed_gap_mm=grade.at("closed_gap_mm").number(),
        gap_slope=grade.at("gap_slope").number(),
        small_gaps_kept=_number_at(grade, "small_gaps_kept"),
    )


def parse_coverage(file: Place) -> dict[str, VisemeReach]:
    """Return the reach of each viseme class; {} if the file has none. Raises CalibrationError."""
    if not file.has("coverage"):
        return {}
    coverage = file.at("coverage")
    return {viseme: _parse_reach(coverage.at(viseme)) for viseme in coverage.names}


def _parse_reach(reach: Place) -> VisemeReach:
    return VisemeReach(
        reachable=reach.at("reachable").number(),
        off_mm=reach.at("off_mm").number(),
        gap_slope=_number_at(reach, "gap_slope"),
        closed_gap_mm=_number_at(reach, "closed_gap_mm"),
        small_gaps_kept=_number_at(reach, "small_gaps_kept"),
        at_limit=_number_at(reach, "at_limit"),
        n_measured=reach.at("n_measured").count() if reach.has("n_measured") else 0,
        measured_mm=_number_at(reach, "measured_mm"),
    )


def _number_at(place: Place, key: str) -> float | None:
    return place.at(key).number() if place.has(key) else None
