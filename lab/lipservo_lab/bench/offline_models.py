"""What the methods that hear a whole line need, of the sentences that taught each face model.

What an offline model of a whole folder costs: time and memory of a process of its own.
"""

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from lipservo_lab.baselines.context_visemes import ContextVisemes, recorded_visemes
from lipservo_lab.bench.motion_figures import BenchError
from lipservo_lab.corpus.utterance import Corpus
from lipservo_lab.evaluation.motion.offline_methods import OfflineModels, RecordedVisemes
from lipservo_lab.learning.motion.trained_model import TrainedModel, save_model
from lipservo_lab.learning.offline.offline_training import train_offline
from lipsync.errors import check_extra
from lipsync.offline.offline_model import OfflineModel
from lipsync.offline.offline_model_file import load_offline_model


def models_of(sentences: Corpus, purpose: str) -> OfflineModels:
    """Return a source of offline models that trains one for each face model that asks for one.

    It trains on the sentences of `sentences` that trained the face model. The shipped face model,
    and one of whose sentences none is in `sentences`, get the shipped offline model; raises
    OfflineModelError where that does not fit. Raises MissingExtraError, which names `purpose`.
    """
    check_extra("dtaidistance", purpose)

    def train(model: TrainedModel) -> OfflineModel:
        trained_on, shipped = _training_corpus(sentences, model), load_offline_model()
        if trained_on.utterances and shipped.face_checksum != model.checksum:
            return train_offline(trained_on, model)
        shipped.check_face(model, "the shipped offline model")
        return shipped

    return OfflineModels(train)


def visemes_of(sentences: Corpus) -> RecordedVisemes:
    """Return a source of recorded phones, with the face model's coefficients of each frame.

    The phones are of the sentences of `sentences` that trained the face model.
    """

    def gather(model: TrainedModel) -> ContextVisemes:
        utterances = _training_corpus(sentences, model).utterances
        return recorded_visemes(utterances, [model.coefficients(u.markers_mm) for u in utterances])

    return RecordedVisemes(gather)


def _training_corpus(sentences: Corpus, model: TrainedModel) -> Corpus:
    """Return the labelled sentences of a corpus that trained a face model."""
    return sentences.labelled().keep(set(model.training_sentences))


#: Runs a command and prints its peak resident memory, as the system counts it, and its processor
#: time. A process inherits the peak of whoever started it, so a small one must start it.
_MEASURE = """
import json, resource, subprocess, sys
status = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL).returncode
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(json.dumps([used.ru_maxrss, used.ru_utime + used.ru_stime]))
sys.exit(status)
"""
_BYTES_OF_PEAK = 1 if sys.platform == "darwin" else 1024


@dataclass(frozen=True, slots=True)
class Cost:
    """What a command costs: build_s: wall-clock time; build_processor_s: of all its threads.

    build_mb: peak resident memory, 10^6 bytes.
    """

    build_s: float
    build_processor_s: float
    build_mb: float


def building_cost(folder: Path, model: TrainedModel, *, skip_bad: bool) -> Cost:
    """Run `lipservo learn offline` on a folder for a face model; return its time and memory.

    Reading the sentences and recognising their phonemes are included. skip_bad: leave out sentences
    that cannot be read. Raises BenchError, with the last line of its errors, if the command fails.
    """
    with tempfile.TemporaryDirectory() as temporary:
        face, output = Path(temporary) / "face.npz", Path(temporary) / "offline.npz"
        save_model(model, face)
        train = [sys.executable, "-P", "-m", "lipservo", "learn", "offline", str(folder), "--quiet"]
        train += ["--model", str(face), "--output", str(output)]
        return cost_of([*train, "--skip-bad"] if skip_bad else train)


def cost_of(command: Sequence[str]) -> Cost:
    """Run a command in a process of its own; return what it costs.

    Raises BenchError with the last line of standard error if the command fails.
    """
    began_s = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-I", "-S", "-c", _MEASURE, *command],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    elapsed_s = time.perf_counter() - began_s
    if done.returncode:
        lines = done.stderr.strip().splitlines()
        raise BenchError(lines[-1] if lines else f"{command[0]} ended with {done.returncode}")
    peak, processor_s = json.loads(done.stdout)
    return Cost(elapsed_s, processor_s, peak * _BYTES_OF_PEAK / 1e6)
