"""Reading and writing of calibrations as YAML files, which are written whole or not at all.

A file is parsed value by value, so that every error names the value's keys.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar

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
    Record,
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

    def __init__(self, value: Any, path: str) -> None:
        self._value = value
        self.path = path

    @property
    def _where(self) -> str:
        return self.path or "the file"

    @property
    def names(self) -> tuple[str, ...]:
        """The keys of this mapping. Raises CalibrationError for no mapping or a key not text."""
        if not isinstance(self._value, dict) or not self._value:
            raise CalibrationError(f"{self._where} must have `key: value` lines")
        for key in self._value:
            if not isinstance(key, str):
                raise CalibrationError(f"{self._where}: the key {shown(key)} must be text")
        return tuple(self._value)

    def at(self, key: str) -> "Place":
        """Return the value under a key of this mapping. Raises CalibrationError if missing."""
        path = f"{self.path}.{key}" if self.path else key
        if key not in self.names or not isinstance(self._value, dict):
            raise CalibrationError(f"key {path} is missing")
        return Place(self._value[key], path)

    def _value_if(self, expected: str, *, is_right: bool) -> Any:
        """Return the value if `is_right`; else raise CalibrationError, which names its keys.

        expected: what the value should be, for the message.
        """
        if not is_right:
            raise CalibrationError(f"{self.path} is {shown(self._value)}, expected {expected}")
        return self._value

    def text(self) -> str:
        """Return the value, which must be text; CalibrationError names its keys otherwise."""
        return str(self._value_if("text in quotes", is_right=isinstance(self._value, str)))

    def number(self) -> float:
        """Return the value, which must be a finite number; CalibrationError otherwise."""
        is_number = type(self._value) in (int, float) and abs(self._value) <= _MAX
        return float(self._value_if("a finite number", is_right=is_number))

    def has(self, key: str) -> bool:
        """Return whether this mapping contains `key`. Raises CalibrationError for no mapping."""
        return key in self.names

    def count(self) -> int:
        """Return the value, which must be a whole number >= 0; CalibrationError otherwise."""
        is_count = type(self._value) is int and self._value >= 0
        return int(self._value_if("a whole number >= 0", is_right=is_count))

    def flag(self) -> bool:
        """Return the value, which must be true or false; CalibrationError otherwise."""
        return bool(self._value_if("true or false", is_right=isinstance(self._value, bool)))

    def whole(self) -> int:
        """Return the value, which must be a whole number; CalibrationError otherwise."""
        return int(self._value_if("a whole number", is_right=type(self._value) is int))

    def rows(self, n: int) -> Array:
        """Return this list of lists of `n` numbers, at least one; CalibrationError otherwise.

        Returns
        -------
        Array
            (n_lists, n).
        """
        values = self._value
        if not isinstance(values, list) or not values:
            raise CalibrationError(f"{self.path} must be a list")
        return np.array([Place(v, f"{self.path}[{i}]").numbers(n) for i, v in enumerate(values)])

    def by_name(self, names: Sequence[str], missing: float | None = None) -> Array:
        """Return the numbers under `names`, in their order; `missing` (None: an error) for none.

        Returns
        -------
        Array
            (n_names,).
        """
        return np.array(
            [
                missing if missing is not None and not self.has(name) else self.at(name).number()
                for name in names
            ]
        )

    def numbers(self, n: int | None = None) -> Array:
        """Return this list of `n` numbers, None: of any number; CalibrationError otherwise."""
        values = self._value
        if not isinstance(values, list) or not values:
            raise CalibrationError(f"{self.path} must be a list of numbers")
        if n is not None and len(values) != n:
            raise CalibrationError(f"{self.path} holds {len(values)} numbers, expected {n}")
        return np.array([Place(v, f"{self.path}[{i}]").number() for i, v in enumerate(values)])


#: A calibration needs five levels.
_DEEPEST = 20


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
            f"nothing is written, since this calibration is unusable: {error}; check the markers"
        ) from error
    if keeps_previous and path.exists():
        write_whole(path.with_name(f"{path.name}.previous"), path.read_bytes())
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
            raise CalibrationError(f"{source}: nested too deep for a calibration")
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
    """Return the calibration in a file's parsed YAML; coupling rules are not in the file.

    Raises CalibrationError, with the keys of the value, for another version, a missing or malformed
    value, and limits that exclude 0 degrees.
    """
    version = file.at("version").count()
    if version != CALIBRATION_VERSION:
        raise CalibrationError(
            f"this file has version {version}, this lipservo reads version {CALIBRATION_VERSION}"
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
    if file.has("centres"):
        raise CalibrationError("its map has centres, which are no longer used")
    return Calibration(
        servo_names=names,
        weights=weights,
        quadratic_weights=quadratic_weights,
        rest=rest,
        rest_deg=_number_of_each(servos, "rest_deg"),
        x_range=x_range,
        min_deg=_number_of_each(servos, "min_deg"),
        max_deg=_number_of_each(servos, "max_deg"),
        errors=_parse_errors(file.at("hold_out"), servos),
        model_checksum=file.at("model_checksum").text(),
        face_checksum=file.at("face_checksum").text(),
        origin=_parse_origin(file, servos),
        following=_parse_following(servos),
        touch=_parse_part(file, "touch", lambda touch: _parse_touch(touch, names)),
        coverage=_parse_mapping(file, "coverage", lambda reach: _parse_record(reach, VisemeReach)),
        trim=_parse_trim(file, names),
        grade=_parse_part(file, "grade", lambda grade: _parse_record(grade, Grade)),
        learnt_lips=_parse_part(file, "learnt_lips", lambda lips: _parse_record(lips, LearntLips)),
        hand_poses=_parse_mapping(file, "hand_poses", lambda pose: pose.by_name(names)),
        closure=_parse_part(file, "closure", lambda it: _parse_closure(it, len(names), len(rest))),
        closing=_parse_part(file, "closing", _parse_closing),
    )


Part = TypeVar("Part")
Kind = TypeVar("Kind", bound=Record)
#: How a field of a record is read, by its type.
_READER_OF_TYPE: Mapping[object, Callable[[Place], object]] = {
    str: Place.text, float: Place.number, float | None: Place.number, int: Place.count,
    bool: Place.flag,
}  # fmt: skip
#: Fields that a file may lack, besides those that may be None.
_MAY_LACK = ("n_measured", "not_measured")


def _parse_record(place: Place, kind: type[Kind], **others: Any) -> Kind:
    """Return the record, of dataclass `kind`, that a mapping holds under its fields' names.

    others: fields that are read otherwise. Raises CalibrationError for a missing or malformed one.
    """
    for field in fields(kind):
        may_lack = field.default is None or field.name in _MAY_LACK
        if field.name not in others and (place.has(field.name) or not may_lack):
            others[field.name] = _READER_OF_TYPE[field.type](place.at(field.name))
    return kind(**others)


def _parse_part(file: Place, key: str, read: Callable[[Place], Part]) -> Part | None:
    """Return what `read` makes of the value under `key`; None if the file has none."""
    return read(file.at(key)) if file.has(key) else None


def _parse_mapping(file: Place, key: str, read: Callable[[Place], Part]) -> dict[str, Part]:
    """Return what `read` makes of each value of the mapping under `key`; {} if there is none."""
    if not file.has(key):
        return {}
    return {name: read(file.at(key).at(name)) for name in file.at(key).names}


def _number_of_each(servos: list[Place], key: str, unknown: float | None = None) -> Array:
    """Return each servo's number under `key`, (n_servos,), `unknown` where it may be missing."""
    return np.concatenate([servo.by_name([key], unknown) for servo in servos])


def _parse_closure(closure: Place, n_servos: int, n_components: int) -> Closure:
    """Return the model of the lips' gaps in the mapping `closure`.

    Raises CalibrationError, with the key, for an array whose shape does not fit `n_servos`,
    `n_components` or the number of gaps.
    """
    gaps_mm = closure.at("gaps_mm").numbers()
    n_gaps = len(gaps_mm)
    shapes = {
        "speaker_mm": (3, n_components),
        "opens_mm": (n_gaps, n_components),
        "slopes": (n_gaps, n_servos),
        "bends": (n_gaps, len(pairs(n_servos)[0])),
        "turns_deg": (n_servos, n_gaps),
    }
    rows = {key: closure.at(key).rows(width) for key, (_, width) in shapes.items()}
    for key, (n, _) in shapes.items():
        if len(rows[key]) != n:
            raise CalibrationError(f"closure.{key} must have {n} lists")
    return Closure(
        speaker_rest_mm=closure.at("speaker_rest_mm").numbers(3),
        at_deg=closure.at("at_deg").numbers(n_servos),
        gaps_mm=gaps_mm,
        press_mm=closure.at("press_mm").number(),
        **rows,
    )


def _parse_closing(closing: Place) -> Closing:
    evidence = closing.at("evidence").text()
    if evidence not in (CONTACT, PASSED, LIMITS):
        known = ", ".join((CONTACT, PASSED, LIMITS))
        raise CalibrationError(f"{closing.path}.evidence is {shown(evidence)}, expected {known}")
    return _parse_record(closing, Closing) if evidence == LIMITS else Closing(evidence)


def _parse_origin(file: Place, servos: list[Place]) -> Origin:
    """Return how, when and from which servos the calibration was made.

    servos: the mapping of each servo. Servo models and memories are () if no servo has any; a
    servo without a model has "". CalibrationError if only some have memories.
    """
    models = tuple(servo.at("model").text() if servo.has("model") else "" for servo in servos)
    has_memories = any(servo.has("memory") for servo in servos)
    keys = [field.name for field in fields(ServoMemory)]
    memories = [s.at("memory") for s in servos] if has_memories else []
    return _parse_record(
        file,
        Origin,
        servo_models=models if any(models) else (),
        servo_memories=tuple(ServoMemory(*(m.at(key).whole() for key in keys)) for m in memories),
    )


def _parse_following(servos: list[Place]) -> Following | None:
    """Return how servos follow goals; None without `lag_s`; CalibrationError if some lack it."""
    if not any(servo.has("lag_s") for servo in servos):
        return None
    return Following(
        lag_s=_number_of_each(servos, "lag_s"),
        backlash_deg=_number_of_each(servos, "backlash_deg"),
        top_speed_deg_s=_number_of_each(servos, "top_speed_deg_s", np.inf),
        bandwidth_hz=_number_of_each(servos, "bandwidth_hz", np.inf),
    )


def _parse_touch(touch: Place, names: tuple[str, ...]) -> Touch:
    return Touch(touch.at("positions_deg").by_name(names), touch.at("current_cap_ma").number())


def _parse_trim(file: Place, names: tuple[str, ...]) -> dict[str, Array]:
    """Return the trims by viseme class; names are checked, because people write trims by hand."""
    classes = [viseme[0] for viseme in VISEME_CLASSES]
    trims = _parse_mapping(file, "trim", lambda trim: trim)
    for viseme, trim in trims.items():
        if viseme not in classes:
            raise CalibrationError(f"trim.{viseme}: unknown viseme; use one of {' '.join(classes)}")
        for name in trim.names:
            if name not in names:
                raise CalibrationError(f"trim.{viseme}.{name}: this file has no servo {name}")
    return {viseme: trim.by_name(names, missing=0.0) for viseme, trim in trims.items()}


def _parse_errors(place: Place, servos: list[Place]) -> HoldOutErrors:
    """Return the errors on held-out motion, from the mapping `hold_out` and those of all servos.

    place: that mapping. Raises CalibrationError unless `each_marker_rms_mm` has `n_markers` values.
    """
    n_markers = place.at("n_markers").count()
    rms: dict[str, float] = {}
    if n_markers:
        rms = _parse_mapping(place, "each_marker_rms_mm", Place.number)
        if len(rms) != n_markers:
            raise CalibrationError(
                f"hold_out.each_marker_rms_mm has {len(rms)} values for {n_markers} markers"
            )
    joint_rms_deg = tuple(_number_of_each(servos, "hold_out_rms_deg").tolist())
    return _parse_record(place, HoldOutErrors, joint_rms_deg=joint_rms_deg, each_marker_rms_mm=rms)
