"""A face as the loudspeaker of a Wyoming satellite, as Home Assistant has them: its `snd` service.

Sound only. Wyoming knows no token: whoever reaches the port speaks through the face. Needs the
extra `wyoming`.
"""

import asyncio
import logging
from contextlib import suppress
from functools import partial
from typing import Final

from wyoming.audio import AudioChunk, AudioChunkConverter, AudioStart, AudioStop
from wyoming.event import Event
from wyoming.info import Attribution, Describe, Info, SndProgram
from wyoming.server import AsyncEventHandler, AsyncTcpServer
from wyoming.snd import Played

from lipservo_client.async_face import AsyncFace, AsyncSpeech
from lipservo_client.protocol import FaceError

_LOG: Final = logging.getLogger(__name__)
_ABOUT: Final = Attribution(name="lipservo", url="https://github.com/rhasspy/wyoming")


class _Handler(AsyncEventHandler):
    """One client: `audio-start`, `audio-chunk` and `audio-stop`, answered by `played`."""

    def __init__(
        self, face: AsyncFace, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        super().__init__(reader, writer)
        self._face = face
        self._speech: AsyncSpeech | None = None
        self._convert = AudioChunkConverter(width=2, channels=1)

    async def handle_event(self, event: Event) -> bool:
        """Do what it asks for; a face that refuses is logged, and the sound is not heard."""
        if Describe.is_type(event.type):
            await self.write_event(_info().event())
        elif AudioStart.is_type(event.type):
            await self._leave()
        elif AudioChunk.is_type(event.type):
            chunk = self._convert.convert(AudioChunk.from_event(event))
            with suppress(FaceError):
                await self._say(chunk)
        elif AudioStop.is_type(event.type):
            await self._end()
            await self.write_event(Played().event())
        return True

    async def disconnect(self) -> None:
        """The client has gone: in the middle of a word, silence."""
        await self._leave()

    async def _say(self, chunk: AudioChunk) -> None:
        if self._speech is None:
            speech = self._face.stream(chunk.rate)
            try:
                await speech.__aenter__()
            except FaceError as error:
                _LOG.warning("not said: %s", error)
                raise
            self._speech = speech
        await self._speech.write(chunk.audio)

    async def _end(self) -> None:
        speech, self._speech = self._speech, None
        if speech is not None:
            try:
                await speech.wait()
            except FaceError as error:
                _LOG.warning("not said to its end: %s", error)

    async def _leave(self) -> None:
        speech, self._speech = self._speech, None
        if speech is not None and not speech.is_over:
            with suppress(FaceError):
                await self._face.interrupt()


class WyomingFace:
    """Serves `snd` at an address while `run` runs."""

    def __init__(self, host: str, port: int, url: str, token: str | None) -> None:
        """url, token: of the face, as for `lipservo.connect`."""
        self._server = AsyncTcpServer(host, port)
        self._url = url
        self._token = token

    async def run(self) -> None:
        """Serve until cancelled. Raises FaceError at first, and OSError for the address."""
        async with AsyncFace(self._url, self._token) as face:
            await self._server.run(partial(_Handler, face))


def _info() -> Info:
    program = SndProgram(
        name="lipservo",
        attribution=_ABOUT,
        installed=True,
        description="Sound and lips of a robot face",
        version=None,
        snd_format=None,
    )
    return Info(snd=[program])
