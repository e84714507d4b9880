"""A face as the loudspeaker of a Wyoming satellite, as in Home Assistant: its `snd` service.

Sound only. Wyoming has no tokens: every client that reaches the port speaks through the face.
Needs the extra `wyoming`.
"""

import asyncio
import logging
from asyncio import StreamReader, StreamWriter
from functools import partial
from typing import Final

from wyoming.audio import AudioChunk, AudioChunkConverter, AudioFormat, AudioStart, AudioStop
from wyoming.error import Error
from wyoming.event import Event
from wyoming.info import Attribution, Describe, Info, SndProgram
from wyoming.server import AsyncEventHandler, AsyncTcpServer
from wyoming.snd import Played

from lipservo_client.async_face import AsyncFace, AsyncSpeech
from lipservo_client.protocol import FaceError

_LOG: Final = logging.getLogger(__name__)
_ABOUT: Final = Attribution(name="lipservo", url="")
_FORMAT: Final = AudioFormat(rate=22_050, width=2, channels=1)
#: A satellite that sends nothing for so long within an announcement has ended it.
_SILENT_S: Final = 5.0


class _Handler(AsyncEventHandler):
    """A Wyoming client's connection: `audio-start`, `-chunk` and `-stop` are an announcement.

    An announcement is answered by `played` once all of it was heard, else by `error`. turn: held by
    the connection whose announcement is spoken; the others wait, and read no further.
    """

    def __init__(
        self,
        url: str,
        token: str | None,
        turn: asyncio.Lock,
        reader: StreamReader,
        writer: StreamWriter,
    ) -> None:
        """Serve one client, which has connected. url, token: of the face; turn: as of the class."""
        super().__init__(reader, writer)
        self._face = AsyncFace(url, token)
        self._turn = turn
        self._has_turn = self._is_entered = self._is_announcing = False
        self._speech: AsyncSpeech | None = None
        self._error: FaceError | None = None
        self._convert = AudioChunkConverter(width=2, channels=1)
        self._silence_timer: asyncio.TimerHandle | None = None
        self._ending: asyncio.Task[None] | None = None

    async def handle_event(self, event: Event) -> bool:
        """Handle an event; return False, which disconnects, if it cannot be read."""
        await self._end_silence()
        try:
            await self._dispatch(event)
        except (KeyError, TypeError, ValueError) as error:
            _LOG.warning("an event of a client cannot be read: %s", error)
            return False
        if self._is_announcing:
            self._silence_timer = asyncio.get_running_loop().call_later(_SILENT_S, self._end_silent)
        return True

    async def disconnect(self) -> None:
        """Disconnect from the face, which cuts off unfinished speech; let the next client speak."""
        try:
            await self._face.__aexit__()
            await self._end_silence()
        finally:
            self._release_turn()
            self.writer.close()

    def _end_silent(self) -> None:
        # In a task of its own: the connection may be reading an event whose rest never comes.
        self._ending = asyncio.get_running_loop().create_task(self._end_announcement())

    async def _end_silence(self) -> None:
        """Cancel the silence timer; wait until an announcement that it has ended is answered."""
        if self._silence_timer is not None:
            self._silence_timer.cancel()
        if self._ending is not None:
            await asyncio.gather(self._ending, return_exceptions=True)

    async def _dispatch(self, event: Event) -> None:
        """Answer `describe`, or begin, play or end an announcement; other events are ignored."""
        if Describe.is_type(event.type):
            await self.write_event(_service_info().event())
        elif AudioStart.is_type(event.type):
            await self._end_announcement()
            self._is_announcing = True
        elif AudioChunk.is_type(event.type):
            await self._send_sound(self._convert.convert(AudioChunk.from_event(event)))
        elif AudioStop.is_type(event.type):
            await self._end_announcement()

    async def _send_sound(self, chunk: AudioChunk) -> None:
        """Send a chunk of mono 16-bit sound to the face; store the first error for the end."""
        self._is_announcing = True
        if self._error is not None:
            return
        try:
            speech = self._speech or await self._start_stream(chunk.rate)
            await speech.write(chunk.audio)
        except FaceError as error:
            self._error = error

    async def _start_stream(self, rate_hz: int) -> AsyncSpeech:
        """Wait for this connection's turn, start a stream, and return it. Raises FaceError."""
        await self._turn.acquire()
        self._has_turn = True
        await (self._face.try_now() if self._is_entered else self._face.__aenter__())
        self._is_entered = True
        speech = self._face.stream(rate_hz)
        await speech.__aenter__()
        self._speech = speech
        return speech

    async def _end_announcement(self) -> None:
        """End the announcement that is open, and answer it once it was heard or cannot be."""
        if not self._is_announcing:
            return
        speech, self._speech = self._speech, None
        error, self._error, self._is_announcing = self._error, None, False
        try:
            if error is None and speech is not None and not (await speech.wait()).finished:
                error = FaceError("interrupted", "the face was silenced")
        except FaceError as lost:
            error = lost
        if error is not None and speech is not None and speech.n_played:
            cut_off = f"{error}: cut off after {speech.n_played / speech.rate_hz:.1f} s"
            error = FaceError(error.code, cut_off)
        self._release_turn()
        if error is None:
            await self.write_event(Played().event())
        else:
            _LOG.warning("not said: %s", error)
            await self.write_event(Error(str(error), error.code).event())

    def _release_turn(self) -> None:
        if self._has_turn:
            self._has_turn = False
            self._turn.release()


async def serve_wyoming(host: str, port: int, url: str, token: str | None) -> None:
    """Serve Wyoming's `snd` at `host` and `port` until cancelled, or SIGTERM.

    url, token: of the face, as for `lipservo.connect`. Raises OSError if the address is in use.
    """
    await AsyncTcpServer(host, port).run(partial(_Handler, url, token, asyncio.Lock()))


def _service_info() -> Info:
    about = "Sound and lips of a robot face"
    return Info(snd=[SndProgram("lipservo", _ABOUT, True, about, None, snd_format=_FORMAT)])
