"""`lipservo bench agent`: whether agents remember what a person heard, and nothing else.

One process: the framework's own code, our adapter, the real server, and a face on a virtual clock
whose loudspeaker tells by the value of each sample which word was heard. Half of the turns are cut
off; once the face restarts in the middle of one, and for one it is absent.
"""

import asyncio
import itertools
import random
from collections import Counter
from collections.abc import Awaitable, Callable
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from typing import Any, Final, Protocol

from lipservo_lab.bench.agents.remembered_words import (
    FIRST_VALUE,
    WORD_S,
    first_of_turn,
    wrongly_remembered,
)
from lipservo_lab.bench.agents.virtual_face import RATE_HZ, VirtualFace

#: A turn that takes longer hangs, or is mute.
PATIENCE_S: Final = 30.0
_TICK_S: Final = 0.0005
#: An adapter that has lost its face tries to reach it more often than this.
_RECONNECTS_S: Final = 6.0


@dataclass(frozen=True, slots=True)
class Turn:
    """What an agent says in one turn.

    sentences: the number of words in each. cut_s: a person interrupts after so much of the turn's
    sound; None: the turn is not interrupted.
    """

    number: int
    sentences: tuple[int, ...]
    cut_s: float | None

    @property
    def first(self) -> int:
        """The number of the turn's first word."""
        return first_of_turn(self.number)

    def words(self) -> list[list[str]]:
        """The words of each sentence."""
        numbers = itertools.count(100)  # of one length, as are their sounds
        return [[f"t{self.number}w{next(numbers)}" for _ in range(n)] for n in self.sentences]


def turns(n_turns: int, n_cuts: int, seed: int = 0) -> list[Turn]:
    """Draw turns of one to four sentences of two to seven words; `n_cuts` of them are cut off."""
    rng = random.Random(seed)
    cut_numbers = set(rng.sample(range(n_turns), n_cuts))
    drawn = []
    for number in range(n_turns):
        sentences = tuple(rng.randint(2, 7) for _ in range(rng.randint(1, 4)))
        cut_s = rng.uniform(0.0, WORD_S * sum(sentences)) if number in cut_numbers else None
        drawn.append(Turn(number, sentences, cut_s))
    return drawn


class Agent(Protocol):
    """An agent of a framework that speaks through a face.

    elsewhere: how many samples were played by another loudspeaker than the face's, by value.
    """

    elsewhere: Counter[int]

    async def say(self, turn: Turn, until_cut: Callable[[], Awaitable[None]] | None) -> str:
        """Say a turn; return the text that the agent remembers of it once it is over.

        until_cut: waits until a person interrupts; None: the turn is not interrupted.
        """


#: Makes an agent that speaks through the given face while the context lasts.
Speaks = Callable[[VirtualFace], AbstractAsyncContextManager[Agent]]


def agent_figures(
    speaks: Speaks, n_turns: int, n_cuts: int, progress: Callable[[int, int], None]
) -> dict[str, Any]:
    """Let an agent speak `n_turns`, `n_cuts` of them interrupted; return what went wrong, counted.

    unheard_words: remembered by the agent, though nothing of them was played; forgotten_words:
    played whole, but not remembered. double_voice_s: sound played twice or after its turn was over.
    mute_turns: nothing was played, though a face was there and the turn was not interrupted.
    progress: called with turns done and all turns.
    """
    with VirtualFace() as face:
        counted = asyncio.run(_Conversation(face).hold(speaks, turns(n_turns, n_cuts), progress))
        refused = face.server.status()["n_streams_refused"]
    about = {"turns": n_turns, "barge_ins": n_cuts, "streams_refused": refused}
    return {**about, **counted, "virtual_s": round(face.loudspeaker.position_s, 1)}


class _Conversation:
    """A conversation of turns one after the other, checked against what the loudspeaker played."""

    def __init__(self, face: VirtualFace) -> None:
        self._face = face

    async def hold(
        self, speaks: Speaks, given: list[Turn], progress: Callable[[int, int], None]
    ) -> dict[str, Any]:
        """Let an agent speak the turns; return the counts that `agent_figures` describes.

        During the turn after a third of them the face restarts; for that after two thirds it is
        absent.
        """
        unheard, forgotten, mute, heard_at_end = 0, 0, 0, []
        restarts_at, absent_at = len(given) // 3, 2 * len(given) // 3
        async with speaks(self._face) as agent:
            for turn in given:
                progress(turn.number, len(given))
                is_absent = turn.number == absent_at
                if is_absent:
                    await asyncio.to_thread(self._face.leave)
                until_cut = None if turn.cut_s is None or is_absent else self._cut_wait(turn, agent)
                restart = None
                if turn.number == restarts_at:
                    restart, until_cut = asyncio.create_task(self._restart(turn)), None
                try:
                    async with asyncio.timeout(PATIENCE_S):
                        remembered = await agent.say(turn, until_cut)
                except TimeoutError:
                    mute, remembered = mute + 1, ""
                if restart is not None:
                    await restart
                    await self._reconnected()
                heard = self._face.loudspeaker.heard + agent.elsewhere
                words = [word for sentence in turn.words() for word in sentence]
                n_wrong = wrongly_remembered(words, heard, remembered, RATE_HZ, turn.first)
                unheard, forgotten = unheard + n_wrong[0], forgotten + n_wrong[1]
                heard_at_end.append(_turn_samples(heard, turn))
                mute += heard_at_end[-1].total() == 0 and turn.cut_s is None and not is_absent
                if is_absent:
                    self._face.come_back()
                    await self._reconnected()
        heard = self._face.loudspeaker.heard + agent.elsewhere
        n_word = round(WORD_S * RATE_HZ)
        n_twice = sum(
            max(0, n - n_word) for turn in given for n in _turn_samples(heard, turn).values()
        )
        n_late = sum(
            (_turn_samples(heard, turn) - heard_in_turn).total()
            for turn, heard_in_turn in zip(given, heard_at_end, strict=True)
        )
        return {
            "unheard_words": unheard,
            "forgotten_words": forgotten,
            "double_voice_s": round((n_twice + n_late) / RATE_HZ, 3),
            "mute_turns": mute,
        }

    def _cut_wait(self, turn: Turn, agent: Agent) -> Callable[[], Awaitable[None]]:
        """Return a function that waits until `turn.cut_s` of the turn's sound has been played."""

        async def wait() -> None:
            sounds, cut_s = (self._face.loudspeaker.heard, agent.elsewhere), turn.cut_s or 0.0
            while sum(_turn_samples(each, turn).total() for each in sounds) < cut_s * RATE_HZ:
                await asyncio.sleep(_TICK_S)

        return wait

    async def _reconnected(self) -> None:
        """Wait until an agent is connected to the face again, at most `_RECONNECTS_S`."""
        until_s = asyncio.get_running_loop().time() + _RECONNECTS_S
        while asyncio.get_running_loop().time() < until_s:
            if self._face.server.status()["n_clients"]:
                return
            await asyncio.sleep(0.01)

    async def _restart(self, turn: Turn) -> None:
        """Restart the face once so much of the turn was played as its first word is long."""
        while _turn_samples(self._face.loudspeaker.heard, turn).total() < WORD_S * RATE_HZ:
            await asyncio.sleep(_TICK_S)
        await asyncio.to_thread(self._face.leave)
        self._face.come_back()


def _turn_samples(heard: Counter[int], turn: Turn) -> Counter[int]:
    """Return how many samples of a turn were played, by value. heard: counts of all values."""
    first = FIRST_VALUE + turn.first
    values = range(first, first + sum(turn.sentences))
    return Counter({value: heard[value] for value in values if heard[value]})
