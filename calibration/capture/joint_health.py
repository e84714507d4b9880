"""Joints that are dead, or that stopped, slipped or came loose during a capture.

A weak joint among many moves the skin by as little as a tracker's noise among so few poses. What
tells it from a dead one is more poses in which nothing else moves: the joint is captured again,
alone, end to end. Every suspicion of a fault is a model of the whole capture, fitted by least
squares beside the healthy one: a joint that stops moving from some pose on, or everything shifted
from some pose on. A suspicion must explain far more than chance, and the accused joint far more
than any other.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from calibration.calibration import CouplingRule
from calibration.capture.capture import Capture, PosePlan, ends_alone, plan_around
from calibration.capture.straight_lines import StraightLines, straight_lines, without_far_points
from calibration.mouth_servos import JointRange
from lipsync.arrays import Array

#: What a joint does to the three markers that it moves most, in square standard errors: noise alone
#: gives 8 to 13, seldom 17. Below the first it is dead, below the second nobody can be sure.
_DEAD_BELOW, WEAK = 12.0, 40.0
#: Seen alone, a joint is alive if noise would move a marker by so much in so many captures. That is
#: 17 square standard errors among 47 markers; dead joints of elastic robots (seeds 100 to 139) came
#: to 13 at most, the weakest healthy ones to 31 in a second look.
_FALSE_ALIVE_RATE = 0.033
#: Looks at a joint that seems dead still, beyond the first: a worse tracker needs more.
MOST_FRAMES = 3
#: A second look is taken up to here: dead joints come as far because the others are not straight.
_DOUBT = 20.0
#: Each end so many times in a second look; so many are needed to judge by: more than there are of
#: the poses that are taken again, which do not go to the end.
_N_REPEATS, _LEAST_REPEATS = 6, 5
#: Another joint this near to 0 does not move; so much of its range is at its end.
_STILL_DEG, _END_SHARE, _LEAST_RANGE_DEG = 0.1, 0.05, 1.0


def doubtful_joints(capture: Capture, looked_at: Sequence[int] | None = None) -> list[int]:
    """Return the numbers of joints that move markers so little that they may be dead.

    looked_at: joints that were captured again alone; only those of them that are dead are returned.
    None: all joints are examined.
    """
    lines = straight_lines(capture)
    if looked_at is None:
        return [j for j in range(len(capture.servo_names)) if joint_signal(lines, j) < _DOUBT]
    cleaned = without_far_points(capture, lines)[0]
    return [j for j in looked_at if is_dead(cleaned, lines, j)]


def unseen_alone(capture: Capture) -> list[int]:
    """Return the numbers of joints that may be dead and were too seldom captured alone.

    Alone: near either end of the joint's range, with all other joints at 0.
    """
    return [
        joint
        for joint in doubtful_joints(capture)
        if min(map(len, _ends_alone(capture, joint))) < _LEAST_REPEATS
    ]


def extra_poses(
    joints: Sequence[JointRange],
    doubtful: Sequence[int],
    *,
    rules: Sequence[CouplingRule] = (),
) -> PosePlan:
    """Return a plan of each doubtful joint alone, at either end of its range, 6 times over.

    All joints come from below each time, so that the backlash of the others is alike in all poses.
    """
    goals_deg = [np.tile(ends_alone(joints, joint), (_N_REPEATS, 1)) for joint in doubtful]
    return plan_around(np.concatenate(goals_deg), joints, rules=rules, seed=None)


def joint_signal(lines: StraightLines, joint: int) -> float:
    """Return joint number `joint`'s mean square effect on the three markers that it moves most.

    lines: fitted to the capture. Unit: square standard errors, of which noise alone gives 8 to 13.
    """
    chance_mm = lines.chance_mm[joint] * lines.own_noise_mm / max(lines.noise_mm, 1e-9)
    return _mean_of_three_largest(lines.slopes_mm[joint], chance_mm)


def is_dead(capture: Capture, lines: StraightLines, joint: int) -> bool:
    """Return whether joint number `joint` moves no marker by more than chance.

    Judged by its poses alone where there are at least 5 at both ends, else by the fitted lines.
    """
    rows_at_ends = _ends_alone(capture, joint)
    if min(map(len, rows_at_ends)) < _LEAST_REPEATS:
        return joint_signal(lines, joint) < _DEAD_BELOW
    seen_mm = [np.ma.masked_invalid(capture.markers_mm[rows]) for rows in rows_at_ends]
    # The noise by the scatter of equal poses, and the standard error of a difference of means.
    spread_mm2 = np.mean([at_end_mm.var(axis=0, ddof=1).mean() for at_end_mm in seen_mm])
    error_mm = np.sqrt(spread_mm2 * sum(1.0 / len(at_end_mm) for at_end_mm in seen_mm))
    n_markers = seen_mm[0].shape[1]
    signal = _mean_of_three_largest(_difference_mm(*seen_mm), np.full(n_markers, error_mm))
    return signal < float(chi2.isf(_FALSE_ALIVE_RATE / n_markers, df=3))


def moved_alone_mm(capture: Capture, joint: int) -> Array:
    """Return how far markers move from a joint's lower to its upper end, with all others at 0.

    Parameters
    ----------
    capture : Capture
        A capture with poses in which only this joint is off 0.
    joint : int
        Number of the joint.

    Returns
    -------
    Array
        (n_markers, 3) mm; NaN where not seen, and everywhere if the joint was never alone.
    """
    upper, lower = (capture.markers_mm[rows] for rows in _ends_alone(capture, joint))
    return _difference_mm(np.ma.masked_invalid(upper), np.ma.masked_invalid(lower))


def _difference_mm(upper_mm: Array, lower_mm: Array) -> Array:
    """Return the difference of mean markers, (n_markers, 3) mm, upper less lower; NaN if unseen.

    upper_mm, lower_mm: (n, n_markers, 3), masked where not seen.
    """
    difference_mm = np.ma.mean(upper_mm, axis=0) - np.ma.mean(lower_mm, axis=0)
    return np.asarray(np.ma.filled(difference_mm, np.nan))


def _mean_of_three_largest(effects_mm: Array, errors_mm: Array) -> float:
    """Return the mean of the three largest squared effects, in square standard errors.

    effects_mm: (n_markers, 3); errors_mm: (n_markers,), the standard error in each axis.
    """
    squares = np.sum(effects_mm**2, axis=1) / np.maximum(errors_mm, 1e-9) ** 2
    return float(np.sort(squares[np.isfinite(squares)])[-3:].mean())


def _ends_alone(capture: Capture, joint: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the capture's rows with `joint` near its upper end and near its lower end.

    All other joints are at 0 in them; both are empty if the joint never moved alone.
    """
    others_still = (np.abs(np.delete(capture.goals_deg, joint, axis=1)) < _STILL_DEG).all(axis=1)
    rows = np.flatnonzero(others_still)
    angles_deg = capture.goals_deg[rows, joint]
    if not len(rows) or np.ptp(angles_deg) < _LEAST_RANGE_DEG:
        return rows[:0], rows[:0]
    near = _END_SHARE * np.ptp(angles_deg)
    return rows[angles_deg > angles_deg.max() - near], rows[angles_deg < angles_deg.min() + near]


#: F values: by how much a suspicion explains more than noise would (1), and than another's.
#: Healthy robots come to 2.6 over poses that fill the range, and with those of speech, which lie
#: elsewhere, to 5: so a suspicion needs poses that were taken twice to bear it out, and less of F.
SURE, SUSPECTED, _AHEAD = 5.0, 3.0, 1.5
_CHANCE = 1e-3
#: A shift is a joint's own where it goes along with what the joint does, and with no other.
_LEAST_COSINE, _COSINE_LEAD = 0.8, 0.15
_N_BEFORE, _N_AFTER = 6, 5
_STOP_SHARE = 0.7
_KINDS = {
    "stopped": "stopped moving",
    "slipped": "slipped on its shaft",
}


@dataclass(frozen=True, slots=True)
class JointFault:
    """A joint's fault in a capture: `stopped`, `slipped`, or `shifted` with joint -1 (unknown).

    pose: the first pose with the fault, counted from 1.
    """

    kind: str
    joint: int
    pose: int

    def description(self, names: tuple[str, ...]) -> str:
        """Return the fault in one line, with the remedy, by the servos' names."""
        if self.joint < 0:
            return (
                f"from pose {self.pose} on the face is another one than before: was the tracker or "
                "a part moved? Look for it and capture again"
            )
        return (
            f"servo {names[self.joint]!r} {_KINDS[self.kind]} at about pose {self.pose}; check "
            "its horn, its rod and its torque, and capture again"
        )


def joint_fault(capture: Capture, lines: StraightLines, sure: float = SURE) -> JointFault | None:
    """Return the one fault that explains the capture much better than no fault.

    lines: fitted to the capture; sure: F value that a fault must exceed at least. None where no
    fault does, and where the capture has too few poses.
    """
    n = len(capture)
    low, high = capture.goals_deg.min(axis=0), capture.goals_deg.max(axis=0)
    # Angles scaled to -1..1 of the captured range.
    x = 2 * (capture.goals_deg - low) / np.maximum(high - low, 1e-6) - 1
    # Lost points and outliers are replaced by what the lines predict.
    is_seen = np.isfinite(capture.markers_mm).all(axis=2) & ~lines.far
    y = np.where(is_seen[..., None], capture.markers_mm, lines.expected_mm).reshape(n, -1)
    y = y - y.mean(axis=0)
    # The columns of a fit without a fault: constant, angles and, with enough poses, their squares.
    base = np.hstack([np.ones((n, 1)), x, x**2])
    if n < base.shape[1] + _N_BEFORE + _N_AFTER:
        base = base[:, : 1 + x.shape[1]]
    if n < base.shape[1] + _N_BEFORE + _N_AFTER:
        return None
    rss = _rss(base, y)
    sure = max(sure, _chance_f_value(base, y, (n - _N_BEFORE - _N_AFTER) * x.shape[1]))
    # A joint that stopped leaves a shift, too: so the stop wins unless the shift's F is half as
    # high again.
    stop, shift = _best_stop(base, x, y, rss, sure), _best_shift(base, x, y, rss, sure)
    if stop and (not shift or stop[0] > _STOP_SHARE * shift[0]):
        return stop[1]
    return shift[1] if shift else None


def _chance_f_value(inputs: Array, y: Array, n_tries: int) -> float:
    """Return the F value that the best of `n_tries` faults reaches by chance once in a thousand.

    inputs: (n, k), columns of the fit without a fault; y: (n, m), the markers. The residuals of
    noise have many independent dimensions, those of skin that is not quadratic two or three, so
    that F varies more (effective number: Satterthwaite, Biometrics Bulletin, 1946).
    """
    basis = np.linalg.qr(inputs)[0]
    variances = np.linalg.svd(y - basis @ (basis.T @ y), compute_uv=False) ** 2
    # The effective number of independent dimensions of the residuals.
    n_dimensions = variances.sum() ** 2 / max(float((variances**2).sum()), 1e-12)
    return float(chi2.isf(_CHANCE / n_tries, n_dimensions) / n_dimensions)


def _rss(inputs: Array, y: Array) -> float:
    """Return the residual sum of squares of a least-squares fit of `y` by `inputs`' columns."""
    basis = np.linalg.qr(inputs)[0]
    return float((y**2).sum() - ((basis.T @ y) ** 2).sum())


def _best_stop(
    base: Array, x: Array, y: Array, healthy_rss: float, sure: float
) -> tuple[float, JointFault] | None:
    """Return the F value and fault of the joint whose stop from some pose on explains most.

    base: (n, k), columns of the fit without a fault; x: (n, n_servos), angles scaled to -1..1; y:
    (n, m), markers; healthy_rss: residual sum of squares of the fit without a fault. None if the F
    value is not above `sure`, or hardly higher than that of another joint.
    """
    n, n_servos = x.shape
    freedom = n - base.shape[1]
    stops = []
    for joint in range(n_servos):
        # The columns of all joints but this one, without its angle and the angle's square.
        others = np.delete(base, list(range(1 + joint, base.shape[1], n_servos)), 1)
        fits = []
        for start in range(_N_BEFORE, n - _N_AFTER):
            # The joint's angle counts before pose `start`; from there on a constant offset does.
            moving = np.where(np.arange(n)[:, None] < start, x[:, joint : joint + 1], 0.0)
            rss = _rss(np.hstack([others, moving, moving**2, np.arange(n)[:, None] >= start]), y)
            fits.append(((healthy_rss - rss) / (rss / freedom), start))
        stops.append((max(fits), joint))
    stops.sort(reverse=True)
    (f, start), joint = stops[0]
    next_f = stops[1][0][0] if len(stops) > 1 else 0.0
    if f > sure and f > _AHEAD * max(next_f, 0.0):
        return f, JointFault("stopped", joint, start + 1)
    return None


def _best_shift(
    base: Array, x: Array, y: Array, healthy_rss: float, sure: float
) -> tuple[float, JointFault] | None:
    """Return the F value and fault of a shift of all markers from some pose on; None below `sure`.

    Arguments: as of `_best_stop`. The fault is `slipped` where the shift has the direction of one
    joint's motion, and of no other's; else `shifted`.
    """
    n, n_servos = x.shape
    fits = []
    for start in range(_N_BEFORE, n - _N_AFTER):
        inputs = np.hstack([base, np.arange(n)[:, None] >= start])
        rss = _rss(inputs, y)
        fits.append(((healthy_rss - rss) / (rss / (n - inputs.shape[1])), start))
    f, start = max(fits)
    if f <= sure:
        return None
    fit = np.linalg.lstsq(np.hstack([base, np.arange(n)[:, None] >= start]), y, rcond=None)[0]
    # The shift of all markers is compared in direction with each joint's effect (slope) on them.
    shift, slope = fit[-1], fit[1 : 1 + n_servos]
    cosine = np.abs(slope @ shift) / (np.linalg.norm(slope, axis=1) * np.linalg.norm(shift) + 1e-12)
    order = np.argsort(cosine)[::-1]
    next_cosine = cosine[order[1]] if n_servos > 1 else 0.0
    one_joint = cosine[order[0]] > _LEAST_COSINE and cosine[order[0]] > next_cosine + _COSINE_LEAD
    kind, joint = ("slipped", int(order[0])) if one_joint else ("shifted", -1)
    return f, JointFault(kind, joint, start + 1)
