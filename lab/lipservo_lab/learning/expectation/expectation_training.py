"""Learning the expectation from recorded sentences: contexts in, faces out."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from lipservo_lab.corpus.utterance import Utterance
from lipservo_lab.learning.expectation.articulation import articulatory_features
from lipservo_lab.learning.expectation.networks import Layers, Schedule, fit, initial_layers
from lipsync.arrays import Array
from lipsync.expectation.context import SLOTS, UNKNOWN, contexts, track_of
from lipsync.expectation.expectation import (
    N_WINDOWS,
    Expectation,
    Stack,
    constant_expectation,
    timing_features,
    window_shares,
)
from lipsync.phonemes import PHONEMES, SILENCE, VISEME_CLASSES, VISEME_OF, PhonemeEvent

Array32 = NDArray[np.float32]
Indices = NDArray[np.int64]
Progress = Callable[[str], None]

#: One model serves every look-ahead between these; learned with all three at once.
TRAINED_LOOKAHEADS_S = (0.0, 0.1, 0.2)
#: Silence this near to speech is learned too: the mouth opens before the sound, and closes after.
_NEAR_SPEECH_S = 0.3


@dataclass(frozen=True, slots=True)
class Family:
    """Networks that read the context in one way."""

    name: str
    n_networks: int
    hidden: tuple[int, int]


#: Chosen on an inner split of the first fold's training part and on inner new words
#: (docs/motion.md).
_SLOT_FAMILY = Family("slots", 3, (256, 64))
_WINDOW_FAMILY = Family("windows", 1, (192, 48))
_N_NETWORKS = _SLOT_FAMILY.n_networks + _WINDOW_FAMILY.n_networks
_SCHEDULE = Schedule(n_epochs=10, decay=0.004)
#: With fewer frames there is nothing to learn but the phonemes' centres.
_FEWEST_FRAMES = 200
#: Slots whose phoneme and viseme class enter by name too, not by articulation alone.
_NAMED_SLOTS = (1, 2, 3)
#: Networks that learn at the same time; each gives the same whatever the others do.
_AT_ONCE = 2
#: A feature that hardly varies in training must not run away when it does later.
_SMALLEST_SPREAD = 0.05


@dataclass(frozen=True, slots=True)
class TrainingSet:
    """What the mouth did in which context: phonemes (n, 5), times (n, 6), faces (n, n_components).

    Contexts are those of every trained look-ahead, one after the other.
    """

    phonemes: Indices
    times_s: Array
    lookahead_s: Array
    faces: Array


def joined(sets: Sequence[TrainingSet]) -> TrainingSet:
    """One after the other."""
    return TrainingSet(
        np.concatenate([one.phonemes for one in sets]),
        np.concatenate([one.times_s for one in sets]),
        np.concatenate([one.lookahead_s for one in sets]),
        np.concatenate([one.faces for one in sets]),
    )


def _empty_set(n_components: int) -> TrainingSet:
    phonemes = np.empty((0, SLOTS), dtype=np.int64)
    return TrainingSet(phonemes, np.empty((0, 6)), np.empty(0), np.empty((0, n_components)))


def collect_training_set(
    utterances: Iterable[Utterance],
    coefficients: Sequence[Array],
    heard: Mapping[str, Sequence[PhonemeEvent]] | None = None,
) -> TrainingSet:
    """All frames in or near speech; coefficients: (n_frames, n_components) of each utterance.

    heard: what a recogniser made of some of the sentences, by name; those alone are taken then, in
    the contexts that were heard, every frame at one look-ahead in turn: an error teaches less than
    a label. None takes every sentence as it is labelled, every frame at every look-ahead.
    """
    n_components = coefficients[0].shape[1] if coefficients else 0
    n_turns = 1 if heard is None else len(TRAINED_LOOKAHEADS_S)
    found = [[_empty_set(n_components)] for _ in TRAINED_LOOKAHEADS_S]
    for utterance, motion in zip(utterances, coefficients, strict=True):
        spoken = [p for p in utterance.phones if p.phoneme != SILENCE and p.end_s is not None]
        if not spoken or (heard is not None and utterance.name not in heard):
            continue
        times_s = np.arange(len(motion)) / utterance.frame_rate_hz
        last_s = max(p.end_s or 0.0 for p in spoken)
        near = times_s >= spoken[0].start_s - _NEAR_SPEECH_S
        near &= times_s <= last_s + _NEAR_SPEECH_S
        track = track_of(utterance.phones if heard is None else heard[utterance.name])
        for turn, lookahead_s in enumerate(TRAINED_LOOKAHEADS_S):
            frames = np.flatnonzero(near)[turn % n_turns :: n_turns]
            phonemes, known_s = contexts(track, times_s[frames], lookahead_s)
            ahead_s = np.full(len(frames), lookahead_s)
            found[turn].append(TrainingSet(phonemes, known_s, ahead_s, motion[frames]))
    return joined([each for list_ in found for each in list_])


def fit_expectation(
    training_set: TrainingSet, centres: Array, *, seed: int, progress: Progress = lambda _: None
) -> Expectation:
    """Learn from a training set; the same set and seed give the same expectation.

    centres: (40, n_components), what a phoneme looks like where there are too few frames to learn.
    """
    if len(training_set.faces) < _FEWEST_FRAMES * len(TRAINED_LOOKAHEADS_S):
        return constant_expectation(centres)
    slots, windows = phoneme_features(), articulation_table()
    timing = timing_features(training_set.times_s, training_set.lookahead_s).astype(np.float32)
    by_slot = [table[training_set.phonemes[:, slot]] for slot, table in enumerate(slots)]
    by_slot_inputs = np.concatenate([*by_slot, timing], axis=1)
    by_window_inputs = np.concatenate([_window_inputs(training_set, windows), timing], axis=1)
    with threadpool_limits(limits=1):  # several threads add up in changing order
        slot_tables, slot_stack = _fit_family(
            by_slot_inputs, training_set.faces, slots, _SLOT_FAMILY, [seed, 0], progress
        )
        window_tables, window_stack = _fit_family(
            by_window_inputs,
            training_set.faces,
            [windows] * N_WINDOWS,
            _WINDOW_FAMILY,
            [seed, 1],
            progress,
        )
    return Expectation(slot_tables, slot_stack, window_tables, window_stack)


def _fit_family(
    inputs: Array32,
    faces: Array,
    dictionary: Sequence[Array32],
    family: Family,
    seed: Sequence[int],
    progress: Progress,
) -> tuple[Array, Stack]:
    """Train the networks of a family; its tables and the rest of it."""
    mean = inputs.mean(axis=0)
    spread = inputs.std(axis=0) + _SMALLEST_SPREAD
    inputs = (inputs - mean) / spread
    unit = float(faces.std())
    targets = (faces / unit).astype(np.float32)

    def learn(number: int) -> Layers:
        rng = np.random.default_rng([*seed, number])
        layers = initial_layers((inputs.shape[1], *family.hidden, targets.shape[1]), rng)
        return fit(layers, inputs, targets, _SCHEDULE, rng)

    progress(f"expectation by {family.name}, {family.n_networks} networks")
    with ThreadPoolExecutor(_AT_ONCE) as threads:  # NumPy computes outside the interpreter's lock
        networks = list(threads.map(learn, range(family.n_networks)))
    return _exported(networks, dictionary, mean, spread, unit)


def articulation_table() -> Array32:
    """(41, 22): articulatory features of each phoneme, zeros for UNKNOWN."""
    features = articulatory_features()
    return np.concatenate([features, np.zeros((1, features.shape[1]))]).astype(np.float32)


def phoneme_features() -> list[Array32]:
    """For each slot (41, n_features): articulation; in the middle slots class and name as well."""
    articulation = articulation_table()
    viseme = np.zeros((UNKNOWN + 1, len(VISEME_CLASSES)), dtype=np.float32)
    viseme[np.arange(len(PHONEMES)), [VISEME_OF[p] for p in PHONEMES]] = 1.0
    names = np.eye(UNKNOWN + 1, len(PHONEMES), dtype=np.float32)
    named = np.concatenate([articulation, viseme, names], axis=1)
    return [named if slot in _NAMED_SLOTS else articulation for slot in range(SLOTS)]


def _window_inputs(training_set: TrainingSet, table: Array32) -> Array32:
    """(n, N_WINDOWS * 22): what the phonemes are, window by window."""
    shares = window_shares(training_set.times_s, training_set.lookahead_s).astype(np.float32)
    inputs = np.zeros((len(shares), N_WINDOWS, table.shape[1]), dtype=np.float32)
    for slot in range(SLOTS):
        inputs += shares[:, :, slot, None] * table[training_set.phonemes[:, slot]][:, None, :]
    return inputs.reshape(len(shares), -1)


def _exported(
    networks: list[Layers],
    dictionary: Sequence[Array32],
    mean: Array32,
    spread: Array32,
    unit: float,
) -> tuple[Array, Stack]:
    """The first layer folded into tables, scaling undone, networks side by side."""
    first = np.concatenate([n[0] for n in networks], axis=1) / spread[:, None].astype(np.float64)
    bias = np.concatenate([n[1] for n in networks]) - mean @ first
    pieces = np.split(first, np.cumsum([table.shape[1] for table in dictionary]))
    hidden = [np.concatenate([n[2], n[3][None]]) for n in networks]
    output = np.concatenate(
        [*(n[4] for n in networks), np.sum([n[5] for n in networks], axis=0)[None]]
    )
    stack = Stack(
        np.concatenate([pieces[-1], bias[None]]),
        np.array(hidden, dtype=np.float64),
        output * (unit / _N_NETWORKS),
    )
    return np.array([t @ p for t, p in zip(dictionary, pieces, strict=False)]), stack
