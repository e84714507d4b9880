"""What is asked of the playout, and what it tells."""

from dataclasses import dataclass
from typing import Literal

from lipsync.audio.playout_stream import PlayoutStream

EventKind = Literal["started", "mark", "finished", "interrupted", "cleared", "underrun"]


@dataclass(frozen=True, slots=True)
class PlayoutEvent:
    """What became of a stream, told when it leaves the loudspeaker.

    position_s: on the timeline. n_played: samples of the stream, at its own rate, that were heard
    so far; n_dropped: that never will be. name: of a mark.
    """

    kind: EventKind
    stream: str
    position_s: float
    n_played: int = 0
    n_dropped: int = 0
    name: str = ""


@dataclass(frozen=True, slots=True)
class PlayoutRequest:
    """What is asked of the playout.

    say: a new stream, after those that wait, or right after `after`, of which it is the next part:
    it is dropped where that was. interrupt: silence at once, and everything that was
    not heard is dropped. clear: what is not yet on its way to the loudspeaker is dropped.
    """

    kind: Literal["say", "interrupt", "clear"]
    stream: PlayoutStream | None = None
    after: PlayoutStream | None = None
