"""The recogniser goes on learning for some minutes, on a GPU where there is one.

    python benchmarks/train_ears.py arrays CORPORA ALIGNMENTS VOICES SOUNDS FOLDER
    python benchmarks/train_ears.py learn FOLDER SECONDS WEIGHTS.npz
    python benchmarks/train_ears.py mean SHARE LEARNED.npz MEAN.npz

CORPORA holds librispeech, speechocean762 and picovoice_commands; ALIGNMENTS is a file of their
alignments (`lipservo lines align-folder`) and of VOICES', the folder of synthetic voices
(`write_voice`); SOUNDS holds recordings without speech. `arrays` writes disturbed copies of a
quarter of the recordings each into FOLDER, until it is stopped or has made 400. `learn` beside it
begins as the shipped weights, learns from all copies that are there, and writes the running average
of its weights. `mean` is SHARE of what was learnt and the rest of the shipped weights. Scored and
validation talkers train nothing.
"""

import multiprocessing
import os
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from lipservo_lab.corpus.alignment_cache import AlignedUtterance, read_alignments
from lipservo_lab.corpus.transcribed import (
    TranscribedUtterance,
    read_speakers,
    read_transcribed,
)
from lipservo_lab.learning.recognition.augmentation import LabelledSamples, Surroundings
from lipservo_lab.learning.recognition.noise import read_found_sounds
from lipservo_lab.learning.recognition.training_data import (
    TrainingArray,
    TrainingPlan,
    as_array,
    disturbed_copy,
    draw_windows,
    read_labelled,
    surroundings,
)
from lipservo_lab.learning.recognition.weight_average import averaged
from lipservo_lab.worker_pool import worker_pool

from lipsync.recognition.alignment import LEAST_SCORE
from lipsync.recognition.features import FRAMES_PER_S
from lipsync.recognition.network import load_weights, save_weights

HERE = Path(__file__).parent
START = HERE.parent / "lipsync" / "models" / "recognizer.npz"
HELD = (
    "librispeech_scored",
    "speechocean762_scored",
    "speechocean762_scored_new",
    "picovoice_commands_scored",
    "validation",
)
CORPORA = ("librispeech", "speechocean762", "picovoice_commands")
PLAN = TrainingPlan(
    dilations=(1, 2, 4, 8, 1, 2, 4, 8, 16, 32), batch=64, window=500, peak_rate=2e-3,
    visible_weight=0.1, n_steps=12_000,
)  # fmt: skip
PARTS = 4
#: Processors left to what learns.
FOR_LEARNING = 4
#: Begin to learn when there are so many arrays.
ENOUGH = 16
#: 65 MB each with 8.8 h of recordings.
MOST_ARRAYS = 400
CLEAN: list[LabelledSamples] = []
AROUND: list[Surroundings] = []


def say(line: str) -> None:
    """Print a line with the time."""
    print(time.strftime("%H:%M:%S"), line, flush=True)


def read_one(job: tuple[TranscribedUtterance, AlignedUtterance]) -> LabelledSamples:
    """Return the labelled recording of an utterance and its alignment; for the pool."""
    return read_labelled(*job)


def arrays(given: Sequence[str]) -> None:
    """Write disturbed copies until stopped."""
    corpora, voices, sounds, folder = Path(given[0]), Path(given[2]), Path(given[3]), Path(given[4])
    folder.mkdir(parents=True, exist_ok=True)
    if any(folder.iterdir()):
        sys.exit(f"{folder}: holds something already; give an empty folder")
    alignments = read_alignments(Path(given[1]))
    held = {name for each in HELD for name in read_speakers(HERE / "speakers" / f"{each}.csv")}
    spoken = [u for corpus in CORPORA for u in read_transcribed(corpora / corpus)]
    spoken += [u for voice in sorted(voices.iterdir()) for u in read_transcribed(voice)]
    jobs = [
        (u, alignments[u.name])
        for u in spoken
        if u.speaker not in held and u.name in alignments and not alignments[u.name].error
        and (alignments[u.name].score is None or alignments[u.name].score >= LEAST_SCORE)
    ]  # fmt: skip
    fork, n_cores = multiprocessing.get_context("fork"), os.cpu_count() or 1
    with worker_pool(n_cores, fork) as pool:
        found_sounds = pool.submit(read_found_sounds, sounds)
        CLEAN[:] = pool.map(read_one, jobs, chunksize=16)
        AROUND[:] = [surroundings(CLEAN, found_sounds.result())]
    hours = sum(len(each.labels) for each in CLEAN) / (3600 * FRAMES_PER_S)
    say(f"{len(jobs)} utterances, {hours:.2f} h, {len({u.speaker for u, _ in jobs})} voices")
    with worker_pool(max(1, n_cores - FOR_LEARNING), fork) as pool:
        for _ in pool.map(partial(one_array, folder), range(MOST_ARRAYS)):
            pass


def one_array(folder: Path, number: int) -> None:
    """Write the array of a part of the recordings; the first of each part is lightly disturbed."""
    copy, part = divmod(number, PARTS)
    copies = disturbed_copy(CLEAN[part::PARTS], AROUND[0], copy, part)
    array = as_array(copies, load_weights(START).scale, PLAN.delays)
    unfinished = folder / f"{number}.unfinished.npy"
    np.save(folder / f"{number}.targets.npy", array.targets.astype(np.int8))
    np.save(unfinished, array.features)
    unfinished.rename(folder / f"{number}.features.npy")


class Growing:
    """The windows of each step, drawn from all arrays that `arrays` has written by then."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._arrays: dict[int, TrainingArray] = {}

    def look(self) -> list[TrainingArray]:
        """Return all arrays in the folder, those written since the last call among them."""
        for path in self._folder.glob("*.features.npy"):
            number = int(path.name.split(".")[0])
            if number not in self._arrays:
                targets = np.load(self._folder / f"{number}.targets.npy", mmap_mode="r")
                features = np.load(path, mmap_mode="r")
                self._arrays[number] = TrainingArray(features, targets)
        return list(self._arrays.values())

    def __getitem__(self, step: int) -> tuple[np.ndarray, np.ndarray]:
        """Return features (b, 40, n) and targets (b, n_heads, n) of a step."""
        if step % 50 < 10 or not self._arrays:
            self.look()
        rng = np.random.default_rng([0, step])
        light = [each for number, each in self._arrays.items() if number < PARTS]
        heavy = [each for number, each in self._arrays.items() if number >= PARTS]
        first = light[int(rng.integers(len(light)))] if light else heavy[0]
        return draw_windows([first, *heavy], PLAN, rng)


def learn(given: Sequence[str]) -> None:
    """Learn for so many seconds from now; the rate falls with the time that is left."""
    import torch
    from lipservo_lab.learning.recognition import network_training as training
    from lipservo_lab.learning.recognition.torch_network import exported, started_from

    folder, seconds, out = Path(given[0]), float(given[1]), Path(given[2])
    came = time.monotonic()
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    torch.set_num_threads(2)
    start = load_weights(START)
    while len(list(folder.glob("*.features.npy"))) < ENOUGH:
        if time.monotonic() - came > seconds:
            sys.exit(f"{folder}: no {ENOUGH} arrays in {seconds:.0f} s; start `arrays` beside it")
        time.sleep(0.1)
    windows = Growing(folder)
    network = started_from(start, windows.look(), PLAN).to(device)
    swa = torch.optim.swa_utils
    average = swa.AveragedModel(
        network, multi_avg_fn=swa.get_ema_multi_avg_fn(PLAN.averaging), use_buffers=True
    )
    optimizer = torch.optim.AdamW(network.parameters(), weight_decay=PLAN.weight_decay)
    loader = torch.utils.data.DataLoader(
        windows,
        batch_size=None,
        sampler=range(10**9),
        num_workers=6,
        pin_memory=device.type == "cuda",
    )
    began, shown, losses = time.monotonic(), 0.0, []
    total = came + seconds - began
    say(f"learning for {total:.0f} s")
    for step, (features, targets) in enumerate(loader):
        share = (time.monotonic() - began) / total
        if share >= 1.0:
            break
        batch = training.Batch(features.to(device), targets.to(device), None)
        rate = training.learning_rate(PLAN, round(share * PLAN.n_steps))
        losses.append(training.learn_from(batch, network, optimizer, PLAN, rate))
        average.update_parameters(network)
        if share - shown > 0.05:
            shown, mean = share, np.mean(losses)
            losses.clear()
            n_arrays = len(list(folder.glob("*.features.npy")))
            say(f"{share:.2f}: step {step}, loss {mean:.4f}, {n_arrays} arrays")
            save_weights(exported(average.module, start.scale, PLAN), out)
    save_weights(exported(average.module, start.scale, PLAN), out)
    say("done")


def mean(given: Sequence[str]) -> None:
    """Write the mean of what was learned and what it began as."""
    learned, began = load_weights(Path(given[1])), load_weights(START)
    save_weights(averaged(learned, began, 1.0 - float(given[0])), given[2])


if __name__ == "__main__":
    {"arrays": arrays, "learn": learn, "mean": mean}[sys.argv[1]](sys.argv[2:])
