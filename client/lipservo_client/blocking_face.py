"""A face to speak through, for programs without an event loop: a call returns when it is done."""

import asyncio
import threading
from collections.abc import Coroutine, Iterator
from concurrent.futures import CancelledError
from typing import Any, Final, Literal, Self, TypeVar

from lipservo_client.async_face import AsyncFace, AsyncSpeech, Events
from lipservo_client.protocol import Event, Pcm, Played, SpeechUnits

#: Between two looks whether there is still somebody who could answer.
_LOOK_S: Final = 0.5

_Answer = TypeVar("_Answer")


class Speech:
    """One stream of speech, from `with face.stream() as speech`; see `AsyncSpeech`."""

    def __init__(self, face: "Face", speech: AsyncSpeech) -> None:
        self._face = face
        self._speech = speech

    @property
    def delay_ms(self) -> float:
        """How long after its sound is sent it is seen on the face."""
        return self._speech.delay_ms

    @property
    def is_over(self) -> bool:
        """Whether it was heard to its end, or cut off: by us or by another client."""
        return self._speech.is_over

    def write(self, samples: Pcm) -> bool:
        """Send samples at any pace; False once it was cut off. Raises FaceError, ValueError."""
        return self._face.wait_for(self._speech.write(samples))

    def mark(self, name: str) -> None:
        """Ask for a `mark` event when all that was written until now has been heard."""
        self._face.wait_for(self._speech.mark(name))

    def tell(
        self, units: SpeechUnits, *, alphabet: str | None = None, language: str | None = None
    ) -> None:
        """Send the text or units of this stream, beside its sound; see `AsyncSpeech.tell`."""
        self._face.wait_for(self._speech.tell(units, alphabet=alphabet, language=language))

    def report_played(self, played_s: float) -> None:
        """With `playback="client"`: so much has left our loudspeaker now; the mouth follows."""
        self._face.wait_for(self._speech.report_played(played_s))

    def end(self) -> None:
        """End the stream; what was written is spoken to its end."""
        self._face.wait_for(self._speech.end())

    def wait(self) -> Played:
        """End it, and wait until it was heard or cut off. Raises FaceError."""
        return self._face.wait_for(self._speech.wait())

    def __enter__(self) -> Self:
        self._face.wait_for(self._speech.__aenter__())
        return self

    def __exit__(self, *exc: Any) -> None:
        """Complete; or, where something went wrong on the way, silent."""
        self._face.wait_for(self._speech.__aexit__(*exc))


class Face:
    """A connection to a face, from `lipservo.connect`. Any thread may use it."""

    def __init__(self, url: str, token: str | None) -> None:
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="lipservo client", daemon=True)
        self._face = AsyncFace(url, token)

    def __enter__(self) -> Self:
        self._thread.start()
        try:
            self.wait_for(self._face.__aenter__())
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(self, *exc: object) -> None:
        """Disconnect. Streams that were ended are spoken to their end; others are cut off."""
        try:
            self.wait_for(self._face.__aexit__())
        finally:
            self._end()

    def stream(
        self,
        sample_rate: int = 24_000,
        playback: Literal["server", "client"] = "server",
        stream: str | None = None,
    ) -> Speech:
        """A new stream of speech; see `AsyncFace.stream`."""

        async def made() -> AsyncSpeech:
            return self._face.stream(sample_rate, playback, stream)

        return Speech(self, self.wait_for(made()))

    def interrupt(self) -> Played | None:
        """Barge-in: silence now. What was heard of all that was not finished; None: nothing was."""
        return self.wait_for(self._face.interrupt())

    def pause(self) -> None:
        """Silence now; what was not heard is kept, up to a minute, until `resume`."""
        self.wait_for(self._face.pause())

    def resume(self) -> None:
        """Resume speech where it was paused."""
        self.wait_for(self._face.resume())

    def events(self) -> Iterator[Event]:
        """Whatever the face tells from now on, until the face is left; `disconnected` too."""

        async def made() -> Events:
            return self._face.events()

        return self._listen(self.wait_for(made()))

    def status(self) -> dict[str, Any]:
        """How the face is. Raises FaceError."""
        return self.wait_for(self._face.status())

    def stop(
        self, level: Literal["soft", "freeze", "limp"] = "soft", *, end: bool = False
    ) -> dict[str, Any]:
        """Stop the face: to rest and limp, frozen, or limp at once. Raises FaceError.

        A daemon that was stopped waits, limp, for `start`; with `end` it ends.
        """
        return self.wait_for(self._face.stop(level, end=end))

    def start(self) -> dict[str, Any]:
        """Drive a stopped face again: it moves. Returns once the start is accepted.

        Whether it came to be driven is in `status`: `state`, `troubles`. Raises FaceError.
        """
        return self.wait_for(self._face.start())

    def set(self, name: str, value: float) -> dict[str, Any]:
        """Change a setting while it runs, as `strength`. Raises FaceError."""
        return self.wait_for(self._face.set(name, value))

    def say(self, text: str, *, wait: bool = False) -> dict[str, Any]:
        """Say a text with the face's own voice; see `AsyncFace.say`. Raises FaceError."""
        return self.wait_for(self._face.say(text, wait=wait))

    def play(self, file: str, *, wait: bool = False) -> dict[str, Any]:
        """Play a sound file or a performance (.perf) of the face's folder. Raises FaceError.

        Returns once it is read and waits for its turn, or with `wait` when it was heard.
        """
        return self.wait_for(self._face.play(file, wait=wait))

    def wait_for(self, call: Coroutine[Any, Any, _Answer]) -> _Answer:
        """Run it in the connection's own thread, and wait."""
        answer = asyncio.run_coroutine_threadsafe(call, self._loop)
        try:
            while True:
                try:
                    return answer.result(_LOOK_S)
                except TimeoutError:
                    if answer.done():
                        raise
                    # What was asked while the connection ended is answered by nobody.
                    if not self._thread.is_alive():
                        raise EOFError("the connection has ended") from None
        except BaseException:
            answer.cancel()  # Ctrl-C: nobody waits for it any more
            raise

    def _listen(self, events: Events) -> Iterator[Event]:
        async def following() -> Event | None:
            return await anext(events, None)

        while not self._loop.is_closed():
            try:
                event = self.wait_for(following())
            except (EOFError, CancelledError):
                return
            if event is None:
                return
            yield event

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._loop.run_forever()

    def _end(self) -> None:
        """Release every thread that still waits for this face."""

        async def cancel_all() -> None:
            others = asyncio.all_tasks() - {asyncio.current_task()}
            for task in others:
                task.cancel()
            await asyncio.gather(*others, return_exceptions=True)

        self.wait_for(cancel_all())
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()
