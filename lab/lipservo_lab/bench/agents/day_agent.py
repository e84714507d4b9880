"""The agent of `lipservo bench day`, a process of its own: a Pipecat pipeline that takes turns.

`python -m lipservo_lab.bench.agents.day_agent URL TOKEN PERIOD_S`: every period it says a few
seconds of the bundled clip. A line of JSON on stdout for each turn that is over: `began_s` and
`ended_s` (monotonic), and `transport_s`, the sound that went elsewhere than to the face; and one
for each error that the face's adapter tells: `error_s`, `error`.
"""

import asyncio
import json
import sys
import time
import warnings
from importlib import resources
from typing import Final

import numpy as np
import soundfile

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # its own imports warn of what it will drop one day
    from lipservo_client.pipecat_face import PipecatFace
    from loguru import logger
    from pipecat.frames.frames import (
        ErrorFrame,
        Frame,
        LLMFullResponseEndFrame,
        LLMFullResponseStartFrame,
        TTSAudioRawFrame,
        TTSStartedFrame,
        TTSStoppedFrame,
    )
    from pipecat.pipeline.pipeline import Pipeline
    from pipecat.pipeline.worker import PipelineWorker
    from pipecat.processors.frame_processor import FrameDirection, FrameProcessor
    from pipecat.workers.runner import WorkerRunner

_TURN_S: Final = 4.0
_CHUNK_S: Final = 0.1
#: The end of a turn is waited for no longer: the next begins.
_PATIENCE_S: Final = 30.0


class _Transport(FrameProcessor):
    """Stands behind the face in the pipeline, where a loudspeaker's transport would be.

    sound_s: seconds of sound that the face let through to it. ended: set at the end of each turn.
    """

    def __init__(self) -> None:
        super().__init__()
        self.sound_s = 0.0
        self.ended = asyncio.Event()

    async def process_frame(self, frame: Frame, direction: FrameDirection) -> None:
        """Count a frame's sound, or note the end of a turn; pass the frame on."""
        await super().process_frame(frame, direction)
        if isinstance(frame, TTSAudioRawFrame):
            self.sound_s += len(frame.audio) / (2 * frame.sample_rate)
        elif isinstance(frame, LLMFullResponseEndFrame):
            self.ended.set()
        await self.push_frame(frame, direction)


def _turn_frames() -> list[list[Frame]]:
    """Return the bundled clip cut into turns of `_TURN_S`, each as a list of Pipecat frames."""
    with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip:
        samples, rate_hz = soundfile.read(clip, dtype="int16")
    size, chunk = round(_TURN_S * rate_hz), round(_CHUNK_S * rate_hz)
    turns = []
    for first in range(0, len(samples) - size + 1, size):
        piece = np.asarray(samples[first : first + size], dtype="<i2")
        sound = [
            TTSAudioRawFrame(piece[n : n + chunk].tobytes(), rate_hz, 1)
            for n in range(0, size, chunk)
        ]
        end_frames = [TTSStoppedFrame(), LLMFullResponseEndFrame()]
        turns.append([LLMFullResponseStartFrame(), TTSStartedFrame(), *sound, *end_frames])
    return turns


async def talk(url: str, token: str, period_s: float) -> None:
    """Run the agent at a face's WebSocket, a turn every `period_s`, until the process is killed."""
    transport = _Transport()
    pipeline = Pipeline([PipecatFace(url, token), transport])
    worker = PipelineWorker(pipeline, cancel_on_idle_timeout=False, enable_rtvi=False)
    began = asyncio.Event()

    @worker.event_handler("on_pipeline_started")  # type: ignore[untyped-decorator]
    async def _note_start(*_about: object) -> None:
        began.set()

    @worker.event_handler("on_pipeline_error")  # type: ignore[untyped-decorator]
    async def _print_error(_worker: object, frame: ErrorFrame) -> None:
        print(json.dumps({"error_s": time.monotonic(), "error": frame.error}), flush=True)  # noqa: T201 - for the bench

    async def speak() -> None:
        """Queue a turn every `period_s` and print each, when over, as a line of JSON; never return.

        `hung` is in the line of a turn that the transport did not report as ended in `_PATIENCE_S`.
        """
        await began.wait()
        number = 0
        while True:
            frames = _turn_frames()
            turn = {"began_s": time.monotonic()}
            transport.ended.clear()
            transport_s = transport.sound_s
            await worker.queue_frames(frames[number % len(frames)])
            try:
                async with asyncio.timeout(_PATIENCE_S):
                    await transport.ended.wait()
            except TimeoutError:
                turn["hung"] = 1.0
            turn["ended_s"] = time.monotonic()
            turn["transport_s"] = transport.sound_s - transport_s
            print(json.dumps(turn), flush=True)  # noqa: T201 - for the bench
            await asyncio.sleep(max(0.0, turn["began_s"] + period_s - time.monotonic()))
            number += 1

    runner = WorkerRunner()
    await runner.add_workers(worker)
    await asyncio.gather(speak(), runner.run())


if __name__ == "__main__":
    logger.remove()
    asyncio.run(talk(sys.argv[1], sys.argv[2], float(sys.argv[3])))
