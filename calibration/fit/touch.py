"""Correction of a calibration's lip contact in a minute: the map stays, its contact is moved.

Screws that are tightened, warm servos and worn skin shift the contact of the lips by tenths of a
millimetre. Ladders of small steps close the lips in shapes in which the map closes them. By
markers, contact is where the dots of both lips come no nearer; without markers it is where the
servos begin to draw more current than the skin alone requires.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from sklearn.cluster import KMeans

from calibration.calibration import Calibration, CalibrationError
from calibration.capture.capture import Capture, PosePlan, ladders_of, plan_of_poses
from calibration.closure import CLOSED_GAP_MM, Closure
from calibration.fit.closing import ladder_apertures
from calibration.mouth_servos import MouthServos
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array, Indices

#: Shapes, and openings of their ladders beyond contact as the map believes it to be.
_N_SHAPES, _LEVELS_MM = 3, np.linspace(2.0, -2.2, 15)
_SOLVER_ROUNDS = 4
#: Contact may have moved by so much; farther, and the face must be measured anew.
_MOST_OFFSET_MM, _STEP_MM = 1.2, 0.05
#: A person sees the lips of all shapes meet within so much: two steps of a ladder, and a half.
_AGREEMENT_MM = 1.0
#: A bend must explain so much more than a straight line, for each ladder (an F value).
_SURE_RISE = 8.0


def touch_plan(calibration: Calibration, model: FaceWithAnimPhos, servos: MouthServos) -> PosePlan:
    """Return a plan of poses that close the lips in steps, from 2 mm open to 2.2 mm past contact.

    There is one ladder of steps for each of three usual closed mouth shapes. Raises
    CalibrationError for a calibration without a model of how its robot's lips close, or a speaker
    whose lips never close.
    """
    closure = _closure_of(calibration)
    frames = model.animphos.frames
    frames = frames[model.lip_gaps_mm(model.markers_mm(frames)) <= CLOSED_GAP_MM]
    if not len(frames):
        raise CalibrationError("the face model never closes the lips; give another with --model")
    n_shapes = min(_N_SHAPES, len(np.unique(frames, axis=0)))
    shapes = KMeans(n_shapes, n_init=2, random_state=0).fit(frames).cluster_centers_
    goals, sides, ladders = [], [], []
    for number, pose_deg in enumerate(calibration.poses_deg(shapes)):
        poses_deg = np.tile(pose_deg, (len(_LEVELS_MM), 1))
        # Turn joints until the predicted gaps are those of the steps.
        for _ in range(_SOLVER_ROUNDS):
            missing_mm = _LEVELS_MM[:, None] - closure.open_mm(poses_deg)
            poses_deg = np.clip(poses_deg + missing_mm @ closure.turns_deg.T, *servos.limits_deg)
        direction = np.sign(poses_deg[-1] - poses_deg[0])
        goals.append(poses_deg)
        sides.append(np.tile(np.where(direction == 0.0, 1.0, direction), (len(poses_deg), 1)))
        ladders.append(np.full(len(poses_deg), number + 1))
    plan = plan_of_poses(servos.joints, np.concatenate(goals), np.concatenate(sides), servos.rules)
    return replace(plan, ladders=np.concatenate(ladders))


def touched_by_markers(calibration: Calibration, seen: Capture) -> tuple[Calibration, float]:
    """Return the calibration with contact moved to where markers show it, and the move in mm.

    seen: capture of the poses of `touch_plan`. The move is positive if lips have to close farther
    than before until they meet. Raises CalibrationError where no contact is found.
    """
    apertures = ladder_apertures(seen)
    if apertures is None:
        raise CalibrationError("contact needs markers on both lips, one above the other; add them")
    following = calibration.following
    half_backlash_deg: Array | float = 0.0 if following is None else following.backlash_deg / 2
    horns_deg = seen.goals_deg - seen.from_below * half_backlash_deg
    unseen = (
        "no contact of the lips was seen within 2 mm of where the calibration has it; measure the "
        "face anew with `lipservo calibrate measure`"
    )
    return _moved_to_bend(calibration, horns_deg, apertures.rows, apertures.mm, unseen)


def touched_by_current(
    calibration: Calibration, plan: PosePlan, efforts: Array
) -> tuple[Calibration, float]:
    """Return the calibration with contact moved to where the servos' current rises.

    Parameters
    ----------
    calibration : Calibration
        Calibration with a model of how the robot's lips close.
    plan : PosePlan
        Plan of ladders, from `touch_plan`.
    efforts : Array
        (n, n_servos), efforts or currents in any one unit.

    Returns
    -------
    tuple[Calibration, float]
        The calibration, and by how many mm lips close farther than before until they meet.

    Raises
    ------
    CalibrationError
        The current does not rise clearly.
    """
    total = np.abs(efforts).sum(axis=1)
    ladders = ladders_of(plan)
    rows = [np.flatnonzero(ladders == number) for number in np.unique(ladders)]
    unseen = (
        "the servos' current does not rise where the lips close; give --tracker, or measure the "
        "face anew with `lipservo calibrate measure`"
    )
    return _moved_to_bend(calibration, plan.goals_deg, rows, [total[own] for own in rows], unseen)


def _moved_to_bend(
    calibration: Calibration,
    horns_deg: Array,
    ladders: Sequence[Indices],
    values: Sequence[Array],
    unseen: str,
) -> tuple[Calibration, float]:
    """Return the calibration with contact where values bend upwards, and the move in mm.

    horns_deg: (n, n_servos), poses; ladders: rows of the poses of each ladder; values: what is seen
    in these, apertures or currents. Raises CalibrationError, with `unseen` where nothing bends.
    """
    closing_mm = [-_closure_of(calibration).open_mm(horns_deg[rows])[:, 0] for rows in ladders]
    offsets_mm = np.arange(-_MOST_OFFSET_MM, _MOST_OFFSET_MM + 1e-9, _STEP_MM)
    # Squared residuals of the values over the closing: a straight line per ladder, and one that
    # bends where contact would be, for each offset tried.
    straight, bent = 0.0, np.zeros(len(offsets_mm))
    for x, y in zip(closing_mm, values, strict=True):
        alone = _line_fit(x[:, None], y)[0]
        straight += alone
        for i, off in enumerate(offsets_mm):
            cost, fit = _line_fit(np.column_stack([x, np.maximum(x - off, 0.0)]), y)
            # What bends downwards is no contact: the straight line counts.
            bent[i] += cost if fit[2] > 0.0 else alone
    best = int(bent.argmin())
    freedom = max(sum(map(len, values)) - 3 * len(ladders) - 1, 1)
    if (straight - bent[best]) / max(bent[best] / freedom, 1e-12) < _SURE_RISE * len(ladders):
        raise CalibrationError(unseen)
    if best in (0, len(offsets_mm) - 1):  # contact may lie beyond
        raise _too_far_error(float(offsets_mm[best]))
    return _move_contact(calibration, float(offsets_mm[best]))


def touched_by_eye(
    calibration: Calibration, plan: PosePlan, touching_rows: Sequence[int]
) -> tuple[Calibration, float]:
    """Return the calibration with contact moved to where a person saw the lips meet.

    Parameters
    ----------
    calibration : Calibration
        Calibration with a model of how the robot's lips close.
    plan : PosePlan
        Plan of ladders, from `touch_plan`.
    touching_rows : Sequence[int]
        For each ladder the row of the plan at which lips just touched.

    Returns
    -------
    tuple[Calibration, float]
        The calibration, and by how many mm lips close farther than before until they meet.

    Raises
    ------
    CalibrationError
        The ladders disagree by more than a millimetre, or contact is too far from where it was.
    """
    ladder_numbers = ladders_of(plan)
    open_mm = _closure_of(calibration).open_mm(plan.goals_deg)[:, 0]
    later_mm = []
    for row in touching_rows:
        # Lips met between this step and the previous one of the ladder.
        previous = row - 1 if row and ladder_numbers[row - 1] == ladder_numbers[row] else row
        later_mm.append(-float(open_mm[row] + open_mm[previous]) / 2)
    if np.ptp(later_mm) > _AGREEMENT_MM:
        raise CalibrationError(
            f"between {len(touching_rows)} shapes, the lips were seen to meet at points "
            f"{np.ptp(later_mm):.1f} mm apart; look again, from the side, at the middle of the lips"
        )
    found_mm = float(np.median(later_mm))
    if abs(found_mm) > _MOST_OFFSET_MM:
        raise _too_far_error(found_mm)
    return _move_contact(calibration, found_mm)


def _too_far_error(off_mm: float) -> CalibrationError:
    how = "later" if off_mm > 0.0 else "earlier"
    return CalibrationError(
        f"the lips meet at least {abs(off_mm):.1f} mm {how} than the calibration says, too far to "
        "correct; check the horns and rods, or measure the face anew with `lipservo calibrate "
        "measure`"
    )


def _move_contact(calibration: Calibration, later_mm: float) -> tuple[Calibration, float]:
    """Return the calibration whose lips meet after closing later_mm farther, and later_mm."""
    closure = _closure_of(calibration)
    moved = replace(closure, gaps_mm=closure.gaps_mm + later_mm)
    return replace(calibration, closure=moved), later_mm


def _line_fit(inputs: Array, y: Array) -> tuple[float, Array]:
    """Return the squared residuals and parameters of a least-squares fit of `y`.

    The fit is by a constant and the columns of `inputs`.
    """
    inputs = np.column_stack([np.ones(len(y)), inputs])
    parameters = np.asarray(np.linalg.lstsq(inputs, y, rcond=None)[0], dtype=np.float64)
    return float(((inputs @ parameters - y) ** 2).sum()), parameters


def _closure_of(calibration: Calibration) -> Closure:
    if calibration.closure is None:
        raise CalibrationError(
            "this calibration has no contact of the lips; make it anew with `lipservo calibrate "
            "measure`"
        )
    return calibration.closure
