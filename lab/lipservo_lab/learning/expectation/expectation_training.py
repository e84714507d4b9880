"""Learning the expectation from recorded sentences: contexts in, faces out.

What each phoneme asks of the mouth, in numbers, so that sounds never seen resemble seen ones.

The features are those of the IPA chart (place, manner, voice; for vowels openness, backness and
rounding, at the beginning and at the end, so that a diphthong moves). Graded values are ours: only
their order matters to a model that learns from them.

Training a small network with two hidden layers of rectifiers, by Adam, in NumPy.

Squared error, weight decay as part of the gradient, a learning rate that falls to zero over the
second half. Kingma and Ba, "Adam", ICLR 2015, algorithm 1; initial weights: Glorot and Bengio,
AISTATS 2010, eq. (16).
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from lipservo_lab.corpus.utterance import Utterance
from lipsync.arrays import Array
from lipsync.expectation.expectation import (
    N_WINDOWS,
    SLOTS,
    UNKNOWN,
    Expectation,
    Stack,
    constant_expectation,
    contexts,
    timing_features,
    track_of,
    window_shares,
)
from lipsync.phonemes import PHONEMES, SILENCE, VISEME_CLASSES, VISEME_OF, PhonemeEvent

#: Vowels: openness, backness and rounding, each at the beginning and at the end, 0 to 1.
_VOWELS: dict[str, tuple[float, float, float, float, float, float]] = {
    "IY": (0.1, 0.1, 0.0, 0.0, 0.0, 0.0),
    "IH": (0.3, 0.3, 0.2, 0.2, 0.0, 0.0),
    "EH": (0.55, 0.55, 0.2, 0.2, 0.0, 0.0),
    "AE": (0.8, 0.8, 0.2, 0.2, 0.0, 0.0),
    "AA": (1.0, 1.0, 0.8, 0.8, 0.1, 0.1),
    "AH": (0.6, 0.6, 0.6, 0.6, 0.0, 0.0),
    "AO": (0.8, 0.8, 1.0, 1.0, 0.6, 0.6),
    "UH": (0.3, 0.3, 0.8, 0.8, 0.6, 0.6),
    "UW": (0.1, 0.1, 0.8, 0.8, 1.0, 1.0),
    "ER": (0.4, 0.4, 0.5, 0.5, 0.4, 0.4),
    "EY": (0.5, 0.15, 0.2, 0.0, 0.0, 0.0),
    "AY": (1.0, 0.2, 0.6, 0.1, 0.0, 0.0),
    "OW": (0.55, 0.2, 0.8, 0.8, 0.5, 1.0),
    "AW": (0.95, 0.3, 0.6, 0.8, 0.0, 0.8),
    "OY": (0.7, 0.2, 1.0, 0.1, 0.7, 0.0),
}

_PLACES = ("labial", "labiodental", "dental", "alveolar", "palatal", "velar", "glottal")
_MANNERS = ("stop", "fricative", "affricate", "nasal", "approximant")

#: Consonants: place, manner, voiced, rounding 0 to 1.
_CONSONANTS: dict[str, tuple[str, str, bool, float]] = {
    "P": ("labial", "stop", False, 0.0),
    "B": ("labial", "stop", True, 0.0),
    "M": ("labial", "nasal", True, 0.0),
    "F": ("labiodental", "fricative", False, 0.0),
    "V": ("labiodental", "fricative", True, 0.0),
    "TH": ("dental", "fricative", False, 0.0),
    "DH": ("dental", "fricative", True, 0.0),
    "T": ("alveolar", "stop", False, 0.0),
    "D": ("alveolar", "stop", True, 0.0),
    "N": ("alveolar", "nasal", True, 0.0),
    "S": ("alveolar", "fricative", False, 0.0),
    "Z": ("alveolar", "fricative", True, 0.0),
    "L": ("alveolar", "approximant", True, 0.0),
    "SH": ("palatal", "fricative", False, 0.6),
    "ZH": ("palatal", "fricative", True, 0.6),
    "CH": ("palatal", "affricate", False, 0.6),
    "JH": ("palatal", "affricate", True, 0.6),
    "Y": ("palatal", "approximant", True, 0.0),
    "R": ("palatal", "approximant", True, 0.6),
    "K": ("velar", "stop", False, 0.0),
    "G": ("velar", "stop", True, 0.0),
    "NG": ("velar", "nasal", True, 0.0),
    "W": ("velar", "approximant", True, 1.0),
    "HH": ("glottal", "fricative", False, 0.0),
}


def articulatory_features() -> Array:
    """Return articulatory features, a row for each of `PHONEMES`.

    Columns: silence, vowel, consonant; openness, backness, rounding, each at the beginning and at
    the end; the places; the manners; voiced.

    Returns
    -------
    Array
        (40, 22).
    """
    return np.array([_features(phoneme) for phoneme in PHONEMES])


def _features(phoneme: str) -> list[float]:
    """Return a phoneme's features: silence, vowel or consonant, shape, place, manner, voice.

    Of the six numbers of shape a vowel has all, a consonant only the two of rounding.
    """
    kind = [0.0, 0.0, 0.0]
    shape = [0.0] * 6
    place, manner, voiced = [0.0] * len(_PLACES), [0.0] * len(_MANNERS), 0.0
    if phoneme == SILENCE:
        kind[0] = 1.0
    elif phoneme in _VOWELS:
        kind[1], voiced = 1.0, 1.0
        shape = list(_VOWELS[phoneme])
    else:
        kind[2] = 1.0
        where, how, is_voiced, rounding = _CONSONANTS[phoneme]
        place[_PLACES.index(where)] = 1.0
        manner[_MANNERS.index(how)] = 1.0
        shape[4] = shape[5] = rounding
        voiced = float(is_voiced)
    return [*kind, *shape, *place, *manner, voiced]


Array32 = NDArray[np.float32]

_BATCH = 800
_LEARNING_RATE = 2e-3
#: Kingma and Ba's own.
_BETA_1, _BETA_2, _EPSILON = 0.9, 0.999, 1e-8


@dataclass(frozen=True, slots=True)
class Schedule:
    """How long and how strictly to train.

    decay: what every weight is pulled by, in units of itself, beside the mean gradient of a batch.
    """

    n_epochs: int
    decay: float


Layers = list[Array32]


def initial_layers(sizes: tuple[int, ...], rng: np.random.Generator) -> Layers:
    """Weights (n_in, n_out) and bias (n_out,) of each layer, alternating."""
    layers: Layers = []
    for n_in, n_out in pairwise(sizes):
        bound = np.sqrt(6.0 / (n_in + n_out))
        layers.append(rng.uniform(-bound, bound, (n_in, n_out)).astype(np.float32))
        layers.append(np.zeros(n_out, dtype=np.float32))
    return layers


def forward(layers: Layers, inputs: Array32) -> list[Array32]:
    """Return the inputs, and the outputs of every layer; the last one is linear.

    Parameters
    ----------
    layers : Layers
        Weights and biases.
    inputs : Array32
        (n, n_inputs).

    Returns
    -------
    list[Array32]
        (n, width) each.
    """
    values = [inputs]
    n_layers = len(layers) // 2
    for i in range(n_layers):
        value = values[-1] @ layers[2 * i] + layers[2 * i + 1]
        values.append(np.maximum(value, 0.0, out=value) if i < n_layers - 1 else value)
    return values


def gradients(layers: Layers, inputs: Array32, targets: Array32) -> Layers:
    """Return gradients of half the squared error, summed over outputs, averaged over the batch.

    Parameters
    ----------
    layers : Layers
        Weights and biases.
    inputs : Array32
        (n, n_inputs).
    targets : Array32
        (n, n_outputs).

    Returns
    -------
    Layers
        In the shape of `layers`.
    """
    values = forward(layers, inputs)
    slope = (values[-1] - targets) / np.float32(len(inputs))
    found: Layers = []
    for i in reversed(range(len(layers) // 2)):
        found += [slope.sum(axis=0), values[i].T @ slope]
        if i:
            slope = (slope @ layers[2 * i].T) * (values[i] > 0.0)
    return found[::-1]


def fit(
    layers: Layers, inputs: Array32, targets: Array32, schedule: Schedule, rng: np.random.Generator
) -> Layers:
    """Train in place, and return the layers.

    Parameters
    ----------
    layers : Layers
        Weights and biases.
    inputs : Array32
        (n, n_inputs).
    targets : Array32
        (n, n_outputs).
    schedule : Schedule
        Steps and rates.
    rng : np.random.Generator
        Draws batches.

    Returns
    -------
    Layers
        In the shape they had.
    """
    first = [np.zeros_like(layer) for layer in layers]
    second = [np.zeros_like(layer) for layer in layers]
    n_batches = -(-len(inputs) // _BATCH)
    n_steps, step = schedule.n_epochs * n_batches, 0
    for _ in range(schedule.n_epochs):
        for batch in np.array_split(rng.permutation(len(inputs)), n_batches):
            slopes = gradients(layers, inputs[batch], targets[batch])
            step += 1
            rate = _LEARNING_RATE * min(1.0, 2.0 * (1.0 - (step - 1) / n_steps))
            rate *= np.sqrt(1.0 - _BETA_2**step) / (1.0 - _BETA_1**step)
            for layer, slope, m, v in zip(layers, slopes, first, second, strict=True):
                if layer.ndim == 2:
                    slope += np.float32(schedule.decay) * layer
                m *= _BETA_1
                m += (1.0 - _BETA_1) * slope
                v *= _BETA_2
                v += (1.0 - _BETA_2) * slope * slope
                layer -= np.float32(rate) * m / (np.sqrt(v) + _EPSILON)
    return layers


Indices = NDArray[np.int64]
Progress = Callable[[str], None]

#: One model serves every look-ahead between these; learned with all three at once.
TRAINED_LOOKAHEADS_S = (0.0, 0.1, 0.2)
#: Silence this near to speech is learned too: the mouth opens before the sound, and closes after.
NEAR_SPEECH_S = 0.3


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
    """Join training sets one after the other."""
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
    """Return all frames in or near speech.

    Parameters
    ----------
    utterances : Iterable[Utterance]
        Labelled.
    coefficients : Sequence[Array]
        (n_frames, n_components) of each.
    heard : Mapping[str, Sequence[PhonemeEvent]] | None
        Phonemes that a recogniser made of some of the sentences, by name; those alone are taken
        then, in the contexts that were recognised, every frame at one look-ahead in turn: an error
        teaches less than a label. None takes every sentence as it is labelled, every frame at every
        look-ahead.

    Returns
    -------
    TrainingSet
        Contexts of shape (n, 5), and faces.
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
        near = times_s >= spoken[0].start_s - NEAR_SPEECH_S
        near &= times_s <= last_s + NEAR_SPEECH_S
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

    Parameters
    ----------
    training_set : TrainingSet
        Contexts and faces.
    centres : Array
        (40, n_components), what a phoneme looks like where there are too few frames to learn.
    seed : int
        Of weights and batches.
    progress : Progress
        Called with the progress.

    Returns
    -------
    Expectation
        The expectation.
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
    """Train the networks of one family; return the tables of their first layer, and the rest."""
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
    """Return articulatory features of each phoneme, zeros for UNKNOWN.

    Returns
    -------
    Array32
        (41, 22).
    """
    features = articulatory_features()
    return np.concatenate([features, np.zeros((1, features.shape[1]))]).astype(np.float32)


def phoneme_features() -> list[Array32]:
    """Return features for each slot: articulation; in the middle slots class and name as well.

    Returns
    -------
    list[Array32]
        (41, n_features) each.
    """
    articulation = articulation_table()
    viseme = np.zeros((UNKNOWN + 1, len(VISEME_CLASSES)), dtype=np.float32)
    viseme[np.arange(len(PHONEMES)), [VISEME_OF[p] for p in PHONEMES]] = 1.0
    names = np.eye(UNKNOWN + 1, len(PHONEMES), dtype=np.float32)
    named = np.concatenate([articulation, viseme, names], axis=1)
    return [named if slot in _NAMED_SLOTS else articulation for slot in range(SLOTS)]


def _window_inputs(training_set: TrainingSet, table: Array32) -> Array32:
    """Return the mean phoneme features in each window of a context, (n, N_WINDOWS * 22)."""
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
    """Fold the first layer into a table for each dictionary entry, and put networks side by side.

    Scaling of inputs and outputs is undone.
    """
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
