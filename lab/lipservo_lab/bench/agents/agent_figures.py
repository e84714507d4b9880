"""`lipservo bench agent`: whether a Pipecat agent remembers what a person heard, and nothing else.

One process: Pipecat's own pipeline and context aggregator, `PipecatFace`, the real server, and a
face on a virtual clock whose loudspeaker tells by the value of each sample which word was heard.
Half of the turns tell their text sentence by sentence, behind its sound; the others word by word,
each at its time within the sound, as services with word timestamps do.
"""

import asyncio
import itertools
import random
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from lipservo_lab.bench.agents.virtual_face import RATE_HZ, VirtualFace

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # its own imports warn of what it will drop one day
    from lipservo_client.pipecat_face import PipecatFace
    from loguru import logger
    from pipecat.frames.frames import (
        EndFrame,
        Frame,
        InterruptionFrame,
        LLMFullResponseEndFrame,
        LLMFullResponseStartFrame,
        TTSAudioRawFrame,
        TTSStartedFrame,
        TTSStoppedFrame,
        TTSTextFrame,
    )
    from pipecat.pipeline.pipeline import Pipeline
    from pipecat.pipeline.worker import PipelineWorker
    from pipecat.processors.aggregators.llm_context import LLMContext
    from pipecat.processors.aggregators.llm_response_universal import LLMContextAggregatorPair
    from pipecat.processors.frame_processor import FrameDirection, FrameProcessor
    from pipecat.utils.context.word_timestamp_tracker import WordTimestampTracker
    from pipecat.utils.text.base_text_aggregator import TextType
    from pipecat.workers.runner import WorkerRunner

_WORD_S: Final = 0.2
_CHUNK_S: Final = 0.1
#: A word that is told by its time may be in the context when it begins less than this later: the
#: time from a service's clock to the face is in it.
_SLACK_S: Final = 0.05
_AT_S: Final = "at_s"
#: The value of a word's samples is this and its number in the turn.
_FIRST_VALUE: Final = 1_000
#: A turn that takes longer hangs.
_PATIENCE_S: Final = 30.0
_N_WORD: Final = round(_WORD_S * RATE_HZ)


@dataclass(frozen=True, slots=True)
class Turn:
    """What an agent says. sentences: words in each. cut_s: of its sound, a person breaks in."""

    number: int
    sentences: tuple[int, ...]
    is_timed: bool
    cut_s: float | None

    def words(self) -> list[list[str]]:
        """The words of each sentence."""
        numbers = itertools.count()
        return [[f"t{self.number}w{next(numbers)}" for _ in range(n)] for n in self.sentences]


def turns(n_turns: int, n_cuts: int, seed: int = 0) -> list[Turn]:
    """Turns of one to four sentences of two to seven words; so many are cut off somewhere."""
    rng = random.Random(seed)
    cut = set(rng.sample(range(n_turns), n_cuts))
    given = []
    for number in range(n_turns):
        sentences = tuple(rng.randint(2, 7) for _ in range(rng.randint(1, 4)))
        cut_s = rng.uniform(0.0, _WORD_S * sum(sentences)) if number in cut else None
        given.append(Turn(number, sentences, bool(number % 2), cut_s))
    return given


def agent_figures(
    n_turns: int, n_cuts: int, progress: Callable[[int, int], None]
) -> dict[str, float]:
    """`context_errors`, `streams_refused`, `double_voice_s` of so many turns and barge-ins.

    A context error is a sentence or word that is in the agent's context and was not heard, or was
    heard whole and is not there. Sound that reaches the transport while the face speaks would be a
    second voice.
    """
    logger.disable("pipecat")
    with VirtualFace() as face:
        errors, transport_s = asyncio.run(_talk(face, turns(n_turns, n_cuts), progress))
        refused = face.server.status()["n_streams_refused"]
        assert isinstance(refused, int)
    return {
        "turns": n_turns,
        "barge_ins": n_cuts,
        "context_errors": errors,
        "streams_refused": refused,
        "double_voice_s": transport_s,
        "virtual_s": round(face.loudspeaker.position_s, 1),
    }


class _Service(FrameProcessor):
    """Times words as Pipecat's own TTS service does, and by its tracker."""

    def __init__(self) -> None:
        super().__init__()
        self._tracker = WordTimestampTracker()

    async def process_frame(self, frame: Frame, direction: FrameDirection) -> None:
        """Stamp it and hand it on."""
        await super().process_frame(frame, direction)
        tracker = self._tracker
        if isinstance(frame, TTSAudioRawFrame):
            tracker.start(self.get_clock().get_time())
        elif isinstance(frame, TTSTextFrame) and _AT_S in frame.metadata:
            frame.pts = tracker.last_pts = tracker.pts(frame.metadata[_AT_S])
        elif isinstance(frame, TTSStoppedFrame):
            frame.pts = tracker.last_pts
            tracker.reset()
        elif isinstance(frame, LLMFullResponseStartFrame):
            tracker.start_reply()
        elif isinstance(frame, LLMFullResponseEndFrame):
            frame.pts = tracker.reply_last_pts
        elif isinstance(frame, InterruptionFrame):
            tracker.reset()
            tracker.last_pts = 0
        await self.push_frame(frame, direction)


class _Listener(FrameProcessor):
    """Notes sound that would reach a transport, and interruptions that have passed it."""

    def __init__(self) -> None:
        super().__init__()
        self.sound_s = 0.0
        self.interrupted = asyncio.Event()

    async def process_frame(self, frame: Frame, direction: FrameDirection) -> None:
        """Note it and hand it on."""
        await super().process_frame(frame, direction)
        if isinstance(frame, TTSAudioRawFrame):
            self.sound_s += len(frame.audio) / (2 * frame.sample_rate)
        await self.push_frame(frame, direction)
        if isinstance(frame, InterruptionFrame):
            self.interrupted.set()


async def _talk(
    face: VirtualFace, given: list[Turn], progress: Callable[[int, int], None]
) -> tuple[int, float]:
    """Context errors, and sound that reached the transport."""
    context = LLMContext()
    transport, behind = _Listener(), _Listener()
    aggregator = LLMContextAggregatorPair(context).assistant()
    pipeline = Pipeline([_Service(), PipecatFace(face.url), transport, aggregator, behind])
    worker = PipelineWorker(pipeline, cancel_on_idle_timeout=False, enable_rtvi=False)
    began = asyncio.Event()

    @worker.event_handler("on_pipeline_started")  # type: ignore[untyped-decorator]
    async def _began(*_about: object) -> None:
        began.set()

    async def speak() -> int:
        await began.wait()
        errors = 0
        for turn in given:
            progress(turn.number, len(given))
            errors += await _errors_of(turn, face, worker, behind, context)
        await worker.queue_frame(EndFrame())
        return errors

    runner = WorkerRunner()
    await runner.add_workers(worker)
    errors, _ = await asyncio.gather(speak(), runner.run())
    return errors, transport.sound_s


async def _errors_of(
    turn: Turn, face: VirtualFace, worker: Any, behind: _Listener, context: LLMContext
) -> int:
    face.loudspeaker.heard.clear()
    behind.interrupted.clear()
    n_before = len(context.messages)
    await worker.queue_frames(_frames(turn))
    async with asyncio.timeout(_PATIENCE_S):
        if turn.cut_s is not None:
            await _heard(face, turn.cut_s)
            await worker.queue_frame(InterruptionFrame())
            await behind.interrupted.wait()
        while not face.playout.is_over or (
            turn.cut_s is None and len(context.messages) == n_before
        ):
            await asyncio.sleep(0.001)
    context_text = " ".join(str(each["content"]) for each in context.messages[n_before:])
    return _n_errors(turn, set(context_text.split()), face.loudspeaker.heard)


async def _heard(face: VirtualFace, cut_s: float) -> None:
    while sum(n for value, n in face.loudspeaker.heard.items() if value) < cut_s * RATE_HZ:
        await asyncio.sleep(0.0005)


def _frames(turn: Turn) -> list[Frame]:
    frames: list[Frame] = [LLMFullResponseStartFrame()]
    number = 0
    for n, words in enumerate(turn.words()):
        context_id = f"{turn.number}.{n}"
        frames.append(TTSStartedFrame(context_id=context_id))
        values = _FIRST_VALUE + number + np.arange(len(words))
        pcm = np.repeat(values, _N_WORD).astype("<i2").tobytes()
        size = 2 * round(_CHUNK_S * RATE_HZ)
        for first in range(0, len(pcm), size):
            frames.append(
                TTSAudioRawFrame(pcm[first : first + size], RATE_HZ, 1, context_id=context_id)
            )
        if turn.is_timed:
            for place, word in enumerate(words):
                text = TTSTextFrame(word, TextType.WORD, context_id=context_id)
                text.metadata[_AT_S] = place * _WORD_S
                frames.append(text)
        else:
            text = TTSTextFrame(" ".join(words), TextType.SENTENCE, context_id=context_id)
            frames.append(text)
        frames.append(TTSStoppedFrame(context_id=context_id))
        number += len(words)
    frames.append(LLMFullResponseEndFrame())
    return frames


def _n_errors(turn: Turn, spoken: set[str], heard: Counter[int]) -> int:
    """Count sentences, or timed words, that are in the context wrongly or missing there.

    heard: samples by value.
    """
    values = itertools.count(_FIRST_VALUE)
    errors = 0
    for sentence in turn.words():
        shares = [heard[next(values)] / _N_WORD for _ in sentence]
        units = [[word] for word in sentence] if turn.is_timed else [sentence]
        starts = range(len(units))
        for unit, start in zip(units, starts, strict=True):
            of_unit = [shares[start]] if turn.is_timed else shares
            is_there = all(word in spoken for word in unit)
            is_partly_there = any(word in spoken for word in unit)
            was_heard = all(share == 1.0 for share in of_unit)
            was_begun = any(share > 0.0 for share in of_unit)
            if turn.is_timed and start:
                before_s = (1.0 - shares[start - 1]) * _WORD_S
                was_begun = was_begun or before_s < _SLACK_S
            is_allowed = was_begun if turn.is_timed else was_heard
            errors += (was_heard and not is_there) or (is_partly_there and not is_allowed)
    return errors
