"""Which poses a robot is moved through to learn its face: decided before anything moves.

Every pose is reached by a short last step from a known side of each joint, so that backlash lies on
a known side too: from below a joint's horn lags by half the backlash, from above it leads by half.
Poses are thereby independent of one another, and a capture can stop and go on.
Loads SciPy; the live path never does.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from calibration.calibration import CalibrationError
from calibration.coupling_rule import CouplingRule, keep_rules
from calibration.joint_range import JointRange
from lipsync.arrays import Array

#: The last step to a pose; more than twice the backlash of a printed gear train.
LEAD_IN_DEG = 3.0
#: How far along its range a single-joint sweep goes: far enough to be seen above the tracker's
#: noise, not so far that a limit set a little wrong does harm.
_SWEEP_SHARE = 0.6
#: Poses a joint takes in the sweeps (the same angle from below and from above).
_POSES_PER_SWEEP = 2
_NEUTRAL_POSES = 2
#: Neutral is taken again in the middle and at the end where so many poses are left for the rest.
_LEAST_CUBE = 16


@dataclass(frozen=True, slots=True)
class PosePlan:
    """Poses in their order, all within the limits.

    goals_deg: (n, n_servos); from_below: (n, n_servos), 1 or -1: the side that the last step comes
    from; start_deg: (n, n_servos), where that step begins.
    """

    servo_names: tuple[str, ...]
    goals_deg: Array
    from_below: Array
    start_deg: Array

    def __len__(self) -> int:
        return len(self.goals_deg)


def least_poses(n_servos: int) -> int:
    """The fewest poses that a face of so many servos is learnt from: its sweeps, and as many."""
    return _NEUTRAL_POSES + 2 * _POSES_PER_SWEEP * n_servos


def plan_poses(
    joints: Sequence[JointRange],
    n_poses: int,
    *,
    rules: Sequence[CouplingRule] = (),
    seed: int = 0,
) -> PosePlan:
    """Neutral, every joint alone from both sides, then a Latin hypercube within the limits.

    Neutral comes again in the middle of the hypercube and at its end.
    rules: what the joints must not do together; a pose that breaks one is scaled towards neutral.
    Raises CalibrationError for fewer poses than `least_poses`.
    """
    least = least_poses(len(joints))
    if n_poses < least:
        raise CalibrationError(
            f"{n_poses} poses are too few for {len(joints)} servos; ask for {least} or more"
        )
    low, high = _inside(joints)
    single, single_side = _sweeps(low, high)
    n_cube = n_poses - len(single)
    rng = np.random.default_rng(seed)
    cube = qmc.LatinHypercube(len(joints), rng=rng).random(n_cube)
    goals_deg = np.concatenate([single, low + cube * (high - low)])
    side = np.concatenate([single_side, rng.choice([-1.0, 1.0], (n_cube, len(joints)))])
    if n_cube >= _LEAST_CUBE:
        # The same pose again: what drifted, slipped or was moved meanwhile shows.
        for repeat in (len(single) + n_cube // 2, len(goals_deg) - 1):
            goals_deg[repeat], side[repeat] = 0.0, 1.0
    return _reached_from(joints, goals_deg, side, rules)


def plan_around(
    goals_deg: Array,
    joints: Sequence[JointRange],
    *,
    rules: Sequence[CouplingRule] = (),
    seed: int | None = 0,
) -> PosePlan:
    """Given poses (n, n_servos), each joint reached from a side drawn by `seed`.

    seed: None for all from below.
    """
    side = np.ones_like(goals_deg)
    if seed is not None:
        side = np.random.default_rng([seed, 1]).choice([-1.0, 1.0], goals_deg.shape)
    return _reached_from(joints, goals_deg, side, rules)


def ends_alone(joints: Sequence[JointRange], joint: int) -> Array:
    """(2, n_servos): one joint at either end of its range, with room for the last step."""
    ends_deg = np.zeros((2, len(joints)))
    ends_deg[:, joint] = [end[joint] for end in _inside(joints)]
    return ends_deg


def joined(first: PosePlan, second: PosePlan) -> PosePlan:
    """One plan after the other."""
    return PosePlan(
        first.servo_names,
        np.concatenate([first.goals_deg, second.goals_deg]),
        np.concatenate([first.from_below, second.from_below]),
        np.concatenate([first.start_deg, second.start_deg]),
    )


def _reached_from(
    joints: Sequence[JointRange], goals_deg: Array, side: Array, rules: Sequence[CouplingRule]
) -> PosePlan:
    """Within limits and rules, each with the beginning of its last step."""
    limits = np.array([[j.min_deg for j in joints], [j.max_deg for j in joints]])
    goals_deg = np.array([keep_rules(rules, goal) for goal in np.clip(goals_deg, *limits)])
    start_deg = np.clip(goals_deg - LEAD_IN_DEG * side, *limits)
    start_deg = np.array([keep_rules(rules, start) for start in start_deg])
    return PosePlan(tuple(j.name for j in joints), goals_deg, side, start_deg)


def _inside(joints: Sequence[JointRange]) -> tuple[Array, Array]:
    """The range that leaves room for the last step from either side, as far as there is any."""
    low = np.array([j.min_deg for j in joints])
    high = np.array([j.max_deg for j in joints])
    room = np.minimum(LEAD_IN_DEG, (high - low) / 4)
    return np.minimum(low + room, 0.0), np.maximum(high - room, 0.0)


def _sweeps(low: Array, high: Array) -> tuple[Array, Array]:
    """Goals and sides of the neutral poses and of every joint alone, at its wider end."""
    n_servos = len(low)
    wider = np.where(high >= -low, high, low)
    goals = np.zeros((_NEUTRAL_POSES + _POSES_PER_SWEEP * n_servos, n_servos))
    side = np.ones_like(goals)
    side[1] = -1.0
    for joint in range(n_servos):
        rows = slice(_NEUTRAL_POSES + _POSES_PER_SWEEP * joint, None)
        up, down = range(*rows.indices(len(goals)))[:_POSES_PER_SWEEP]
        goals[[up, down], joint] = _SWEEP_SHARE * wider[joint]
        side[down, joint] = -1.0
    return goals, side
