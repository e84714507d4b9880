"""Marker positions from C3D files, as motion-capture systems write them: one file a pose.

Needs ezc3d, the extra `mocap`; imported only when such files are read.
"""

import re
from pathlib import Path

import numpy as np

from calibration.calibration import CalibrationError
from lipsync.arrays import Array
from lipsync.extras import check_extra

_MM_PER_UNIT = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
_AXIS = re.compile(r"^([+-]?)([xyz])$")


def read_c3d_folder(folder: Path, axes: str = "x y z") -> list[tuple[int, str, Array]]:
    """Pose, marker and median position (3,) in mm, of every `*.c3d`; its last number is the pose.

    axes: which of the file's axes point to the robot's left, up and forward, such as `x z -y`.
    Points that the system marks as lost are NaN. Raises CalibrationError for other files.
    """
    turn = _axes_matrix(axes)
    files = sorted(folder.glob("*.c3d"))
    if not files:
        raise CalibrationError(f"{folder}: no .c3d file in this folder; one a pose is needed")
    readings = []
    for file in files:
        numbers = re.findall(r"\d+", file.stem)
        if not numbers:
            raise CalibrationError(f"{file}: no pose number in the name; call it pose_1.c3d")
        for name, place_mm in read_c3d(file).items():
            readings.append((int(numbers[-1]), name, turn @ place_mm))
    return readings


def read_c3d(path: Path) -> dict[str, Array]:
    """Median position (3,) in mm of each labelled point; NaN for one never seen.

    Raises CalibrationError for what is no C3D file, MissingExtraError without ezc3d.
    """
    check_extra("ezc3d", f"{path}: reading C3D")
    import ezc3d

    try:
        content = ezc3d.c3d(str(path))
        labels = [str(label) for label in content["parameters"]["POINT"]["LABELS"]["value"]]
        unit = str(content["parameters"]["POINT"]["UNITS"]["value"][0]).strip()
        points = np.asarray(content["data"]["points"], dtype=np.float64)[:3]
    except (OSError, RuntimeError, ValueError, KeyError, IndexError) as error:
        raise CalibrationError(f"{path}: not readable as C3D") from error
    if unit not in _MM_PER_UNIT:
        raise CalibrationError(f"{path}: unit {unit!r}, expected {', '.join(_MM_PER_UNIT)}")
    seen = np.asarray(np.isfinite(points).all(axis=0), dtype=np.bool_).reshape(points.shape[1:])
    return {
        label: _MM_PER_UNIT[unit] * np.median(points[:, i, seen[i]], axis=1)
        if seen[i].any()
        else np.full(3, np.nan)
        for i, label in enumerate(labels)
    }


def _axes_matrix(axes: str) -> Array:
    """(3, 3): what the file says -> left, up, forward."""
    matrix = np.zeros((3, 3))
    matches = [_AXIS.match(part) for part in axes.split()]
    if len(matches) != 3 or len({m.group(2) for m in matches if m}) != 3:
        raise CalibrationError(f"axes {axes!r}: expected three different ones such as 'x z -y'")
    for row, match in enumerate(matches):
        assert match is not None
        matrix[row, "xyz".index(match.group(2))] = -1.0 if match.group(1) == "-" else 1.0
    return matrix
