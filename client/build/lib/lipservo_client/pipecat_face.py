"""A face as the voice of a Pipecat pipeline: it plays what the TTS service makes.

Needs the extra `pipecat`. docs/agents.md has the frames as a table.
"""

from asyncio import Task
from contextlib import suppress

import numpy as np
from pipecat.frames.frames import (
    BotStartedSpeakingFrame,
    BotStoppedSpeakingFrame,
    CancelFrame,
    EndFrame,
    Frame,
    InterruptionFrame,
    StartFrame,
    TTSAudioRawFrame,
    TTSStoppedFrame,
)
from pipecat.processors.frame_processor import FrameDirection, FrameProcessor

from lipservo_client.async_face import AsyncFace, AsyncSpeech
from lipservo_client.protocol import FaceError, Played


class PipecatFace(FrameProcessor):
    """Stands behind the TTS service, where the sound would go to the transport.

    last_played: what became of what was said when a person broke in last; None: nothing was said.
    """

    def __init__(self, url: str = "ws://127.0.0.1:8765", token: str | None = None) -> None:
        super().__init__()
        self._url = url
        self._token = token
        self._face: AsyncFace | None = None
        self._speech: AsyncSpeech | None = None
        self._unheard: list[AsyncSpeech] = []
        self._telling: Task[None] | None = None
        self.last_played: Played | None = None

    async def process_frame(self, frame: Frame, direction: FrameDirection) -> None:
        """Take the sound; hand on everything else."""
        await super().process_frame(frame, direction)
        try:
            if isinstance(frame, TTSAudioRawFrame) and self._face is not None:
                await self._say(self._face, frame)
                return
            if isinstance(frame, StartFrame):
                await self._connect()
            elif isinstance(frame, TTSStoppedFrame):
                await self._end()
            elif isinstance(frame, EndFrame):
                await self._end()
                await self._hear_out()
            elif isinstance(frame, (InterruptionFrame, CancelFrame)):
                await self._interrupt()
        except (FaceError, TimeoutError) as error:
            # Sound that comes after this goes to the transport.
            self._face = None
            await self.push_error(f"the face: {error}", exception=error)
        await self.push_frame(frame, direction)

    async def cleanup(self) -> None:
        """Hang up."""
        await super().cleanup()
        if self._telling is not None:
            await self.cancel_task(self._telling)
        face, self._face = self._face, None
        if face is not None:
            await face.__aexit__()

    async def _connect(self) -> None:
        face = AsyncFace(self._url, self._token)
        await face.__aenter__()
        self._face = face
        self._telling = self.create_task(self._tell(face))

    async def _say(self, face: AsyncFace, frame: TTSAudioRawFrame) -> None:
        if self._speech is None:
            self._unheard = [each for each in self._unheard if not each.is_over]
            self._speech = face.stream(frame.sample_rate)
            self._unheard.append(self._speech)
            await self._speech.__aenter__()
        samples = np.frombuffer(frame.audio, dtype="<i2")
        if frame.num_channels > 1:
            channels = samples.reshape(-1, frame.num_channels)
            samples = np.rint(channels.mean(axis=1)).astype("<i2")
        await self._speech.write(samples.tobytes())

    async def _end(self) -> None:
        speech, self._speech = self._speech, None
        if speech is not None:
            await speech.end()

    async def _hear_out(self) -> None:
        for speech in self._unheard:
            await speech.heard()

    async def _interrupt(self) -> None:
        self._speech = None
        if self._face is not None:
            self.last_played = await self._face.interrupt()

    async def _tell(self, face: AsyncFace) -> None:
        """The pipeline learns when the face is heard, as it would from an output transport."""
        speaking: set[str] = set()
        async for event in face.events():
            with suppress(KeyError):
                stream, was_speaking = event["stream"], bool(speaking)
                if event["type"] == "started":
                    speaking.add(stream)
                elif event["type"] in ("finished", "interrupted"):
                    speaking.discard(stream)
                if speaking and not was_speaking:
                    await self.broadcast_frame(BotStartedSpeakingFrame)
                elif was_speaking and not speaking:
                    await self.broadcast_frame(BotStoppedSpeakingFrame)
