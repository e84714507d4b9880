"""The last gate before the servos; it trusts no input: finiteness, range, speed, rules.

It does not judge the motion. A wrong one comes out slow, inside the limits, and counted.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.bus import CATCH_UP_DEG_S, Array, all_set, any_set
from firmware_bridge.joints import Joint


def clip(values: Array, low: Array, high: Array) -> Array:
    """Return np.clip(values, low, high), in a quarter of its time for a face's few joints."""
    clipped = np.maximum(values, low)
    return np.minimum(clipped, high, out=clipped)


def braking_speed(distance_deg: Array, deceleration_deg_s2: Array, step_s: float) -> Array:
    """Return the highest speed of the next step from which a joint stops within a distance.

    Braking takes steps of u, u - 1, u - 2, ... down to rest, in units of deceleration x step_s^2.
    With u = m + f, m whole and 0 <= f < 1, they add up to the distance d = (m + 1)(m / 2 + f). This
    is solved for u, so that the stop is exact on the grid of steps.

    Parameters
    ----------
    distance_deg : Array
        (n_joints,) degrees.
    deceleration_deg_s2 : Array
        (n_joints,) degrees / s^2.
    step_s : float
        Seconds between goals.

    Returns
    -------
    Array
        (n_joints,) degrees / s.
    """
    unit = deceleration_deg_s2 * step_s * step_s
    d = np.maximum(distance_deg, 0.0) / unit
    m = np.floor((np.sqrt(1.0 + 8.0 * d) - 1.0) / 2.0)
    return np.asarray((m + d / (m + 1.0) - m / 2.0) * deceleration_deg_s2 * step_s)


class AccelerationLimit:
    """A limit of the change of speed of each step, so that joints can stop at goal and range ends.

    Joints with infinite acceleration are not limited.
    """

    def __init__(self, max_acceleration_deg_s2: Array, max_speed_deg_s: Array) -> None:
        """Set the limits, (n_joints,) each; infinite acceleration: the joint is not limited."""
        self._limited = np.isfinite(max_acceleration_deg_s2)
        self._any = bool(self._limited.any())
        self._acceleration = np.where(self._limited, max_acceleration_deg_s2, 1e12)
        self._top = max_speed_deg_s
        self._velocity = np.zeros(len(max_speed_deg_s))
        self._wanted = np.zeros(len(max_speed_deg_s))

    def rest_at(self, positions_deg: Array) -> None:
        """Set all joints to standstill at these positions.

        Parameters
        ----------
        positions_deg : Array
            (n_joints,) degrees.
        """
        self._velocity = np.zeros(len(self._velocity))
        self._wanted = positions_deg.copy()

    def rest_some(self, at: int | NDArray[np.bool_], positions_deg: float | Array) -> None:
        """Set some joints to standstill.

        Parameters
        ----------
        at : int or NDArray[np.bool_]
            The joint's index, or (n_joints,): True for these joints.
        positions_deg : float or Array
            Where they stand, degrees; of several (n_at,).

        """
        self._velocity[at] = 0.0
        self._wanted[at] = positions_deg

    def step(self, sent: Array, wanted: Array, low: Array, high: Array, step_s: float) -> Array:
        """Return the next goal from `sent` towards `wanted`, within the joints' accelerations.

        Parameters
        ----------
        sent,wanted : Array
            (n_joints,) degrees, both in range.
        low,high : Array
            (n_joints,) degrees: the range.
        step_s : float
            Seconds since the last goal.

        Returns
        -------
        Array
            (n_joints,) degrees.
        """
        if not self._any or step_s <= 0.0:
            return wanted
        # All speeds in degrees / s. The joint follows a moving target at the target's own speed,
        # plus that from which it can still stop at the target.
        a, change = self._acceleration, self._acceleration * step_s
        left = wanted - sent
        moving = clip((wanted - self._wanted) / step_s, -self._top, self._top)
        with_it = np.where(moving * left > 0.0, np.abs(moving), 0.0)
        reach = np.abs(left) / step_s
        speed = np.minimum(
            reach, braking_speed(np.abs(left), a, step_s) + np.minimum(with_it, reach)
        )
        velocity = clip(np.sign(left) * speed, self._velocity - change, self._velocity + change)
        velocity = clip(velocity, -self._top, self._top)
        # Within the range the joint must be able to stop at its ends.
        inside = (low <= sent) & (sent <= high)
        up, down = (braking_speed(room, a, step_s) for room in (high - sent, sent - low))
        velocity = np.where(inside, clip(velocity, -down, up), velocity)
        self._wanted = wanted
        return np.asarray(np.where(self._limited, sent + velocity * step_s, wanted))

    def sent(self, before: Array, after: Array, step_s: float) -> None:
        """Store the speed of the step that was sent, from which the next step starts.

        To be called after `step`, when all further limits have been applied.

        Parameters
        ----------
        before,after : Array
            (n_joints,) degrees.
        step_s : float
            Seconds between them.
        """
        if self._any and step_s > 0.0:
            self._velocity = (after - before) / step_s


_SAME_SUM = 1e-9


@dataclass(frozen=True, slots=True)
class PreventRule:
    """What joints must not do together: the sum of factors x joint degrees is at most `above`.

    factors: one a joint, 0 = not used. because: the reason, for messages.
    """

    factors: tuple[float, ...]
    above: float
    because: str


class Prevention:
    """A filter that cuts a step short where it would break a rule.

    A step that leads out of a pose that breaks a rule is not cut.
    """

    def __init__(self, rules: Sequence[PreventRule], n_joints: int) -> None:
        """Store the rules. Raises ValueError if any lacks a joint's factor or forbids neutral."""
        for rule in rules:
            if len(rule.factors) != n_joints or rule.above < 0.0:
                raise ValueError(
                    f"rule {rule.because!r} needs {n_joints} factors and must allow neutral"
                )
        self._factors = [np.array(rule.factors) for rule in rules]
        self._parts = [factors != 0.0 for factors in self._factors]
        self._above = [rule.above for rule in rules]

    def cut(self, from_deg: Array, to_deg: Array) -> Array:
        """Return goals in place of `to_deg` that keep the rules between joints.

        All joints of a broken rule make the same share of their step from `from_deg`. That may
        break another rule, so it is repeated; if a rule is still broken then, `from_deg` is
        returned. `to_deg` itself is returned where nothing was cut.

        Parameters
        ----------
        from_deg,to_deg : Array
            (n_joints,) degrees.

        Returns
        -------
        Array
            (n_joints,) degrees.
        """
        if not self._factors:
            return to_deg
        for _ in range(len(self._factors)):
            before = to_deg
            for factors, parts, above in zip(self._factors, self._parts, self._above, strict=True):
                start, end = float(factors @ from_deg), float(factors @ to_deg)
                if end > above + _SAME_SUM and end > start:
                    share = max(0.0, (above - start) / (end - start))
                    to_deg = np.where(parts, from_deg + share * (to_deg - from_deg), to_deg)
            if to_deg is before:
                return to_deg
        broken = any(
            factors @ to_deg > max(above, float(factors @ from_deg)) + _SAME_SUM
            for factors, above in zip(self._factors, self._above, strict=True)
        )
        return from_deg if broken else to_deg


#: Rounding of float64 arithmetic is no violation; a servo's own step is 0.088 deg.
_SAME_DEG = 1e-6
#: The longest step, in periods. Missed ticks are not made up for: the servos stood still at the
#: last goal meanwhile, and would go through a step of two periods at twice the allowed speed.
_LONGEST_STEP_PERIODS = 1.0
#: After so long without a goal the servos stand: an acceleration-limited motion starts from rest.
_STALL_PERIODS = 2.0 + 1e-6


@dataclass(frozen=True, slots=True)
class Limited:
    """The goals that passed the gate, `Limiter`, and where it changed them; arrays are (n_joints,).

    positions_deg: the goals. range_hits: clamped to the range. rate_hits: slowed to speed or
    acceleration. rejected: not finite, or of another shape. prevented: cut short by a rule between
    joints.
    """

    positions_deg: Array
    range_hits: NDArray[np.bool_]
    rate_hits: NDArray[np.bool_]
    rejected: NDArray[np.bool_]
    prevented: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class GateCounts:
    """How often `Limiter`, the gate, changed goals, (n_joints,) each; kinds as in `Limited`."""

    range_hits: NDArray[np.int64]
    rate_hits: NDArray[np.int64]
    rejected: NDArray[np.int64]
    prevented: NDArray[np.int64]


class Limiter:
    """The gate that keeps goals finite, in range, within reach of the last, and within the rules.

    `period_s` is the loop's nominal period. Start it at the joints' positions; a goal outside its
    joint's range is clamped to the range, and reached no faster than the joint may move.
    """

    def __init__(
        self, joints: Sequence[Joint], period_s: float, prevent: Sequence[PreventRule] = ()
    ) -> None:
        """Take limits from `joints`; `start_from` sets positions. prevent: rules between joints.

        Raises ValueError for a rule that lacks a joint's factor or forbids neutral.
        """
        n_joints = len(joints)
        self._min_deg = np.array([joint.min_deg for joint in joints])
        self._max_deg = np.array([joint.max_deg for joint in joints])
        self._low_deg, self._high_deg = self._min_deg, self._max_deg
        reach = [joint.pulse.reach_deg if joint.pulse else None for joint in joints]
        ends = [each or (j.min_deg, j.max_deg) for each, j in zip(reach, joints, strict=True)]
        self._reach_deg = np.array(ends).T
        self._max_speed_deg_s = np.array([joint.max_speed_deg_s for joint in joints])
        self._longest_step_s = _LONGEST_STEP_PERIODS * period_s
        self._sent_deg = np.zeros(n_joints)
        self._sent_at_s = 0.0
        self._totals = np.zeros((4, n_joints), dtype=np.int64)
        self._range_hits, self._rate_hits, self._rejected, self._prevented = self._totals
        self._no_joint = np.zeros(n_joints, dtype=np.bool_)
        self._no_joint.flags.writeable = False  # returned again and again, without a copy
        accelerations = np.array([joint.max_acceleration_deg_s2 for joint in joints])
        self._acceleration = AccelerationLimit(accelerations, self._max_speed_deg_s)
        self._prevention = Prevention(prevent, n_joints)
        self._slow_deg_s = np.minimum(CATCH_UP_DEG_S, self._max_speed_deg_s)
        self._waits = self._no_joint.copy()
        self._catches_up = self._no_joint.copy()
        self._any_late = False
        self._limp = self._no_joint

    @property
    def sent_deg(self) -> Array:
        """The goals that passed the gate last.

        Returns
        -------
        Array
            (n_joints,) degrees.
        """
        return self._sent_deg

    @property
    def counts(self) -> GateCounts:
        """How often each kind of limit changed a goal so far."""
        return GateCounts(*self._totals.copy())

    def widen(self, low_deg: Array, high_deg: Array) -> NDArray[np.bool_]:
        """Set the joints' range from now on, for a person who searches the limits of hobby servos.

        Never less than the joints' limits, never more than `JointPulse.reach_us`. Return which
        joints may go beyond their limits.

        Parameters
        ----------
        low_deg,high_deg : Array
            (n_joints,) degrees.

        Returns
        -------
        NDArray[np.bool_]
            (n_joints,): which joints may go beyond their limits.
        """
        least_deg, most_deg = self._reach_deg
        self._low_deg = np.clip(low_deg, least_deg, self._min_deg)
        self._high_deg = np.clip(high_deg, self._max_deg, most_deg)
        return (self._low_deg < self._min_deg) | (self._high_deg > self._max_deg)

    def start_from(self, positions_deg: Array, time_s: float) -> None:
        """Store the joints' present positions as the goals sent last, at standstill.

        Parameters
        ----------
        positions_deg : Array
            (n_joints,) degrees.
        time_s : float
            Monotonic seconds.

        Raises
        ------
        ValueError
            The positions are not finite, or of another shape.
        """
        if positions_deg.shape != self._sent_deg.shape or not np.isfinite(positions_deg).all():
            raise ValueError(f"start {positions_deg} is not one finite angle for each joint")
        self._limp = self._no_joint
        self._sent_deg = positions_deg.copy()
        self._sent_at_s = time_s
        self._acceleration.rest_at(positions_deg)

    def follow(self, joints: NDArray[np.bool_], positions_deg: Array) -> None:
        """Store positions of joints without goals as sent last; NaN leaves a joint unchanged.

        So the rules between joints count with the real position of a limp joint.

        Parameters
        ----------
        joints : NDArray[np.bool_]
            (n_joints,): True for joints without goals.
        positions_deg : Array
            (n_joints,) degrees, NaN = not known.
        """
        self._limp = joints
        known = joints & np.isfinite(positions_deg)
        self._sent_deg = np.where(known, positions_deg, self._sent_deg)
        self._acceleration.rest_some(known, positions_deg[known])

    def start_one(self, index: int, position_deg: float) -> None:
        """Store one joint's position in degrees as its goal sent last, at standstill.

        Raises ValueError if it is not finite.
        """
        if not np.isfinite(position_deg):
            raise ValueError(f"start position {position_deg} is not finite")
        self._limp = self._limp.copy()
        self._limp[index] = False
        self._sent_deg = self._sent_deg.copy()
        self._sent_deg[index] = position_deg
        self._acceleration.rest_some(index, position_deg)

    def hold_back(self, ready: NDArray[np.bool_] | None) -> None:
        """Keep joints that are not ready at their last goal; once ready, each catches up slowly.

        Not ready are hobby servos that have not started: off, or waiting for their
        turn. So the rules between joints use the position that each was really sent to.

        Parameters
        ----------
        ready : NDArray[np.bool_] | None
            (n_joints,): True for joints that are ready; None: all are ready.
        """
        if ready is None and not self._any_late:
            return
        waits = self._no_joint if ready is None else ~ready
        self._catches_up |= self._waits & ~waits
        self._waits = waits
        self._any_late = any_set(self._waits) or any_set(self._catches_up)

    def apply(self, positions_deg: Array, time_s: float) -> Limited:
        """Return the goals to send at `time_s`, limited in this order.

        Not finite: the joint stays at its last goal; a wrong shape makes every joint stay. Then the
        range; then the step from the last goal: at most top speed times the time since, a period at
        most, and no faster change of speed than the joint may make; then the rules between joints,
        for which a step is cut short, whatever that does to its acceleration. Whatever these do, a
        goal is in its range, or no farther out than the last. Never raises: on the live path a held
        mouth is better than a stopped loop.

        Parameters
        ----------
        positions_deg : Array
            (n_joints,) degrees: the targets.
        time_s : float
            Monotonic seconds.

        Returns
        -------
        Limited
            Goals in degrees, and which limits were hit.
        """
        before_deg, no_joint = self._sent_deg, self._no_joint
        wanted_deg, rejected = positions_deg, no_joint
        if positions_deg.shape != before_deg.shape:
            wanted_deg, rejected = before_deg, ~no_joint
        elif not all_set(finite := np.isfinite(positions_deg)):
            wanted_deg, rejected = np.where(finite, positions_deg, before_deg), ~finite
        # Range. After a pause the joints stand, so that acceleration counts from rest.
        in_range_deg = clip(wanted_deg, self._low_deg, self._high_deg)
        since_s = max(0.0, time_s - self._sent_at_s)
        if since_s > _STALL_PERIODS * self._longest_step_s:
            self._acceleration.rest_at(before_deg)
        elapsed_s = min(since_s, self._longest_step_s)
        # Speed: none for joints that wait for their start, little while they catch up.
        top_deg_s = self._max_speed_deg_s
        if self._any_late:
            top_deg_s = np.where(self._catches_up, self._slow_deg_s, top_deg_s)
            top_deg_s[self._waits] = 0.0
        step_deg = top_deg_s * elapsed_s
        reached_deg = self._acceleration.step(
            before_deg, in_range_deg, self._low_deg, self._high_deg, elapsed_s
        )
        # A joint beyond its range may stay where it is, and goes no farther out.
        least_deg = np.minimum(self._low_deg, before_deg)
        most_deg = np.maximum(self._high_deg, before_deg)
        low_deg = np.maximum(least_deg, before_deg - step_deg)
        high_deg = np.minimum(most_deg, before_deg + step_deg)
        reached_deg = clip(reached_deg, low_deg, high_deg)
        # In the moment of the start no joint has had the time to move: none is slowed.
        slowed_deg = in_range_deg if since_s else reached_deg
        # A limp joint takes no goal, so that none is slowed: the rules count with where it stands.
        limp, self._limp = self._limp, no_joint
        if any_set(limp):
            reached_deg = np.where(limp, before_deg, reached_deg)
            slowed_deg = np.where(limp, before_deg, slowed_deg)
        sent_deg = self._prevention.cut(before_deg, reached_deg)
        if sent_deg is not reached_deg:
            sent_deg = clip(sent_deg, least_deg, most_deg)
        self._acceleration.sent(before_deg, sent_deg, elapsed_s)
        if self._any_late:
            self._catches_up &= np.abs(sent_deg - in_range_deg) > _SAME_DEG

        if rejected is not no_joint:
            self._rejected += rejected
        self._sent_deg = sent_deg
        # Never back in time: arming takes longer than the tick it happens in.
        self._sent_at_s = max(self._sent_at_s, time_s)
        return Limited(
            positions_deg=sent_deg,
            range_hits=self._hits(in_range_deg, wanted_deg, self._range_hits),
            rate_hits=self._hits(reached_deg, slowed_deg, self._rate_hits),
            rejected=rejected,
            prevented=self._hits(sent_deg, reached_deg, self._prevented),
        )

    def unchanged(self) -> Limited:
        """Return the goals sent last, and that no limit was hit: for a tick without new goals."""
        none = self._no_joint
        return Limited(self._sent_deg, none, none, none, none)

    def _hits(
        self, limited_deg: Array, wanted_deg: Array, total: NDArray[np.int64]
    ) -> NDArray[np.bool_]:
        """Return where limits changed `wanted_deg`, (n_joints,); add 1 there to `total`.

        limited_deg, wanted_deg: (n_joints,) degrees after and before a limit. Nearly always they
        are equal, so that is tested first, by bytes, which is quick.
        """
        if limited_deg is wanted_deg or limited_deg.tobytes() == wanted_deg.tobytes():
            return self._no_joint
        hits = np.abs(limited_deg - wanted_deg) > _SAME_DEG
        total += hits
        return np.asarray(hits)
