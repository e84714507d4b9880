"""Gaze of a face: at its partner, away, and back, by saccades shared by eyes and head."""

import math
from bisect import bisect
from dataclasses import dataclass
from itertools import accumulate
from random import Random
from typing import Final

from lipsync.expression.cue import CUE_PERIOD_S, bounded, smoothstep

#: Lee, Badler and Badler, "Eyes Alive", SIGGRAPH 2002: magnitude -6.9 ln(P / 15.7) degrees with P
#: uniform up to 15 (percent); duration 25 ms + 2.4 ms a degree; share of each of eight directions,
#: in percent, counter-clockwise from 0 in steps of 45 degrees.
_SCALE_DEG, _MOST_PERCENT, _OFFSET_PERCENT = 6.9, 15.0, 15.7
_SHORTEST_S, _S_PER_DEG = 0.025, 0.0024
_DIRECTIONS = tuple(accumulate((15.54, 6.46, 17.69, 7.44, 16.80, 7.89, 20.38, 7.79)))
_BIN_DEG = 45.0


def drawn_magnitude_deg(random: Random) -> float:
    """Return a random saccade size in degrees: 0.3 at least; 7.2 on average."""
    percent = _MOST_PERCENT * (1.0 - random.random())
    return -_SCALE_DEG * math.log(percent / _OFFSET_PERCENT)


def drawn_direction_rad(random: Random) -> float:
    """Return a random saccade direction in rad: a bin of 45 degrees by its share, then uniform."""
    direction = bisect(_DIRECTIONS, random.random() * _DIRECTIONS[-1])
    return math.radians(_BIN_DEG * (direction + random.random() - 0.5))


def duration_s(magnitude_deg: float) -> float:
    """Return the seconds that a saccade of `magnitude_deg` lasts."""
    return _SHORTEST_S + _S_PER_DEG * magnitude_deg


class Saccade:
    """One straight movement of gaze from `start_deg` to `aim_deg`, (yaw, pitch) each."""

    def __init__(self, start_deg: tuple[float, float], aim_deg: tuple[float, float]) -> None:
        self.aim_deg = aim_deg
        self._start_deg = start_deg
        self.magnitude_deg = math.hypot(aim_deg[0] - start_deg[0], aim_deg[1] - start_deg[1])
        self._duration_s = duration_s(self.magnitude_deg)
        self._elapsed_s = 0.0

    def step(self) -> tuple[float, float]:
        """Advance by one cue, 10 ms; return gaze as (yaw, pitch) in degrees, at the end the aim."""
        self._elapsed_s += CUE_PERIOD_S
        share = smoothstep(self._elapsed_s / self._duration_s)
        if share >= 1.0:
            return self.aim_deg
        yaw_deg, pitch_deg = self._start_deg
        return (
            yaw_deg + share * (self.aim_deg[0] - yaw_deg),
            pitch_deg + share * (self.aim_deg[1] - pitch_deg),
        )

    @property
    def is_over(self) -> bool:
        """Whether the saccade has reached its aim."""
        return self._elapsed_s >= self._duration_s


#: Nothing new is looked at sooner.
_SHORTEST_FIXATION_S = 0.2
#: Who is asked to look at somebody else looks at least so long.
_FIRST_LOOK_S = 2.0
#: A partner who moves less than this is looked at still.
_FOVEA_DEG = 1.0
#: A look away stays within this of the partner, degrees of yaw and pitch.
_AWAY_YAW_DEG, _AWAY_PITCH_DEG = 25.0, 12.0
_TRIES = 8
#: Allowed shares of the time on the partner begin here; above the second gaze never looks away.
_LEAST_SHARE, _MOST_SHARE = 0.05, 0.98


@dataclass(frozen=True, slots=True)
class GazeHabit:
    """How long gaze stays on the partner and away, and the partner's share of the time.

    mutual_share: share of the time on the partner; mutual_mean_s, mutual_sd_s: mean and standard
    deviation of gaze on the partner; away_mean_s, away_sd_s: of one fixation away. These durations
    are those of SmartBody's model of "Eyes Alive", in seconds (its frames are 1/30 s, and what its
    table calls a standard deviation is one). With them alone gaze would be on the partner for 77
    and 95 % of the time, where the model has 41 and 75. So the share is a setting, and a period
    away is made of as many fixations as the share needs.
    """

    mutual_share: float
    mutual_mean_s: float
    mutual_sd_s: float
    away_mean_s: float
    away_sd_s: float

    def __post_init__(self) -> None:
        """Raise ValueError for a share below 0.05 or above 1."""
        if not _LEAST_SHARE <= self.mutual_share <= 1.0:
            raise ValueError(
                f"mutual_share, the share of time looking at the partner, is {self.mutual_share}; "
                f"allowed: {_LEAST_SHARE} to 1"
            )

    def return_probability(self) -> float:
        """Return the probability that gaze returns to the partner after a fixation away.

        It is the mean length of such a fixation over that of a whole period away, 1 at most.
        """
        share = self.mutual_share
        away_s = self.mutual_mean_s * (1.0 - share) / share if share < 1.0 else 0.0
        return 1.0 if away_s <= self.away_mean_s else self.away_mean_s / away_s

    def drawn_mutual_s(self, random: Random) -> float:
        """Return a random length in s of gaze on the partner; inf for a share above 0.98."""
        if self.mutual_share > _MOST_SHARE:
            return math.inf
        return _drawn_duration_s(random, self.mutual_mean_s, self.mutual_sd_s)

    def drawn_away_s(self, random: Random) -> float:
        """Return a random length in s of one fixation away, shorter where the share requires it."""
        share = self.mutual_share
        away_s = self.mutual_mean_s * (1.0 - share) / share
        shrunk = min(1.0, away_s / self.away_mean_s)
        return shrunk * _drawn_duration_s(random, self.away_mean_s, self.away_sd_s)


def _drawn_duration_s(random: Random, mean_s: float, sd_s: float) -> float:
    """Return a random duration in s with this mean and standard deviation, at least 0.2 s.

    What exceeds these 0.2 s, the shortest fixation, is gamma-distributed.
    """
    above_s = mean_s - _SHORTEST_FIXATION_S
    shape = (above_s / sd_s) ** 2
    return _SHORTEST_FIXATION_S + random.gammavariate(shape, above_s / shape)


def talking_habit(mutual_share: float = 0.41) -> GazeHabit:
    """Return the gaze habit of a talking person; `mutual_share`: of the time, on the partner."""
    return GazeHabit(mutual_share, 93.9 / 30, 94.9 / 30, 27.8 / 30, 24.0 / 30)


def listening_habit(mutual_share: float = 0.75) -> GazeHabit:
    """Return the gaze habit of a listening person; `mutual_share`: of the time, on the partner."""
    return GazeHabit(mutual_share, 237.5 / 30, 47.1 / 30, 13.0 / 30, 7.1 / 30)


STRAIGHT_AHEAD: Final = (0.0, 0.0)


class Gaze:
    """The direction of gaze in the robot's frame, (yaw, pitch) degrees, moved by saccades.

    direction_deg: the present direction. aim_deg: the target of the last saccade. saccade_deg: the
    size of a saccade that begins in this cue, else 0. is_mutual: whether gaze is on the partner.
    """

    def __init__(self, random: Random, talking: GazeHabit, listening: GazeHabit) -> None:
        """Start with gaze straight ahead, at a partner, with the habit of a listener."""
        self._random = random
        self._habits = (listening, talking)
        self._habit = listening
        self._fixation_left_s = listening.drawn_mutual_s(random)
        self._offset_deg = STRAIGHT_AHEAD
        self._saccade: Saccade | None = None
        self._is_saccade_due = False
        self._since_saccade_s = _SHORTEST_FIXATION_S
        self.is_mutual = True
        self.direction_deg = STRAIGHT_AHEAD
        self.aim_deg = STRAIGHT_AHEAD
        self.saccade_deg = 0.0

    def step(self, partner_deg: tuple[float, float], pace: float, size: float) -> None:
        """Advance gaze by one cue, 10 ms; `partner_deg`: the partner's (yaw, pitch).

        pace: factor of the rate of fixations, 1 as measured on people. size: factor of the offsets
        away from the partner; 0: gaze stays on the partner.
        """
        self._fixation_left_s -= pace * CUE_PERIOD_S
        if self._fixation_left_s <= 0.0:
            self._begin_fixation()
        # No look away where offsets have no size.
        elif size == 0.0 and not self.is_mutual:
            self.look_at_partner(at_least_s=0.0)
        across_deg, up_deg = self._offset_deg
        self._advance_saccade((partner_deg[0] + size * across_deg, partner_deg[1] + size * up_deg))

    def set_talking(self, is_talking: bool) -> None:
        """Set the gaze habit to talking or listening; adapt what is left of the fixation to it.

        The rest is scaled by the habits' mean times; a fixation without an end, or one of a habit
        that looks at the partner nearly always, is drawn anew.
        """
        habit = self._habits[is_talking]
        if habit is self._habit:
            return
        if not self.is_mutual:
            self._fixation_left_s *= habit.away_mean_s / self._habit.away_mean_s
        elif math.isinf(self._fixation_left_s) or habit.mutual_share > _MOST_SHARE:
            self._fixation_left_s = habit.drawn_mutual_s(self._random)
        else:
            self._fixation_left_s *= habit.mutual_mean_s / self._habit.mutual_mean_s
        self._habit = habit

    def look_at_partner(self, at_least_s: float = _FIRST_LOOK_S) -> None:
        """Direct gaze to the partner now, for at least `at_least_s` seconds."""
        self.is_mutual = True
        self._is_saccade_due = True
        self._offset_deg = STRAIGHT_AHEAD
        self._fixation_left_s = max(at_least_s, self._habit.drawn_mutual_s(self._random))

    def _begin_fixation(self) -> None:
        """Begin the next fixation, on the partner or away, as drawn by the gaze habit."""
        habit, random = self._habit, self._random
        if not self.is_mutual and random.random() < habit.return_probability():
            self.look_at_partner(at_least_s=0.0)
        elif self.is_mutual and habit.mutual_share > _MOST_SHARE:
            self._fixation_left_s = math.inf
        else:
            self.is_mutual = False
            self._is_saccade_due = True
            self._offset_deg = self._drawn_offset_deg()
            self._fixation_left_s = habit.drawn_away_s(random)

    def _drawn_offset_deg(self) -> tuple[float, float]:
        """Return a random offset (yaw, pitch) from the partner, one saccade from the last offset.

        An offset out of range is drawn again; after eight draws the last offset is halved.
        """
        for _ in range(_TRIES):
            magnitude_deg = drawn_magnitude_deg(self._random)
            direction_rad = drawn_direction_rad(self._random)
            yaw_deg = self._offset_deg[0] + magnitude_deg * math.cos(direction_rad)
            pitch_deg = self._offset_deg[1] + magnitude_deg * math.sin(direction_rad)
            if abs(yaw_deg) <= _AWAY_YAW_DEG and abs(pitch_deg) <= _AWAY_PITCH_DEG:
                return yaw_deg, pitch_deg
        return self._offset_deg[0] / 2.0, self._offset_deg[1] / 2.0

    def _advance_saccade(self, wanted_deg: tuple[float, float]) -> None:
        """Advance gaze by one cue, 10 ms: begin a saccade to `wanted_deg` if due, and continue it.

        wanted_deg: (yaw, pitch) in the robot's frame.
        """
        self.saccade_deg = 0.0
        self._since_saccade_s += CUE_PERIOD_S
        if self._saccade is None and self._begins_saccade(wanted_deg):
            self._saccade = Saccade(self.direction_deg, wanted_deg)
            self.saccade_deg = self._saccade.magnitude_deg
            self.aim_deg = wanted_deg
            self._since_saccade_s = 0.0
            self._is_saccade_due = False
        if self._saccade is not None:
            self.direction_deg = self._saccade.step()
            if self._saccade.is_over:
                self._saccade = None

    def _begins_saccade(self, wanted_deg: tuple[float, float]) -> bool:
        """Return whether a saccade to `wanted_deg` begins now.

        Yes at once after a decision to change between partner and away; a partner in motion is
        followed in steps of over 1 degree, at least 0.2 s apart.
        """
        if self._is_saccade_due:
            return wanted_deg != self.aim_deg
        off_deg = math.hypot(wanted_deg[0] - self.aim_deg[0], wanted_deg[1] - self.aim_deg[1])
        return off_deg > _FOVEA_DEG and self._since_saccade_s >= _SHORTEST_FIXATION_S


#: Pitch, yaw and roll that a head goes to in conversation, either way.
MOST_PITCH_DEG, MOST_YAW_DEG, MOST_ROLL_DEG = 15.0, 25.0, 10.0
#: How far eyes turn in the head, either way; a robot's own limits come later.
MOST_EYE_PITCH_DEG, MOST_EYE_YAW_DEG = 25.0, 35.0
#: Eyes do not stay further out than this where the head can come to help.
_EASY_EYE_PITCH_DEG, _EASY_EYE_YAW_DEG = 18.0, 28.0
#: The head's share of small and of large directions, and where the one becomes the other.
_LEAST_HEAD_SHARE, _MOST_HEAD_SHARE = 0.25, 0.6
_SMALL_DEG, _LARGE_DEG = 10.0, 40.0


def head_part_deg(aim_deg: tuple[float, float]) -> tuple[float, float]:
    """Return the head's (yaw, pitch) for gaze at `aim_deg`: a larger share the further out it is.

    People turn the head little for what the eyes reach with ease, and nearly all of the rest of the
    way beyond that (Stahl, Experimental Brain Research 126, 1999).
    """
    yaw_deg, pitch_deg = aim_deg
    distance = (math.hypot(yaw_deg, pitch_deg) - _SMALL_DEG) / (_LARGE_DEG - _SMALL_DEG)
    share = _LEAST_HEAD_SHARE + (_MOST_HEAD_SHARE - _LEAST_HEAD_SHARE) * smoothstep(distance)
    return (
        _head_share_deg(yaw_deg, share, _EASY_EYE_YAW_DEG, MOST_YAW_DEG),
        _head_share_deg(pitch_deg, share, _EASY_EYE_PITCH_DEG, MOST_PITCH_DEG),
    )


def eyes_deg(
    direction_deg: tuple[float, float], head_yaw_deg: float, head_pitch_deg: float
) -> tuple[float, float]:
    """Return (yaw, pitch) of the eyes in the head, so that gaze keeps `direction_deg` in the world.

    The vestibulo-ocular reflex, to first order: gaze minus head. Roll turns the eyes about the line
    of sight and is left out; at 3 degrees of it, eyes 10 degrees off centre miss by half a degree.
    """
    return (
        bounded(direction_deg[0] - head_yaw_deg, -MOST_EYE_YAW_DEG, MOST_EYE_YAW_DEG),
        bounded(direction_deg[1] - head_pitch_deg, -MOST_EYE_PITCH_DEG, MOST_EYE_PITCH_DEG),
    )


def _head_share_deg(angle_deg: float, share: float, easy_deg: float, most_deg: float) -> float:
    """Return `share` of an angle, or all of it beyond `easy_deg`; `most_deg` at most."""
    out_deg = abs(angle_deg)
    return math.copysign(min(most_deg, max(share * out_deg, out_deg - easy_deg)), angle_deg)
