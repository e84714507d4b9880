"""The figures of `lipservo bench replay`: how much faster than sound a file is replayed.

The figures of `lipservo bench synthesis`: how fast the street is, how often selection misses.
"""

import json
import math
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median

import numpy as np

from firmware_bridge.clock import ManualClock
from lipservo.commands.options import DEFAULT_FACE
from lipservo.runtime.face_runtime import run_face
from lipservo.runtime.run_request import RunRequest, Sound
from lipservo.runtime.sound import open_sound
from lipsync.animpho.selection import STRATEGIES
from lipsync.animpho.synthesizer import PublishedSynthesizer
from lipsync.animpho.units import AnimPhoUnits
from lipsync.audio.file import FileSource
from lipsync.audio.source import SilenceAfter
from lipsync.audio_block import BLOCK_S
from lipsync.phonemes import PhonemeEvent, PhonemeUpdate
from lipsync.recognition.recognizers import make_recognizer
from lipsync.recognition.streaming import RecognizerStream, SoundAhead

#: Each recording is replayed so often; the median counts, as machines are shared.
_REPLAYS = 3


def replay_speed(recordings: Sequence[Path]) -> float:
    """Sound seconds in a second, loading included: the slowest recording's median."""

    def speed(recording: Path) -> float:
        request = RunRequest(DEFAULT_FACE, Sound("file", str(recording)), quiet=True)
        with SilenceAfter(FileSource(recording)) as source:
            return run_face(request, source, ManualClock()).summary.speed

    return min(float(np.median([speed(r) for _ in range(_REPLAYS)])) for r in recordings)


def live_figures() -> dict[str, float]:
    """Start-up and memory of a whole `lipservo run`, in a process of its own."""
    command = [sys.executable, "-P", "-m", "lipservo", "run", "--json"]
    finished = subprocess.run(command, check=True, capture_output=True, text=True)
    summary = json.loads(finished.stdout)
    return {
        "start_to_first_command_s": summary["start_to_first_command_s"],
        "rss_mb": summary["rss_mb"],
    }


def synthesis_times_ms(
    units: AnimPhoUnits, sentences: Sequence[Sequence[PhonemeEvent]]
) -> dict[str, float]:
    """Selection and blending of one phoneme: percentiles over all phonemes of the sentences."""
    times_ms = []
    for sentence in sentences:
        synthesizer = PublishedSynthesizer(units)
        synthesizer.push(PhonemeUpdate(0.0, np.inf, np.inf, tuple(sentence)))
        for event in sentence:
            began_s = time.perf_counter()
            synthesizer.frame_at(event.start_s)
            times_ms.append((time.perf_counter() - began_s) * 1e3)
    p50, p95 = np.percentile(times_ms, [50, 95])
    return {"ms_per_phoneme_p50": float(p50), "ms_per_phoneme_p95": float(p95)}


def miss_rates(corpus_folder: Path) -> dict[str, float]:
    """Both published strategies on `random_test`, by a model that never saw those sentences."""
    from lipservo_lab.corpus.grid import read_grid
    from lipservo_lab.evaluation.motion.paper_tables import miss_rate
    from lipservo_lab.learning.motion.face_training import train

    corpus = read_grid(corpus_folder)
    held_out = set(json.loads((corpus_folder / "splits.json").read_text())["random_test"])
    model = train(corpus.keep({u.name for u in corpus.utterances} - held_out))
    sentences = [u.phones for u in corpus.keep(held_out).utterances]
    return {
        f"miss_rate_{name}": miss_rate(model.animphos, strategy, sentences)
        for name, strategy in STRATEGIES.items()
    }


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
