"""Train the expectation, which predicts the mean face from the phonemes around an instant.

Features of articulation say what each phoneme demands of the mouth, in numbers, so that phonemes
without recordings resemble recorded ones.

The features are those of the IPA chart (place, manner, voice; for vowels openness, backness and
rounding, at the beginning and at the end, so that a diphthong moves). Graded values are ours: only
their order matters to a model that learns from them.

The training: a small network with two hidden layers of rectifiers, by Adam, in NumPy.

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
    """Return the 22 features of a phoneme: kind (3), shape (6), place (7), manner (5), voiced (1).

    Of the six numbers of the shape (openness, backness, rounding, each at begin and end) a vowel
    has all, a consonant only the two of rounding.
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
        phoneme_place, phoneme_manner, is_voiced, rounding = _CONSONANTS[phoneme]
        place[_PLACES.index(phoneme_place)] = 1.0
        manner[_MANNERS.index(phoneme_manner)] = 1.0
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

    decay: weight decay; decay times the weight is added to the weight's mean gradient in a batch.
    """

    n_epochs: int
    decay: float


Layers = list[Array32]


def initial_layers(sizes: tuple[int, ...], rng: np.random.Generator) -> Layers:
    """Return random weights (n_in, n_out) and zero biases (n_out,) of each layer, alternating.

    sizes: number of inputs, widths of the hidden layers, number of outputs.
    """
    layers: Layers = []
    for n_in, n_out in pairwise(sizes):
        bound = np.sqrt(6.0 / (n_in + n_out))
        layers.append(rng.uniform(-bound, bound, (n_in, n_out)).astype(np.float32))
        layers.append(np.zeros(n_out, dtype=np.float32))
    return layers


def forward(layers: Layers, inputs: Array32) -> list[Array32]:
    """Return the inputs and the outputs of every layer; the last layer is linear.

    Parameters
    ----------
    layers : Layers
        Weights and biases, alternating.
    inputs : Array32
        (n, n_inputs).

    Returns
    -------
    list[Array32]
        The inputs, then (n, width) for each layer; the last are the network's outputs.
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
        Weights and biases, alternating.
    inputs : Array32
        (n, n_inputs).
    targets : Array32
        (n, n_outputs).

    Returns
    -------
    Layers
        Gradients of weights and biases, in the shapes of `layers`.
    """
    values = forward(layers, inputs)
    error = (values[-1] - targets) / np.float32(len(inputs))
    reversed_gradients: Layers = []
    for i in reversed(range(len(layers) // 2)):
        reversed_gradients += [error.sum(axis=0), values[i].T @ error]
        # Back through the rectifiers to the outputs of the layer before.
        if i:
            error = (error @ layers[2 * i].T) * (values[i] > 0.0)
    return reversed_gradients[::-1]


def fit(
    layers: Layers, inputs: Array32, targets: Array32, schedule: Schedule, rng: np.random.Generator
) -> Layers:
    """Train the layers in place by Adam (Kingma and Ba, algorithm 1), and return them.

    Parameters
    ----------
    layers : Layers
        Weights and biases, alternating.
    inputs : Array32
        (n, n_inputs).
    targets : Array32
        (n, n_outputs).
    schedule : Schedule
        Epochs and weight decay.
    rng : np.random.Generator
        Draws the order of the samples in each epoch.

    Returns
    -------
    Layers
        The same list.
    """
    # Running means of the gradients and of their squares, m and v in the paper.
    means = [np.zeros_like(layer) for layer in layers]
    squares = [np.zeros_like(layer) for layer in layers]
    n_batches = -(-len(inputs) // _BATCH)
    n_steps, step = schedule.n_epochs * n_batches, 0
    for _ in range(schedule.n_epochs):
        for batch in np.array_split(rng.permutation(len(inputs)), n_batches):
            slopes = gradients(layers, inputs[batch], targets[batch])
            step += 1
            # Constant for half of the steps, then down to zero; then the bias correction of Adam.
            rate = _LEARNING_RATE * min(1.0, 2.0 * (1.0 - (step - 1) / n_steps))
            rate *= np.sqrt(1.0 - _BETA_2**step) / (1.0 - _BETA_1**step)
            for layer, slope, m, v in zip(layers, slopes, means, squares, strict=True):
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
    """Networks that read the phonemes of a context in one way: by slot or by window of time.

    hidden: widths of the two hidden layers.
    """

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
    """Phoneme contexts of recorded frames, and the face of each frame.

    phonemes (n, 5) and times_s (n, 6): as `contexts` returns them. lookahead_s: (n,). faces:
    coefficients (n, n_components). The contexts of each trained look-ahead follow one another.
    """

    phonemes: Indices
    times_s: Array
    lookahead_s: Array
    faces: Array


def joined(sets: Sequence[TrainingSet]) -> TrainingSet:
    """Join training sets one after the other."""
    return TrainingSet(
        np.concatenate([part.phonemes for part in sets]),
        np.concatenate([part.times_s for part in sets]),
        np.concatenate([part.lookahead_s for part in sets]),
        np.concatenate([part.faces for part in sets]),
    )


def _empty_set(n_components: int) -> TrainingSet:
    phonemes = np.empty((0, SLOTS), dtype=np.int64)
    return TrainingSet(phonemes, np.empty((0, 6)), np.empty(0), np.empty((0, n_components)))


def collect_training_set(
    utterances: Iterable[Utterance],
    coefficients: Sequence[Array],
    heard: Mapping[str, Sequence[PhonemeEvent]] | None = None,
) -> TrainingSet:
    """Return the contexts and faces of all frames in or near speech.

    These are the frames from 0.3 s before the first phone to 0.3 s after the last.

    Parameters
    ----------
    utterances : Iterable[Utterance]
        Sentences with phone labels.
    coefficients : Sequence[Array]
        Face coefficients (n_frames, n_components) of each.
    heard : Mapping[str, Sequence[PhonemeEvent]] | None
        None: contexts are of the labels, every frame at every look-ahead. Otherwise the phonemes
        that a recogniser found, by the sentence's name: only these sentences are used, with
        contexts of the recognised phonemes, and each frame at one look-ahead in turn, so that an
        error teaches less than a label.

    Returns
    -------
    TrainingSet
        Contexts of shape (n, 5), and faces.
    """
    n_components = coefficients[0].shape[1] if coefficients else 0
    n_parts = 1 if heard is None else len(TRAINED_LOOKAHEADS_S)
    by_lookahead = [[_empty_set(n_components)] for _ in TRAINED_LOOKAHEADS_S]
    for utterance, motion in zip(utterances, coefficients, strict=True):
        spoken = [p for p in utterance.phones if p.phoneme != SILENCE and p.end_s is not None]
        if not spoken or (heard is not None and utterance.name not in heard):
            continue
        times_s = np.arange(len(motion)) / utterance.frame_rate_hz
        end_s = max(p.end_s or 0.0 for p in spoken)
        is_chosen = times_s >= spoken[0].start_s - NEAR_SPEECH_S
        is_chosen &= times_s <= end_s + NEAR_SPEECH_S
        track = track_of(utterance.phones if heard is None else heard[utterance.name])
        for number, lookahead_s in enumerate(TRAINED_LOOKAHEADS_S):
            frames = np.flatnonzero(is_chosen)[number % n_parts :: n_parts]
            phonemes, context_s = contexts(track, times_s[frames], lookahead_s)
            ahead_s = np.full(len(frames), lookahead_s)
            by_lookahead[number].append(TrainingSet(phonemes, context_s, ahead_s, motion[frames]))
    return joined([part for sets in by_lookahead for part in sets])


def fit_expectation(
    training_set: TrainingSet, centres: Array, *, seed: int, progress: Progress = lambda _: None
) -> Expectation:
    """Learn from a training set; the same set and seed give the same expectation.

    Parameters
    ----------
    training_set : TrainingSet
        Contexts and faces.
    centres : Array
        (40, n_components), the mean face in the middle of each phoneme: with fewer than 200 frames
        the expectation is the centre of the present phoneme.
    seed : int
        Draws the initial weights and the batches.
    progress : Progress
        Called with a line about what is being trained.

    Returns
    -------
    Expectation
        Predicts the mean face of a context; without back-off.
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
    """Train the networks of one family; return their first layer as tables, and the other layers.

    inputs: (n, n_inputs), features by `dictionary`, then timing; not scaled. dictionary: for each
    slot or window the features (41, n_features) of each phoneme. The tables are (len(dictionary),
    41, n_networks * h1): what a phoneme adds to the first hidden layer.
    """
    mean = inputs.mean(axis=0)
    deviation = inputs.std(axis=0) + _SMALLEST_SPREAD
    inputs = (inputs - mean) / deviation
    face_deviation = float(faces.std())
    targets = (faces / face_deviation).astype(np.float32)

    def train_network(number: int) -> Layers:
        rng = np.random.default_rng([*seed, number])
        layers = initial_layers((inputs.shape[1], *family.hidden, targets.shape[1]), rng)
        return fit(layers, inputs, targets, _SCHEDULE, rng)

    progress(f"expectation by {family.name}, {family.n_networks} networks")
    with ThreadPoolExecutor(_AT_ONCE) as threads:  # NumPy computes outside the interpreter's lock
        networks = list(threads.map(train_network, range(family.n_networks)))
    return _exported(networks, dictionary, mean, deviation, face_deviation)


def articulation_table() -> Array32:
    """Return the articulatory features of each phoneme; the last row, for UNKNOWN, is zero.

    Returns
    -------
    Array32
        (41, 22).
    """
    features = articulatory_features()
    return np.concatenate([features, np.zeros((1, features.shape[1]))]).astype(np.float32)


def phoneme_features() -> list[Array32]:
    """Return for each of the five slots of a context the features of every phoneme.

    All slots have articulation; the middle three, of the present phoneme and its neighbours, also
    the viseme class and the phoneme itself, one-hot.

    Returns
    -------
    list[Array32]
        (41, n_features) each; the last row is for UNKNOWN.
    """
    articulation = articulation_table()
    viseme_classes = np.zeros((UNKNOWN + 1, len(VISEME_CLASSES)), dtype=np.float32)
    viseme_classes[np.arange(len(PHONEMES)), [VISEME_OF[p] for p in PHONEMES]] = 1.0
    names = np.eye(UNKNOWN + 1, len(PHONEMES), dtype=np.float32)
    named = np.concatenate([articulation, viseme_classes, names], axis=1)
    return [named if slot in _NAMED_SLOTS else articulation for slot in range(SLOTS)]


def _window_inputs(training_set: TrainingSet, table: Array32) -> Array32:
    """Return each window's phoneme features, weighted by the shares of time that phonemes fill.

    table: (41, 22) features. The result is (n, N_WINDOWS * 22).
    """
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
    """Return networks in the form of `Expectation`: tables (n_entries, 41, m h1), and a `Stack`.

    A phoneme's features times the first layer's weights give its table row; the weights of the
    timing features and all biases go into the stack. Scaling of inputs (mean, spread) and outputs
    (unit) is folded in, and the output divided by the number of all networks.
    """
    weights = np.concatenate([n[0] for n in networks], axis=1) / spread[:, None].astype(np.float64)
    bias = np.concatenate([n[1] for n in networks]) - mean @ weights
    pieces = np.split(weights, np.cumsum([table.shape[1] for table in dictionary]))
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
