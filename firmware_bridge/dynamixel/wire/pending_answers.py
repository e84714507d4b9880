"""Answers that did not come in time and may still come, so that none is taken for another."""

from collections.abc import Iterable
from typing import Final

#: How long after we gave up waiting an answer may still arrive. Ours: computers that are busy hold
#: bytes back for up to 190 ms (measured over a pseudo-terminal), adapters for 16.
LATE_S: Final = 0.25
#: In place of an id: whoever there is.
ANYBODY: Final = -1


class PendingAnswers:
    """Whose answer of how many bytes may still come, and until when.

    A status packet says who answers and how many bytes it holds, not which question it answers. So
    a question whose answer would look like a pending one must be asked in another length.
    any: whether there may be something; `expire` makes it exact.
    """

    def __init__(self) -> None:
        self.any = False
        self._until_s: dict[tuple[int, int], float] = {}
        self._n: dict[tuple[int, int], int] = {}
        self._requests: dict[tuple[int, int], bytes] = {}

    @property
    def until_s(self) -> float:
        """When the last of them can no longer come; minus infinity when none is pending."""
        return max(self._until_s.values(), default=float("-inf"))

    def note(self, servo_id: int, size: int, request: bytes, now_s: float) -> None:
        """We waited in vain for `size` bytes in answer to `request`; b"" = to several requests."""
        key = (servo_id, size)
        if self._requests.setdefault(key, request) != request:
            self._requests[key] = b""
        self._until_s[key] = now_s + LATE_S
        self._n[key] = self._n.get(key, 0) + 1
        self.any = True

    def note_arrived(self, servo_id: int, size: int) -> None:
        """An answer of `size` bytes arrived too late for its question."""
        key = (servo_id, size)
        if key in self._n:
            self._n[key] -= 1
            if not self._n[key]:
                self._forget(key)

    def expire(self, now_s: float) -> bool:
        """Forget what can no longer come; whether anything is left."""
        for key in [each for each, until_s in self._until_s.items() if until_s <= now_s]:
            self._forget(key)
        return self.any

    def looks_like(self, servo_id: int, size: int, request: bytes) -> bool:
        """Whether an answer to `request` could be taken for one to some other request.

        For what has the same answer whenever it is asked: pings, and writes of the same bytes.
        """
        return self._requests.get((servo_id, size), request) != request

    def free_size(self, ids: Iterable[int], size: int, step: int = 1) -> int:
        """The least of size, size + step, ... that no pending answer of `ids` has."""
        asked = {*ids, ANYBODY}
        taken = {pending for servo_id, pending in self._until_s if servo_id in asked}
        while size in taken:
            size += step
        return size

    def _forget(self, key: tuple[int, int]) -> None:
        del self._until_s[key], self._requests[key], self._n[key]
        self.any = bool(self._until_s)
