"""The figures of `lipservo bench replay`: how much faster than sound a file is replayed."""

import math
import time
from pathlib import Path
from statistics import median

import numpy as np
import soundfile

from firmware_bridge.clock import ManualClock
from lipservo.commands.options import DEFAULT_FACE
from lipservo.street.motion_options import make_recognizer
from lipservo.street.run_face import run_face
from lipservo.street.run_request import RunRequest
from lipservo.street.sources import Sound, open_sound
from lipsync.audio.file import FileSource
from lipsync.audio.silence import SilenceAfter
from lipsync.audio_block import BLOCK_S
from lipsync.recognition.streaming import RecognizerStream, SoundAhead

#: Length of the file that is made of a shorter recording.
REPLAYED_S = 20.0


def repeated(recording: Path, path: Path, duration_s: float = REPLAYED_S) -> Path:
    """Write the recording over and over until `duration_s`, as WAV at its own rate."""
    samples, rate_hz = soundfile.read(recording, dtype="float32")
    soundfile.write(path, samples[np.arange(round(duration_s * rate_hz)) % len(samples)], rate_hz)
    return path


def replay_figures(recording: Path, n_times: int) -> dict[str, float]:
    """Sound seconds in a second, medians: of a replay, loading included; of the recogniser alone.

    The recogniser prepares the file ahead as in a replay, and gets it block by block as live; one
    after the other each time, so that what else the machine does slows both alike.
    """
    replays, ahead, by_blocks = [], [], []
    for _ in range(n_times):
        replays.append(_replay_speed(recording))
        by_blocks.append(_recognizer_speed(recording, is_ahead=False))
        ahead.append(_recognizer_speed(recording, is_ahead=True))
    return {
        "replay_speed": median(replays),
        "recognizer_speed_ahead": median(ahead),
        "recognizer_speed_block_by_block": median(by_blocks),
        "recognizer_speed_ratio": median(a / b for a, b in zip(ahead, by_blocks, strict=True)),
    }


def _replay_speed(recording: Path) -> float:
    request = RunRequest(DEFAULT_FACE, Sound("file", str(recording)), quiet=True)
    with open_sound(request.sound) as source:
        return run_face(request, source, ManualClock()).summary.speed


def _recognizer_speed(recording: Path, *, is_ahead: bool) -> float:
    recognizer = make_recognizer()
    stream = RecognizerStream(recognizer)
    with SilenceAfter(FileSource(recording)) as source:
        sound = SoundAhead(source, recognizer) if is_ahead else source
        began_s = time.perf_counter()
        for step in range(1, math.ceil(source.duration_s / BLOCK_S) + 1):
            stream.feed(sound.blocks(step * BLOCK_S))
        return source.duration_s / (time.perf_counter() - began_s)
