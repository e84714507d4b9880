"""The recogniser goes on learning for some minutes, on a GPU where there is one.

    python benchmarks/train_ears.py arrays CORPORA ALIGNMENTS VOICES SOUNDS FOLDER
    python benchmarks/train_ears.py teach FOLDER SECONDS TEACHER.npz [FROM.npz]
    python benchmarks/train_ears.py relabel FOLDER
    python benchmarks/train_ears.py learn FOLDER SECONDS WEIGHTS.npz CHANNELS labels|teacher
    python benchmarks/train_ears.py mean SHARE LEARNED.npz MEAN.npz

CORPORA holds librispeech, speechocean762 and picovoice_commands; ALIGNMENTS is a file of their
alignments (`lipservo lines align-folder`) and of VOICES', the folder of synthetic voices
(`write_voice`); SOUNDS holds recordings without speech. `arrays` writes disturbed copies of a
quarter of the recordings each into FOLDER, until it is stopped or has made 600. Beside it `teach`
trains a larger network that hears .6 s ahead, anew or going on from weights, and writes what it
says of each frame of the clean recordings. `relabel` lays the labels anew by that, for a second
round of `teach`. `learn` begins as the shipped weights, grown to CHANNELS, learns from all copies
that are there, by labels alone or by the teacher's posteriors too, and writes the running average
of its weights. `mean` is SHARE of what was learnt and the rest of the shipped weights. Scored and
validation talkers train nothing.
"""

import multiprocessing
import os
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from lipservo_lab.corpus.alignment_cache import AlignedUtterance, read_alignments
from lipservo_lab.corpus.transcribed import (
    TranscribedUtterance,
    read_speakers,
    read_transcribed,
)
from lipservo_lab.learning.recognition.augmentation import LabelledSamples, Surroundings
from lipservo_lab.learning.recognition.noise import read_found_sounds
from lipservo_lab.learning.recognition.retimed_labels import labels_if_spoken
from lipservo_lab.learning.recognition.training_data import (
    MASKED_BANDS,
    NO_TARGET,
    TrainingArray,
    TrainingPlan,
    as_array,
    disturbed_copy,
    read_labelled,
    surroundings,
)
from lipservo_lab.learning.recognition.weight_average import averaged
from lipservo_lab.worker_pool import worker_pool

from lipsync.phonemes import PHONEMES
from lipsync.recognition.alignment import LEAST_SCORE
from lipsync.recognition.features import FRAMES_PER_S, HOP, N_BANDS
from lipsync.recognition.network import NetworkWeights, load_weights, save_weights

if TYPE_CHECKING:
    import torch
    from lipservo_lab.learning.recognition.network_training import TaughtOnDevice
    from lipservo_lab.learning.recognition.torch_network import TorchNetwork

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
#: The running average spans a quarter of `n_steps`.
PLAN = TrainingPlan(
    dilations=(1, 2, 4, 8, 1, 2, 4, 8, 16, 32), batch=64, window=500, peak_rate=2e-3,
    visible_weight=0.1, n_steps=16_000,
)  # fmt: skip
TEACHER = replace(
    PLAN, dilations=(1, 2, 4, 8, 16, 1, 2, 4, 8, 16, 32), channels=384, delays=(60,),
    head_weights=(1.0,), n_steps=8_000,
)  # fmt: skip
#: Without a GPU: windows of a step, its seconds on one core (224 channels, 2026-11-28, measured),
#: and the share of the rate that so few windows allow (the root of 16 / 64).
BATCH_ON_PROCESSOR, STEP_ON_PROCESSOR_S, RATE_ON_PROCESSOR = 16, 0.5, 0.5
PARTS = 4
#: Processors left to what learns.
FOR_LEARNING = 3
#: Begin to learn when there are so many arrays.
ENOUGH = 16
#: The newest so many are learnt from; 95 MB each on the device.
KEPT_ARRAYS = 300
MOST_ARRAYS = 600
CLEAN: list[LabelledSamples] = []
AROUND: list[Surroundings] = []


def say(line: str) -> None:
    """Print a line with the time."""
    print(time.strftime("%H:%M:%S"), line, flush=True)


def read_one(job: tuple[TranscribedUtterance, AlignedUtterance]) -> LabelledSamples:
    """Return the labelled recording of an utterance and its alignment; for the pool."""
    return read_labelled(*job)


def clean_features(recording: LabelledSamples) -> np.ndarray:
    """Return the features (n, 40) of a recording and of the silence that the teacher waits for."""
    silence = np.zeros((TEACHER.delays[0] + 4) * HOP, np.float32)
    padded = np.concatenate((recording.samples, silence))
    array = as_array([LabelledSamples(padded, recording.labels)], load_weights(START).scale, [0])
    return array.features[: len(recording.labels) + TEACHER.delays[0]]


def arrays(given: Sequence[str]) -> None:
    """Write the clean recordings' labels and features, then disturbed copies until stopped."""
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
        clean = list(pool.map(read_one, jobs, chunksize=16))
        features = list(pool.map(clean_features, clean, chunksize=16))
        around = surroundings(clean, found_sounds.result())
    ends = np.cumsum([len(each.labels) for each in clean])
    np.save(folder / "clean_features.npy", np.concatenate(features))
    np.savez(folder / "clean.npz", labels=np.concatenate([u.labels for u in clean]), ends=ends)
    # From here on labels are frames of the clean recordings, so that a teacher can speak of them.
    CLEAN[:] = [
        replace(each, labels=len(PHONEMES) + np.arange(end - len(each.labels), end))
        for each, end in zip(clean, ends, strict=True)
    ]
    AROUND[:] = [around]
    hours = ends[-1] / (3600 * FRAMES_PER_S)
    say(f"{len(jobs)} utterances, {hours:.2f} h, {len({u.speaker for u, _ in jobs})} voices")
    with worker_pool(max(1, n_cores - FOR_LEARNING), fork) as pool:
        for _ in pool.map(partial(one_array, folder), range(MOST_ARRAYS)):
            pass


def one_array(folder: Path, number: int) -> None:
    """Write the array of a part of the recordings."""
    copy, part = divmod(number, PARTS)
    copies = disturbed_copy(CLEAN[part::PARTS], AROUND[0], copy, part)
    array = as_array(copies, load_weights(START).scale, PLAN.delays)
    unfinished = folder / f"{number}.unfinished.npy"
    np.save(folder / f"{number}.targets.npy", array.targets.astype(np.int32))
    np.save(unfinished, array.features)
    unfinished.rename(folder / f"{number}.features.npy")


class Windows:
    """The arrays that `arrays` has written by now, on the device, and windows drawn from them."""

    def __init__(self, folder: Path, plan: TrainingPlan, device: "torch.device") -> None:
        self._folder = folder
        self._plan = plan
        self._device = device
        self._arrays: dict[int, tuple[torch.Tensor, torch.Tensor]] = {}
        self._rng = np.random.default_rng(plan.channels)
        self.seen: set[int] = set()

    def look(self) -> None:
        """Take in the arrays written since the last call; the oldest make room."""
        import torch

        for path in self._folder.glob("*.features.npy"):
            number = int(path.name.split(".")[0])
            if number in self.seen:
                continue
            self.seen.add(number)
            features = torch.from_numpy(np.load(path)).to(self._device)
            targets = torch.from_numpy(np.load(self._folder / f"{number}.targets.npy"))
            self._arrays[number] = (features, self._of_heads(targets).to(self._device))
            if len(self._arrays) > KEPT_ARRAYS:
                del self._arrays[min(self._arrays)]

    def _of_heads(self, targets: "torch.Tensor") -> "torch.Tensor":
        """Targets of the plan's heads: those of the first head, moved; a teacher waits longer."""
        if self._plan.delays == PLAN.delays:
            return targets
        first = targets[:, :1]
        return first.roll(self._plan.delays[0] - PLAN.delays[0], 0)

    def draw(self) -> tuple["torch.Tensor", "torch.Tensor"]:
        """Return features (b, 40, n), some bands blanked, and targets (b, n_heads, n)."""
        import torch

        plan, listed = self._plan, list(self._arrays.values())
        features, targets = [], []
        for _ in range(plan.batch):
            array = listed[int(self._rng.integers(len(listed)))]
            first = int(self._rng.integers(0, len(array[0]) - plan.window))
            features.append(array[0][first : first + plan.window])
            targets.append(array[1][first : first + plan.window])
        low = self._rng.integers(0, N_BANDS - MASKED_BANDS, plan.batch)
        high = low + self._rng.integers(1, MASKED_BANDS, plan.batch) * (
            self._rng.random(plan.batch) < 0.5
        )
        bands = np.arange(N_BANDS)
        kept = (bands < low[:, None]) | (bands >= high[:, None])
        mask = torch.from_numpy(kept.astype(np.float32)).to(self._device)
        drawn = torch.stack(features).float().permute(0, 2, 1) * mask[:, :, None]
        return drawn, torch.stack(targets).long().permute(0, 2, 1)

    def some(self) -> TrainingArray:
        """Return one array, from which the norms of a network are set."""
        features, targets = next(iter(self._arrays.values()))
        return TrainingArray(features.cpu().numpy(), targets.cpu().numpy())


def ready(folder: Path, seconds: float, plan: TrainingPlan) -> Windows:
    """Wait until there are arrays enough."""
    import torch

    came = time.monotonic()
    torch.set_num_threads(1)
    while len(list(folder.glob("*.features.npy"))) < ENOUGH:
        if time.monotonic() - came > seconds:
            sys.exit(f"{folder}: no {ENOUGH} arrays in {seconds:.0f} s; start `arrays` beside it")
        time.sleep(0.1)
    windows = Windows(folder, plan, torch.device("cuda" if torch.cuda.is_available() else "cpu"))
    windows.look()
    return windows


def affordable(plan: TrainingPlan, seconds: float) -> TrainingPlan:
    """Return the plan for so many seconds; without a GPU fewer windows a step, at a lower rate."""
    import torch

    if torch.cuda.is_available():
        return plan
    return replace(
        plan,
        batch=BATCH_ON_PROCESSOR,
        peak_rate=plan.peak_rate * RATE_ON_PROCESSOR,
        n_steps=round(seconds / STEP_ON_PROCESSOR_S),
    )


def trained(
    network: "TorchNetwork",
    windows: Windows,
    known: "TaughtOnDevice",
    plan: TrainingPlan,
    ends_at: float,
    keep: Callable[["torch.nn.Module"], None] = lambda _average: None,
) -> "torch.optim.swa_utils.AveragedModel":
    """Return the running average of a network that learns until a time of the monotonic clock."""
    import torch
    from lipservo_lab.learning.recognition import network_training as training

    swa = torch.optim.swa_utils
    average = swa.AveragedModel(
        network, multi_avg_fn=swa.get_ema_multi_avg_fn(plan.averaging), use_buffers=True
    )
    optimizer = torch.optim.AdamW(network.parameters(), weight_decay=plan.weight_decay)
    began, shown, losses, step = time.monotonic(), 0.0, [], 0
    say(f"learning for {ends_at - began:.0f} s")
    while (share := (time.monotonic() - began) / (ends_at - began)) < 1.0:
        if step % 100 == 0:
            windows.look()
        rate = training.learning_rate(plan, round(share * plan.n_steps))
        batch = known.batch(*windows.draw())
        losses.append(training.learn_from(batch, network, optimizer, plan, rate))
        average.update_parameters(network)
        step += 1
        if share - shown > 0.05:
            shown, mean = share, np.mean(losses)
            losses.clear()
            say(f"{share:.2f}: step {step}, loss {mean:.4f}, {len(windows.seen)} arrays")
            keep(average.module)
    say(f"done: {step} steps")
    return average


def on_device(folder: Path, posteriors: Path | None) -> "TaughtOnDevice":
    """Return the labels of all clean frames, and what a teacher says of them."""
    import torch
    from lipservo_lab.learning.recognition.network_training import TaughtOnDevice

    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    labels = torch.from_numpy(np.load(folder / "clean.npz")["labels"]).to(device)
    if posteriors is None:
        return TaughtOnDevice(labels, None)
    said = torch.from_numpy(np.load(posteriors)).to(device)
    said[labels < 0] = 0.0  # what was not said, a teacher does not know either
    return TaughtOnDevice(labels, said)


def teach(given: Sequence[str]) -> None:
    """Train the teacher; write it, and its posteriors of the clean recordings."""
    import torch
    from lipservo_lab.learning.recognition.torch_network import (
        TorchNetwork,
        exported,
        started_from,
    )

    folder, seconds, out = Path(given[0]), float(given[1]), Path(given[2])
    ends_at = time.monotonic() + seconds
    start = load_weights(Path(given[3])) if len(given) > 3 else None
    plan = TEACHER if start is None else replace(TEACHER.shaped_as(start), delays=TEACHER.delays)
    plan = affordable(plan, seconds)
    windows = ready(folder, seconds, plan)
    known = on_device(folder, None)
    network = TorchNetwork(plan)
    if start is not None:
        network = started_from(of_last_head(start), [windows.some()], plan)
    network = trained(network.to(known.labels.device), windows, known, plan, ends_at).module.eval()
    save_weights(exported(network, load_weights(START).scale, plan), out)
    features = np.load(folder / "clean_features.npy", mmap_mode="r")
    ends, delay = np.load(folder / "clean.npz")["ends"], TEACHER.delays[0]
    posteriors = np.empty((ends[-1], len(PHONEMES)), np.float16)
    first = 0
    with torch.no_grad(), torch.autocast(known.labels.device.type, torch.bfloat16):
        for number, end in enumerate(ends):
            # Each recording's features are longer than its labels by what the teacher waits.
            part = features[first + number * delay : end + (number + 1) * delay]
            heard = torch.from_numpy(part.astype(np.float32)).to(known.labels.device).T[None]
            logits = network(heard)[0, 0].float()[:, delay:]
            posteriors[first:end] = torch.softmax(logits, 0).T.cpu().numpy()
            first = end
    labels = known.labels.cpu().numpy()
    is_known = labels >= 0
    agreed = float(np.mean((posteriors.argmax(axis=1) == labels)[is_known]))
    certain = float(np.mean(posteriors.max(axis=1).astype(np.float32)))
    say(f"agrees with {agreed:.3f} of the labels; largest posterior {certain:.3f} in the mean")
    np.save(folder / "unfinished.npy", posteriors)
    (folder / "unfinished.npy").rename(folder / "posteriors.npy")


def of_last_head(weights: NetworkWeights) -> NetworkWeights:
    """Return the weights with their last head alone, which goes on as the teacher's."""
    n = len(PHONEMES)
    return replace(
        weights,
        output=weights.output[:, -n:],
        output_bias=weights.output_bias[-n:],
        delays=TEACHER.delays,
    )


def relabel(given: Sequence[str]) -> None:
    """Lay the labels of the clean recordings anew by the teacher's posteriors.

    A recording whose phones the teacher does not find has no labels any more.
    """
    folder = Path(given[0])
    with np.load(folder / "clean.npz") as clean:
        before, ends = clean["labels"], clean["ends"]
    posteriors = np.load(folder / "posteriors.npy", mmap_mode="r")
    parts = [slice(first, end) for first, end in zip([0, *ends[:-1]], ends, strict=True)]
    jobs = ((before[part], posteriors[part]) for part in parts)
    with worker_pool(os.cpu_count() or 1, multiprocessing.get_context("fork")) as pool:
        found = list(pool.map(relabelled, jobs, chunksize=16))
    labels = np.concatenate(found)
    is_dropped = np.array([(each < 0).all() for each in found])
    is_known = (labels >= 0) & (before >= 0)
    moved = float(np.mean((labels != before)[is_known]))
    say(f"{is_dropped.sum()} recordings dropped; {moved:.3f} of the other frames moved")
    unfinished = folder / "unfinished.npz"
    np.savez(unfinished, labels=labels, ends=ends)
    unfinished.rename(folder / "clean.npz")


def relabelled(job: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Return the labels (n,) of a recording laid anew over posteriors; for the pool."""
    labels, posteriors = job
    spoken = labels[labels >= 0]
    if not len(spoken):
        return labels
    phones = spoken[np.flatnonzero(np.diff(spoken, prepend=-1))]
    found = labels_if_spoken(phones.tolist(), posteriors.astype(np.float32))
    return np.full_like(labels, NO_TARGET) if found is None else found


def learn(given: Sequence[str]) -> None:
    """Learn for so many seconds from now; the rate falls with the time that is left."""
    import torch
    from lipservo_lab.learning.recognition.torch_network import exported, started_from

    folder, seconds, out = Path(given[0]), float(given[1]), Path(given[2])
    plan, is_taught = replace(PLAN, channels=int(given[3])), given[4] == "teacher"
    plan = affordable(plan, seconds)
    ends_at = time.monotonic() + seconds
    posteriors = folder / "posteriors.npy"
    while is_taught and not posteriors.exists():
        if time.monotonic() > ends_at:
            sys.exit(f"{posteriors}: not there after {seconds:.0f} s; start `teach` beside it")
        time.sleep(0.5)
    windows = ready(folder, seconds, plan)
    known = on_device(folder, posteriors if is_taught else None)
    start = load_weights(START)
    torch.manual_seed(plan.seed)
    network = started_from(start, [windows.some()], plan).to(known.labels.device)

    def keep(average: torch.nn.Module) -> None:
        save_weights(exported(average, start.scale, plan), out)

    keep(trained(network, windows, known, plan, ends_at, keep).module)


def mean(given: Sequence[str]) -> None:
    """Write the mean of what was learned and what it began as."""
    from lipservo_lab.learning.recognition.torch_network import grown

    learned = load_weights(Path(given[1]))
    began = grown(load_weights(START), PLAN.shaped_as(learned))
    save_weights(averaged(learned, began, 1.0 - float(given[0])), given[2])


if __name__ == "__main__":
    {
        "arrays": arrays, "teach": teach, "relabel": relabel, "learn": learn, "mean": mean
    }[sys.argv[1]](sys.argv[2:])  # fmt: skip
