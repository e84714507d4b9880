"""A face as the loudspeaker of a Wyoming satellite, as in Home Assistant: its `snd` service.

Sound only. Wyoming has no tokens: every client that reaches the port speaks through the face.
Needs the extra `wyoming`.
"""

import logging
from asyncio import StreamReader, StreamWriter
from functools import partial
from typing import Final

from wyoming.audio import AudioChunk, AudioChunkConverter, AudioFormat, AudioStart, AudioStop
from wyoming.event import Event
from wyoming.info import Attribution, Describe, Info, SndProgram
from wyoming.server import AsyncEventHandler, AsyncTcpServer
from wyoming.snd import Played

from lipservo_client.async_face import AsyncFace, AsyncSpeech
from lipservo_client.protocol import FaceError

_LOG: Final = logging.getLogger(__name__)
_ABOUT: Final = Attribution(name="lipservo", url="")
_FORMAT: Final = AudioFormat(rate=22_050, width=2, channels=1)


class _Handler(AsyncEventHandler):
    """A Wyoming client's connection: `audio-start`, `-chunk` and `-stop`, answered by `played`."""

    def __init__(
        self, url: str, token: str | None, reader: StreamReader, writer: StreamWriter
    ) -> None:
        super().__init__(reader, writer)
        self._face = AsyncFace(url, token)
        self._speech: AsyncSpeech | None = None
        self._is_entered = self._is_refused = False
        self._convert = AudioChunkConverter(width=2, channels=1)

    async def handle_event(self, event: Event) -> bool:
        """Handle an event; return False, which disconnects, if it cannot be read.

        Errors of the face are logged, once until the next `audio-start`; the sound is not played.
        """
        try:
            await self._handle(event)
        except FaceError as error:
            if not self._is_refused:
                _LOG.warning("not said: %s", error)
            self._speech, self._is_refused = None, True
            if AudioStop.is_type(event.type):
                await self.write_event(Played().event())
        except (KeyError, TypeError, ValueError) as error:
            _LOG.warning("an event of a client cannot be read: %s", error)
            return False
        return True

    async def disconnect(self) -> None:
        """Disconnect from the face, which cuts off unfinished speech."""
        await self._face.__aexit__()

    async def _handle(self, event: Event) -> None:
        if Describe.is_type(event.type):
            await self.write_event(_info().event())
        elif AudioStart.is_type(event.type):
            self._is_refused = False
        elif AudioChunk.is_type(event.type) and not self._is_refused:
            await self._say(self._convert.convert(AudioChunk.from_event(event)))
        elif AudioStop.is_type(event.type):
            speech, self._speech = self._speech, None
            if speech is not None:
                await speech.wait()
            await self.write_event(Played().event())

    async def _say(self, chunk: AudioChunk) -> None:
        if self._speech is None:
            if not self._is_entered:
                await self._face.__aenter__()
                self._is_entered = True
            speech = self._face.stream(chunk.rate)
            await speech.__aenter__()
            self._speech = speech
        await self._speech.write(chunk.audio)


async def serve_wyoming(host: str, port: int, url: str, token: str | None) -> None:
    """Serve Wyoming's `snd` at `host` and `port` until cancelled, or SIGTERM.

    url, token: of the face, as for `lipservo.connect`. Raises OSError if the address is in use.
    """
    await AsyncTcpServer(host, port).run(partial(_Handler, url, token))


def _info() -> Info:
    about = "Sound and lips of a robot face"
    program = SndProgram("lipservo", _ABOUT, True, about, None, snd_format=_FORMAT)
    return Info(snd=[program])
