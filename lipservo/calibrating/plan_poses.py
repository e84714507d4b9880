"""`lipservo calibrate pose`: servos moved to poses of a plan, for markers recorded by hand."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from calibration.calibration import CalibrationError
from calibration.capture.capture_plan import PosePlan
from calibration.capture.marker_files import read_numbered_plan
from lipservo.calibrating.calibration_setup import CalibrationSetup, held_servos
from lipsync.arrays import Array


def read_poses(
    setup: CalibrationSetup, path: Path, wanted: Sequence[int]
) -> tuple[tuple[int, ...], PosePlan]:
    """The numbers of the poses to go to and the plan of these alone; all where none is wanted.

    Raises CalibrationError for a number that is not in the plan, or goals beyond the face's limits.
    """
    numbers, plan = read_numbered_plan(path, setup.servos.names)
    for number in wanted:
        if number not in numbers:
            raise CalibrationError(f"{path}: has no pose {number}")
    low_deg, high_deg = setup.servos.limits_deg
    beyond = np.argwhere((plan.goals_deg < low_deg) | (plan.goals_deg > high_deg))
    if len(beyond):
        row, joint = beyond[0]
        raise CalibrationError(
            f"{path}, pose {numbers[row]}: {plan.servo_names[joint]} at "
            f"{plan.goals_deg[row, joint]:g} deg is outside {low_deg[joint]:g}.."
            f"{high_deg[joint]:g}; is it a plan of this face?"
        )
    rows = [numbers.index(number) for number in wanted or numbers]
    start_deg = np.clip(plan.start_deg[rows], low_deg, high_deg)
    chosen = PosePlan(plan.servo_names, plan.goals_deg[rows], plan.from_below[rows], start_deg)
    return tuple(numbers[row] for row in rows), chosen


def check_plan(setup: CalibrationSetup, path: Path) -> None:
    """Raises CalibrationError for goals beyond the face's limits, and a joint that never moves."""
    _, plan = read_poses(setup, path, ())
    still = (
        np.ptp(plan.goals_deg, axis=0) == 0.0 if len(plan) > 1 else np.zeros(len(plan.servo_names))
    )
    names = [name for name, stays in zip(plan.servo_names, still, strict=True) if stays]
    if names:
        raise CalibrationError(
            f"{path}: {', '.join(names)} moves in no pose, so nothing can be learnt of it; write "
            "a plan with `lipservo calibrate plan`"
        )


def stand_in_poses(
    setup: CalibrationSetup,
    plan: PosePlan,
    arrived: Callable[[int, Array], object],
    wait: Callable[[], object],
) -> None:
    """Go to one pose after another, each from the side it names; then to neutral, and let go.

    arrived: hears the row of the pose in the plan and the encoders, (n_servos,). wait: returns when
    the pose has been recorded; the servos are held meanwhile.
    """
    with held_servos(setup) as face:
        for row in range(len(plan)):
            face.move(plan.start_deg[row])
            arrived(row, face.move(plan.goals_deg[row]))
            face.hold_while(wait)
