"""Where a face looks: at its partner, away, and back, by saccades."""

import math
from dataclasses import dataclass
from random import Random
from typing import Final

from lipsync.expression.cue import CUE_PERIOD_S
from lipsync.expression.saccade import Saccade, drawn_direction_rad, drawn_magnitude_deg

#: Nothing new is looked at sooner.
_SHORTEST_FIXATION_S = 0.2
#: Who is asked to look at somebody else looks at least so long.
_FIRST_LOOK_S = 2.0
#: A partner who moves less than this is looked at still.
_FOVEA_DEG = 1.0
#: A look away stays within this of the partner, degrees of yaw and pitch.
_AWAY_YAW_DEG, _AWAY_PITCH_DEG = 25.0, 12.0
_TRIES = 8
#: A share below this would be no partner, above its mirror no look away.
_LEAST_SHARE, _MOST_SHARE = 0.05, 0.98


@dataclass(frozen=True, slots=True)
class GazeHabit:
    """How long fixations last, mean and standard deviation, and the share of them on the partner.

    The durations are those of SmartBody's model of "Eyes Alive", in seconds (its frames are 1/30
    s, and what its table calls a standard deviation is one). They do not go with its shares (they
    give 77 and 95 % on the partner, not 41 and 75), so that the share is what is set, and a look
    away is made of as many fixations as it takes.
    """

    mutual_share: float
    mutual_mean_s: float
    mutual_sd_s: float
    away_mean_s: float
    away_sd_s: float

    def __post_init__(self) -> None:
        if not _LEAST_SHARE <= self.mutual_share <= 1.0:
            raise ValueError(
                f"the share of time on the partner is {self.mutual_share}; "
                f"allowed: {_LEAST_SHARE} to 1"
            )

    def returning(self) -> float:
        """The chance that a fixation away is the last of its look away: mean length over theirs."""
        share = self.mutual_share
        away_s = self.mutual_mean_s * (1.0 - share) / share if share < 1.0 else 0.0
        return 1.0 if away_s <= self.away_mean_s else self.away_mean_s / away_s

    def drawn_mutual_s(self, random: Random) -> float:
        """A time on the partner."""
        if self.mutual_share > _MOST_SHARE:
            return math.inf
        return _gamma(random, self.mutual_mean_s, self.mutual_sd_s)

    def drawn_away_s(self, random: Random) -> float:
        """A fixation away; shorter than measured where the share leaves no time for it."""
        share = self.mutual_share
        away_s = self.mutual_mean_s * (1.0 - share) / share
        shrunk = min(1.0, away_s / self.away_mean_s)
        return shrunk * _gamma(random, self.away_mean_s, self.away_sd_s)


def _gamma(random: Random, mean_s: float, sd_s: float) -> float:
    """Gamma above the shortest fixation, with this mean and standard deviation in all."""
    above_s = mean_s - _SHORTEST_FIXATION_S
    shape = (above_s / sd_s) ** 2
    return _SHORTEST_FIXATION_S + random.gammavariate(shape, above_s / shape)


def talking_habit(mutual_share: float = 0.41) -> GazeHabit:
    """Of who talks."""
    return GazeHabit(mutual_share, 93.9 / 30, 94.9 / 30, 27.8 / 30, 24.0 / 30)


def listening_habit(mutual_share: float = 0.75) -> GazeHabit:
    """Of who listens."""
    return GazeHabit(mutual_share, 237.5 / 30, 47.1 / 30, 13.0 / 30, 7.1 / 30)


STRAIGHT_AHEAD: Final = (0.0, 0.0)


class Gaze:
    """The direction of gaze in the robot's frame, (yaw, pitch) degrees, a saccade at a time.

    direction_deg: now. aim_deg: where the last saccade leads, or has led. saccade_deg: the size of
    one that has just begun, else 0. is_mutual: on the partner.
    """

    def __init__(self, random: Random, talking: GazeHabit, listening: GazeHabit) -> None:
        self._random = random
        self._habits = (listening, talking)
        self._habit = listening
        self._left_s = listening.drawn_mutual_s(random)
        self._offset_deg = STRAIGHT_AHEAD
        self._saccade: Saccade | None = None
        self._is_due = False
        self._since_saccade_s = _SHORTEST_FIXATION_S
        self.is_mutual = True
        self.direction_deg = STRAIGHT_AHEAD
        self.aim_deg = STRAIGHT_AHEAD
        self.saccade_deg = 0.0

    def step(self, partner_deg: tuple[float, float], pace: float, size: float) -> None:
        """One cue later. pace: of fixations, 1 as measured; size: of looks away, 0 for none."""
        self._left_s -= pace * CUE_PERIOD_S
        if self._left_s <= 0.0:
            self._change()
        elif size == 0.0 and not self.is_mutual:
            self.look(at_least_s=0.0)
        across_deg, up_deg = self._offset_deg
        self._move((partner_deg[0] + size * across_deg, partner_deg[1] + size * up_deg))

    def turn(self, is_talking: bool) -> None:
        """Talk or listen from now on; what is left of a fixation becomes as long as it is then."""
        habit = self._habits[is_talking]
        if habit is self._habit:
            return
        if not self.is_mutual:
            self._left_s *= habit.away_mean_s / self._habit.away_mean_s
        elif math.isinf(self._left_s) or habit.mutual_share > _MOST_SHARE:
            self._left_s = habit.drawn_mutual_s(self._random)
        else:
            self._left_s *= habit.mutual_mean_s / self._habit.mutual_mean_s
        self._habit = habit

    def look(self, at_least_s: float = _FIRST_LOOK_S) -> None:
        """At the partner, now."""
        self.is_mutual = True
        self._is_due = True
        self._offset_deg = STRAIGHT_AHEAD
        self._left_s = max(at_least_s, self._habit.drawn_mutual_s(self._random))

    def _change(self) -> None:
        habit, random = self._habit, self._random
        if not self.is_mutual and random.random() < habit.returning():
            self.look(at_least_s=0.0)
        elif self.is_mutual and habit.mutual_share > _MOST_SHARE:
            self._left_s = math.inf
        else:
            self.is_mutual = False
            self._is_due = True
            self._offset_deg = self._drawn_offset_deg()
            self._left_s = habit.drawn_away_s(random)

    def _drawn_offset_deg(self) -> tuple[float, float]:
        """One saccade on from the last place; a place outside of the range is drawn again."""
        for _ in range(_TRIES):
            magnitude_deg = drawn_magnitude_deg(self._random)
            direction_rad = drawn_direction_rad(self._random)
            yaw_deg = self._offset_deg[0] + magnitude_deg * math.cos(direction_rad)
            pitch_deg = self._offset_deg[1] + magnitude_deg * math.sin(direction_rad)
            if abs(yaw_deg) <= _AWAY_YAW_DEG and abs(pitch_deg) <= _AWAY_PITCH_DEG:
                return yaw_deg, pitch_deg
        return self._offset_deg[0] / 2.0, self._offset_deg[1] / 2.0

    def _move(self, wanted_deg: tuple[float, float]) -> None:
        self.saccade_deg = 0.0
        self._since_saccade_s += CUE_PERIOD_S
        if self._saccade is None and self._is_worth_it(wanted_deg):
            self._saccade = Saccade(self.direction_deg, wanted_deg)
            self.saccade_deg = self._saccade.magnitude_deg
            self.aim_deg = wanted_deg
            self._since_saccade_s = 0.0
            self._is_due = False
        if self._saccade is not None:
            self.direction_deg = self._saccade.step()
            if self._saccade.is_over:
                self._saccade = None

    def _is_worth_it(self, wanted_deg: tuple[float, float]) -> bool:
        """A decision is carried out at once; a partner who moves is followed by steps."""
        if self._is_due:
            return wanted_deg != self.aim_deg
        off_deg = math.hypot(wanted_deg[0] - self.aim_deg[0], wanted_deg[1] - self.aim_deg[1])
        return off_deg > _FOVEA_DEG and self._since_saccade_s >= _SHORTEST_FIXATION_S
