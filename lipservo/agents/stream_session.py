"""One client's connection to `/stream`: handles each message; mistakes are answered by errors."""

import asyncio
import logging
import time
from collections import deque
from collections.abc import Callable

from lipservo.agents.messages import (
    PROTOCOL,
    Audio,
    Clear,
    End,
    Hello,
    Interrupt,
    Mark,
    MessageError,
    Outbox,
    Pause,
    Phonemes,
    Position,
    Resume,
    SpeechUnits,
    Start,
    StreamMessage,
    Text,
    Visemes,
    Words,
    decode_base64,
    id_of,
    spoken_text_of,
    stream_message,
)
from lipservo.agents.turns import AgentStream, OpenStreams
from lipsync.audio.playout import Playout
from lipsync.audio.playout_stream import PlayoutTextError
from lipsync.errors import UserError
from lipsync.spoken_text import PronouncedWord
from lipsync.text_to_speech.pronunciation import DEFAULT_LANGUAGE, pronounced_units

_LOG = logging.getLogger(__name__)
#: A chunk is resampled in pieces of this length, and other clients are served in between.
_PIECE_S = 0.5

#: So many ids of streams that a client started, the newest, are kept.
_MOST_IDS = 64
#: Texts of one client whose pronunciation is being looked up.
_MOST_APPLYING = 256


class StreamSession:
    """One client's connection to `/stream`, whose messages it applies to the client's streams.

    delay_ms: returns the present delay in ms from the arrival of sound to the motion that shows it.
    """

    def __init__(
        self, outbox: Outbox, streams: OpenStreams, playout: Playout, delay_ms: Callable[[], float]
    ) -> None:
        """Create a session without streams. outbox: queue of the messages to this client.

        streams: the speech of all clients, which `playout` plays.
        """
        self._outbox = outbox
        self._streams = streams
        self._playout = playout
        self._delay_ms = delay_ms
        self._open_stream: AgentStream | None = None
        # After an interruption, the rest of the stream may still arrive: that is no mistake.
        self._ignores_rest = False
        #: Tasks that look up and apply texts or units, one after the other; and the last of them.
        self._applying: set[asyncio.Task[None]] = set()
        self._last_applied: asyncio.Task[None] | None = None
        #: Ids of streams that were started: their texts may come when they are over.
        self._started_ids: deque[str] = deque(maxlen=_MOST_IDS)

    async def hear(self, message: str | bytes) -> None:
        """Handle a message of the client, PCM bytes or JSON; send an error for a mistake."""
        stream_id = self._open_stream.stream_id if self._open_stream is not None else None
        try:
            if isinstance(message, bytes):
                await self._append_audio(message)
            elif (parsed := stream_message(message)) is not None:
                stream_id = parsed.stream if isinstance(parsed, Start) else stream_id
                await self._carry_out(parsed)
        except MessageError as error:
            fields = {} if isinstance(message, bytes) else {"id": id_of(message)}
            ids = {name: value for name, value in fields.items() if value is not None}
            self._outbox.error(error.code, str(error), stream=stream_id, **ids)

    def leave(self) -> None:
        """Interrupt the speech of a client that left a stream open or paused; it has disconnected.

        Streams that it has ended are played, and their texts are still applied.
        """
        self._streams.leave(self._outbox)

    async def _carry_out(self, parsed: StreamMessage) -> None:
        """Carry out a parsed message of the client, by its type. Raises MessageError."""
        match parsed:
            case Hello():
                self._greet(parsed)
            case Start():
                self._start_stream(parsed)
            case Audio():
                await self._append_audio(decode_base64(parsed.data))
            case End():
                self._end_stream()
            case Mark():
                self._add_mark(parsed.name)
            case Interrupt():
                self._drop_open_stream()
                self._streams.interrupt(self._outbox)
            case Clear():
                self._drop_open_stream()
                self._streams.clear(self._outbox)
            case Pause():
                self._streams.pause(self._outbox, time.monotonic())
            case Resume():
                self._streams.resume(self._outbox)
            case Position():
                self._note_position(parsed)
            case Text() | Words() | Phonemes() | Visemes():
                self._queue_units(parsed)

    def _greet(self, hello: Hello) -> None:
        """Answer `hello`. Raises MessageError if the client's protocol version is another."""
        if hello.protocol not in (None, PROTOCOL):
            differ = f"this client speaks protocol {hello.protocol}, the face {PROTOCOL}"
            remedy = "install the lipservo-client of the face's version"
            raise MessageError("bad_protocol", f"{differ}; {remedy}")
        times = {"delay_ms": self._delay_ms(), "time_s": round(time.monotonic(), 3)}
        self._outbox.put({"type": "hello", "protocol": PROTOCOL, **times})

    def _start_stream(self, start: Start) -> None:
        """Open the stream that a `start` message requests, and send the client `ready`.

        Raises MessageError if the client's previous stream has not ended, or if the stream is
        refused.
        """
        if self._open_stream is not None and not self._open_stream.speech.ended:
            open_id = self._open_stream.stream_id
            raise MessageError("stream_open", f"stream {open_id!r} has not ended; send `end` first")
        self._open_stream = self._streams.open(self._outbox, start, time.monotonic())
        self._ignores_rest = False
        self._started_ids.append(self._open_stream.stream_id)
        self._outbox.put(
            {
                "type": "ready",
                "stream": self._open_stream.stream_id,
                "delay_ms": self._delay_ms(),
                "playback": start.playback,
            }
        )

    def _stream_unless_cut(self, refusal: str) -> AgentStream | None:
        """Return the open stream; None: it was cut off, and its rest is ignored.

        Raises MessageError, with the text `refusal`, if no stream is open.
        """
        if self._open_stream is None and not self._ignores_rest:
            raise MessageError("no_stream", refusal)
        return self._open_stream

    def _drop_open_stream(self) -> None:
        """Forget the open stream, whose rest is ignored from now on."""
        self._ignores_rest = self._ignores_rest or self._open_stream is not None
        self._open_stream = None

    async def _append_audio(self, data: bytes) -> None:
        """Decode PCM bytes and append the samples to the client's open stream.

        Other clients are served after each 0.5 s of sound. Without an open stream the bytes are
        dropped: silently after an `interrupt` or `clear`, else with a MessageError. Also raised if
        more than 5 minutes of speech would wait.
        """
        stream = self._stream_unless_cut("audio was dropped; send `start` first")
        if stream is None or stream.speech.ended:
            return
        self._streams.check_room(stream.decoder.n_samples(data) / stream.rate_hz)
        samples = stream.decoder.decode(data)
        piece = round(_PIECE_S * stream.rate_hz)
        for first in range(0, len(samples), piece):
            stream.push(samples[first : first + piece], time.monotonic())
            await asyncio.sleep(0.0)

    def _end_stream(self) -> None:
        """Mark the client's open stream as complete; speech that it still contains is played.

        Raises MessageError if no stream is open, unless it was cut off, and if the audio ended
        within a sample; then the stream is complete all the same.
        """
        stream = self._stream_unless_cut("`end` without a stream; send `start` first")
        if stream is None:
            return
        self._open_stream = None
        stream.speech.end()
        if n_bytes := len(stream.decoder.partial_sample):
            cut = f"the last {n_bytes} bytes were dropped: they are only part of a sample"
            raise MessageError("bad_audio", cut)

    def _add_mark(self, name: str) -> None:
        """Add a mark to the open stream.

        Raises MessageError if no stream is open, unless it was cut off.
        """
        stream = self._stream_unless_cut("`mark` without a stream; send `start` first")
        if stream is not None:
            stream.mark(name)

    def _queue_units(self, units: SpeechUnits) -> None:
        """Start a task that applies a text, words, phonemes or visemes to their stream.

        Samples do not wait for it: the first text loads a dictionary. Raises MessageError for an
        unknown stream, or while 256 texts wait.
        """
        stream = self._named_stream(units.stream)
        if stream is None:
            return
        if len(self._applying) >= _MOST_APPLYING:
            raise MessageError("bad_text", f"{_MOST_APPLYING} texts already wait; send more later")
        applying = self._apply_units(units, stream, self._last_applied)
        self._last_applied = asyncio.get_running_loop().create_task(applying)
        self._applying.add(self._last_applied)
        self._last_applied.add_done_callback(self._applying.discard)

    async def _apply_units(
        self, units: SpeechUnits, stream: AgentStream, before: asyncio.Task[None] | None
    ) -> None:
        """Wait for the task `before`, then give a stream its text, words, phonemes or visemes.

        Pronunciations are looked up in a thread. Raises nothing: the client is sent errors as
        events.
        """
        if before is not None:
            await asyncio.wait([before])
        try:
            spoken = spoken_text_of(units, stream.rate_hz)
            words: tuple[PronouncedWord, ...] = ()
            if not (spoken.moves_mouth and spoken.is_timed):
                language = units.language if isinstance(units, Text | Words) else DEFAULT_LANGUAGE
                words = await asyncio.to_thread(pronounced_units, spoken, language)
            stream.speech.tell(spoken, words)
        except (UserError, PlayoutTextError) as error:
            line = f"{units.type}: {error}; it was not taken"
            self._outbox.error("bad_text", line, stream=stream.stream_id)
        except Exception as error:  # a fault of ours, or of the library for pronunciations
            _LOG.error("voice agents: a text failed: %s: %s", type(error).__name__, error)
            self._outbox.error("internal", "the text failed; see the face's log")

    def _named_stream(self, name: str | None) -> AgentStream | None:
        """Return the stream `name`, or the open one if None; None: it was cut off or is over.

        Raises MessageError for a stream that was never started.
        """
        if name is None:
            return self._stream_unless_cut("no stream is open; start or name one")
        stream = self._streams.stream_of(self._outbox, name)
        if stream is None and name not in self._started_ids:
            raise MessageError("no_stream", f"stream {name!r} does not exist; start it first")
        return stream

    def _note_position(self, parsed: Position) -> None:
        """Record how much of a stream the client has played; without `played_s` send positions.

        Raises MessageError for a stream that the face itself plays.
        """
        if parsed.played_s is None:
            self._streams.tell_positions(self._outbox)
            return
        now_s = time.monotonic()
        for stream in self._streams.playing:
            if stream.owner is self._outbox and parsed.stream in (None, stream.stream_id):
                if stream.start.playback != "client":
                    plays = "the face plays this stream itself and knows its position"
                    raise MessageError("bad_message", f"position: {plays}")
                n_samples = round(parsed.played_s * stream.rate_hz)
                self._playout.reports.append((now_s, stream.speech.name, n_samples))
                return
