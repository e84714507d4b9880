"""One stream of speech of a client: what it sent, and what it is told."""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from lipservo.agents.messages import MessageError, Start
from lipservo.agents.outbox import Outbox
from lipservo.agents.pcm import PcmDecoder
from lipsync.audio.playout_events import PlayoutEvent
from lipsync.audio.playout_stream import PlayoutStream

#: Marks of a stream that were not heard yet: fewer than a client may leave unread, since many may
#: be heard at once.
_MOST_MARKS: Final = 64


@dataclass(eq=False, slots=True)
class AgentStream:
    """A client's stream. Two clients may give theirs the same id; the playout's name is unique.

    owner: the client's outbox. asked: what the playout was asked to drop of it, if anything.
    n_marks: that were not heard yet. fed_s: monotonic, when its client sent some of it last.
    """

    owner: Outbox
    stream_id: str
    start: Start
    speech: PlayoutStream
    decoder: PcmDecoder
    fed_s: float
    asked: Literal["", "clear", "interrupt"] = ""
    n_marks: int = 0
    n_played: int = 0

    @property
    def rate_hz(self) -> int:
        """Of what the client sends."""
        return self.speech.sample_rate_hz

    @property
    def is_played_by_client(self) -> bool:
        """Whether the sound leaves the client's loudspeaker, not ours."""
        return self.start.playback == "client"

    def mark(self, name: str) -> None:
        """Tell when all that came until now has been heard. Raises MessageError."""
        if self.n_marks >= _MOST_MARKS:
            raise MessageError("too_many_marks", f"{_MOST_MARKS} marks wait to be heard already")
        self.n_marks += 1
        self.speech.mark(name)

    def push(self, samples: NDArray[np.float32], now_s: float) -> None:
        """More of it, at monotonic `now_s`. What comes after it was cut off is dropped."""
        self.fed_s = now_s
        if not self.speech.ended:
            try:
                self.speech.push(samples)
            except ValueError:
                # The loop has cut it off between the two lines.
                if not self.speech.ended:
                    raise

    def tell(self, event: PlayoutEvent) -> None:
        """Hand the client what the playout says of the stream."""
        self.n_played = max(self.n_played, event.n_played)
        if event.kind == "mark":
            self.n_marks -= 1
            self._put("mark", name=event.name)
        elif event.kind in ("interrupted", "cleared"):
            self._put(
                event.kind, dropped_s=event.n_dropped / self.rate_hz, n_dropped=event.n_dropped
            )
        else:
            self._put(event.kind)

    def tell_dropped(self, kind: str) -> None:
        """It was interrupted or cleared before any of it was said."""
        n_dropped = self.speech.n_received
        self.speech.drop()
        self._put(kind, dropped_s=n_dropped / self.rate_hz, n_dropped=n_dropped)

    def tell_position(self, n_played: int) -> None:
        """How much was heard by now, and how much waits."""
        self.n_played = max(self.n_played, n_played)
        self._put("position", waiting_s=round(self.speech.waiting_s, 3))

    def tell_phoneme(self, phoneme: str, start_s: float, end_s: float, heard_in_s: float) -> None:
        """What is said there: seconds in the stream, and how long until it is heard."""
        times_s = {"start_s": start_s, "end_s": end_s, "heard_in_s": heard_in_s}
        rounded_s = {name: round(value, 3) for name, value in times_s.items()}
        self.owner.put(
            {"type": "phoneme", "stream": self.stream_id, "phoneme": phoneme, **rounded_s}
        )

    def _put(self, kind: str, **about: object) -> None:
        played_s = self.n_played / self.rate_hz
        heard = {"played_s": played_s, "n_played": self.n_played}
        self.owner.put({"type": kind, "stream": self.stream_id, **heard, **about})
