"""The streams of speech of all clients; while one client speaks, others are refused or wait.

The playout, the live loop's queue of speech to play, has streams of one client only at a time. So
an interruption, which empties it, ends no other client's speech.
"""

import itertools
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from lipservo.agents.listener import AgentSettings, Utterance
from lipservo.agents.messages import MessageError, Outbox, PcmDecoder, Start
from lipsync.audio.playout import Playout
from lipsync.audio.playout_stream import MOST_WAITING_S, PlayoutEvent, PlayoutRequest, PlayoutStream

#: Marks of a stream that were not reached yet: fewer than the events that a client may leave
#: unread, since many may be reached at once.
_MOST_MARKS: Final = 64
#: So many requests to the playout wait only if the face's loop hangs. Each stream makes three at
#: most, so that admitted streams never reach the playout's own limit.
_MOST_REQUESTS: Final = 32
#: Once the playout has been empty for so long, streams whose end was not reported count as over.
_LOST_S: Final = 1.0
#: A sender that pauses for so long after a mark waits for the mark: the last block is then filled
#: up with silence, or it would wait for more samples.
_PAUSE_S: Final = 0.05
#: The samples of less than a block, which a stream's waiting time leaves out.
_BLOCK_S: Final = 0.01
#: A sender with more than this unplayed may wait until some of it was played.
_WAITS_S: Final = 1.0
_LATER: Final = "try again, or set access: {queue: true} in the face's YAML"


_Request = TypeVar("_Request")


@dataclass(eq=False, slots=True)
class AgentStream:
    """A client's stream of speech. Clients may share a `stream_id`; `speech.name` is unique.

    owner: the client's outbox. speech: the stream in the playout. ended_by: the message that cut it
    off, if any. n_marks: marks that were not reached yet. n_played: samples played so far. fed_s:
    monotonic time of the client's last audio.
    """

    owner: Outbox
    stream_id: str
    start: Start
    speech: PlayoutStream
    decoder: PcmDecoder
    fed_s: float
    ended_by: Literal["", "clear", "interrupt"] = ""
    n_marks: int = 0
    n_played: int = 0

    @property
    def rate_hz(self) -> int:
        """The sample rate of the client's audio, in Hz."""
        return self.speech.sample_rate_hz

    def mark(self, name: str) -> None:
        """Request an event `name` for when all audio so far is played; MessageError if 64 wait."""
        if self.n_marks >= _MOST_MARKS:
            raise MessageError("too_many_marks", f"{_MOST_MARKS} marks already wait; try later")
        self.n_marks += 1
        self.speech.mark(name)

    def push(self, samples: NDArray[np.float32], now_s: float) -> None:
        """Append audio to the stream; do nothing if the stream has ended or was cut off.

        Parameters
        ----------
        samples : NDArray[np.float32]
            (n,) samples at the stream's rate.
        now_s : float
            Present monotonic time.
        """
        self.fed_s = now_s
        if not self.speech.ended:
            try:
                self.speech.push(samples)
            except ValueError:
                # The face's loop has cut the stream off between the check and the push.
                if not self.speech.ended:
                    raise

    def tell(self, event: PlayoutEvent) -> None:
        """Send the client a playout event about this stream; update `n_played` and `n_marks`."""
        self.n_played = max(self.n_played, event.n_played)
        if event.kind == "mark":
            self.n_marks -= 1
            self._send("mark", name=event.name)
        elif event.kind == "moved_by":
            self._send("moved_by", moved_by=event.name, reason=event.reason)
        elif event.kind == "units_shifted":
            self._send("units_shifted", shifted_ms=round(event.shifted_s * 1e3, 1))
        elif event.kind in ("interrupted", "cleared"):
            n_dropped = event.n_dropped
            self._send(event.kind, dropped_s=n_dropped / self.rate_hz, n_dropped=n_dropped)
        else:
            self._send(event.kind)

    def tell_dropped(self, kind: str) -> None:
        """Drop the stream, of which nothing was played; send `kind`, `interrupted` or `cleared`.

        `cleared` is followed by `finished`, as after the rest of a stream that was playing.
        """
        n_dropped = self.speech.n_received
        self.speech.drop()
        self._send(kind, dropped_s=n_dropped / self.rate_hz, n_dropped=n_dropped)
        if kind == "cleared":
            self._send("finished")

    def tell_position(self, n_played: int) -> None:
        """Send the client the samples played, at least `n_played`, and the seconds that wait."""
        self.n_played = max(self.n_played, n_played)
        self._send("position", waiting_s=round(self.speech.waiting_s, 3))

    def tell_phoneme(self, phoneme: str, start_s: float, end_s: float, heard_in_s: float) -> None:
        """Send the client a phoneme, from `start_s` to `end_s` in the stream.

        heard_in_s: seconds from now until it is audible.
        """
        times_s = {"start_s": start_s, "end_s": end_s, "heard_in_s": heard_in_s}
        rounded_s = {name: round(value, 3) for name, value in times_s.items()}
        self.owner.put(
            {"type": "phoneme", "stream": self.stream_id, "phoneme": phoneme, **rounded_s}
        )

    def _send(self, kind: str, **about: object) -> None:
        """Send the client an event of this stream, with the seconds and samples played so far."""
        heard = {"played_s": self.n_played / self.rate_hz, "n_played": self.n_played}
        at = {"time_s": round(time.monotonic(), 3)}
        self.owner.put({"type": kind, "stream": self.stream_id, **heard, **at, **about})


@dataclass(eq=False, slots=True)
class OwnSpeech:
    """A text or file of a client that the face itself speaks, by `say` or `play`.

    owner: the client's outbox; request_id: `id` of its command. stream_id: the name of all its
    streams in the playout. spoken: None until the first is synthesised or read. began_s: start of
    its first sample on the playout's timeline, None before; from_s: of the stream that plays now.
    heard_s: seconds played; n_ended: streams played.
    """

    owner: Outbox
    request_id: int | float | str | None
    stream_id: str
    spoken: Utterance | None = None
    began_s: float | None = None
    from_s: float | None = None
    heard_s: float = 0.0
    n_ended: int = 0
    is_dropped: bool = False

    @property
    def is_over(self) -> bool:
        """Whether no more of it will be played: it was dropped, or all its streams have ended."""
        whole = self.spoken is not None and self.spoken.is_whole
        n_streams = 0 if self.spoken is None else self.spoken.n_streams
        return self.is_dropped or (whole and self.n_ended >= n_streams)

    def take(self, event: PlayoutEvent) -> None:
        """Update this speech from a playout event about one of its streams.

        At the first start the client gets `started`.
        """
        if event.kind == "started":
            self.from_s = event.position_s
            if self.began_s is None:
                self.began_s = event.position_s
                self.tell("started")
        elif event.kind in ("interrupted", "cleared"):
            self.is_dropped = True
        elif event.kind == "finished":
            self.n_ended += 1
        if event.kind in ("finished", "interrupted", "cleared") and self.from_s is not None:
            self.heard_s += event.position_s - self.from_s
            self.from_s = None

    def tell(self, kind: str) -> None:
        """Send the client `kind` (`started`, `finished`, `dropped`), seconds played and in all."""
        about = {"stream": self.stream_id, "id": self.request_id}
        duration_s = 0.0 if self.spoken is None else self.spoken.duration_s
        times = {"played_s": round(self.heard_s, 3), "duration_s": round(duration_s, 3)}
        self.owner.put({"type": kind, **about, **times, "time_s": round(time.monotonic(), 3)})


class OpenStreams:
    """The streams of all clients in the order in which they are spoken, for one event loop."""

    def __init__(self, playout: Playout, settings: AgentSettings) -> None:
        """Start without streams. playout: plays them. settings: limits, and who may speak when."""
        self._playout = playout
        self._settings = settings
        self._numbers = itertools.count(1)
        self._waiting: deque[AgentStream] = deque()
        self._playing: dict[str, AgentStream] = {}
        # Speech that is no client's stream: names of the streams that play now; and each `say` or
        # `play` of a client until it is over, by the name of its streams.
        self._own_playing: set[str] = set()
        self._own_items: dict[str, OwnSpeech] = {}
        # The client that has paused the speech, and since when (monotonic s); None: nobody has.
        self._paused: tuple[Outbox, float] | None = None
        self._silent_since_s: float | None = None
        self.n_refused = 0

    @property
    def playing(self) -> list[AgentStream]:
        """The clients' streams in the playout, the queue of speech to play, in order of playing."""
        return list(self._playing.values())

    def open(self, owner: Outbox, start: Start, now_s: float) -> AgentStream:
        """Create the stream that a client's `start` message requests, and return it.

        owner: the client's outbox. now_s: monotonic. The stream is spoken at once, or waits for the
        streams of other clients. Raises MessageError if the stream is refused.
        """
        try:
            self._check_start(owner, start)
        except MessageError:
            self.n_refused += 1
            raise
        number = next(self._numbers)
        stream_id = start.stream or f"stream {number}"
        speech = PlayoutStream(
            f"{stream_id} #{number}",
            start.sample_rate,
            self._playout.output_rate_hz,
            played_elsewhere=start.playback == "client",
        )
        stream = AgentStream(owner, stream_id, start, speech, PcmDecoder(start.format), now_s)
        self._waiting.append(stream)
        self._start_next()
        return stream

    def check_room(self, duration_s: float) -> None:
        """Raise MessageError if all clients' waiting speech plus `duration_s` exceeds 5 minutes."""
        waiting_s = sum(each.speech.waiting_s + _BLOCK_S for each in self._open_streams())
        if waiting_s + duration_s > MOST_WAITING_S - _BLOCK_S:
            kept = f"{MOST_WAITING_S:g} s of speech are kept, and {waiting_s:.1f} wait"
            raise MessageError("buffer_full", f"this audio was dropped: {kept}; send it later")

    def interrupt(self, owner: Outbox) -> None:
        """Silence the speech of client `owner` at once and drop all of its streams.

        Each stream gets an `interrupted` event; a client without streams gets one, too. Speech by
        `say` or `play` ends as well, unless another client speaks.
        """
        # Streams that wait are dropped here; those that play, by a request to the playout, unless
        # that was made before.
        n_dropped = self._drop_waiting(owner, "interrupted")
        streams = [each for each in self._playing.values() if each.owner is owner]
        others = len(self._playing) > len(streams)
        # Speech by the face itself is known by its events, or by what waits in the playout.
        face_speaks = bool(self._own_playing) or not (self._playing or self._playout.is_over)
        if any(each.ended_by != "interrupt" for each in streams) or (face_speaks and not others):
            self._playout.requests.append(PlayoutRequest("interrupt"))
            self._own_playing.clear()
            self._paused = None
        for item in () if others else self._own_items.values():
            item.is_dropped = item.is_dropped or item.spoken is None
        for each in streams:
            each.ended_by = "interrupt"
        if not streams and not n_dropped:
            owner.put({"type": "interrupted", "stream": None, "played_s": 0.0, "dropped_s": 0.0})
        self._start_next()

    def clear(self, owner: Outbox) -> None:
        """Drop the audio of client `owner` that is not yet on its way to the loudspeaker."""
        self._drop_waiting(owner, "cleared")
        streams = [
            each for each in self._playing.values() if each.owner is owner and not each.ended_by
        ]
        if streams:
            self._playout.requests.append(PlayoutRequest("clear"))
        for each in streams:
            each.ended_by = "clear"
        self._start_next()

    def pause(self, owner: Outbox, now_s: float) -> None:
        """Silence the face at once, for client `owner`, and keep what was not played.

        Raises MessageError if the playout has no stream of this client, or 32 requests wait in it.
        """
        if not any(each.owner is owner for each in self._playing.values()):
            raise MessageError("no_stream", "nothing to pause: this client has no stream")
        if self._paused is None:
            self._check_requests()
            self._playout.requests.append(PlayoutRequest("pause"))
            self._paused = owner, now_s

    def resume(self, owner: Outbox) -> None:
        """Continue speech that `owner` paused, if any; MessageError if 32 requests wait."""
        if self._paused is not None and self._paused[0] is owner:
            self._check_requests()
            self._playout.requests.append(PlayoutRequest("resume"))
            self._paused = None

    def open_own(
        self, owner: Outbox, request_id: int | float | str | None, label: str
    ) -> OwnSpeech:
        """Register a `say` or `play` of client `owner`, named `label` and a number, and return it.

        request_id: `id` of the command. MessageError if an agent speaks, unless clients queue.
        """
        if self._settings.when_busy == "refuse" and self._open_streams():
            raise MessageError("busy", f"an agent is speaking; {_LATER}")
        item = OwnSpeech(owner, request_id, f"{label} #{next(self._numbers)}")
        self._own_items[item.stream_id] = item
        return item

    def keep(self, own: OwnSpeech, spoken: Utterance) -> None:
        """Store what was synthesised or read of `own`; if interrupted before, drop what can be."""
        own.spoken = spoken
        if own.is_dropped:
            self._playout.requests.append(PlayoutRequest("clear", name=own.stream_id))

    def forget(self, own: OwnSpeech) -> None:
        """Unregister `own`, a `say` or `play` that failed before it was spoken."""
        self._own_items.pop(own.stream_id, None)

    def leave(self, owner: Outbox) -> None:
        """Close `owner`, the outbox of a client that has disconnected; ended streams are spoken.

        If the client left a stream open or has paused, all its speech is interrupted.
        """
        owner.close()
        has_paused = self._paused is not None and self._paused[0] is owner
        is_cut = any(each.owner is owner and not each.speech.ended for each in self._open_streams())
        if is_cut or has_paused:
            self.interrupt(owner)

    def end_all(self) -> None:
        """Interrupt the speech of all clients, as the server ends."""
        for owner in {each.owner for each in self._open_streams()}:
            self.interrupt(owner)

    def take_events(self, now_s: float) -> None:
        """Send clients the playout's events since the last call; start streams that wait.

        Only streams of the client that speaks are started; if none speaks, the client of the first
        stream that waits is next. now_s: monotonic. If the playout has been empty for 1 s, all its
        streams count as over.
        """
        events = self._playout.events
        while events:
            self._pass_on(events.popleft())
        # The last block of a sender that waits for a mark is filled up, or it is never reached.
        for stream in self._playing.values():
            speech, has_paused = stream.speech, now_s - stream.fed_s > _PAUSE_S
            if speech.is_marked and has_paused and not (speech.ended or speech.is_filled):
                speech.fill()
        if not self._playout.is_over or self._playout.requests:
            self._silent_since_s = None
        elif self._silent_since_s is None:
            self._silent_since_s = now_s
        elif now_s - self._silent_since_s > _LOST_S:
            # Their ends were not reported, and will not be.
            self._playing.clear()
            self._own_playing.clear()
            for item in self._own_items.values():
                item.is_dropped = item.is_dropped or item.spoken is not None
        for item in [each for each in self._own_items.values() if each.is_over]:
            is_cut = item.is_dropped or (item.spoken is not None and item.spoken.is_cut_short)
            item.tell("dropped" if is_cut else "finished")
            del self._own_items[item.stream_id]
        if not self._playing:
            self._paused = None
        self._start_next()

    def end_stalled(self, now_s: float) -> None:
        """End streams without audio for `stalled_s`; interrupt a client that has paused as long.

        The time counts from when at most a second of the stream waits to be played.
        """
        for stream in self._open_streams():
            if stream.speech.waiting_s > _WAITS_S:
                stream.fed_s = now_s
            if not stream.speech.ended and now_s - stream.fed_s > self._settings.stalled_s:
                stalled = f"no audio for {self._settings.stalled_s:g} s: the stream was ended"
                stream.owner.error("stalled", stalled, stream=stream.stream_id)
                stream.speech.end()
        if self._paused is not None and now_s - self._paused[1] > self._settings.stalled_s:
            owner = self._paused[0]
            owner.error("stalled", f"paused for {self._settings.stalled_s:g} s: it was cut off")
            self.interrupt(owner)

    def stream_of(self, owner: Outbox, stream_id: str) -> AgentStream | None:
        """Return the stream of client `owner` with this id; None: over, or never started."""
        streams = (each for each in self._open_streams() if each.owner is owner)
        return next((each for each in streams if each.stream_id == stream_id), None)

    def tell_positions(self, owner: Outbox | None = None) -> None:
        """Send clients, or `owner` alone, how much of each of their streams was played.

        Only streams in the playout count, not those that wait.
        """
        for stream in self.playing:
            if owner is None or stream.owner is owner:
                n_played = _retried(partial(self._playout.n_played, stream.speech.name))
                stream.tell_position(n_played or 0)

    def tell_phoneme(self, phoneme: str, start_s: float, end_s: float) -> None:
        """Send a phoneme to the client whose stream is played at `start_s`, if any.

        start_s, end_s: on the playout's timeline.
        """
        found = _retried(partial(self._playout.stream_at, start_s))
        if found is None or (stream := self._playing.get(found[0].name)) is None:
            return
        heard_in_s = start_s - self._playout.position_s
        stream.tell_phoneme(phoneme, found[1], found[1] + end_s - start_s, heard_in_s)

    def _open_streams(self) -> list[AgentStream]:
        """Return the streams in the playout, then those that wait for it, in order."""
        return [*self._playing.values(), *self._waiting]

    def _check_start(self, owner: Outbox, start: Start) -> None:
        """Raise MessageError if the stream that client `owner` requests by `start` is refused."""
        streams = self._open_streams()
        if start.playback == "server" and self._playout.loudspeaker is None:
            silent = "the face has no loudspeaker: start it with --play"
            raise MessageError("no_loudspeaker", f'{silent}, or play it yourself ("client")')
        if self._settings.when_busy == "refuse":
            if any(each.owner is not owner for each in streams):
                raise MessageError("busy", f"another client is speaking; {_LATER}")
            if self._own_items or self._own_playing:
                own = "the face says something of its own"
                raise MessageError("busy", f"{own}; interrupt it, {_LATER}")
        if len(streams) >= self._settings.most_streams:
            most = f"{self._settings.most_streams} streams are spoken or wait already"
            raise MessageError("too_many_streams", most)
        self._check_requests()
        if any(each.owner is owner and each.stream_id == start.stream for each in streams):
            raise MessageError("stream_open", "that stream id is in use; choose another")

    def _check_requests(self) -> None:
        """Raise MessageError if the playout has 32 requests that its loop has not carried out."""
        if len(self._playout.requests) >= _MOST_REQUESTS:
            raise MessageError("not_available", "the face is too busy; try again later")

    def _drop_waiting(self, owner: Outbox, kind: str) -> int:
        """Drop the client's streams that wait, send it `kind` for each; return their number."""
        dropped = [each for each in self._waiting if each.owner is owner]
        self._waiting = deque(each for each in self._waiting if each.owner is not owner)
        for each in dropped:
            each.tell_dropped(kind)
        return len(dropped)

    def _pass_on(self, event: PlayoutEvent) -> None:
        """Pass a playout event to the client's stream, or the `say` or `play`, that it is about."""
        is_last = event.kind in ("finished", "interrupted")
        stream = self._playing.get(event.stream)
        if stream is not None:
            stream.tell(event)
            if is_last:
                del self._playing[event.stream]
            return
        if (item := self._own_items.get(event.stream)) is not None:
            item.take(event)
        if is_last:
            self._own_playing.discard(event.stream)
        elif event.kind == "started":
            self._own_playing.add(event.stream)

    def _start_next(self) -> None:
        """Move waiting streams into the playout while they are of the client that speaks.

        If nothing is spoken, the client of the first waiting stream is next.
        """
        while self._waiting:
            speaker = next((each.owner for each in self._playing.values()), None)
            if speaker is not None and self._waiting[0].owner is not speaker:
                return
            stream = self._waiting.popleft()
            self._playing[stream.speech.name] = stream
            self._playout.requests.append(PlayoutRequest("say", stream.speech))


def _retried(query: Callable[[], _Request | None]) -> _Request | None:
    """Return `query()`, tried once more if the live loop changes the playout meanwhile.

    None: the playout changed both times, or `query` returned None.
    """
    for _ in range(2):
        try:
            return query()
        except RuntimeError:  # a deque was changed while it was read
            continue
    return None
