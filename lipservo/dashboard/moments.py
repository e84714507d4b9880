"""What a face does at a moment, as its live board tells it; and whether its two sides still do."""

from dataclasses import dataclass
from typing import Final

from lipservo.status.live_board import BoardLayout, LiveBoard, Record

#: A side that has written nothing for so long is gone: a page, which looks 30 times a second, says
#: so within a second.
GONE_S: Final = 0.8
#: Peaks of sound that a moment holds: 10 ms each, so that 30 moments a second leave none out.
MOST_PEAKS: Final = 8

#: Of a face that was never seen.
NO_LAYOUT: Final = BoardLayout("", "", (), (), (), 0, 0.0)


@dataclass(frozen=True, slots=True)
class Moment:
    """number: of the dashboard's tick; time_s: since it started.

    servos, speech: the newest record of each side, None before its first. peaks: 255 = full scale,
    of the blocks of 10 ms shown since the moment before.
    """

    number: int
    time_s: float
    servos: Record | None = None
    speech: Record | None = None
    servos_gone: bool = True
    speech_gone: bool = True
    peaks: bytes = b""


@dataclass(slots=True)
class _Side:
    """The newest record of one writer. seen_s: monotonic, when it was new."""

    number: int = 0
    record: Record | None = None
    seen_s: float = float("-inf")

    def take(self, found: list[tuple[int, Record]], now_s: float) -> None:
        if not found:
            return
        # What lay there before the first look may be old.
        seen_s = now_s if self.number else min(now_s, float(found[-1][1]["time_s"]))
        (self.number, self.record), self.seen_s = found[-1], seen_s

    def is_gone(self, now_s: float) -> bool:
        return now_s - self.seen_s > GONE_S


class BoardReader:
    """Reads one board tick by tick. Times are monotonic seconds."""

    def __init__(self, board: LiveBoard) -> None:
        """board: is closed by `close`."""
        self._board = board
        self._servos, self._speech = _Side(), _Side()
        self.layout = board.layout

    def read(self, number: int, since_start_s: float, now_s: float) -> Moment:
        """What has been written by now."""
        speech = self._board.speech_since(self._speech.number)
        peaks = b""
        if self._speech.number:
            peaks = b"".join(each["peaks"][: each["n_peaks"]].tobytes() for _, each in speech)
        self._servos.take(self._board.servos_since(self._servos.number), now_s)
        self._speech.take(speech, now_s)
        return Moment(
            number,
            since_start_s,
            self._servos.record,
            self._speech.record,
            self._servos.is_gone(now_s),
            self._speech.is_gone(now_s),
            peaks[-MOST_PEAKS:],
        )

    def close(self) -> None:
        """Give the memory back."""
        self._board.__exit__()
