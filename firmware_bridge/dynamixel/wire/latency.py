"""How much later than on the wire a reply reaches us: learnt, so that deadlines fit the adapter."""

from typing import Final

#: Before anything is known: an FTDI adapter left at its 16 ms latency timer, and a little more.
_UNKNOWN_S: Final = 0.018
#: A computer that does other things wakes up this late once in a hundred times; measured on a
#: loaded two-core machine over a pseudo-terminal.
_LEAST_S: Final = 0.004
_MOST_S: Final = 0.025
#: Once part of a reply is here we are awake, and only adapter and wire can hold back the rest. On
#: the same loaded machine 2 ms lost samples and 4 ms took longer.
_LEAST_REST_S: Final = 0.0035
_RISE, _FALL = 0.5, 0.05
_MARGIN_S: Final = 0.001


class LearntLatency:
    """Follows the largest recent delays: up by half a step at once, down slowly."""

    def __init__(self) -> None:
        self._high_s = _UNKNOWN_S
        #: How long to wait for a reply after its computed time on the wire.
        self.slack_s = min(max(_UNKNOWN_S + _MARGIN_S, _LEAST_S), _MOST_S)

    @property
    def rest_slack_s(self) -> float:
        """The same for the rest of a reply of which part has come."""
        return min(max(self._high_s + _MARGIN_S, _LEAST_REST_S), _MOST_S)

    def learn(self, delay_s: float) -> None:
        """A reply came `delay_s` after its computed time."""
        share = _RISE if delay_s > self._high_s else _FALL
        self._high_s += share * (min(delay_s, _MOST_S) - self._high_s)
        self.slack_s = min(max(self._high_s + _MARGIN_S, _LEAST_S), _MOST_S)
