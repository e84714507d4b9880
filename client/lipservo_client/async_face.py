"""An asyncio client of a face: it sends speech and commands, and receives events."""

import asyncio
import contextlib
import itertools
import random
import weakref
from collections import deque
from collections.abc import AsyncGenerator
from typing import Any, Final, Literal, Self

from lipservo_client.protocol import (
    PROTOCOL,
    Event,
    FaceError,
    Pcm,
    Played,
    SpeechUnits,
    error_of,
    pcm_bytes,
    played_of,
    unit_messages,
)
from lipservo_client.wire import PATIENCE_S, Wire, connected

#: A chunk is sent in pieces: the face takes messages of up to 1 MB.
_PIECE_BYTES: Final = 1 << 16
#: Less sound is kept until more comes: a face reads 2,000 messages a second of a client.
_LEAST_PIECE_S: Final = 0.005
#: `write` waits while so much of a stream is unplayed: with eight streams less than a face keeps.
_AHEAD_S: Final = 30.0
#: Limit for the answer to `say` and `play`: a sentence is synthesised, or a file read, before it.
_READING_S: Final = 60.0
#: Five minutes of speech may wait in a face. When nothing of a stream was played for longer, the
#: face hangs.
STILL_S: Final = 310.0
#: Between a lost connection and the next try, doubled from try to try; half of it by chance, so
#: that many clients of one face do not come at once.
_FIRST_WAIT_S, _LONGEST_WAIT_S = 0.25, 5.0
#: Events that a slow reader of `events` finds; the oldest are lost beyond it.
_MOST_EVENTS: Final = 1024


class AsyncSpeech:
    """One stream of speech, from `async with face.stream() as speech`.

    delay_ms: from the sending of sound to the lips' motion with it; a client that plays the sound
    itself plays it that much later. rate_hz: sample rate. stream: its id. n_sent, n_played: samples
    sent so far, and played by the face's last report.
    """

    def __init__(self, face: "AsyncFace", stream: str, start: dict[str, object]) -> None:
        """Prepare a stream. stream: its id. start: fields of the message that will start it."""
        self._start = start
        #: Whether the end of the stream was sent.
        self.is_complete = False
        self._error: FaceError | None = None
        loop = asyncio.get_running_loop()
        #: The delay in ms, once the face has answered the start of the stream.
        self.ready: asyncio.Future[float] = loop.create_future()
        self._end_of_play: asyncio.Future[Played] = loop.create_future()
        self._wire = face.wire
        self.rate_hz = int(str(start["sample_rate"]))
        self._unsent = b""
        self._progress_s, self._progressed = loop.time(), asyncio.Event()
        self._n_bytes = 0
        self.n_sent = self.n_played = 0
        self.stream = stream
        self.delay_ms = 0.0

    @property
    def is_over(self) -> bool:
        """Whether the stream was played to its end, or cut off by this or another client."""
        return self._end_of_play.done()

    @property
    def was_heard(self) -> bool:
        """Whether the stream was played to its end."""
        has_result = self.is_over and self._end_of_play.exception() is None
        return has_result and self._end_of_play.result().finished

    async def write(self, samples: Pcm) -> bool:
        """Send samples at any pace; return False once the stream is over and accepts no more.

        Waits while more than half a minute is sent and not played. Raises FaceError for an error of
        the stream that the face reported, ValueError for arrays that are no mono sound.
        """
        data = self._unsent + pcm_bytes(samples)
        self._unsent = b""
        if len(data) < 2 * self.rate_hz * _LEAST_PIECE_S:
            self._unsent, data = data, b""
        for first in range(0, max(1, len(data)), _PIECE_BYTES):
            self._raise_error()
            if not await self._has_room():
                return False
            if data:
                await self._send(data[first : first + _PIECE_BYTES])
        return True

    async def mark(self, name: str) -> None:
        """Request a `mark` event for when all samples written so far have been played."""
        if not self.is_over:  # as for `end`
            await self._send_unsent()
            await self._wire.send("mark", name=name)

    async def tell(
        self, units: SpeechUnits, *, alphabet: str | None = None, language: str | None = None
    ) -> None:
        """Send the text or units of this stream: before its sound, with it or later.

        units: a text; or (kind, units), kind `words`, `phonemes` or `visemes`, a unit being a
        label, or (label, start, end) in samples of the stream; start and end are None if unknown.
        They are added to earlier units; if the first has a start, they replace those from there on.
        alphabet: of the labels, as docs/text.md names it; None: ARPAbet. language: as `en-us`, the
        default. A face that cannot use the units sends an `error` event, `bad_text` or
        `bad_message`, and recognises phonemes in the sound.
        """
        for message in unit_messages(units):
            about = {"alphabet": alphabet, "language": language}
            await self._wire.send(message.pop("type"), stream=self.stream, **message, **about)

    async def report_played(self, played_s: float) -> None:
        """Report how many s of the stream this client has played; for `playback="client"`."""
        await self._wire.send("position", stream=self.stream, played_s=played_s)

    async def end(self) -> None:
        """Send the end of the stream, once; the face plays what was written to its end."""
        was_complete, self.is_complete = self.is_complete, True
        if not (was_complete or self.is_over):  # `end` names no stream: it would end the next one
            await self._send_unsent()
            await self._wire.send("end")

    async def wait(self) -> Played:
        """End the stream, wait until it is played or cut off, and return how much was played.

        Raises FaceError for an error of the stream, or if the connection is lost.
        """
        await self.end()
        played = await self.heard()
        self._raise_error()
        return played

    async def heard(self) -> Played:
        """Wait, without ending the stream, until it is over; return how much of it was played.

        Over: played or cut off. Raises FaceError if the connection is lost, or nothing was played
        for `STILL_S` seconds.
        """
        while not self._end_of_play.done():
            await asyncio.wait([self._end_of_play], timeout=self._patience_s())
        return self._end_of_play.result()

    async def __aenter__(self) -> Self:
        await self._wire.send("start", stream=self.stream, **self._start)
        async with _time_limit("start", PATIENCE_S):
            self.delay_ms = await self.ready
        return self

    async def __aexit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        """Send the end of the stream; or, after an exception, interrupt the face."""
        with contextlib.suppress(FaceError):
            if kind is None:
                await self.end()
            elif not self.is_over:
                self.is_complete = True
                await self._wire.send("interrupt")

    def hear(self, event: Event) -> None:
        """Update the stream by the face's event about it: ready, samples played, end or error."""
        if event.get("n_played", 0) > self.n_played:
            self.n_played = int(event["n_played"])
            self._progress_s = asyncio.get_running_loop().time()
            self._progressed.set()
        match event["type"]:
            case "ready" if not self.ready.done():
                self.ready.set_result(float(event["delay_ms"]))
            case "finished" | "interrupted" if not self.is_over:
                self._end_of_play.set_result(played_of(event))
                self._progressed.set()
            case "error" if event.get("code") not in ("bad_text", "bad_message"):  # sound plays on
                self.fail(error_of(event))

    def fail(self, error: FaceError) -> None:
        """Store an error of this stream, which the next `write` or `wait` raises.

        If the stream has not started yet, starting it raises the error.
        """
        if not self.ready.done():
            _set_answer(self.ready, error)
            if not self.is_over:  # it never began: `interrupt` must not wait for its end
                self._end_of_play.set_result(Played(finished=False, played_s=0.0))
        else:
            self._error = self._error or error

    def lose(self, error: FaceError) -> None:
        """End the stream with the error of a lost connection, which waiting calls raise."""
        self.fail(error)
        if not self.is_over:
            _set_answer(self._end_of_play, error)
            self._progressed.set()

    async def _has_room(self) -> bool:
        """Wait until at most 30 s are unplayed; return True, or False if the stream is over."""
        while not self.is_over and self.n_sent - self.n_played > _AHEAD_S * self.rate_hz:
            self._progressed.clear()
            await _wait_at_most(self._progressed, self._patience_s())
        return not self.is_over

    def _patience_s(self) -> float:
        """Return the seconds left to wait for progress. Raises FaceError if none are left."""
        still_s = self._progress_s + STILL_S - asyncio.get_running_loop().time()
        if still_s <= 0.0:
            still = f"nothing of {self.stream} was heard for {STILL_S:g} s"
            raise FaceError("not_answering", still)
        return still_s

    async def _send(self, data: bytes) -> None:
        await self._wire.send_message(data)
        self._n_bytes += len(data)
        self.n_sent = self._n_bytes // 2

    async def _send_unsent(self) -> None:
        data, self._unsent = self._unsent, b""
        if data:
            await self._send(data)

    def _raise_error(self) -> None:
        error, self._error = self._error, None
        if error is not None:
            raise error


class Events:
    """An asynchronous iterator over a face's events, in order, until the client disconnects.

    A reader that is slow, or never reads, gets the newest 1,024.
    """

    def __init__(self) -> None:
        self._waiting: deque[Event] = deque(maxlen=_MOST_EVENTS)
        self._filled = asyncio.Event()
        self._is_over = False

    def put(self, event: Event) -> None:
        """Append an event; beyond 1,024 the oldest is dropped."""
        self._waiting.append(event)
        self._filled.set()

    def end(self) -> None:
        """Let the iterator end after the events that it has not yielded yet."""
        self._is_over = True
        self._filled.set()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Event:
        while not self._waiting:
            if self._is_over:
                raise StopAsyncIteration
            self._filled.clear()
            await self._filled.wait()
        return self._waiting.popleft()


class AsyncFace:
    """A connection to a face; from `lipservo.connect_async`.

    A lost connection is opened again, with pauses that grow up to five seconds, until the client
    disconnects. `events()` yields `disconnected` and `reconnected`, with `code` and `message`;
    `disconnected` again if the face is back and refuses this client (bad_protocol, unauthorized).
    A lost connection ends all streams: they raise FaceError, and nothing of them is sent again.
    """

    def __init__(self, url: str, token: str | None) -> None:
        """Prepare a client of the face at `url`; arguments as of `connect`."""
        self._url = url.rstrip("/")
        self._token = token
        self._numbers = itertools.count(1)
        self._speeches: dict[str, AsyncSpeech] = {}
        self._events: weakref.WeakSet[Events] = weakref.WeakSet()
        self._greeting: asyncio.Future[object] | None = None
        self._stream_wire: Wire | None = None
        self._control_wire: Wire | None = None
        self._connecting = asyncio.Lock()
        self._reconnecting: asyncio.Task[None] | None = None
        self._try_requested, self._tried = asyncio.Event(), asyncio.Event()
        self._pending: dict[int, asyncio.Future[dict[str, Any]]] = {}
        self._ends_of_speech: dict[int, asyncio.Future[Event]] = {}

    @property
    def wire(self) -> Wire:
        """The open WebSocket to `/stream`. Raises FaceError while there is none."""
        if self._stream_wire is None:
            raise FaceError("disconnected", f"{self._url}: not connected; connecting again")
        return self._stream_wire

    @property
    def is_connected(self) -> bool:
        """Whether the connection to `/stream` is open, so that speech can be sent."""
        return self._stream_wire is not None

    async def __aenter__(self) -> Self:
        """Connect. Raises FaceError: unauthorized, refused, not_answering, bad_protocol."""
        await self._connect()
        return self

    async def __aexit__(self, *exc: object) -> None:
        """Disconnect. Ended streams play on, unless another is open; waits raise FaceError."""
        if self._reconnecting is not None:
            self._reconnecting.cancel()
            await asyncio.gather(self._reconnecting, return_exceptions=True)
        wires = [wire for wire in (self._control_wire, self._stream_wire) if wire is not None]
        self._control_wire = self._stream_wire = None
        for wire in wires:
            await wire.close()
        for speech in self._speeches.values():
            speech.lose(FaceError("disconnected", "the face was left"))
        for events in self._events:
            events.end()

    def stream(
        self,
        sample_rate: int = 24_000,
        playback: Literal["server", "client"] = "server",
        stream: str | None = None,
    ) -> AsyncSpeech:
        """Return a new stream of speech, which starts when it is entered.

        playback: "client" if this program plays the sound itself. stream: an id, unique among this
        client's open streams; None: one is made. Raises FaceError: disconnected, or stream_open if
        the id is in use.
        """
        name = stream or f"speech {next(self._numbers)}"
        self._speeches = {key: each for key, each in self._speeches.items() if not each.is_over}
        if name in self._speeches:
            raise FaceError("stream_open", f"stream {name!r} already waits or is spoken")
        speech = AsyncSpeech(self, name, {"sample_rate": sample_rate, "playback": playback})
        self._speeches[name] = speech
        return speech

    async def interrupt(self) -> Played | None:
        """Silence the face now; return how much of all unfinished streams was played (barge-in).

        None: no stream was unfinished. Raises FaceError.
        """
        unfinished = [each for each in self._speeches.values() if not each.is_over]
        await self.wire.send("interrupt")
        if not unfinished:
            return None
        async with _time_limit("the interruption", PATIENCE_S):
            played = await asyncio.gather(*(each.heard() for each in unfinished))
        return Played(
            all(each.finished for each in played),
            sum(each.played_s for each in played),
            sum(each.dropped_s for each in played),
        )

    async def pause(self) -> None:
        """Silence the face now; unplayed speech is kept, up to a minute, until `resume`."""
        await self.wire.send("pause")

    async def resume(self) -> None:
        """Resume speech that `pause` silenced; up to 10 ms of it are lost."""
        await self.wire.send("resume")

    def keep_trying(self) -> None:
        """Connect in the background, trying until a face answers; instead of `async with`."""
        self._reconnecting = asyncio.get_running_loop().create_task(self._reconnect())

    async def try_now(self) -> None:
        """Let a lost connection be tried now, not after the pause; return once it was tried."""
        if self._stream_wire is None and self._reconnecting is not None:
            self._tried.clear()
            self._try_requested.set()
            await _wait_at_most(self._tried, PATIENCE_S)

    def events(self) -> Events:
        """Return an iterator over the face's events from now on, until this client disconnects."""
        events = Events()
        self._events.add(events)
        return events

    async def status(self) -> dict[str, Any]:
        """Return the face's status: fields of docs/architecture.md, "Status". Raises FaceError."""
        return await self._request("status")

    async def stop(
        self, level: Literal["soft", "freeze", "limp"] = "soft", *, end: bool = False
    ) -> dict[str, Any]:
        """Stop the face at a level: soft, freeze, or limp.

        soft: to rest, then torque off; freeze: hold the position; limp: torque off at once. A
        stopped daemon waits, torque off, for `start`; with `end` it exits. Returns the face's
        answer. Raises FaceError.
        """
        return await self._request("stop", level=level, end=end)

    async def start(self) -> dict[str, Any]:
        """Start a stopped face again: it moves. Return the answer once the start is accepted.

        Whether the face is really running is in `status`: `state`, `troubles`. Raises FaceError.
        """
        return await self._request("start")

    async def set(self, name: str, value: float) -> dict[str, Any]:
        """Change a setting of the running face, such as `strength`. Raises FaceError."""
        return await self._request("set", name=name, value=value)

    async def say(self, text: str, *, wait: bool = False, **voice: str | int) -> dict[str, Any]:
        """Speak a text with the face's own voice. Raises FaceError.

        voice: `language`, `voice`, `rate_wpm` and `pitch`, where it is to be another than usual.
        Returns `stream`, its id in the field `speaking` of the status, and `duration_s` of what is
        synthesised; `is_whole`: whether that is all of it. wait: return after it was played or
        dropped, and also `finished` (it was played whole) and `played_s`.
        """
        return await self._request_speech("say", wait=wait, text=text, **voice)

    async def play(self, file: str, *, wait: bool = False) -> dict[str, Any]:
        """Play a sound file or a performance (.perf) of the face's folder. Raises FaceError.

        Returns `stream`, `duration_s` and `is_whole` as `say`. wait: return after it was played or
        dropped, and also `finished` (it was played whole) and `played_s`.
        """
        return await self._request_speech("play", wait=wait, file=file)

    async def _request_speech(self, kind: str, *, wait: bool, **fields: object) -> dict[str, Any]:
        """Send `say` or `play` and return the answer; with `wait` once the speech has ended.

        Raises FaceError: 60 s without an answer, or no end of it long after the face last spoke.
        """
        number = next(self._numbers)
        ended_event: asyncio.Future[Event] = asyncio.get_running_loop().create_future()
        self._ends_of_speech[number] = ended_event
        try:
            answer = await self._request(kind, number, _READING_S, **fields)
            if not wait:
                return answer
            is_speaking, limit_s = True, STILL_S + answer["duration_s"]
            while not (await asyncio.wait([ended_event], timeout=limit_s))[0]:
                if not is_speaking:  # not even at the last look
                    raise FaceError("not_answering", f"the face did not report the end of {kind}")
                is_speaking = (await self._request("status")).get("speaking") is not None
            event = ended_event.result()
        finally:
            del self._ends_of_speech[number]
        result = {"finished": event["type"] == "finished", "played_s": event["played_s"]}
        is_whole = result["finished"] or answer["is_whole"]
        return {**answer, **result, "duration_s": event["duration_s"], "is_whole": is_whole}

    async def _request(
        self, kind: str, number: int | None = None, limit_s: float = PATIENCE_S, **fields: object
    ) -> dict[str, Any]:
        """Send a command over `/control`, connecting first if needed; return the answer's `result`.

        number: the command's id; None: a new one. limit_s: seconds until the answer.
        Raises FaceError for an `error` as the answer, or none.
        """
        number = next(self._numbers) if number is None else number
        answer: asyncio.Future[dict[str, Any]] = asyncio.get_running_loop().create_future()
        self._pending[number] = answer
        try:
            async with _time_limit(kind, limit_s):
                async with self._connecting:
                    if self._control_wire is None:
                        url, take, lose = f"{self._url}/control", self._complete, self._lose_control
                        # `/control` admits a wrong token, too, but to stop the face alone.
                        wire = self._stream_wire
                        token = self._token if wire is None else wire.token
                        self._control_wire = await connected(url, token, take, lose, limit_s)
                await self._control_wire.send(kind, id=number, **fields)
                return await answer
        except FaceError as error:
            # This connection may only stop the face, for good; the next command opens another.
            wire = self._control_wire
            if error.code == "unauthorized" and wire is not None and len(self._pending) == 1:
                await wire.close()
            raise
        finally:
            del self._pending[number]

    async def _connect(self) -> None:
        """Open `/stream` and compare protocol versions. Raises FaceError as `__aenter__` does."""
        url = f"{self._url}/stream"
        self._greeting = asyncio.get_running_loop().create_future()
        async with _time_limit(url, PATIENCE_S):
            wire = await connected(url, self._token, self._distribute, self._lose, PATIENCE_S)
            try:
                await wire.send("hello", protocol=PROTOCOL)
                version = await self._greeting
                if version != PROTOCOL:
                    differ = f"the face speaks protocol {version}, this lipservo-client {PROTOCOL}"
                    remedy = "install the lipservo-client of the face's version"
                    raise FaceError("bad_protocol", f"{url}: {differ}; {remedy}")
            except BaseException:
                await wire.close()
                raise
        self._stream_wire = wire

    async def _reconnect(self) -> None:
        """Try to connect, with growing pauses, until a face answers; then emit `reconnected`."""
        wait_s, reason = _FIRST_WAIT_S, "not_answering"
        while self._stream_wire is None:
            await _wait_at_most(self._try_requested, wait_s * random.uniform(0.5, 1.0))
            self._try_requested.clear()
            wait_s = min(2.0 * wait_s, _LONGEST_WAIT_S)
            try:
                await self._connect()
            except FaceError as error:
                if error.code not in (reason, "disconnected", "shutting_down"):
                    reason = error.code
                    self._emit_loss(error)
            self._tried.set()
        self._emit({"type": "reconnected", "code": "", "message": f"{self._url}: is back"})

    def _complete(self, event: Event) -> None:
        """Complete the command that a message of `/control` answers, or whose speech has ended."""
        number = event.get("id") or 0
        if event["type"] in ("finished", "dropped"):
            _set_answer(self._ends_of_speech.get(number), event)
        elif event["type"] == "result":
            _set_answer(self._pending.get(number), event.get("result") or {})
        elif event["type"] == "error":
            _set_answer(self._pending.get(number), error_of(event))

    def _lose_control(self, error: FaceError) -> None:
        self._control_wire = None
        for waiting in (*self._pending.values(), *self._ends_of_speech.values()):
            _set_answer(waiting, error)

    def _distribute(self, event: Event) -> None:
        """Hand an event of `/stream` to its stream and all `Events`; the greeting to `_connect`.

        An error without a stream fails the first stream that waits for its start.
        """
        if self._greeting is not None and not self._greeting.done():
            if event["type"] == "error":
                self._greeting.set_exception(error_of(event))
            elif event["type"] == "hello":
                self._greeting.set_result(event.get("protocol", "unknown"))
            return
        speech = self._speeches.get(str(event.get("stream")))
        if speech is not None:
            speech.hear(event)
        elif event["type"] == "error":
            starting = [each for each in self._speeches.values() if not each.ready.done()]
            for each in starting[:1]:
                each.fail(error_of(event))
        self._emit(event)

    def _lose(self, error: FaceError) -> None:
        """End all streams with the error of the lost `/stream`, and start reconnecting."""
        _set_answer(self._greeting, error)
        if self._stream_wire is None:  # this client has left, or the hello was never answered
            return
        self._stream_wire = None
        for speech in self._speeches.values():
            speech.lose(error)
        self._emit_loss(error)
        self._reconnecting = asyncio.get_running_loop().create_task(self._reconnect())

    def _emit_loss(self, error: FaceError) -> None:
        self._emit({"type": "disconnected", "code": error.code, "message": str(error)})

    def _emit(self, event: Event) -> None:
        for events in self._events:
            events.put(event)


def _set_answer(waiting: asyncio.Future[Any] | None, answer: object) -> None:
    """Set `answer` as the result of a future, or as its exception if it is a FaceError.

    Do nothing if the future, `waiting`, is None or already done.
    """
    if waiting is None or waiting.done():
        return
    if isinstance(answer, FaceError):
        waiting.set_exception(answer)
        waiting.exception()  # or asyncio logs it if nobody waits
    else:
        waiting.set_result(answer)


async def _wait_at_most(event: asyncio.Event, limit_s: float) -> None:
    """Wait for an event, at most `limit_s`."""
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(limit_s):
            await event.wait()


@contextlib.asynccontextmanager
async def _time_limit(what: str, limit_s: float) -> AsyncGenerator[None, None]:
    """Raise FaceError if the block runs longer than `limit_s`; `what` names it in the message."""
    try:
        async with asyncio.timeout(limit_s):
            yield
    except TimeoutError as error:
        raise FaceError("not_answering", f"{what}: no answer within {limit_s:g} s") from error
