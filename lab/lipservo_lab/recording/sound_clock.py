"""When the microphone's sound was captured, on the monotonic clock that pictures are timed by."""

from collections import deque
from statistics import median

#: Time stamps of so many blocks are remembered, two seconds: a card's clock drifts by less than
#: 0.1 ms in that time.
_REMEMBERED = 200


class SoundClock:
    """The monotonic time of a moment of sound: the median of what the device has said of late.

    One time stamp is off by a few milliseconds, whenever the computer was busy.
    """

    def __init__(self) -> None:
        self._zeros_s: deque[float] = deque(maxlen=_REMEMBERED)
        self._last: tuple[float, float] | None = None

    def observe(self, captured: tuple[float, float] | None) -> None:
        """(monotonic seconds, sound time captured then), `MicrophoneSource.captured`."""
        if captured is not None and captured != self._last:
            self._last = captured
            self._zeros_s.append(captured[0] - captured[1])

    @property
    def is_ready(self) -> bool:
        """Whether anything has come."""
        return bool(self._zeros_s)

    @property
    def zero_s(self) -> float:
        """The monotonic time at which sound time 0 was captured."""
        return median(self._zeros_s)
