"""An agent of OpenAI's Realtime API: the SDK's own events, and the example of this repository.

What the API remembers of an item is modelled as it documents it: its whole transcript; after a
truncation the words whose sound begins before it; after a deletion nothing.
"""

import base64
import importlib.util
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from openai.types import realtime

import lipservo
from lipservo_lab.bench.agents.agent_figures import Turn
from lipservo_lab.bench.agents.remembered_words import WORD_S, worded_pcm
from lipservo_lab.bench.agents.virtual_face import RATE_HZ, VirtualFace
from lipsync.errors import UserError

_CHUNK: Final = 2 * RATE_HZ // 10
_EXAMPLE: Final = Path("examples") / "openai_realtime.py"


class _OpenAiAgent:
    """An `Agent`: a `RealtimeVoice`, and what the API remembers by its answers."""

    def __init__(self, voice: Any) -> None:
        self._voice = voice
        self.elsewhere: Counter[int] = Counter()

    async def say(self, turn: Turn, until_cut: Callable[[], Awaitable[None]] | None) -> str:
        """Let the agent speak a turn as one item; return the words that the conversation keeps."""
        words = [word for sentence in turn.words() for word in sentence]
        answers = []
        for event in _server_events(turn, words):
            answers += await self._voice.hear(event)
        if until_cut is not None:
            await until_cut()
            speech_started = realtime.InputAudioBufferSpeechStartedEvent(
                type="input_audio_buffer.speech_started",
                event_id="s",
                item_id="u",
                audio_start_ms=9,
            )
            answers += await self._voice.hear(speech_started)
        else:
            answers += await self._voice.finish()
        # A truncation keeps the words that begin before its time, as the API documents it.
        n_kept = len(words)
        for answer in answers:
            end_ms = answer.get("audio_end_ms", 0)
            n_kept = min(n_kept, sum(1e3 * WORD_S * n < end_ms for n in range(len(words))))
        return " ".join(words[:n_kept])


@asynccontextmanager
async def openai_agent(face: VirtualFace) -> AsyncIterator[_OpenAiAgent]:
    """Yield an agent that speaks through the face."""
    async with lipservo.connect_async(face.url) as connection:
        yield _OpenAiAgent(_import_example().RealtimeVoice(connection))


def _import_example() -> ModuleType:
    """Import examples/openai_realtime.py of this checkout; raise UserError where it is missing."""
    path = Path(lipservo.__file__).parents[1] / _EXAMPLE
    spec = importlib.util.spec_from_file_location("openai_realtime", path)
    if not path.exists() or spec is None or spec.loader is None:
        raise UserError(f"{path} is not there: `bench agent` needs a checkout")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _server_events(turn: Turn, words: list[str]) -> list[Any]:
    """Return the server's events of a turn: transcript word by word, then sound in 0.1 s chunks."""
    item = {"item_id": f"turn{turn.number}", "response_id": "r", "output_index": 0}
    about: dict[str, Any] = {**item, "content_index": 0}
    pcm = worded_pcm(len(words), RATE_HZ, turn.first)
    return [
        *(
            realtime.ResponseAudioTranscriptDeltaEvent(
                type="response.output_audio_transcript.delta",
                event_id="t",
                delta=f"{word} ",
                **about,
            )
            for word in words
        ),
        *(
            realtime.ResponseAudioDeltaEvent(
                type="response.output_audio.delta",
                event_id="d",
                delta=base64.b64encode(pcm[first : first + _CHUNK]).decode(),
                **about,
            )
            for first in range(0, len(pcm), _CHUNK)
        ),
        realtime.ResponseAudioDoneEvent(type="response.output_audio.done", event_id="e", **about),
    ]
