"""The last gate before the servos; it trusts no input: range, speed, finiteness, staleness.

Nothing here knows what a good motion is. A wrong one comes out slow, inside the
limits, and counted.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.arrays import Array, all_set
from firmware_bridge.gate.braking import AccelerationLimit
from firmware_bridge.gate.coupling import Prevention, PreventRule
from firmware_bridge.joints import Joint

#: Rounding of float64 arithmetic is no violation; a servo's own step is 0.088 deg.
_SAME_DEG = 1e-6
#: Missed ticks are not made up for: the servos stood still at the last goal meanwhile, and a step
#: of two periods would be run through at twice the speed that a person was promised.
_LONGEST_STEP_PERIODS = 1.0
#: After so long without a goal the servos stand: an acceleration-limited motion starts from rest.
_STALL_PERIODS = 2.0 + 1e-6


@dataclass(frozen=True, slots=True)
class Limited:
    """What the gate let through, and where it stepped in. Every array is (n_joints,)."""

    positions_deg: Array
    range_hits: NDArray[np.bool_]
    rate_hits: NDArray[np.bool_]
    rejected: NDArray[np.bool_]
    prevented: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class GateCounts:
    """How often the gate stepped in since it was made, per joint, (n_joints,) each."""

    range_hits: NDArray[np.int64]
    rate_hits: NDArray[np.int64]
    rejected: NDArray[np.int64]
    prevented: NDArray[np.int64]


class Limiter:
    """Keeps every goal finite, in range, within reach of the last one sent, and out of harm.

    `period_s` is the loop's nominal period. Start it where the joints stand; a goal outside
    its joint's range is clamped to the range, and reached no faster than the joint may move.
    """

    def __init__(
        self, joints: Sequence[Joint], period_s: float, prevent: Sequence[PreventRule] = ()
    ) -> None:
        n_joints = len(joints)
        self._min_deg = np.array([joint.min_deg for joint in joints])
        self._max_deg = np.array([joint.max_deg for joint in joints])
        self._max_speed_deg_s = np.array([joint.max_speed_deg_s for joint in joints])
        self._longest_step_s = _LONGEST_STEP_PERIODS * period_s
        self._sent_deg = np.zeros(n_joints)
        self._sent_at_s = 0.0
        self._range_hits = np.zeros(n_joints, dtype=np.int64)
        self._rate_hits = np.zeros(n_joints, dtype=np.int64)
        self._rejected = np.zeros(n_joints, dtype=np.int64)
        self._prevented = np.zeros(n_joints, dtype=np.int64)
        self._no_joint = np.zeros(n_joints, dtype=np.bool_)
        self._no_joint.flags.writeable = False  # handed out again and again
        accelerations = np.array([joint.max_acceleration_deg_s2 for joint in joints])
        self._acceleration = AccelerationLimit(accelerations, self._max_speed_deg_s)
        self._prevention = Prevention(prevent, n_joints)

    @property
    def sent_deg(self) -> Array:
        """The goals let through last, (n_joints,)."""
        return self._sent_deg

    @property
    def counts(self) -> GateCounts:
        """How often each kind of limit was hit so far."""
        return GateCounts(
            self._range_hits.copy(),
            self._rate_hits.copy(),
            self._rejected.copy(),
            self._prevented.copy(),
        )

    def start_from(self, positions_deg: Array, time_s: float) -> None:
        """Take the joints' present positions, (n_joints,), as sent.

        Raises ValueError unless they are finite.
        """
        if positions_deg.shape != self._sent_deg.shape or not np.isfinite(positions_deg).all():
            raise ValueError(f"cannot start from {positions_deg}: one finite angle a joint, please")
        self._sent_deg = positions_deg.copy()
        self._sent_at_s = time_s
        self._acceleration.rest_at(positions_deg)

    def follow(self, joints: NDArray[np.bool_], positions_deg: Array) -> None:
        """Take as sent where some joints stand that get no goals; what is not known stays.

        joints: which, (n_joints,); positions_deg: (n_joints,), NaN = not known. So the rules
        between joints count with where a limp joint is.
        """
        known = joints & np.isfinite(positions_deg)
        self._sent_deg = np.where(known, positions_deg, self._sent_deg)
        for index in np.flatnonzero(known).tolist():
            self._acceleration.rest_one(index, float(positions_deg[index]))

    def start_one(self, index: int, position_deg: float) -> None:
        """Take one joint's present position as sent. Raises ValueError unless it is finite."""
        if not np.isfinite(position_deg):
            raise ValueError(f"cannot start from {position_deg}")
        self._sent_deg = self._sent_deg.copy()
        self._sent_deg[index] = position_deg
        self._acceleration.rest_one(index, position_deg)

    def apply(self, positions_deg: Array, time_s: float) -> Limited:
        """Choose the goals to send at `time_s` when `positions_deg` is wanted.

        Not finite: the joint stays at its last goal; a wrong shape makes every joint stay.
        Then the range; then the step from the last goal: at most top speed times the time since,
        and no faster change of speed than the joint may make; then the rules between joints, for
        which a step is cut short, whatever that does to its acceleration.
        Never raises: on the live path a held mouth is better than a stopped loop.
        """
        before_deg, no_joint = self._sent_deg, self._no_joint
        wanted_deg, rejected = positions_deg, no_joint
        if positions_deg.shape != before_deg.shape:
            wanted_deg, rejected = before_deg, ~no_joint
        elif not all_set(finite := np.isfinite(positions_deg)):
            wanted_deg, rejected = np.where(finite, positions_deg, before_deg), ~finite
        in_range_deg = _clip(wanted_deg, self._min_deg, self._max_deg)
        since_s = max(0.0, time_s - self._sent_at_s)
        if since_s > _STALL_PERIODS * self._longest_step_s:
            self._acceleration.rest_at(before_deg)
        elapsed_s = min(since_s, self._longest_step_s)
        step_deg = self._max_speed_deg_s * elapsed_s
        reached_deg = self._acceleration.step(
            before_deg, in_range_deg, self._min_deg, self._max_deg, elapsed_s
        )
        reached_deg = _clip(reached_deg, before_deg - step_deg, before_deg + step_deg)
        sent_deg = self._prevention.cut(before_deg, reached_deg)
        self._acceleration.sent(before_deg, sent_deg, elapsed_s)

        if rejected is not no_joint:
            self._rejected += rejected
        self._sent_deg = sent_deg
        # Never back in time: arming takes longer than the tick it happens in.
        self._sent_at_s = max(self._sent_at_s, time_s)
        return Limited(
            positions_deg=sent_deg,
            range_hits=self._hits(in_range_deg, wanted_deg, self._range_hits),
            rate_hits=self._hits(reached_deg, in_range_deg, self._rate_hits),
            rejected=rejected,
            prevented=self._hits(sent_deg, reached_deg, self._prevented),
        )

    def unchanged(self) -> Limited:
        """The last goals, for a tick in which nobody gets new ones; no limit is hit."""
        none = self._no_joint
        return Limited(self._sent_deg, none, none, none, none)

    def _hits(
        self, limited_deg: Array, wanted_deg: Array, total: NDArray[np.int64]
    ) -> NDArray[np.bool_]:
        """Where a limit changed a goal, added to `total`; nearly always it changed none at all."""
        if limited_deg is wanted_deg or limited_deg.tobytes() == wanted_deg.tobytes():
            return self._no_joint
        hits = np.abs(limited_deg - wanted_deg) > _SAME_DEG
        total += hits
        return np.asarray(hits)


def _clip(values: Array, low: Array, high: Array) -> Array:
    """As np.clip, in a quarter of its time for a face full of joints."""
    clipped = np.maximum(values, low)
    return np.minimum(clipped, high, out=clipped)


class StaleLevel(IntEnum):
    """How far the bridge has gone in giving up on a silent speech side."""

    FRESH = 0
    EASING = 1
    NEUTRAL = 2
    LIMP = 3


@dataclass(frozen=True, slots=True)
class StaleRule:
    """What happens when no new target comes: follow and hold, ease to neutral, let go.

    Up to `hold_s` the last target counts in full; from there to `neutral_s` it fades to neutral; at
    `limp_s` torque goes off. The defaults are our choice: 0.1 s is ten missing targets at 100 Hz
    and shorter than most pauses in speech; by 1 s a frozen half-open mouth looks broken; 5 s is
    more than a restart of the speech side takes. Raises ValueError unless the times rise.
    """

    hold_s: float = 0.1
    neutral_s: float = 1.0
    limp_s: float = 5.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.hold_s < self.neutral_s <= self.limp_s:
            raise ValueError(
                f"needs 0 <= hold_s < neutral_s <= limp_s, got {self.hold_s}, {self.neutral_s} "
                f"and {self.limp_s}"
            )

    def level(self, age_s: float) -> StaleLevel:
        """Decide what to do when the newest target is `age_s` old."""
        if age_s <= self.hold_s:
            return StaleLevel.FRESH
        if age_s < self.neutral_s:
            return StaleLevel.EASING
        return StaleLevel.NEUTRAL if age_s < self.limp_s else StaleLevel.LIMP

    def weight(self, age_s: float) -> float:
        """Say how much of the held position remains: 1 while fresh, fading to 0 = neutral."""
        return 1.0 - ease((age_s - self.hold_s) / (self.neutral_s - self.hold_s))


#: Steepest slope of `ease`, at its middle.
EASE_PEAK_SLOPE = 1.5


def ease(progress: float) -> float:
    """From 0 to 1 with rest at both ends: 3 p^2 - 2 p^3, p clipped to [0, 1]."""
    p = min(max(progress, 0.0), 1.0)
    return p * p * (3.0 - 2.0 * p)
