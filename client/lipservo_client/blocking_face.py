"""A blocking client of a face, for programs without an event loop: a call returns when done."""

import asyncio
import threading
from collections.abc import Coroutine, Iterator
from concurrent import futures
from contextlib import suppress
from typing import Any, Final, Literal, Self, TypeVar

from lipservo_client.async_face import AsyncFace, AsyncSpeech, Events
from lipservo_client.protocol import Event, Pcm, Played, SpeechUnits

#: A call that waits checks so often whether the connection's thread still runs.
_CHECK_EVERY_S: Final = 0.5

_Answer = TypeVar("_Answer")


class Speech:
    """One stream of speech, from `with face.stream() as speech`; a blocking `AsyncSpeech`."""

    def __init__(self, face: "Face", speech: AsyncSpeech) -> None:
        self._face = face
        self._speech = speech

    @property
    def delay_ms(self) -> float:
        """The delay in ms from the sending of sound to the lips' motion with it."""
        return self._speech.delay_ms

    @property
    def is_over(self) -> bool:
        """Whether the stream was played to its end, or cut off by this or another client."""
        return self._speech.is_over

    def write(self, samples: Pcm) -> bool:
        """Send samples; return False once the stream is over. Raises FaceError, ValueError."""
        return self._face.wait_for(self._speech.write(samples))

    def mark(self, name: str) -> None:
        """Request a `mark` event for when all samples written so far have been played."""
        self._face.wait_for(self._speech.mark(name))

    def tell(
        self, units: SpeechUnits, *, alphabet: str | None = None, language: str | None = None
    ) -> None:
        """Send the text, words, phonemes or visemes of this stream; as `AsyncSpeech.tell`."""
        self._face.wait_for(self._speech.tell(units, alphabet=alphabet, language=language))

    def report_played(self, played_s: float) -> None:
        """Report how many s of the stream this client has played; for `playback="client"`."""
        self._face.wait_for(self._speech.report_played(played_s))

    def end(self) -> None:
        """Send the end of the stream, once; the face plays what was written to its end."""
        self._face.wait_for(self._speech.end())

    def wait(self) -> Played:
        """End the stream, wait until it is played or cut off, and return how much was played.

        Raises FaceError.
        """
        return self._face.wait_for(self._speech.wait())

    def __enter__(self) -> Self:
        self._face.wait_for(self._speech.__aenter__())
        return self

    def __exit__(self, *exc: Any) -> None:
        """Send the end of the stream; or, after an exception, interrupt the face."""
        self._face.wait_for(self._speech.__aexit__(*exc))


class Face:
    """A connection to a face, from `lipservo.connect`, that any thread may use."""

    def __init__(self, url: str, token: str | None) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="lipservo client", daemon=True)
        self._face = AsyncFace(url, token)

    def __enter__(self) -> Self:
        """Start the connection's thread and connect. Raises FaceError as `AsyncFace.__aenter__`."""
        self._thread.start()
        try:
            self.wait_for(self._face.__aenter__())
        except BaseException:
            self._end_thread()
            raise
        return self

    def __exit__(self, *exc: object) -> None:
        """Disconnect. Ended streams are played on, unless another is open or paused."""
        try:
            self.wait_for(self._face.__aexit__())
        finally:
            self._end_thread()

    def stream(
        self,
        sample_rate: int = 24_000,
        playback: Literal["server", "client"] = "server",
        stream: str | None = None,
    ) -> Speech:
        """Return a new stream of speech, which starts when entered; as `AsyncFace.stream`."""

        async def make_stream() -> AsyncSpeech:
            return self._face.stream(sample_rate, playback, stream)

        return Speech(self, self.wait_for(make_stream()))

    def interrupt(self) -> Played | None:
        """Silence the face now; return how much of all unfinished streams was played (barge-in).

        None: no stream was unfinished. Raises FaceError.
        """
        return self.wait_for(self._face.interrupt())

    def pause(self) -> None:
        """Silence the face now; unplayed speech is kept, up to a minute, until `resume`."""
        self.wait_for(self._face.pause())

    def resume(self) -> None:
        """Resume speech that `pause` silenced; up to 10 ms of it are lost."""
        self.wait_for(self._face.resume())

    def events(self) -> Iterator[Event]:
        """Return an iterator over the face's events from now on, until this client disconnects."""

        async def make_events() -> Events:
            return self._face.events()

        return self._yield_events(self.wait_for(make_events()))

    def status(self) -> dict[str, Any]:
        """Return the face's status: fields of docs/architecture.md, "Status". Raises FaceError."""
        return self.wait_for(self._face.status())

    def stop(
        self, level: Literal["soft", "freeze", "limp"] = "soft", *, end: bool = False
    ) -> dict[str, Any]:
        """Stop the face at a level: soft, freeze, or limp.

        soft: to rest, then torque off; freeze: hold the position; limp: torque off at once. A
        stopped daemon waits, torque off, for `start`; with `end` it exits. Returns the face's
        answer. Raises FaceError.
        """
        return self.wait_for(self._face.stop(level, end=end))

    def start(self) -> dict[str, Any]:
        """Start a stopped face again: it moves. Return the answer once the start is accepted.

        Whether the face is really running is in `status`: `state`, `troubles`. Raises FaceError.
        """
        return self.wait_for(self._face.start())

    def set(self, name: str, value: float) -> dict[str, Any]:
        """Change a setting of the running face, such as `strength`. Raises FaceError."""
        return self.wait_for(self._face.set(name, value))

    def say(self, text: str, *, wait: bool = False, **voice: str | int) -> dict[str, Any]:
        """Speak a text with the face's own voice. Raises FaceError.

        voice: `language`, `voice`, `rate_wpm` and `pitch`, where it is to be another than usual.
        Returns `stream`, `duration_s` of what is synthesised, and `is_whole`: that is all of it.
        wait: return after it was played or dropped, and also `finished` (it was played whole) and
        `played_s`.
        """
        return self.wait_for(self._face.say(text, wait=wait, **voice))

    def play(self, file: str, *, wait: bool = False) -> dict[str, Any]:
        """Play a sound file or a performance (.perf) of the face's folder. Raises FaceError.

        Returns `stream`, `duration_s` and `is_whole` as `say`. wait: return after it was played or
        dropped, and also `finished` (it was played whole) and `played_s`.
        """
        return self.wait_for(self._face.play(file, wait=wait))

    def wait_for(self, call: Coroutine[Any, Any, _Answer]) -> _Answer:
        """Run a coroutine in the connection's thread and return its result.

        Raises EOFError if the connection has ended.
        """
        answer = asyncio.run_coroutine_threadsafe(call, self._loop)
        try:
            while not futures.wait([answer], _CHECK_EVERY_S).done:
                # A call made while the connection ended is never completed.
                if not self._thread.is_alive():
                    raise EOFError("the connection to the face has ended")
            return answer.result()
        except BaseException:
            answer.cancel()  # for example at Ctrl-C: the caller does not wait for it any more
            raise

    def _yield_events(self, events: Events) -> Iterator[Event]:
        """Yield a face's events, blocking until each comes; end when the client disconnects."""

        async def next_event() -> Event | None:
            return await anext(events, None)

        with suppress(EOFError, futures.CancelledError):
            while not self._loop.is_closed() and (event := self.wait_for(next_event())):
                yield event

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._loop.run_forever()

    def _end_thread(self) -> None:
        """Cancel all calls that still wait for this face, and end the connection's thread."""

        async def cancel_all() -> None:
            others = asyncio.all_tasks() - {asyncio.current_task()}
            for task in others:
                task.cancel()
            await asyncio.gather(*others, return_exceptions=True)

        self.wait_for(cancel_all())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()
