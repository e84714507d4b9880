"""A setting that may change while the mouth moves: it goes over smoothly and does not jump."""

from lipsync.motion.amount import Amount

#: So long a change takes: lips 10 mm apart that are told to close by strength 0 approach at 50 mm/s
#: at most (1.5 times the mean, as of any cubic).
ADJUSTING_S = 0.3


class EasedSetting:
    """A number between 0 and `most`, as a function of time."""

    def __init__(self, value: float, most: float) -> None:
        self._most = most
        self._now = _steady(value)

    def at(self, time_s: float) -> float:
        """The value; before the last change began it is the one at its beginning."""
        value = self._now.at(max(time_s, self._now.start_s))[0]
        # A cubic that turns round on its way may overshoot its limits.
        return min(self._most, max(0.0, value))

    def change(self, start_s: float, value: float) -> None:
        """Go over to a value from `start_s` on, from wherever it is then."""
        now = self._now
        self._now = Amount(start_s, ADJUSTING_S, *now.at(max(start_s, now.start_s)), value)

    def settle(self) -> None:
        """Be where the last change leads, from the beginning of time."""
        self._now = _steady(self._now.goal)


def _steady(value: float) -> Amount:
    return Amount(0.0, ADJUSTING_S, value, 0.0, value)
