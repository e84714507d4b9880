"""A LiveKit agent: an `AgentSession` that says recordings, and `LiveKitFace`."""

import warnings
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

from lipservo_lab.bench.agents.agent_figures import Turn
from lipservo_lab.bench.agents.remembered_words import WORD_S, worded_pcm
from lipservo_lab.bench.agents.virtual_face import RATE_HZ, VirtualFace

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # its own imports warn of what Python will drop one day
    from lipservo_client.livekit_face import LiveKitFace
    from livekit import rtc
    from livekit.agents import Agent, AgentSession
    from livekit.agents.types import USERDATA_TIMED_TRANSCRIPT, TimedString


class _LiveKitAgent:
    """An `Agent`: a session whose only output is the face."""

    def __init__(self, session: "AgentSession[Any]") -> None:
        self._session = session
        self.elsewhere: Counter[int] = Counter()

    async def say(self, turn: Turn, until_cut: Callable[[], Awaitable[None]] | None) -> str:
        """Let the session speak a turn; return the text that its history holds of the turn.

        Every second turn comes with the times of its words.
        """
        words = [word for sentence in turn.words() for word in sentence]
        n_before = len(self._session.history.items)

        async def recording() -> AsyncIterator[rtc.AudioFrame]:
            for frame in _turn_frames(words, turn.first, has_times=bool(turn.number % 2)):
                yield frame

        handle = self._session.say(" ".join(words), audio=recording())
        if until_cut is not None:
            await until_cut()
            handle.interrupt()
        await handle
        new_items = self._session.history.items[n_before:]
        return " ".join(getattr(item, "text_content", None) or "" for item in new_items)


@asynccontextmanager
async def livekit_agent(face: VirtualFace) -> AsyncIterator[_LiveKitAgent]:
    """Yield an agent that speaks through the face."""
    async with LiveKitFace(face.url) as output:
        session: AgentSession[Any] = AgentSession()
        session.output.audio = output
        await session.start(Agent(instructions="none"))
        yield _LiveKitAgent(session)
        await session.aclose()


def _turn_frames(words: list[str], first: int, *, has_times: bool) -> list[rtc.AudioFrame]:
    """Return the sound of words in frames of 20 ms; has_times: the first frame has their times."""
    pcm, size = worded_pcm(len(words), RATE_HZ, first), 2 * RATE_HZ // 50
    pieces = [pcm[n : n + size] for n in range(0, len(pcm), size)]
    frames = [rtc.AudioFrame(piece, RATE_HZ, 1, len(piece) // 2) for piece in pieces]
    if has_times:
        frames[0].userdata[USERDATA_TIMED_TRANSCRIPT] = [
            TimedString(f"{word} ", start_time=WORD_S * number) for number, word in enumerate(words)
        ]
    return frames
