"""Poses to grade a calibration by, as a file: a plan that also says what should be seen.

The columns of a plan, so that whatever moves a robot through one moves it through this; then, of
each pose, the viseme class, the speaker's gap, the share of speech that it stands for, the opening
asked for, the robot's own closed gap and the tracker's noise; which map it belongs to; and where
each marker should be, `<marker>_x_mm`, `_y_mm`, `_z_mm`.
"""

import csv
import hashlib
import io
from pathlib import Path
from typing import Final

import numpy as np

from calibration.calibration import Calibration, CalibrationError
from calibration.capture.marker_files import csv_rows, number_in, read_plan
from calibration.fit.measured_grade import GradedPoses
from lipsync.arrays import Array
from lipsync.output_file import write_whole

_AXES: Final = ("x_mm", "y_mm", "z_mm")
_NUMBERS: Final = ("human_gap_mm", "share", "asked_open_mm", "own_gap_mm", "noise_mm")
_VISEME, _MAP, _FIRST = "viseme", "map", "_x_mm"


def write_check_plan(poses: GradedPoses, calibration: Calibration, path: Path) -> None:
    """Write it whole or not at all; poses are counted from 1. Raises OutputError."""
    plan = poses.plan
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        [
            "pose",
            *(f"{name}_deg" for name in plan.servo_names),
            *(f"{name}_from" for name in plan.servo_names),
            _VISEME,
            *_NUMBERS,
            _MAP,
            *(f"{name}_{axis}" for name in poses.marker_names for axis in _AXES),
        ]
    )
    for i in range(len(poses)):
        numbers = (
            poses.human_gap_mm[i],
            poses.shares[i],
            poses.asked_open_mm[i],
            poses.own_gap_mm,
            poses.noise_mm,
        )
        writer.writerow(
            [
                i + 1,
                *(f"{goal:.2f}" for goal in plan.goals_deg[i]),
                *(f"{side:.0f}" for side in plan.from_below[i]),
                poses.visemes[i],
                *(f"{number:.4f}" for number in numbers),
                map_checksum(calibration),
                *(f"{place:.3f}" for place in poses.targets_mm[i].ravel()),
            ]
        )
    write_whole(path, text.getvalue())


def read_check_plan(path: Path, calibration: Calibration) -> GradedPoses:
    """Raises CalibrationError for a plan of another map, or one that says not what to see."""
    servo_names = calibration.servo_names
    plan = read_plan(path, servo_names)
    rows = list(csv_rows(path, ("pose",)))
    columns = rows[0][1] if rows else {}
    names = tuple(name.removesuffix(_FIRST) for name in columns if name.endswith(_FIRST))
    if _MAP not in columns or not names:
        raise CalibrationError(
            f"{path}: says not what should be seen; `lipservo calibrate fit --check-plan FILE` "
            "writes poses to grade by"
        )
    needed = (_VISEME, *_NUMBERS, *(f"{name}_{axis}" for name in names for axis in _AXES))
    rows = list(csv_rows(path, needed))
    if {row[_MAP] for _, row in rows} != {map_checksum(calibration)}:
        raise CalibrationError(
            f"{path}: was written for another calibration than this; each fit needs its own"
        )

    def numbers(column: str) -> Array:
        return np.array([number_in(row[column], place) for place, row in rows])

    targets_mm = [[numbers(f"{name}_{axis}") for axis in _AXES] for name in names]
    return GradedPoses(
        plan=plan,
        marker_names=names,
        targets_mm=np.array(targets_mm).transpose(2, 0, 1),
        asked_open_mm=numbers("asked_open_mm"),
        visemes=tuple(str(row[_VISEME]) for _, row in rows),
        human_gap_mm=numbers("human_gap_mm"),
        shares=numbers("share"),
        own_gap_mm=float(numbers("own_gap_mm")[0]),
        noise_mm=float(numbers("noise_mm")[0]),
    )


def map_checksum(calibration: Calibration) -> str:
    """16 hex digits over where a map sends servos, to 6 digits as in its file; not over trims."""
    parts = [",".join(calibration.servo_names)]
    for numbers in (
        calibration.rest,
        calibration.rest_deg,
        calibration.weights,
        calibration.quadratic_weights,
        calibration.centre_weights,
    ):
        parts += [f"{number:.6g}" for number in numbers.ravel()]
    return hashlib.sha256(" ".join(parts).encode()).hexdigest()[:16]
