"""Pose plans and marker positions in files, written by any tracker or by a person with callipers.

A plan is CSV: `pose`, then the goal of each joint as `<servo>_deg` and the side of the last step as
`<servo>_from` (1 below, -1 above). Markers are CSV with the columns `pose, marker, x_mm, y_mm,
z_mm`, or JSON as a list of objects with those keys; several readings of one marker in one pose
count as their median, and an empty or missing reading as lost. A folder of C3D files, as
motion-capture systems write them, holds one file per pose; they need ezc3d, the extra `mocap`,
imported only when such files are read.
"""

import csv
import io
import json
import math
import os.path
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from calibration.calibration import CalibrationError
from calibration.capture.capture import LEAD_IN_DEG, Capture, PosePlan, ladders_of
from lipsync.arrays import Array, Indices
from lipsync.errors import check_extra, shown
from lipsync.output_file import write_whole

#: A marker that was seen: pose, name, and place (3,) in mm.
Reading = tuple[int, str, Array]
_MM_PER_UNIT = {"mm": 1.0, "cm": 10.0, "m": 1000.0}
#: Channels that stand beside the points and are no places (The C3D File Format, POINT:ANGLES ...).
_NOT_POINTS = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "REACTIONS")
#: The second byte of every C3D file.
_C3D_KEY = b"\x50"
_AXIS = re.compile(r"^([+-]?)([xyz])$")


def read_c3d_folder(folder: Path, axes: str = "x y z") -> list[Reading]:
    """Read every `*.c3d` of a folder; the last number in a file's name is the pose.

    Points that the system marks as lost are NaN. Raises CalibrationError without such files, for a
    name without a number, and for a file that is not readable as C3D.

    Parameters
    ----------
    folder : Path
        Folder of C3D files.
    axes : str
        Which of the file's axes point to the robot's left, up and forward, such as `x z -y`.

    Returns
    -------
    list[Reading]
        Pose, marker and median position (3,) in mm.
    """
    to_face_axes = _axes_matrix(axes)
    files = sorted(folder.glob("*.c3d"))
    if not files:
        raise CalibrationError(f"{folder}: no .c3d file in this folder; each pose needs one")
    readings = []
    for file in files:
        numbers = re.findall(r"\d+", file.stem)
        if not numbers:
            raise CalibrationError(f"{file}: its name has no pose number; call it pose_1.c3d")
        for name, place_mm in read_c3d(file).items():
            readings.append((int(numbers[-1]), name, to_face_axes @ place_mm))
    return readings


def read_c3d(path: Path) -> dict[str, Array]:
    """Return the median position of each labelled point of a C3D file.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    dict[str, Array]
        (3,) mm by label; NaN for one never seen: its residual is negative, or all its coordinates
        are 0, as systems write what they have lost. Angles, forces and points without a label are
        left out.

    Raises
    ------
    CalibrationError
        The file is no C3D file, its unit is unknown, or two of its points have one label.
    MissingExtraError
        ezc3d is not installed.
    """
    _check_is_c3d(path)
    check_extra("ezc3d", f"{path}: reading C3D")
    import ezc3d

    try:
        content = ezc3d.c3d(str(path))
        point_group = content["parameters"]["POINT"]
        labels = _c3d_texts(point_group, "LABELS")
        not_points = {each for kind in _NOT_POINTS for each in _c3d_texts(point_group, kind)}
        unit = next((str(each).strip() for each in point_group["UNITS"]["value"]), "")
        points = np.asarray(content["data"]["points"], dtype=np.float64)[:3]
        residuals = np.asarray(content["data"]["meta_points"]["residuals"], dtype=np.float64)[0]
    except (OSError, RuntimeError, ValueError, KeyError, IndexError) as error:
        raise CalibrationError(f"{path}: not readable as C3D") from error
    if unit not in _MM_PER_UNIT:
        raise CalibrationError(
            f"{path}: unit {unit!r} (POINT:UNITS) is not known; export it again in one of "
            f"{', '.join(_MM_PER_UNIT)}"
        )
    named = [(i, label) for i, label in enumerate(labels) if label and label not in not_points]
    equal = [label for label, n in Counter(label for _, label in named).items() if n > 1]
    if equal:
        raise CalibrationError(
            f"{path}: several points share a label: {shown(equal[0])} ({len(equal)} such labels); "
            "give each point its own"
        )
    # Lost: not finite, a negative residual, or all coordinates 0.
    lost = ~np.isfinite(points).all(axis=0) | (residuals < 0.0) | (points == 0.0).all(axis=0)
    places = {}
    for i, label in named:
        # A label beyond the stored points is of a point that was never seen.
        seen = points[:, i, ~lost[i]] if i < points.shape[1] else points[:, :0, 0]
        median = np.median(seen, axis=1) if seen.size else np.full(3, np.nan)
        places[label] = _MM_PER_UNIT[unit] * median
    return places


def _check_is_c3d(path: Path) -> None:
    """Raise CalibrationError for a file that does not begin as C3D does: ezc3d may hang on it."""
    if not os.path.isfile(path):  # Path's raises for too long a name
        raise CalibrationError(f"{str(path)[:200]!r}: no such file")
    try:
        with path.open("rb") as file:
            is_c3d = file.read(2)[1:] == _C3D_KEY
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be read: {error.strerror}") from error
    if not is_c3d:
        raise CalibrationError(f"{path}: not readable as C3D")


def _c3d_texts(group: Mapping[str, Any], name: str) -> list[str]:
    """Return the list of texts under `name` in a C3D file's group POINT.

    A list of more than 255 texts goes on under `name` with 2, 3 ... added.
    """
    names = (name, *(f"{name}{n}" for n in range(2, 10)))
    parts = (group[each]["value"] for each in names if each in group)
    return [str(text).strip() for part in parts for text in part]


def _axes_matrix(axes: str) -> Array:
    """Return the matrix (3, 3) from a file's axes to left, up, forward, written as `x z -y`.

    Raises CalibrationError for any other text.
    """
    matrix = np.zeros((3, 3))
    matches = [_AXIS.match(part) for part in axes.split()]
    if len(matches) != 3 or len({m.group(2) for m in matches if m}) != 3:
        raise CalibrationError(f"axes {axes!r} must be three different ones, such as 'x z -y'")
    for row, match in enumerate(matches):
        assert match is not None
        matrix[row, "xyz".index(match.group(2))] = -1.0 if match.group(1) == "-" else 1.0
    return matrix


_AXES = ("x_mm", "y_mm", "z_mm")
_COLUMNS = ("pose", "marker", *_AXES)
_LADDER = "ladder"
#: A hundred metres: no tracker is so far from its zero.
_FARTHEST_MM = 1e5
#: Poses without markers are named up to so many.
_MOST_NAMED = 8


def write_plan(plan: PosePlan, path: Path) -> None:
    """Write a plan as CSV, whole or not at all; poses count from 1. Raises OutputError."""
    header, rows = plan_table(plan)
    ladders = ladders_of(plan).tolist()
    write_table(path, [*header, _LADDER], [[*r, n] for r, n in zip(rows, ladders, strict=True)])


def plan_table(plan: PosePlan) -> tuple[list[str], list[list[object]]]:
    """Return the columns of a plan's goals and sides, and their row for each pose."""
    degrees = [f"{name}_deg" for name in plan.servo_names]
    sides = [f"{name}_from" for name in plan.servo_names]
    rows = [
        [pose + 1, *(f"{g:.2f}" for g in goals), *(f"{s:.0f}" for s in from_)]
        for pose, (goals, from_) in enumerate(zip(plan.goals_deg, plan.from_below, strict=True))
    ]
    return ["pose", *degrees, *sides], rows


def write_table(path: Path, header: list[str], rows: Iterable[list[object]]) -> None:
    """Write CSV, whole or not at all. Raises OutputError."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([header, *rows])
    write_whole(path, text.getvalue())


def read_plan(path: Path, servo_names: tuple[str, ...]) -> PosePlan:
    """Return these servos' plan in a CSV file. Raises CalibrationError, with file and line."""
    return read_numbered_plan(path, servo_names)[1]


def read_numbered_plan(path: Path, servo_names: tuple[str, ...]) -> tuple[list[int], PosePlan]:
    """Return the pose numbers in a plan's CSV file, and its plan. Raises CalibrationError."""
    numbers, goals_deg, from_below, ladders = _read_plan(path, servo_names)
    start_deg = goals_deg - LEAD_IN_DEG * from_below
    return numbers, PosePlan(servo_names, goals_deg, from_below, start_deg, ladders)


def read_capture(
    plan_path: Path,
    markers_path: Path,
    servo_names: tuple[str, ...],
    *,
    axes: str = "x y z",
    read: Callable[[], list[Reading]] | None = None,
) -> Capture:
    """Return a capture: the poses of a plan's file that markers were recorded for.

    Parameters
    ----------
    plan_path : Path
        CSV file of the plan.
    markers_path : Path
        CSV, JSON or folder of the markers.
    servo_names : tuple[str, ...]
        Names of the face's servos.
    axes : str
        Axes of C3D files to the robot's left, up and forward, such as `x z -y`.
    read : Callable[[], list[Reading]] | None
        Function that returns the readings; None: `markers_path` is read.

    Returns
    -------
    Capture
        Markers are (n, n_markers, 3) mm.

    Raises
    ------
    CalibrationError
        A file is malformed, has no readings, or readings of a pose not in the plan.
    """
    poses, goals_deg, from_below, ladders = _read_plan(plan_path, servo_names)
    readings = read_readings(markers_path, axes) if read is None else read()
    if not readings:
        raise CalibrationError(f"{markers_path}: has no readings of markers")
    unknown = sorted({pose for pose, _, _ in readings} - set(poses))
    if unknown:
        raise CalibrationError(f"{markers_path}: pose {unknown[0]} is not in {plan_path}")
    names = tuple(dict.fromkeys(name for _, name, _ in readings))
    places_mm: dict[tuple[int, str], list[Array]] = {}
    for pose, name, place_mm in readings:
        places_mm.setdefault((pose, name), []).append(place_mm)
    with_markers = {pose for pose, _ in places_mm}
    recorded_poses = [pose for pose in poses if pose in with_markers]
    markers_mm = np.full((len(recorded_poses), len(names), 3), np.nan)
    for row, pose in enumerate(recorded_poses):
        for column, name in enumerate(names):
            if (pose, name) in places_mm:
                markers_mm[row, column] = median_place(places_mm[pose, name])
    rows = [poses.index(pose) for pose in recorded_poses]
    left_out = _missing_poses_line([pose for pose in poses if pose not in with_markers], len(poses))
    return Capture(
        servo_names,
        names,
        goals_deg[rows],
        from_below[rows],
        markers_mm,
        left_out,
        rows=tuple(rows),
        ladders=ladders[rows],
    )


def _missing_poses_line(poses: list[int], n_poses: int) -> tuple[str, ...]:
    """Return one line with the numbers `poses`, of `n_poses`, that lack markers; () if none do."""
    if not poses:
        return ()
    named = ", ".join(str(pose) for pose in poses[:_MOST_NAMED])
    more = ", ..." if len(poses) > _MOST_NAMED else ""
    return (f"no markers for {len(poses)} of {n_poses} poses, which are left out: {named}{more}",)


def median_place(places_mm: list[Array]) -> Array:
    """Return the median of the readings that are finite, so that one outlier counts for nothing.

    Parameters
    ----------
    places_mm : list[Array]
        (3,) mm each.

    Returns
    -------
    Array
        (3,) mm; NaN if no reading is finite.
    """
    whole = [place for place in places_mm if np.isfinite(place).all()]
    return np.asarray(np.median(whole, axis=0)) if whole else np.full(3, np.nan)


def _read_plan(path: Path, servo_names: tuple[str, ...]) -> tuple[list[int], Array, Array, Indices]:
    """Return the pose numbers, goals, sides and ladder numbers in a plan's CSV file.

    Goals: (n, n_servos) degrees; sides: (n, n_servos), 1 from below or -1 from above; ladders:
    (n,). Without columns for them, sides are 1 and ladders 0. Raises CalibrationError for a
    malformed file, or a pose that occurs twice.
    """
    rows = list(csv_rows(path, ("pose", *(f"{name}_deg" for name in servo_names))))
    poses = [_whole_number(row["pose"], place) for place, row in rows]
    goals = [[number_in(row[f"{n}_deg"], place) for n in servo_names] for place, row in rows]
    sides = [
        [number_in(row.get(f"{n}_from", "1"), place) for n in servo_names] for place, row in rows
    ]
    if len(set(poses)) < len(poses):
        raise CalibrationError(f"{path}: two lines have the same pose")
    for (place, _), pose_sides in zip(rows, sides, strict=True):
        if not set(pose_sides) <= {1.0, -1.0}:
            raise CalibrationError(f"{place}: sides must be 1 (from below) or -1 (from above)")
    shape = (len(poses), len(servo_names))
    ladders = [_whole_number(row.get(_LADDER, 0), place, _LADDER) for place, row in rows]
    return (
        poses,
        np.array(goals).reshape(shape),
        np.array(sides).reshape(shape),
        np.array(ladders, dtype=np.int64),
    )


def read_readings(path: Path, axes: str = "x y z") -> list[Reading]:
    """Return every marker reading in a file or folder.

    A folder contains C3D files, or pictures of coloured dots with a `dots.csv`.

    Parameters
    ----------
    path : Path
        CSV, JSON or a folder.
    axes : str
        Axes of C3D files to the robot's left, up and forward, such as `x z -y`.

    Returns
    -------
    list[Reading]
        Pose, marker and position (3,) in mm, NaN where lost.
    """
    if path.is_dir():
        return read_c3d_folder(path, axes)
    rows = _json_rows(path) if path.suffix.lower() == ".json" else csv_rows(path, _COLUMNS)
    return [
        (
            _whole_number(row["pose"], place),
            str(row["marker"]),
            np.array([_number_mm(row[axis], place, axis) for axis in _AXES]),
        )
        for place, row in rows
    ]


def csv_rows(path: Path, needed: Iterable[str]) -> Iterable[tuple[str, Mapping[str, object]]]:
    """Yield `file, line n` and the row, by column, of every line of a CSV file.

    Raises CalibrationError for an unreadable file, a missing column of `needed`, or a line with
    surplus values.
    """
    reader = csv.DictReader(io.StringIO(_read_text(path)))
    try:
        for column in needed:
            if column not in (reader.fieldnames or ()):
                raise CalibrationError(f"{path}: column {column!r} is missing in the first line")
        for number, row in enumerate(reader):
            place = f"{path}, line {number + 2}"
            if any(row.get(None, ())):  # spreadsheets leave empty ones
                raise CalibrationError(
                    f"{place}: has more values than the first line has columns; write decimals "
                    "with a point, not a comma"
                )
            yield place, row
    except csv.Error as error:
        raise CalibrationError(f"{path}: not readable as CSV: {error}") from error


def _json_rows(path: Path) -> Iterable[tuple[str, Mapping[str, object]]]:
    """Yield `file, reading n` and the reading, by key, of every reading in a JSON file.

    Missing coordinates are None. Raises CalibrationError for a file that is unreadable or no list,
    or a reading without pose or marker.
    """
    try:
        content = json.loads(_read_text(path))
    except (ValueError, RecursionError) as error:
        raise CalibrationError(f"{path}: not readable as JSON") from error
    if not isinstance(content, list):
        raise CalibrationError(f"{path}: must be a list of readings")
    for number, row in enumerate(content):
        place = f"{path}, reading {number + 1}"
        for key in _COLUMNS[:2]:
            if not isinstance(row, dict) or key not in row:
                raise CalibrationError(f"{place}: {key!r} is missing")
        yield place, dict.fromkeys(_AXES) | row


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")  # as spreadsheets write it
    except UnicodeDecodeError as error:
        raise CalibrationError(f"{path}: not a text file") from error
    except OSError as error:
        raise CalibrationError(f"{path}: cannot be read: {error.strerror}") from error


def _number_mm(value: object, place: str, axis: str) -> float:
    """Return `value` in mm as a number, NaN if it is empty.

    Raises CalibrationError, which names `place` and `axis`, beyond a hundred metres.
    """
    number = number_in(value, place, lost=True)
    if abs(number) > _FARTHEST_MM:
        raise CalibrationError(f"{place}: {axis} is {shown(value)}; give it in millimetres")
    return number


def number_in(value: object, place: str, *, lost: bool = False) -> float:
    """Return `value` as a finite number; NaN if it is empty or nan and `lost` allows that.

    Raises CalibrationError, which names `place`, its file and line, for anything else.
    """
    if lost and (value is None or str(value).strip() == ""):
        return math.nan
    if value is None:
        raise CalibrationError(f"{place}: a value is missing")
    try:
        number = float(str(value))
    except ValueError:
        number = math.inf
    if not math.isfinite(number) and not (lost and math.isnan(number)):
        raise CalibrationError(f"{place}: {shown(value)} is not a number")
    return number


def _whole_number(value: object, place: str, what: str = "pose") -> int:
    number = number_in(value, place)
    if number != int(number):
        raise CalibrationError(f"{place}: {what} {shown(value)} is not a whole number")
    return int(number)
