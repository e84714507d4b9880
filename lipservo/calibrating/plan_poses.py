"""Calibration by markers that are recorded apart: poses of a plan, and a grade at later poses.

`lipservo calibrate pose` moves servos to the poses of a plan, for markers recorded by hand.
`calibrate fit --check-plan` writes ten poses of speech that were not used in the fit, and
`calibrate grade` grades the calibration by markers recorded in them.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from calibration.calibration import Calibration, CalibrationError
from calibration.capture.capture import Capture, PosePlan, plan_rows
from calibration.capture.marker_files import read_capture, read_numbered_plan
from calibration.capture.sanity import check_frame
from calibration.fit.measured import MeasuredFit
from calibration.fit.measured_grade import graded, graded_poses, read_check_plan, write_check_plan
from lipservo.calibrating.calibration_setup import CalibrationSetup, held_servos
from lipservo.calibrating.face_source import ReadAll
from lipsync.arrays import Array


def read_poses(
    setup: CalibrationSetup, path: Path, wanted: Sequence[int]
) -> tuple[tuple[int, ...], PosePlan]:
    """Return the numbers and the plan of the poses numbered `wanted` in a file; empty: of all.

    Raises CalibrationError for a number that is not in the file, or goals beyond the face's limits.
    """
    numbers, plan = read_numbered_plan(path, setup.servos.names)
    for number in wanted:
        if number not in numbers:
            raise CalibrationError(f"{path}: pose {number} does not exist")
    low_deg, high_deg = setup.servos.limits_deg
    beyond_limits = np.argwhere((plan.goals_deg < low_deg) | (plan.goals_deg > high_deg))
    if len(beyond_limits):
        row, joint = beyond_limits[0]
        raise CalibrationError(
            f"{path}, pose {numbers[row]}: {plan.servo_names[joint]} at "
            f"{plan.goals_deg[row, joint]:g} deg is outside "
            f"{low_deg[joint]:g}..{high_deg[joint]:g} deg; is it a plan of this face?"
        )
    rows = [numbers.index(number) for number in wanted or numbers]
    chosen_plan = plan_rows(plan, rows)
    chosen_plan = replace(chosen_plan, start_deg=np.clip(chosen_plan.start_deg, low_deg, high_deg))
    return tuple(numbers[row] for row in rows), chosen_plan


def check_plan(setup: CalibrationSetup, path: Path) -> None:
    """Raise CalibrationError if a plan exceeds the face's limits or a joint never moves in it."""
    _, plan = read_poses(setup, path, ())
    never_moves = (
        np.ptp(plan.goals_deg, axis=0) == 0.0 if len(plan) > 1 else np.zeros(len(plan.servo_names))
    )
    names = [name for name, is_still in zip(plan.servo_names, never_moves, strict=True) if is_still]
    if names:
        raise CalibrationError(
            f"{path}: {', '.join(names)} never moves in it, so nothing can be learnt of it; write "
            "a plan with `lipservo calibrate plan`"
        )


def hold_plan_poses(
    setup: CalibrationSetup,
    plan: PosePlan,
    arrived: Callable[[int, Array], object],
    wait: Callable[[], object],
) -> None:
    """Move the servos to each pose of a plan, and wait there; switch torque off at the end.

    Each joint comes from the side that the plan names, because of backlash.

    Parameters
    ----------
    setup : CalibrationSetup
        Face and options.
    plan : PosePlan
        The n poses.
    arrived : Callable[[int, Array], object]
        Called with the row of a pose in the plan and the encoders' positions, (n_servos,) degrees.
    wait : Callable[[], object]
        Returns when the pose has been recorded; the servos are held meanwhile.
    """
    with held_servos(setup) as face:
        for row in range(len(plan)):
            face.move(plan.start_deg[row])
            arrived(row, face.move(plan.goals_deg[row]))
            face.hold_while(wait)


def check_face(setup: CalibrationSetup, calibration: Calibration, source: str) -> None:
    """Raise CalibrationError if a calibration, from `source`, was made for another face."""
    if calibration.face_checksum != setup.servos.face_checksum:
        raise CalibrationError(
            f"{source}: is not of face {setup.settings.name!r}; give its own face with --config"
        )


def grade_by_files(
    setup: CalibrationSetup,
    calibration: Calibration,
    plan: Path,
    markers: Path,
    *,
    axes: str,
    read: ReadAll | None,
) -> tuple[Calibration, tuple[str, ...]]:
    """Return the calibration graded by recorded markers, and warnings.

    plan: as `fit --check-plan` wrote it. markers: the file or folder of the recording; axes: of C3D
    files, as for `tracker_source`; read: reads pictures instead, None for others. Raises
    CalibrationError.
    """
    poses = read_check_plan(plan, calibration)
    capture = read_capture(plan, markers, calibration.servo_names, axes=axes, read=read)
    reordered = _in_marker_order(capture, poses.marker_names, markers)
    usual_mm = _median_markers_mm(capture.markers_mm)
    size_warnings = check_frame(capture.marker_names, usual_mm, setup.model, accept=setup.accept)
    calibration, remarks = graded(calibration, poses, reordered)
    return calibration, (*capture.stalled, *size_warnings, *remarks)


def write_check_poses(
    setup: CalibrationSetup,
    calibration: Calibration,
    fit: MeasuredFit | None,
    path: Path,
    output: Path,
) -> str:
    """Write the poses to grade a calibration by to `path`; return a line with the next steps.

    output: the file of the calibration, for that line. Without a fit (a jaw alone, which has no
    lips to grade) no file is written. Raises OutputError.
    """
    if fit is None:
        return f"{path} is not written: a jaw alone has no lips to be graded"
    poses = graded_poses(replace(fit, calibration=calibration), setup.servos)
    write_check_plan(poses, calibration, path)
    return (
        f"{path}: {len(poses)} poses to grade it by. Reach each from the side it names (`lipservo "
        f"calibrate pose {path}` does), record the markers, then `lipservo calibrate grade "
        f"{output} --plan {path} --markers FILE`"
    )


def _in_marker_order(capture: Capture, names: tuple[str, ...], markers: Path) -> Capture:
    """Return the capture with the markers `names`, in that order, NaN for missing ones.

    Raises CalibrationError for a marker that is not in `names`; `markers`: the file to name then.
    """
    unknown = [name for name in capture.marker_names if name not in names]
    if unknown:
        raise CalibrationError(
            f"{markers}: marker {unknown[0]!r} was not captured for the fit; known: "
            f"{', '.join(names)}"
        )
    ordered_mm = np.full((len(capture), len(names), 3), np.nan)
    ordered_mm[:, [names.index(name) for name in capture.marker_names]] = capture.markers_mm
    return replace(capture, marker_names=names, markers_mm=ordered_mm)


def _median_markers_mm(markers_mm: Array) -> Array:
    """Return each marker's median place, (n, n_markers, 3) -> (n_markers, 3); NaN if never seen."""
    median_mm = np.full(markers_mm.shape[1:], np.nan)
    is_seen = np.asarray(np.isfinite(markers_mm).any(axis=0)).all(axis=1)
    median_mm[is_seen] = np.nanmedian(markers_mm[:, is_seen], axis=0)
    return median_mm
