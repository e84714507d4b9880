"""The expectation: the mean motion of the mouth that small networks predict for decided phonemes.

The networks' only input is a context: what is known about the phonemes around one instant. The rule
that makes the prediction live: with look-ahead L, at time t a phoneme is known when it begins at or
before t + L, and its end only when it lies at or before t + L.

Inference only, NumPy only. Every network has two hidden layers of rectifiers. Phonemes enter by
table look-up (a row for each slot and phoneme, the first layer already applied to the phoneme's
features), so a frame costs a few matrix-vector products.

Its arrays are one part of a model file.
"""

import math
from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array
from lipsync.expectation.back_off import BackOff
from lipsync.face.model import ModelFile
from lipsync.phonemes import PHONEMES, SILENCE, PhonemeEvent

Indices = NDArray[np.int64]

#: Two phonemes before, the one going on, two after.
SLOTS = 5
#: Stands where no phoneme is, or none is known yet.
UNKNOWN = len(PHONEMES)
_INDEX_OF = {phoneme: index for index, phoneme in enumerate(PHONEMES)}
_SILENCE = _INDEX_OF[SILENCE]
#: Sums of the same times differ by less.
_ROUNDING_S = 1e-9


@dataclass(frozen=True, slots=True)
class PhonemeTrack:
    """Decided phonemes end to end over all time, as indices in `PHONEMES`; gaps are silence.

    Phoneme i lasts from starts_s[i] to ends_s[i] = starts_s[i + 1]; no silence follows a silence.
    starts_s[0] is minus infinity, the last end is infinite.
    """

    phonemes: tuple[int, ...]
    starts_s: tuple[float, ...]
    ends_s: tuple[float, ...]


def track_of(events: Iterable[PhonemeEvent]) -> PhonemeTrack:
    """Return the track of phoneme events, which must be in order of time and not overlap."""
    phonemes, starts_s, end_s = [_SILENCE], [-math.inf], -math.inf

    def begin_phoneme(phoneme: int, start_s: float) -> None:
        if not (phoneme == phonemes[-1] == _SILENCE):
            phonemes.append(phoneme)
            starts_s.append(start_s)

    for event in events:
        if event.start_s > end_s + _ROUNDING_S:
            begin_phoneme(_SILENCE, end_s)
        begin_phoneme(_INDEX_OF[event.phoneme], event.start_s)
        end_s = math.inf if event.end_s is None else event.end_s
    if math.isfinite(end_s):
        begin_phoneme(_SILENCE, end_s)
    return PhonemeTrack(tuple(phonemes), tuple(starts_s), (*starts_s[1:], math.inf))


def context_at(
    track: PhonemeTrack, time_s: float, known_until_s: float
) -> tuple[list[int], list[float]]:
    """Return the context of `time_s`: five phonemes around it and six times, as far as known.

    Phonemes: indices of the two before, the present one, the two after; UNKNOWN where there is no
    such phoneme or it is not known. Times, in seconds: since the starts of the first three,
    infinite where there is no such phoneme; until the ends of the last three, NaN where that end
    lies after the sound time `known_until_s`.
    """
    limit_s = known_until_s + _ROUNDING_S
    # The index of the present phoneme.
    at = bisect_right(track.starts_s, min(time_s + _ROUNDING_S, limit_s)) - 1
    phonemes = [track.phonemes[i] if i >= 0 else UNKNOWN for i in (at - 2, at - 1, at)]
    times_s = [time_s - track.starts_s[i] if i >= 0 else math.inf for i in (at - 2, at - 1, at)]
    for i in (at, at + 1, at + 2):
        end_s = track.ends_s[i] if i < len(track.ends_s) else math.inf
        known = end_s <= limit_s
        times_s.append(end_s - time_s if known else math.nan)
        if i < at + 2:
            phonemes.append(track.phonemes[i + 1] if known else UNKNOWN)
        # Beyond the first end that is not known nothing is known: fill up and stop.
        if not known:
            times_s.extend([math.nan] * (at + 2 - i))
            phonemes.extend([UNKNOWN] * (SLOTS - len(phonemes)))
            break
    return phonemes, times_s


def contexts(
    track: PhonemeTrack, times_s: Sequence[float] | Array, lookahead_s: float
) -> tuple[Indices, Array]:
    """Return the contexts (`context_at`) of many instants.

    Parameters
    ----------
    track : PhonemeTrack
        Phonemes with their times.
    times_s : Sequence[float] | Array
        (n,) sound times of the instants.
    lookahead_s : float
        Seconds of sound known beyond each instant.

    Returns
    -------
    tuple[Indices, Array]
        Phonemes (n, 5) and times (n, 6) in s, as `context_at` returns them.
    """
    each_context = [context_at(track, float(t), float(t) + lookahead_s) for t in times_s]
    phonemes = np.array([p for p, _ in each_context], dtype=np.int64).reshape(-1, SLOTS)
    return phonemes, np.array([t for _, t in each_context]).reshape(-1, 6)


#: Times are capped here, s: since the starts of the phone before last, the last, this one; until
#: the ends of this one, the next, the one after. Of the phones of grid_s1 95 % last at most 0.16 s
#: and 99 % at most 0.23 s; a longer memory only tells sentences apart.
_LONGEST_EACH_S = (0.5, 0.4, 0.3, 0.25, 0.3, 0.3)
_LONGEST_S = np.array(_LONGEST_EACH_S)
#: How fast an end that comes near makes itself felt, s: the last frame, and the last few.
_NEAR_S = (0.04, 0.1)
#: Windows of one recorded frame each, from 280 ms before to 200 ms after: what a mouth remembers
#: and the most that is ever known beforehand.
_WINDOW_S = 0.04
_WINDOWS_S = np.arange(-7, 6) * _WINDOW_S
N_WINDOWS = len(_WINDOWS_S) - 1
_SLOT_NUMBERS = np.arange(SLOTS)
#: The unit of the look-ahead feature.
_LOOKAHEAD_UNIT_S = 0.1
#: How long the last two phonemes took says how fast the speaker goes: in units of a usual one, at
#: most four of them; where none was, one and a half.
_USUAL_S, _SLOWEST, _UNHEARD = 0.1, 4.0, 1.5
N_TIMING = 6 + 3 + 2 + 3 * len(_NEAR_S) + 3 + 1 + 3


def timing_features(times_s: Array, lookahead_s: Array) -> Array:
    """Return features of the times of contexts, between 0 and about 1, as input of the networks.

    Parameters
    ----------
    times_s : Array
        (n, 6) times of `context_at`, NaN: not known.
    lookahead_s : Array
        (n,) seconds of sound known beyond each instant.

    Returns
    -------
    Array
        (n, N_TIMING) features.
    """
    known = ~np.isnan(times_s)
    share = np.where(known, np.clip(times_s, 0.0, _LONGEST_S), 0.0) / _LONGEST_S
    ends_s = np.where(known[:, 3:], times_s[:, 3:], np.inf)
    starts_s = np.where(known[:, :3], times_s[:, :3], np.inf)
    # Each falls from 1 to 0 with the time until an end, and since a start.
    near = [np.exp(-ends_s / unit_s) for unit_s in _NEAR_S]
    fresh = np.exp(-starts_s / _NEAR_S[1])
    lookahead = lookahead_s[:, None] / _LOOKAHEAD_UNIT_S
    features = np.concatenate(
        [share, known[:, 3:], np.sqrt(share[:, 2:4]), *near, fresh, lookahead, _pace(starts_s)],
        axis=1,
    )
    return np.asarray(features, dtype=np.float64)


def _pace(starts_s: Array) -> Array:
    """Return the speaker's pace (n, 3): two durations in units of 0.1 s and their mean's log.

    starts_s: (n, 3), seconds since the phone before last, the last phone and the present phone
    began, infinite where there is none. The durations are those of the first two. With a logarithm
    half as fast is as far from usual as twice as fast.
    """
    # Where there was no such phoneme its duration counts as 1.5 units.
    heard = np.isfinite(starts_s[:, :2])
    before = np.where(heard, starts_s[:, :2], 0.0)
    lasted = np.where(heard, (before - np.where(heard, starts_s[:, 1:], 0.0)) / _USUAL_S, _UNHEARD)
    lasted = np.clip(lasted, 0.0, _SLOWEST)
    mean = np.log(np.maximum(lasted.mean(axis=1, keepdims=True), 1.0 / _SLOWEST))
    return np.concatenate([lasted, mean], axis=1)


#: Contexts for which `timing_features_at` one by one is the quicker.
_FEW = 4


def timing_features_at(times_s: list[float], lookahead_s: float) -> list[float]:
    """Return the N_TIMING `timing_features` of one context, faster than by NumPy.

    times_s: six times of `context_at`; lookahead_s: seconds of sound known beyond the instant.
    """
    known = [not math.isnan(time_s) for time_s in times_s]
    share = [
        min(max(time_s, 0.0), longest_s) / longest_s if is_known else 0.0
        for time_s, is_known, longest_s in zip(times_s, known, _LONGEST_EACH_S, strict=True)
    ]
    begun_s = [time_s if ok else math.inf for time_s, ok in zip(times_s[:3], known, strict=False)]
    ends_s = [time_s if ok else math.inf for time_s, ok in zip(times_s[3:], known[3:], strict=True)]
    lasted = [
        min(max((begun - ended) / _USUAL_S, 0.0), _SLOWEST) if math.isfinite(begun) else _UNHEARD
        for begun, ended in pairwise(begun_s)
    ]
    return [
        *share,
        *map(float, known[3:]),
        math.sqrt(share[2]),
        math.sqrt(share[3]),
        *(math.exp(-end_s / unit_s) for unit_s in _NEAR_S for end_s in ends_s),
        *(math.exp(-start_s / _NEAR_S[1]) for start_s in begun_s),
        lookahead_s / _LOOKAHEAD_UNIT_S,
        *lasted,
        math.log(max(sum(lasted) / len(lasted), 1.0 / _SLOWEST)),
    ]


def window_shares(times_s: Array, lookahead_s: Array) -> Array:
    """Return how much of each 40 ms window around an instant each phoneme of its context fills.

    Phonemes not known, and the time beyond the instant plus look-ahead L, fill nothing.

    Parameters
    ----------
    times_s : Array
        (n, 6) times of `context_at`, NaN: not known.
    lookahead_s : Array
        (n,): L, seconds of sound known beyond each instant.

    Returns
    -------
    Array
        (n, N_WINDOWS, SLOTS), 0 to 1.
    """
    # The borders of the five phonemes, s after the instant; unknown ends lie at the limit.
    limit_s = lookahead_s[:, None]
    ends_s = np.where(np.isnan(times_s[:, 3:]), limit_s, np.minimum(times_s[:, 3:], limit_s))
    borders_s = np.concatenate([-times_s[:, :3], np.maximum.accumulate(ends_s, axis=1)], axis=1)
    # The overlap of each window with each phoneme.
    from_s = np.maximum(borders_s[:, None, :-1], _WINDOWS_S[:-1, None])
    until_s = np.minimum(borders_s[:, None, 1:], _WINDOWS_S[1:, None])
    return np.asarray(np.clip((until_s - from_s) / _WINDOW_S, 0.0, 1.0))


@dataclass(frozen=True, slots=True)
class Stack:
    """m networks with h1 and h2 hidden units; the phonemes' part of their first layer is not in it.

    timing: (N_TIMING + 1, m h1), the first layer for the timing features, its bias in the last row;
    hidden: (m, h1 + 1, h2), the second layer, its bias in the last row; output: (m h2 + 1,
    n_components), the last layer, its bias in the last row, already divided by the number of all
    networks that are averaged.
    """

    timing: Array
    hidden: Array
    output: Array

    def faces(self, first: Array, timing: Array) -> Array:
        """Return these networks' part of the mean face: the sum of their outputs.

        `output` contains the division by the number of all networks.

        Parameters
        ----------
        first : Array
            (n, m h1): the phonemes' part of the first layer, sums of rows of their tables.
        timing : Array
            (n, N_TIMING) timing features.

        Returns
        -------
        Array
            (n, n_components) face coefficients.
        """
        first = first + timing @ self.timing[:-1] + self.timing[-1]
        np.maximum(first, 0.0, out=first)
        n_networks, n_first = len(self.hidden), self.hidden.shape[1] - 1
        grouped = first.reshape(len(first), n_networks, n_first).transpose(1, 0, 2)
        second = np.matmul(grouped, self.hidden[:, :-1]) + self.hidden[:, -1:]
        np.maximum(second, 0.0, out=second)
        joined = second.transpose(1, 0, 2).reshape(len(first), -1)
        return np.asarray(joined @ self.output[:-1] + self.output[-1])


@dataclass(frozen=True, slots=True)
class Expectation:
    """The predictor of the mouth's mean motion: two families of networks that err differently.

    The mean of their outputs is the face expected in a context. The first family reads phonemes by
    their number in the sequence: slot_tables (SLOTS, 41, m h1), the first layer for each slot and
    phoneme. The second reads them by their time: for each window of 40 ms, which share of it each
    phoneme fills; window_tables (N_WINDOWS, 41, m h1). The last row of a table is for UNKNOWN.
    back_off: the fixed method that has a share where phonemes meet that did not in training; None:
    of models without one.
    """

    slot_tables: Array
    slots: Stack
    window_tables: Array
    windows: Stack
    back_off: BackOff | None = None

    def at(self, phonemes: list[int], times_s: list[float], lookahead_s: float) -> Array:
        """Return the face expected in one context (`context_at`), with the back-off's share in it.

        Parameters
        ----------
        phonemes : list[int]
            5 phoneme indices.
        times_s : list[float]
            6 times relative to the instant, NaN: not known.
        lookahead_s : float
            Seconds of sound known beyond the instant.

        Returns
        -------
        Array
            (n_components,) face coefficients.
        """
        timing = np.array([timing_features_at(times_s, lookahead_s)])
        by_slot = self.slot_tables[_SLOT_NUMBERS, phonemes].sum(axis=0)[None]
        filled = window_shares(np.array([times_s]), np.array([lookahead_s]))[0]
        # Only the rows of phonemes that fill a part of a window, each weighted by that part.
        windows, slots = np.nonzero(filled)
        rows = self.window_tables[windows, np.array(phonemes)[slots]]
        by_window = (filled[windows, slots] @ rows)[None]
        face: Array = (self.slots.faces(by_slot, timing) + self.windows.faces(by_window, timing))[0]
        if self.back_off is None:
            return face
        return self.back_off.mixed(face, phonemes, times_s, lookahead_s)

    def faces(self, phonemes: Indices, times_s: Array, lookahead_s: Array) -> Array:
        """Return the networks' faces in several contexts, without back-off.

        Parameters
        ----------
        phonemes : Indices
            (n, 5) phoneme indices.
        times_s : Array
            (n, 6) times relative to the instants, NaN: not known.
        lookahead_s : Array
            (n,) seconds of sound known beyond each instant.

        Returns
        -------
        Array
            (n, n_components) face coefficients.
        """
        # For few contexts the scalar computation is the quicker.
        if len(phonemes) <= _FEW:
            each = zip(times_s.tolist(), lookahead_s.tolist(), strict=True)
            timing = np.array([timing_features_at(*context) for context in each])
        else:
            timing = timing_features(times_s, lookahead_s)
        by_slot = self.slot_tables[np.arange(SLOTS), phonemes].sum(axis=1)
        # All windows' rows, weighted by the share that each phoneme fills, in one product.
        filled = window_shares(times_s, lookahead_s).reshape(len(phonemes), 1, -1)
        windows = np.arange(N_WINDOWS)[:, None]
        rows = self.window_tables[windows, phonemes[:, None, :]]
        by_window = (filled @ rows.reshape(len(phonemes), N_WINDOWS * SLOTS, -1))[:, 0]
        return self.slots.faces(by_slot, timing) + self.windows.faces(by_window, timing)

    def faces_after(self, track: PhonemeTrack, times_s: Array, known_until_s: float) -> Array:
        """Return the expected faces at times, with back-off, by the phonemes known at one instant.

        Parameters
        ----------
        track : PhonemeTrack
            Phonemes with their times.
        times_s : Array
            (n,) sound times of the faces.
        known_until_s : float
            Sound time until which phonemes are known.

        Returns
        -------
        Array
            (n, n_components) face coefficients.
        """
        each_context = [context_at(track, time_s, known_until_s) for time_s in times_s.tolist()]
        phonemes = np.array([phonemes for phonemes, _ in each_context])
        known_s = np.maximum(known_until_s - times_s, 0.0)
        faces = self.faces(phonemes, np.array([times for _, times in each_context]), known_s)
        if self.back_off is not None:
            for i, (context, known) in enumerate(zip(each_context, known_s.tolist(), strict=True)):
                faces[i] = self.back_off.mixed(faces[i], *context, known)
        return faces

    def arrays(self) -> dict[str, Array]:
        """Return all arrays that a model file must store.

        Returns
        -------
        dict[str, Array]
            By name, each in the shape that its class describes; those of the back-off only if there
            is one.
        """
        arrays = {
            "slot_tables": self.slot_tables,
            "window_tables": self.window_tables,
            **{f"slots_{name}": getattr(self.slots, name) for name in _STACK},
            **{f"windows_{name}": getattr(self.windows, name) for name in _STACK},
        }
        if self.back_off is not None:
            arrays["centres"] = self.back_off.centres
            arrays["diphones"] = self.back_off.diphones.astype(float)
        return arrays

    def check(self, n_components: int) -> None:
        """Raise ValueError unless shapes fit each other and `n_components`, and all is finite."""
        shapes: dict[str, tuple[tuple[int, ...], tuple[int, ...]]] = {}
        # Of both families: the expected shapes follow from those of the hidden layers.
        families = (
            ("slot", SLOTS, self.slot_tables, self.slots),
            ("window", N_WINDOWS, self.window_tables, self.windows),
        )
        for name, n_tables, tables, stack in families:
            n_networks, n_inputs, n_second = stack.hidden.shape
            width = n_networks * (n_inputs - 1)
            n_output_rows = n_networks * n_second + 1
            shapes[f"{name}_tables"] = (tables.shape, (n_tables, UNKNOWN + 1, width))
            shapes[f"{name}s_timing"] = (stack.timing.shape, (N_TIMING + 1, width))
            shapes[f"{name}s_output"] = (stack.output.shape, (n_output_rows, n_components))
        if self.back_off is not None:
            centres, diphones = self.back_off.centres, self.back_off.diphones
            shapes["centres"] = (centres.shape, (UNKNOWN, n_components))
            shapes["diphones"] = (diphones.shape, (UNKNOWN + 1, UNKNOWN + 1))
        for field, (shape, expected) in shapes.items():
            if shape != expected:
                raise ValueError(f"array {field} has shape {shape}, expected {expected}")
        for field, values in self.arrays().items():
            if not np.isfinite(values).all():
                raise ValueError(f"array {field} has values that are not finite")


_STACK = ("timing", "hidden", "output")


def expectation_of(arrays: dict[str, Array]) -> Expectation:
    """Return the expectation made of the arrays that `Expectation.arrays` returns.

    Parameters
    ----------
    arrays : dict[str, Array]
        By name, each with its original shape.

    Returns
    -------
    Expectation
        An equal expectation.

    Raises
    ------
    KeyError
        An array is missing.
    """
    slots, windows = (
        Stack(*(arrays[f"{family}_{name}"] for name in _STACK)) for family in ("slots", "windows")
    )
    has_back_off = "diphones" in arrays
    back_off = BackOff(arrays["centres"], arrays["diphones"] > 0.0) if has_back_off else None
    return Expectation(arrays["slot_tables"], slots, arrays["window_tables"], windows, back_off)


def constant_expectation(faces: Array) -> Expectation:
    """Return an expectation by the present phoneme only, for corpora too small to train networks.

    The expectation returns exactly a row of `faces`: each phoneme has two rectifiers a component.

    Parameters
    ----------
    faces : Array
        (40, n_components), a row for each phoneme.

    Returns
    -------
    Expectation
        Its faces are rows of `faces`.
    """
    n_components = faces.shape[1]
    width = 2 * n_components
    tables = np.zeros((SLOTS, UNKNOWN + 1, width))
    # Two rectifiers, of x and of -x, whose difference is x; slot 2 is the present phoneme.
    tables[2, : len(PHONEMES)] = np.concatenate([faces, -faces], axis=1)
    timing = np.zeros((N_TIMING + 1, width))
    hidden = np.concatenate([np.eye(width), np.zeros((1, width))])[None]
    output = np.concatenate(
        [np.eye(n_components), -np.eye(n_components), np.zeros((1, n_components))]
    )
    return Expectation(
        tables,
        Stack(timing, hidden, output),
        np.zeros((N_WINDOWS, UNKNOWN + 1, width)),
        Stack(timing, hidden, np.zeros_like(output)),
    )


#: The part of a model file that holds the expectation.
EXPECTATION_PART = "expectation"


def read_expectation(file: ModelFile, n_components: int) -> Expectation:
    """Return the expectation, which predicts mean faces from phonemes, of an open model file.

    n_components: number of components of the face. Raises ModelError if the expectation is missing,
    damaged or made for another number of components.
    """

    def assemble(arrays: Mapping[str, NDArray[np.generic]]) -> Expectation:
        floats = {name: np.asarray(array, dtype=np.float64) for name, array in arrays.items()}
        expectation = expectation_of(floats)
        expectation.check(n_components)
        return expectation

    return file.read(EXPECTATION_PART, assemble)


def expectation_arrays(expectation: Expectation) -> dict[str, NDArray[np.generic]]:
    """Return the arrays that a model file stores for an expectation.

    Parameters
    ----------
    expectation : Expectation
        The expectation to store.

    Returns
    -------
    dict[str, NDArray[np.generic]]
        By name, float32, in the shape of `Expectation.arrays`.
    """
    return {name: values.astype(np.float32) for name, values in expectation.arrays().items()}
