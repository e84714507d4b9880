"""How fast one client may send: what is too fast waits."""


class MessageRate:
    """A bucket that holds a second's worth of messages and fills up steadily."""

    def __init__(self, per_s: float) -> None:
        self._per_s = per_s
        self._left = per_s
        self._asked_s = 0.0

    def wait_s(self, now_s: float) -> float:
        """One more message has come at monotonic `now_s`: how long to wait before the next."""
        if self._asked_s:
            filled = (now_s - self._asked_s) * self._per_s
            self._left = min(self._per_s, self._left + filled)
        self._asked_s = now_s
        self._left -= 1.0
        return max(0.0, -self._left / self._per_s)
