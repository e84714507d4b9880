"""Detects servos that do not follow: jammed, too weak, or a horn that slipped.

Two signs. A servo stays far from its goal; or its goals move and it does not, however near they
are: a jaw moves 7 degrees in speech, so a jammed one is never far from its goal.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.bus import Array, Feedback, any_set
from firmware_bridge.joints import Joint

#: The error allowed without a setting: this share of a joint's range, between the two bounds. Ours:
#: in the bundled clip no joint of a shipped face is farther off than a fifth of its range.
_ERROR_SHARE: Final = 1.0 / 3.0
_LEAST_ERROR_DEG: Final = 3.0
_MOST_ERROR_DEG: Final = 15.0
#: Travel is forgotten with this time constant, seconds: a phrase, not a sentence.
_MEMORY_S: Final = 1.5
#: Goals must have travelled so far within the memory, degrees, and the servo less than this share
#: of it. Driven well it makes .68 and more of it, jammed .06 and less (bundled clip, simulator).
_ENOUGH_TRAVEL_DEG: Final = 6.0
_TRAVEL_SHARE: Final = 0.25
#: Motion to and fro within twice this does not count as travel: of goals, since friction may
#: swallow it; of encoders, since they flicker (a step is 0.088 degrees).
_GOAL_SLACK_DEG: Final = 1.0
_ENCODER_SLACK_DEG: Final = 0.2
#: Places are compared so far apart at least, to save CPU: every second tick at 30 Hz, every fifth
#: at 100. A mouth goes to and fro five times a second at most. A little less than the 50 ms meant,
#: so that rounding makes no sixth tick of the fifth.
_SAMPLE_S: Final = 0.049
#: The time from one tick to the next counts for so long at most. A busy computer may take longer,
#: but saw no servo fail meanwhile; so half a second of not following is ten ticks at least.
_TICK_S: Final = 0.05


@dataclass(frozen=True, slots=True)
class TrackingRule:
    """A servo farther than `error_deg` from its goal for `after_s` without a break does not follow.

    error_deg: None = a third of each joint's range, between 3 and 15 degrees. after_s applies, too,
    to servos that do not move while their goals do. The defaults are our choice: at 400 deg/s a
    servo that lags 30 ms behind its goal is 12 deg off, and no motion of speech keeps one direction
    for half a second. Raises ValueError unless both are positive.
    """

    error_deg: float | None = None
    after_s: float = 0.5

    def __post_init__(self) -> None:
        if not ((self.error_deg is None or self.error_deg > 0.0) and self.after_s > 0.0):
            raise ValueError(
                f"tracking: error_deg is {self.error_deg}, after_s {self.after_s}; both must be > 0"
            )

    def allowed_deg(self, joint: Joint) -> float:
        """Return how far a joint may be from its goal, in degrees."""
        if self.error_deg is not None:
            return self.error_deg
        share_deg = _ERROR_SHARE * (joint.max_deg - joint.min_deg)
        return min(max(share_deg, _LEAST_ERROR_DEG), _MOST_ERROR_DEG)


class TrackingMonitor:
    """A monitor that compares each tick's positions with the goals of the tick before.

    Servos have had the time to follow those, however late the tick comes. A servo that does not
    answer keeps its last error, and a tick counts for .05 s at most.

    error_deg: how far each servo was from its goal when it last answered, (n_servos,).
    """

    def __init__(self, joints: Sequence[Joint], rule: TrackingRule) -> None:
        """Begin without errors. rule: how far a servo may be from its goal, and for how long."""
        self._rule = rule
        self._allowed_deg = np.array([rule.allowed_deg(joint) for joint in joints])
        self._within_s: Array = np.full(len(joints), math.inf)
        self._suspended_until_s = np.zeros(len(joints))
        self._all_count_s = 0.0
        self._goals_deg: Array | None = None
        self._ticked_s = math.inf
        self._stolen_s = 0.0
        self._travel = _Travel(len(joints))
        self.error_deg: Array = np.zeros(len(joints))

    def suspend_until(self, index: int, until_s: float) -> None:
        """Ignore one servo until `until_s`: after torque comes on a servo is slow on purpose."""
        self._within_s[index] = math.inf
        self._suspended_until_s[index] = until_s
        self._all_count_s = max(self._all_count_s, until_s)
        self._travel.travelled_deg[:, index] = 0.0

    def reason(self, index: int) -> str:
        """Return why servo `index`, reported by `behind`, does not follow, in words for a log."""
        off_deg = self.error_deg[index]
        if off_deg > self._allowed_deg[index]:
            after_s = self._rule.after_s
            return f"does not follow, {off_deg:.0f} deg off for {after_s:g} s: jammed or weak"
        goal_deg, made_deg = self._travel.travelled_deg[:, index]
        return (
            f"does not move: its goals travelled {goal_deg:.0f} deg lately, "
            f"it {made_deg:.0f}: jammed or weak"
        )

    def behind(self, sent_deg: Array, feedback: Feedback) -> NDArray[np.bool_]:
        """Compare goals with positions in every tick; return which servos have not followed.

        That is, farther from their goals than `TrackingRule` allows, for as long as it states.

        Parameters
        ----------
        sent_deg : Array
            (n_joints,) degrees: goals of this tick, which the next one compares.
        feedback : Feedback
            Positions in degrees, with their age.

        Returns
        -------
        NDArray[np.bool_]
            (n_servos,): True for those that have not followed.
        """
        # Time that ticks took beyond .05 s each is left out of `seen_s`.
        self._stolen_s += max(0.0, feedback.time_s - self._ticked_s - _TICK_S)
        self._ticked_s = feedback.time_s
        seen_s = feedback.time_s - self._stolen_s
        suspended = None
        if feedback.time_s < self._all_count_s:
            suspended = feedback.time_s < self._suspended_until_s
        # Positions read now are compared with the goals of the tick before; a servo that did not
        # answer just now keeps its last error.
        goals_deg = sent_deg if self._goals_deg is None else self._goals_deg
        self._goals_deg = sent_deg
        error_deg = np.abs(goals_deg - feedback.positions_deg)
        heard = None
        if any_set(feedback.age_s):
            heard = feedback.age_s == 0.0
            error_deg = np.where(heard, error_deg, self.error_deg)
        self.error_deg = error_deg
        self._travel.observe(goals_deg, feedback.positions_deg, seen_s, heard)
        # A servo has not followed once it has been too far off, or still, for `after_s` on end.
        doubtful = self.error_deg > self._allowed_deg
        doubtful |= self._travel.still
        if suspended is not None:
            doubtful &= ~suspended
            self._travel.travelled_deg[:, suspended] = 0.0
        if not any_set(doubtful):  # nearly always
            self._within_s.fill(seen_s)
            return doubtful
        self._within_s[~doubtful] = seen_s
        np.minimum(self._within_s, seen_s, out=self._within_s)  # infinite: counted from now on
        return seen_s - self._within_s > self._rule.after_s


class _Travel:
    """How far goals and encoders have moved within the last seconds, in degrees.

    travelled_deg: (2, n_servos), goals and encoders; older travel counts less. still: servos whose
    goals move but whose encoders do not, (n_servos,).
    """

    def __init__(self, n: int) -> None:
        # Rows of two: goals, encoders. Made once and changed in place; `still` is replaced.
        self.travelled_deg = np.zeros((2, n))
        self.still = np.zeros(n, dtype=np.bool_)
        self._goal_deg, self._made_deg = self.travelled_deg
        self._slack_deg = np.repeat([[_GOAL_SLACK_DEG], [_ENCODER_SLACK_DEG]], n, axis=1)
        self._less_slack_deg = -self._slack_deg
        self._places_deg = np.zeros((2, n))
        self._moved_deg = np.zeros((2, n))
        self._dragged_deg = np.zeros((2, n))
        self._time_s = -math.inf

    def observe(
        self, goals_deg: Array, places_deg: Array, seen_s: float, heard: NDArray[np.bool_] | None
    ) -> None:
        """Update `travelled_deg` and `still` from one tick.

        goals_deg, places_deg: (n_servos,), goals and positions. seen_s: the tick's monotonic time,
        less all that ticks lasted beyond .05 s each. heard: (n_servos,), True for servos that
        answered; None: all did. The arrays are computed anew only every 50 ms or so, to save
        time in every tick.
        """
        elapsed_s = seen_s - self._time_s
        if elapsed_s < _SAMPLE_S:
            return
        self._time_s = seen_s
        moved_deg, dragged_deg = self._moved_deg, self._dragged_deg
        moved_deg[0], moved_deg[1] = goals_deg, places_deg
        moved_deg -= self._places_deg
        if heard is not None:
            moved_deg[:, ~heard] = 0.0
        # Each stored place follows as if pulled by a loose coupling: the slack of a motion does not
        # move it; the rest does, and is travel.
        np.minimum(moved_deg, self._slack_deg, out=dragged_deg)
        np.maximum(dragged_deg, self._less_slack_deg, out=dragged_deg)
        moved_deg -= dragged_deg
        self._places_deg += moved_deg
        self.travelled_deg += np.abs(moved_deg, out=moved_deg)
        self.travelled_deg *= math.exp(-elapsed_s / _MEMORY_S)
        self.still = self._goal_deg > _ENOUGH_TRAVEL_DEG
        self.still &= self._made_deg < _TRAVEL_SHARE * self._goal_deg
