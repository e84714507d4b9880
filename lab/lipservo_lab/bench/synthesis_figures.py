"""The figures of `lipservo bench synthesis`: how fast the street is, how often selection misses."""

import json
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from firmware_bridge.clock import ManualClock
from lipservo.commands.options import DEFAULT_FACE
from lipservo.street.run_face import run_face
from lipservo.street.run_request import RunRequest
from lipservo.street.sources import Sound
from lipsync.animpho.selection import STRATEGIES
from lipsync.animpho.synthesizer import PublishedSynthesizer
from lipsync.animpho.units import AnimPhoUnits
from lipsync.audio.file import FileSource
from lipsync.audio.silence import SilenceAfter
from lipsync.phonemes import PhonemeEvent, PhonemeUpdate

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
    command = [sys.executable, "-m", "lipservo", "run", "--json"]
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
    from lipservo_lab.evaluation.motion.miss_rates import miss_rate
    from lipservo_lab.learning.motion.face_training import train

    corpus = read_grid(corpus_folder)
    held_out = set(json.loads((corpus_folder / "splits.json").read_text())["random_test"])
    model = train(corpus.keep({u.name for u in corpus.utterances} - held_out))
    sentences = [u.phones for u in corpus.keep(held_out).utterances]
    return {
        f"miss_rate_{name}": miss_rate(model.animphos, strategy, sentences)
        for name, strategy in STRATEGIES.items()
    }
