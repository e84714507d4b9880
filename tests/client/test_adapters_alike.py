"""One stream through Pipecat, LiveKit and Wyoming: what the face makes of it is the same."""

import asyncio
import contextlib
import gc
import logging
import warnings

import numpy as np
import pytest
from voice_agents.served_face import RATE_HZ, ServedFace, distinct, heard, tone

import lipservo
from lipservo.agents.listener import AgentSettings

# Their own imports warn of what they will drop one day.
with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    pytest.importorskip("pipecat", reason="make agents")
    pytest.importorskip("livekit.agents", reason="make agents")
    pytest.importorskip("wyoming", reason="make agents")
    from lipservo_client.livekit_face import LiveKitFace
    from lipservo_client.pipecat_face import PipecatFace
    from lipservo_client.wyoming_face import serve_wyoming
    from livekit import rtc
    from pipecat.frames.frames import (
        EndFrame,
        ErrorFrame,
        LLMFullResponseEndFrame,
        TTSAudioRawFrame,
        TTSStartedFrame,
        TTSStoppedFrame,
        TTSTextFrame,
    )
    from pipecat.pipeline.pipeline import Pipeline
    from pipecat.pipeline.worker import PipelineWorker
    from pipecat.processors.frame_processor import FrameProcessor
    from pipecat.utils.text.base_text_aggregator import TextType
    from pipecat.workers.runner import WorkerRunner
    from wyoming.audio import AudioChunk, AudioStart, AudioStop
    from wyoming.client import AsyncTcpClient

of_the_schema = pytest.mark.usefixtures("traffic_by_the_schema")
pytestmark = [pytest.mark.filterwarnings("ignore"), of_the_schema]

#: Samples of each piece, in turns: none of them a whole number of blocks of the face.
PIECES = (480, 1, 961, 333, 2_400)


@pytest.fixture(autouse=True)
def _collected():
    """Wyoming leaves closed connections to the garbage collector."""
    yield
    gc.collect()


def pieces(samples):
    first = number = 0
    while first < len(samples):
        n = PIECES[number % len(PIECES)]
        yield samples[first : first + n].tobytes()
        first, number = first + n, number + 1


class _Heard(FrameProcessor):
    """Behind the face: texts that were heard, and the end of each turn. Before it: its errors."""

    def __init__(self):
        super().__init__()
        self.texts, self.errors = [], []
        self.ended = asyncio.Event()

    async def process_frame(self, frame, direction):
        await super().process_frame(frame, direction)
        if isinstance(frame, TTSTextFrame):
            self.texts.append(frame.text)
        elif isinstance(frame, ErrorFrame):
            self.errors.append(frame.error)
        elif isinstance(frame, LLMFullResponseEndFrame):
            self.ended.set()
        await self.push_frame(frame, direction)


@contextlib.asynccontextmanager
async def pipecat_agent(url, _port):
    before, behind, began = _Heard(), _Heard(), asyncio.Event()
    pipeline = Pipeline([before, PipecatFace(url), behind])
    worker = PipelineWorker(pipeline, cancel_on_idle_timeout=False, enable_rtvi=False)
    worker.event_handler("on_pipeline_started")(lambda *_: began.set())

    async def say(samples):
        behind.ended.clear()
        sound = [TTSAudioRawFrame(piece, RATE_HZ, 1) for piece in pieces(samples)]
        text = TTSTextFrame("said", TextType.SENTENCE)
        ends = [TTSStoppedFrame(), LLMFullResponseEndFrame()]
        await worker.queue_frames([TTSStartedFrame(), *sound, text, *ends])
        await behind.ended.wait()
        told, before.errors, behind.texts = (before.errors, behind.texts), [], []
        errors, texts = told
        return bool(texts), errors

    runner = WorkerRunner(handle_sigint=False)
    await runner.add_workers(worker)
    running = asyncio.ensure_future(runner.run())
    await began.wait()
    yield say
    await worker.queue_frame(EndFrame())
    await running


@contextlib.asynccontextmanager
async def livekit_agent(url, _port):
    async with LiveKitFace(url) as output:

        async def say(samples):
            with told("lipservo_client.livekit_face") as lines:
                for piece in pieces(samples):
                    await output.capture_frame(rtc.AudioFrame(piece, RATE_HZ, 1, len(piece) // 2))
                output.flush()
                ended = await output.wait_for_playout()
            assert ended.playback_position == (0.0 if ended.interrupted else len(samples) / RATE_HZ)
            return not ended.interrupted, lines

        yield say


@contextlib.asynccontextmanager
async def wyoming_agent(url, port):
    serving = asyncio.ensure_future(serve_wyoming("127.0.0.1", port, url, None))
    client = AsyncTcpClient("127.0.0.1", port)
    while True:
        with contextlib.suppress(OSError):
            await client.connect()
            break
        await asyncio.sleep(0.005)

    async def say(samples):
        about = {"rate": RATE_HZ, "width": 2, "channels": 1}
        with told("lipservo_client.wyoming_face") as lines:
            await client.write_event(AudioStart(**about).event())
            for piece in pieces(samples):
                await client.write_event(AudioChunk(audio=piece, **about).event())
            await client.write_event(AudioStop().event())
            answer = await client.read_event()
        assert answer.type == ("error" if lines else "played")
        return not lines, lines

    try:
        yield say
        n_handlers = wyoming_handlers()
        await client.disconnect()
        while wyoming_handlers() == n_handlers:  # else it would never close its connection
            await asyncio.sleep(0.005)
    finally:
        serving.cancel()
        await asyncio.gather(serving, return_exceptions=True)


def wyoming_handlers():
    names = [getattr(task.get_coro(), "__qualname__", "") for task in asyncio.all_tasks()]
    return names.count("AsyncEventHandler.run")


@contextlib.contextmanager
def told(logger):
    """The lines that it logs meanwhile."""
    lines, handler = [], logging.Handler()
    handler.emit = lambda record: lines.append(record.getMessage())
    logging.getLogger(logger).addHandler(handler)
    try:
        yield lines
    finally:
        logging.getLogger(logger).removeHandler(handler)


AGENTS = {"pipecat": pipecat_agent, "livekit": livekit_agent, "wyoming": wyoming_agent}
kinds = pytest.mark.parametrize("kind", AGENTS)


@kinds
async def test_no_sample_of_a_stream_is_lost_or_doubled(served, kind, unused_port):
    turns = [distinct(duration_s, seed) for seed, duration_s in enumerate((1.0, 0.0312, 2.0))]
    async with AGENTS[kind](served.url, unused_port) as say:
        assert [await say(samples) for samples in turns] == [(True, [])] * 3
    assert np.array_equal(heard(served), np.concatenate(turns))


@kinds
async def test_two_agents_take_turns(served, kind, unused_ports):
    turns = [distinct(0.3, seed) for seed in range(6)]
    async with (
        AGENTS[kind](served.url, unused_ports[0]) as first,
        AGENTS[kind](served.url, unused_ports[1]) as second,
    ):
        says = zip([first, second] * 3, turns, strict=True)
        assert [await say(samples) for say, samples in says] == [(True, [])] * 6
    assert np.array_equal(heard(served), np.concatenate(turns))
    assert served.server.status()["n_streams_refused"] == 0


@kinds
async def test_while_another_client_speaks_a_turn_is_dropped_with_a_warning_and_the_next_is_heard(
    served, kind, unused_port
):
    samples = distinct(0.3, 1)
    async with AGENTS[kind](served.url, unused_port) as say:
        async with lipservo.connect_async(served.url) as other, other.stream() as speech:
            await speech.write(tone(0.1))
            is_heard, (warning,) = await say(samples)
            await speech.wait()
        after = await say(samples)

    assert not is_heard
    assert "another client is speaking" in warning
    assert after == (True, [])
    assert np.array_equal(heard(served)[-len(samples) :], samples)


@kinds
async def test_where_clients_wait_for_each_other_a_turn_is_heard_behind_the_others(
    kind, unused_port
):
    first, second = distinct(0.3, 1), distinct(0.3, 2)

    with ServedFace(AgentSettings(when_busy="queue")) as face:
        async with (
            AGENTS[kind](face.url, unused_port) as say,
            lipservo.connect_async(face.url) as other,
        ):
            async with other.stream() as speech:
                await speech.write(first)
                waiting = asyncio.ensure_future(say(second))
            assert await waiting == (True, [])
        assert np.array_equal(heard(face), np.concatenate([first, second]))


@kinds
async def test_while_the_face_says_a_text_of_its_own_a_turn_is_dropped_with_a_warning(
    kind, unused_port
):
    with ServedFace(has_voice=True) as face:
        async with (
            AGENTS[kind](face.url, unused_port) as say,
            lipservo.connect_async(face.url) as other,
        ):
            await other.say("a text of five seconds, to be sure of it as it is said.")
            is_heard, (warning,) = await say(distinct(0.3, 1))
            await other.interrupt()

    assert not is_heard
    assert "the face says something of its own" in warning
