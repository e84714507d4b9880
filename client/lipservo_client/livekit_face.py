"""A face as the audio output of a LiveKit agent: `session.output.audio = face`.

Needs the extra `livekit`.
"""

import asyncio
import logging
import time
from collections.abc import Coroutine
from contextlib import suppress
from typing import Any, Final, Self

from livekit import rtc
from livekit.agents.types import NOT_GIVEN, USERDATA_TIMED_TRANSCRIPT
from livekit.agents.utils import is_given
from livekit.agents.voice.io import AudioOutput, AudioOutputCapabilities

from lipservo_client.async_face import AsyncFace, AsyncSpeech
from lipservo_client.protocol import FaceError, SpeechUnits, mono_pcm

_LOG: Final = logging.getLogger(__name__)


class LiveKitFace(AudioOutput):
    """An audio output that plays an `AgentSession`'s speech on a face; it can pause.

    It reports to the session how much was played. Enter the face before the session starts. While
    no face answers, or another client speaks through it, segments end at once as interrupted, with
    nothing played, and a warning is logged; a face that comes back is used from the next segment
    on.
    """

    def __init__(self, url: str = "ws://127.0.0.1:8765", token: str | None = None) -> None:
        super().__init__(label="lipservo", capabilities=AudioOutputCapabilities(pause=True))
        self._face = AsyncFace(url, token)
        self._speech: AsyncSpeech | None = None
        # Nothing more of the segment is wanted, until it is flushed.
        self._is_cut = False
        self._is_paused = False
        self._working: set[asyncio.Task[None]] = set()
        self._last: asyncio.Task[None] | None = None

    async def __aenter__(self) -> Self:
        """Connect to the face; go on trying in the background if no face answers."""
        try:
            await self._face.__aenter__()
        except FaceError:
            self._face.keep_trying()
        self._begin(self._follow())
        return self

    async def __aexit__(self, *exc: object) -> None:
        """Disconnect; segments that are not over end as interrupted."""
        await self._face.__aexit__()
        for task in self._working:
            task.cancel()
        await asyncio.gather(*self._working, return_exceptions=True)

    async def capture_frame(self, frame: rtc.AudioFrame) -> None:
        """Send a frame of sound to the face; wait while 30 s are unplayed."""
        await super().capture_frame(frame)
        if self._is_cut:
            return
        try:
            speech = self._speech
            if speech is None:
                if self._last is not None:
                    await asyncio.wait([self._last])
                speech = self._face.stream(frame.sample_rate)
                await speech.__aenter__()
                self._speech = speech
                self._begin(self._tell_end(speech))
                if self._is_paused:
                    await self._face.pause()
            for units in _frame_units(frame):
                await speech.tell(units)
            self._is_cut = not await speech.write(mono_pcm(frame.data, frame.num_channels))
        except FaceError as error:
            _LOG.warning("not said: %s", error)
            self._is_cut = True
            if self._speech is None:  # it never began: nothing follows its end
                self.on_playback_finished(playback_position=0.0, interrupted=True)

    def flush(self) -> None:
        """Mark the current segment of the agent's speech as complete; it is played to its end."""
        super().flush()
        speech, self._speech, self._is_cut = self._speech, None, False
        if speech is not None:
            self._then(speech.end())

    def clear_buffer(self) -> None:
        """Interrupt the face at once; drop the rest of the agent's current segment of speech."""
        self._is_cut = self._is_cut or self._speech is not None
        if self._face.is_connected:
            self._then(self._face.interrupt())

    def pause(self) -> None:
        """Silence the face now; unplayed speech is kept, up to a minute, until `resume`."""
        super().pause()
        self._is_paused = True
        if self._is_saying:
            self._then(self._face.pause())

    def resume(self) -> None:
        """Resume speech that `pause` silenced."""
        super().resume()
        self._is_paused = False
        if self._is_saying:
            self._then(self._face.resume())

    @property
    def _is_saying(self) -> bool:
        return self._face.is_connected and self._pending_playback_count > 0

    async def _tell_end(self, speech: AsyncSpeech) -> None:
        with suppress(FaceError):
            await speech.heard()
        played_s, is_whole = speech.n_played / speech.rate_hz, speech.was_heard
        self.on_playback_finished(playback_position=played_s, interrupted=not is_whole)

    async def _follow(self) -> None:
        async for event in self._face.events():
            if event["type"] == "started":
                self.on_playback_started(created_at=time.time())

    def _begin(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        task = asyncio.get_running_loop().create_task(work)
        self._working.add(task)
        task.add_done_callback(self._working.discard)
        return task

    def _then(self, work: Coroutine[Any, Any, object]) -> None:
        """Run `work` after that of the call before, so that an end precedes an interruption."""
        before = self._last

        async def done() -> None:
            if before is not None:
                await asyncio.wait([before])
            with suppress(FaceError):
                await work

        self._last = self._begin(done())


def _frame_units(frame: rtc.AudioFrame) -> list[SpeechUnits]:
    """Return the words, with times, or the texts that the synthesiser sent with a frame's sound."""
    units: list[SpeechUnits] = []
    for word in frame.userdata.get(USERDATA_TIMED_TRANSCRIPT, ()):
        if not word.strip():
            continue
        start_s = getattr(word, "start_time", NOT_GIVEN)
        if is_given(start_s):
            start = max(0, round(start_s * frame.sample_rate))
            units.append(("words", [(str(word).strip(), start)]))
        else:
            units.append(str(word))
    return units
