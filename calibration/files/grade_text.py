"""What a calibration is worth, as YAML: how these parts are written and read."""

from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Final

from calibration.files.file_place import Place
from calibration.grade import Grade, LearntLips, VisemeReach
from lipsync.phonemes import VISEME_CLASSES

_HEAD: Final = "coverage:  # of each viseme class, on the face as learnt; measured_mm on the robot"


def learnt_lips_lines(lips: LearntLips | None) -> list[str]:
    """Nothing where nothing was learnt."""
    if lips is None:
        return []
    parts = ", ".join(f"{name}: {_shown(value)}" for name, value in _known(lips))
    return [f"learnt_lips: {{{parts}}}"]


def grade_lines(grade: Grade | None) -> list[str]:
    """Nothing where nothing was measured."""
    if grade is None:
        return []
    head = "grade:  # measured on the robot, at poses of speech that were never fitted"
    return [head, *(f"  {name}: {_shown(value)}" for name, value in _known(grade))]


def coverage_lines(coverage: Mapping[str, VisemeReach]) -> list[str]:
    """A line for each viseme class."""
    if not coverage:
        return []
    phonemes = {viseme[0]: " ".join(viseme) for viseme in VISEME_CLASSES}
    lines = [_HEAD]
    for viseme, reach in coverage.items():
        parts = [(n, v) for n, v in _known(reach) if reach.n_measured or n != "n_measured"]
        told = ", ".join(f"{name}: {_shown(value)}" for name, value in parts)
        lines.append(f"  {viseme}: {{{told}}}  # {phonemes.get(viseme, '')}")
    return lines


def parse_learnt_lips(file: Place) -> LearntLips | None:
    """Raises CalibrationError."""
    if not file.has("learnt_lips"):
        return None
    lips = file.at("learnt_lips")
    return LearntLips(
        left_out_rms_mm=lips.at("left_out_rms_mm").number(),
        noise_mm=lips.at("noise_mm").number(),
        own_gap_mm=lips.at("own_gap_mm").number(),
        stop=lips.at("stop").flag(),
    )


def parse_grade(file: Place) -> Grade | None:
    """Raises CalibrationError."""
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
    """Raises CalibrationError."""
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


def _known(part: Grade | LearntLips | VisemeReach) -> Iterable[tuple[str, float]]:
    for field in fields(part):
        value = getattr(part, field.name)
        if value is not None:
            yield field.name, value


def _shown(value: float) -> str:
    """Numbers to 4 significant digits. YAML 1.1 takes 1e-05 for a word; 1.0e-05 is a number."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int):
        return str(value)
    text = f"{value:.4g}"
    return text if "." in text else text.replace("e", ".0e")
