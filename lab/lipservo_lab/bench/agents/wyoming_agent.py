"""A Wyoming satellite, as of Home Assistant, and `lipservo wyoming`'s service.

It remembers what the face answers: an announcement answered `played` whole, of one that was cut off
the words before the seconds that the answer names, of any other error nothing. No one can break
in by Wyoming: who does is another program at the face.
"""

import asyncio
import contextlib
import re
import socket
import warnings
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Final

from lipservo_lab.bench.agents.agent_figures import Turn
from lipservo_lab.bench.agents.remembered_words import WORD_S, worded_pcm
from lipservo_lab.bench.agents.virtual_face import RATE_HZ, VirtualFace
from lipsync.audio.playout_stream import PlayoutRequest

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # its own imports warn of what Python will drop one day
    from lipservo_client.wyoming_face import serve_wyoming
    from wyoming.audio import AudioChunk, AudioStart, AudioStop
    from wyoming.client import AsyncTcpClient
    from wyoming.error import Error
    from wyoming.snd import Played

_CUT_OFF: Final = re.compile(r"cut off after ([\d.]+) s")
_CHUNK: Final = 2 * RATE_HZ // 10


class _WyomingAgent:
    """An `Agent`: a satellite."""

    def __init__(self, face: VirtualFace, client: AsyncTcpClient) -> None:
        self._face, self._client = face, client
        self.elsewhere: Counter[int] = Counter()

    async def say(self, turn: Turn, until_cut: Callable[[], Awaitable[None]] | None) -> str:
        """Send a turn's sound to the satellite; return the words that it reports as played."""
        words = [word for sentence in turn.words() for word in sentence]
        pcm = worded_pcm(len(words), RATE_HZ, turn.first)
        about = {"rate": RATE_HZ, "width": 2, "channels": 1}
        await self._client.write_event(AudioStart(**about).event())
        for first in range(0, len(pcm), _CHUNK):
            chunk = AudioChunk(audio=pcm[first : first + _CHUNK], **about)
            await self._client.write_event(chunk.event())
        await self._client.write_event(AudioStop().event())
        if until_cut is not None:
            await until_cut()
            self._face.playout.requests.append(PlayoutRequest("interrupt"))
        answer = await self._client.read_event()
        if answer is None:
            return ""
        if Played.is_type(answer.type):
            return " ".join(words)
        found = _CUT_OFF.search(Error.from_event(answer).text)
        played_s = 0.0 if found is None else float(found.group(1))
        return " ".join(word for n, word in enumerate(words) if n * WORD_S < played_s - 1e-6)


@asynccontextmanager
async def wyoming_agent(face: VirtualFace) -> AsyncIterator[_WyomingAgent]:
    """Run a Wyoming server at the face, and yield an agent that speaks through it."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    serving = asyncio.ensure_future(serve_wyoming("127.0.0.1", port, face.url, None))
    try:
        client = AsyncTcpClient("127.0.0.1", port)
        while not serving.done():
            with contextlib.suppress(OSError):
                await client.connect()
                break
            await asyncio.sleep(0.005)
        yield _WyomingAgent(face, client)
        await client.disconnect()
    finally:
        serving.cancel()
        await asyncio.gather(serving, return_exceptions=True)
