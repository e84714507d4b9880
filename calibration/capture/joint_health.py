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
_DEAD, WEAK = 12.0, 40.0
#: Seen alone, a joint is alive if noise would move a marker by so much in so many captures. That is
#: 17 square standard errors among 47 markers; dead joints of elastic robots (seeds 100 to 139) came
#: to 13 at most, the weakest healthy ones to 31 in a second look.
_BY_CHANCE = 0.033
#: Looks at a joint that seems dead still, beyond the first: a worse tracker needs more.
MOST_FRAMES = 3
#: A second look is taken up to here: dead joints come as far because the others are not straight.
_DOUBT = 20.0
#: Each end so many times in a second look; so many are needed to judge by: more than there are of
#: the poses that are taken again, which do not go to the end.
_TIMES, _LEAST_TIMES = 6, 5
#: Another joint this near to 0 does not move; so much of its range is at its end.
_STILL_DEG, _END_SHARE, _LEAST_RANGE_DEG = 0.1, 0.05, 1.0


def doubtful_joints(capture: Capture, looked_at: Sequence[int] | None = None) -> list[int]:
    """Return the numbers of joints that move markers so little that they may be dead.

    looked_at: joints that were captured again alone; only those of them that are dead are returned.
    None: all joints are examined.
    """
    lines = straight_lines(capture)
    if looked_at is None:
        return [j for j in range(len(capture.servo_names)) if alive(lines, j) < _DOUBT]
    believed = without_far_points(capture, lines)[0]
    return [j for j in looked_at if is_dead(believed, lines, j)]


def unseen_alone(capture: Capture) -> list[int]:
    """Return the numbers of joints that may be dead and were too seldom captured alone.

    Alone: near either end of the joint's range, with all other joints at 0.
    """
    return [
        joint
        for joint in doubtful_joints(capture)
        if min(map(len, _ends_alone(capture, joint))) < _LEAST_TIMES
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
    goals_deg = [np.tile(ends_alone(joints, joint), (_TIMES, 1)) for joint in doubtful]
    return plan_around(np.concatenate(goals_deg), joints, rules=rules, seed=None)


def alive(lines: StraightLines, joint: int) -> float:
    """Return joint number `joint`'s mean square effect on the three markers that it moves most.

    lines: fitted to the capture. Unit: square standard errors, of which noise alone gives 8 to 13.
    """
    chance_mm = lines.chance_mm[joint] * lines.own_noise_mm / max(lines.noise_mm, 1e-9)
    return _mean_of_most(lines.slopes_mm[joint], chance_mm)


def is_dead(capture: Capture, lines: StraightLines, joint: int) -> bool:
    """Return whether joint number `joint` moves no marker by more than chance.

    Judged by its poses alone where there are at least 5 at both ends, else by the fitted lines.
    """
    ends = _ends_alone(capture, joint)
    if min(map(len, ends)) < _LEAST_TIMES:
        return alive(lines, joint) < _DEAD
    seen_mm = [np.ma.masked_invalid(capture.markers_mm[rows]) for rows in ends]
    spread_mm2 = np.mean([each.var(axis=0, ddof=1).mean() for each in seen_mm])
    error_mm = np.sqrt(spread_mm2 * sum(1.0 / len(each) for each in seen_mm))
    n_markers = seen_mm[0].shape[1]
    alone = _mean_of_most(_apart_mm(*seen_mm), np.full(n_markers, error_mm))
    return alone < float(chi2.isf(_BY_CHANCE / n_markers, df=3))


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
    return _apart_mm(np.ma.masked_invalid(upper), np.ma.masked_invalid(lower))


def _apart_mm(upper_mm: Array, lower_mm: Array) -> Array:
    """Return the difference of mean markers, (n_markers, 3) mm, upper less lower; NaN if unseen.

    upper_mm, lower_mm: (n, n_markers, 3), masked where not seen.
    """
    apart_mm = np.ma.mean(upper_mm, axis=0) - np.ma.mean(lower_mm, axis=0)
    return np.asarray(np.ma.filled(apart_mm, np.nan))


def _mean_of_most(effects_mm: Array, errors_mm: Array) -> float:
    squares = np.sum(effects_mm**2, axis=1) / np.maximum(errors_mm, 1e-9) ** 2
    return float(np.sort(squares[np.isfinite(squares)])[-3:].mean())


def _ends_alone(capture: Capture, joint: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the capture's rows with `joint` near its upper end and near its lower end.

    All other joints are at 0 in them; both are empty if the joint never moved alone.
    """
    still = (np.abs(np.delete(capture.goals_deg, joint, axis=1)) < _STILL_DEG).all(axis=1)
    rows = np.flatnonzero(still)
    own_deg = capture.goals_deg[rows, joint]
    if not len(rows) or np.ptp(own_deg) < _LEAST_RANGE_DEG:
        return rows[:0], rows[:0]
    near_deg = _END_SHARE * np.ptp(own_deg)
    return rows[own_deg > own_deg.max() - near_deg], rows[own_deg < own_deg.min() + near_deg]


#: F values: by how much a suspicion explains more than noise would (1), and than another's.
#: Healthy robots come to 2.6 over poses that fill the range, and with those of speech, which lie
#: elsewhere, to 5: so a suspicion needs poses that were taken twice to bear it out, and less of F.
SURE, SUSPECTED, _AHEAD = 5.0, 3.0, 1.5
_CHANCE = 1e-3
#: A shift is a joint's own where it goes along with what the joint does, and with no other.
_ALIKE, _UNLIKE = 0.8, 0.15
_FIRST, _LAST = 6, 5
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
    x = 2 * (capture.goals_deg - low) / np.maximum(high - low, 1e-6) - 1
    seen = np.isfinite(capture.markers_mm).all(axis=2) & ~lines.far
    y = np.where(seen[..., None], capture.markers_mm, lines.expected_mm).reshape(n, -1)
    y = y - y.mean(axis=0)
    base = np.hstack([np.ones((n, 1)), x, x**2])
    if n < base.shape[1] + _FIRST + _LAST:
        base = base[:, : 1 + x.shape[1]]
    if n < base.shape[1] + _FIRST + _LAST:
        return None
    healthy = _left(base, y)
    sure = max(sure, _by_chance(base, y, (n - _FIRST - _LAST) * x.shape[1]))
    # A joint that stands still is somewhere else, too: so a stop is asked for first.
    stops, shifts = _stops(base, x, y, healthy, sure), _shifts(base, x, y, healthy, sure)
    if stops and (not shifts or stops[0] > _STOP_SHARE * shifts[0]):
        return stops[1]
    return shifts[1] if shifts else None


def _by_chance(inputs: Array, y: Array, n_tries: int) -> float:
    """Return the F value that the best of `n_tries` faults reaches by chance once in a thousand.

    inputs: (n, k), columns of the fit without a fault; y: (n, m), the markers. The residuals of
    noise have many independent dimensions, those of skin that is not quadratic two or three, so
    that F varies more (effective number: Satterthwaite, Biometrics Bulletin, 1946).
    """
    basis = np.linalg.qr(inputs)[0]
    powers = np.linalg.svd(y - basis @ (basis.T @ y), compute_uv=False) ** 2
    n_dimensions = powers.sum() ** 2 / max(float((powers**2).sum()), 1e-12)
    return float(chi2.isf(_CHANCE / n_tries, n_dimensions) / n_dimensions)


def _left(inputs: Array, y: Array) -> float:
    """Return the residual sum of squares of a least-squares fit of `y` by `inputs`."""
    basis = np.linalg.qr(inputs)[0]
    return float((y**2).sum() - ((basis.T @ y) ** 2).sum())


def _stops(
    base: Array, x: Array, y: Array, healthy: float, sure: float
) -> tuple[float, JointFault] | None:
    """Return the F value and fault of the joint whose stop from some pose on explains most.

    base: (n, k), columns of the fit without a fault; x: (n, n_servos), angles scaled to -1..1; y:
    (n, m), markers; healthy: residual sum of squares of the fit without a fault. None if the F
    value is not above `sure`, or hardly higher than that of another joint.
    """
    n, n_servos = x.shape
    freedom = n - base.shape[1]
    best = []
    for joint in range(n_servos):
        others = np.delete(base, list(range(1 + joint, base.shape[1], n_servos)), 1)
        tries = []
        for k in range(_FIRST, n - _LAST):
            moves = np.where(np.arange(n)[:, None] < k, x[:, joint : joint + 1], 0.0)
            left = _left(np.hstack([others, moves, moves**2, np.arange(n)[:, None] >= k]), y)
            tries.append(((healthy - left) / (left / freedom), k))
        best.append((max(tries), joint))
    best.sort(reverse=True)
    (gain, k), joint = best[0]
    second = best[1][0][0] if len(best) > 1 else 0.0
    if gain > sure and gain > _AHEAD * max(second, 0.0):
        return gain, JointFault("stopped", joint, k + 1)
    return None


def _shifts(
    base: Array, x: Array, y: Array, healthy: float, sure: float
) -> tuple[float, JointFault] | None:
    """Return the F value and fault of a shift of all markers from some pose on; None below `sure`.

    Arguments: as of `_stops`. The fault is `slipped` where the shift is like one joint's motion
    alone, else `shifted`.
    """
    n, n_servos = x.shape
    tries = []
    for k in range(_FIRST, n - _LAST):
        inputs = np.hstack([base, np.arange(n)[:, None] >= k])
        left = _left(inputs, y)
        tries.append(((healthy - left) / (left / (n - inputs.shape[1])), k))
    gain, k = max(tries)
    if gain <= sure:
        return None
    fit = np.linalg.lstsq(np.hstack([base, np.arange(n)[:, None] >= k]), y, rcond=None)[0]
    shift, does = fit[-1], fit[1 : 1 + n_servos]
    alike = np.abs(does @ shift) / (np.linalg.norm(does, axis=1) * np.linalg.norm(shift) + 1e-12)
    order = np.argsort(alike)[::-1]
    second = alike[order[1]] if n_servos > 1 else 0.0
    own = alike[order[0]] > _ALIKE and alike[order[0]] > second + _UNLIKE
    kind, joint = ("slipped", int(order[0])) if own else ("shifted", -1)
    return gain, JointFault(kind, joint, k + 1)
