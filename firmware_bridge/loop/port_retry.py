"""Whether the port is there, and when one that is gone is tried again."""

from typing import Final

#: The first wait before a lost port is tried again, and the longest; it doubles in between.
_FIRST_WAIT_S: Final = 0.1
_LONGEST_WAIT_S: Final = 0.5


class PortRetry:
    """Counts in seconds of tick time. n_lost: how often the port went."""

    def __init__(self) -> None:
        self.is_open = True
        self.n_lost = 0
        self._wait_s = self._due_s = 0.0

    def note_lost(self, time_s: float) -> None:
        """It went now."""
        self.is_open = False
        self.n_lost += 1
        self._wait_s = _FIRST_WAIT_S
        self._due_s = time_s + _FIRST_WAIT_S

    def is_due(self, time_s: float) -> bool:
        """Whether it should be tried now."""
        return not self.is_open and time_s >= self._due_s

    def note_failed(self, time_s: float) -> None:
        """It was tried in vain."""
        self._wait_s = min(2.0 * self._wait_s, _LONGEST_WAIT_S)
        self._due_s = time_s + self._wait_s

    def note_open(self) -> None:
        """It is back."""
        self.is_open = True
