"""A Pipecat agent: its own pipeline and context aggregator, and `PipecatFace`.

Half of the turns tell their text sentence by sentence, behind its sound; the others word by word,
each at its time within the sound, as services with word timestamps do.
"""

import asyncio
import warnings
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Final

import numpy as np

from lipservo_lab.bench.agents.agent_figures import Turn
from lipservo_lab.bench.agents.remembered_words import WORD_S, worded_pcm
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

_CHUNK_S: Final = 0.1
_AT_S: Final = "at_s"
#: A turn is over for its context so long after its last sound at the latest.
_SETTLED_S: Final = 2.0
#: Without a face sound passes faster than it is heard; a transport says its text with it.
_PASSING_S: Final = 0.2


class _TimingTtsService(FrameProcessor):
    """Stands for a TTS service: dates words by Pipecat's own tracker, as such services do."""

    def __init__(self) -> None:
        super().__init__()
        self._tracker = WordTimestampTracker()

    async def process_frame(self, frame: Frame, direction: FrameDirection) -> None:
        """Give each frame the time stamp that a TTS service would, then pass it on."""
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
    """Counts samples that pass this place in the pipeline, by value, and notes interruptions."""

    def __init__(self) -> None:
        super().__init__()
        self.heard: Counter[int] = Counter()
        self.interrupted = asyncio.Event()

    async def process_frame(self, frame: Frame, direction: FrameDirection) -> None:
        """Count a frame's samples, or note an interruption; pass the frame on."""
        await super().process_frame(frame, direction)
        if isinstance(frame, TTSAudioRawFrame):
            self.heard.update(np.frombuffer(frame.audio, "<i2").tolist())
        await self.push_frame(frame, direction)
        if isinstance(frame, InterruptionFrame):
            self.interrupted.set()


class _PipecatAgent:
    """An `Agent`: a pipeline that runs."""

    def __init__(self, face: VirtualFace) -> None:
        self._face = face
        self._context = LLMContext()
        self._transport, self._behind = _Listener(), _Listener()
        aggregator = LLMContextAggregatorPair(self._context).assistant()
        pipeline = Pipeline(
            [_TimingTtsService(), PipecatFace(face.url), self._transport, aggregator, self._behind]
        )
        self.worker = PipelineWorker(pipeline, cancel_on_idle_timeout=False, enable_rtvi=False)
        self.elsewhere = self._transport.heard

    async def say(self, turn: Turn, until_cut: Callable[[], Awaitable[None]] | None) -> str:
        """Let the pipeline speak a turn; return the text that its context holds of the turn."""
        messages = self._context.messages
        self._behind.interrupted.clear()
        n_before, loop = len(messages), asyncio.get_running_loop()
        n_elsewhere = self.elsewhere.total()
        await self.worker.queue_frames(_turn_frames(turn))
        if until_cut is not None:
            await until_cut()
            # Without a face the sound has gone elsewhere at once; its text still has to follow.
            if self.elsewhere.total() > n_elsewhere:
                await asyncio.sleep(_PASSING_S)
            await self.worker.queue_frame(InterruptionFrame())
            await self._behind.interrupted.wait()
        # Wait until nothing has been played for `_SETTLED_S`, or the context has the turn's text.
        last_sound_s = loop.time()
        while loop.time() < last_sound_s + _SETTLED_S:
            await asyncio.sleep(0.001)
            if not self._face.playout.is_over:
                last_sound_s = loop.time()
            elif until_cut is not None or len(messages) > n_before:
                break
        return " ".join(str(each["content"]) for each in messages[n_before:])


@asynccontextmanager
async def pipecat_agent(face: VirtualFace) -> AsyncIterator[_PipecatAgent]:
    """Yield an agent that speaks through the face."""
    logger.disable("pipecat")
    agent, began = _PipecatAgent(face), asyncio.Event()

    @agent.worker.event_handler("on_pipeline_started")  # type: ignore[untyped-decorator]
    async def _note_start(*_about: object) -> None:
        began.set()

    runner = WorkerRunner()
    await runner.add_workers(agent.worker)
    running = asyncio.create_task(runner.run())
    await began.wait()
    yield agent
    await agent.worker.queue_frame(EndFrame())
    await running


def _turn_frames(turn: Turn) -> list[Frame]:
    """Return the frames of one turn: each sentence's sound, then its text.

    Turns of odd number carry a text frame a word, with its time in the sound (s) as metadata; the
    others one text frame a sentence.
    """
    frames: list[Frame] = [LLMFullResponseStartFrame()]
    first_word = turn.first
    for n, words in enumerate(turn.words()):
        context_id = f"{turn.number}.{n}"
        frames.append(TTSStartedFrame(context_id=context_id))
        pcm = worded_pcm(len(words), RATE_HZ, first_word)
        size = 2 * round(_CHUNK_S * RATE_HZ)
        for first in range(0, len(pcm), size):
            frames.append(
                TTSAudioRawFrame(pcm[first : first + size], RATE_HZ, 1, context_id=context_id)
            )
        if turn.number % 2:
            for position, word in enumerate(words):
                text = TTSTextFrame(word, TextType.WORD, context_id=context_id)
                text.metadata[_AT_S] = position * WORD_S
                frames.append(text)
        else:
            text = TTSTextFrame(" ".join(words), TextType.SENTENCE, context_id=context_id)
            frames.append(text)
        frames.append(TTSStoppedFrame(context_id=context_id))
        first_word += len(words)
    frames.append(LLMFullResponseEndFrame())
    return frames
