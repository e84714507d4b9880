"""How much faster than sound a file is replayed, and how often selection misses.

Of `lipservo bench replay` and `lipservo bench synthesis`.
"""

import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import median

from firmware_bridge.clock import ManualClock
from lipservo.commands.options import DEFAULT_FACE
from lipservo.runtime.face_runtime import run_face
from lipservo.runtime.run_request import RunRequest, Sound
from lipservo.runtime.sound import open_sound
from lipsync.animpho.selection import STRATEGIES


def replay_speed(recordings: Sequence[Path], n_times: int = 3) -> float:
    """Return seconds of sound that are replayed in a second, loading included.

    Each recording is replayed `n_times`; the result is the least of the recordings' medians.
    """

    def replay_once(recording: Path) -> float:
        request = RunRequest(DEFAULT_FACE, Sound("file", str(recording)), quiet=True)
        with open_sound(request.sound) as source:
            return run_face(request, source, ManualClock()).summary.speed

    return min(median(replay_once(each) for _ in range(n_times)) for each in recordings)


def live_figures() -> dict[str, float]:
    """Return start-up time, s, and resident memory, MB, of a `lipservo run` in its own process."""
    command = [sys.executable, "-P", "-m", "lipservo", "run", "--json"]
    finished = subprocess.run(command, check=True, capture_output=True, text=True)
    summary = json.loads(finished.stdout)
    return {
        "start_to_first_command_s": summary["start_to_first_command_s"],
        "rss_mb": summary["rss_mb"],
    }


def miss_rates(corpus_folder: Path) -> dict[str, float]:
    """Return the miss rate (see `miss_rate`) of both strategies of Wei and Deng, by figure name.

    Scored are the sentences of `random_test` in the folder's `splits.json`; the model is trained on
    all others.
    """
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
