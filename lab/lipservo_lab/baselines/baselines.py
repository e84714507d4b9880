"""The baselines for comparison, as learned from the training sentences; only evaluation uses them.

- Dominance functions: every phone attracts the face, the more the nearer it is. After Cohen and
  Massaro, "Modeling coarticulation in synthetic visual speech", 1993. They use the whole sentence.
- One linear regression from phoneme context to face, frame by frame: it gets what the live method
  gets, the five phonemes and six times of a context.
- Catmull-Rom splines through the centres of phones. Catmull and Rom, "A class of local
  interpolating splines", 1974; non-uniform, each slope the difference of the two neighbours over
  their distance in time. They use the whole sentence.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array
from lipsync.expectation.expectation import SLOTS, UNKNOWN, timing_features
from lipsync.face.model import ModelFile
from lipsync.phonemes import PHONEMES, SILENCE, VISEME_CLASSES, VISEME_OF, PhonemeEvent

#: The fixed reference of every error ratio, never retuned: D = exp(-(24 |tau|)^1.4).
REFERENCE_RATE_PER_S, REFERENCE_POWER = 24.0, 1.4
_TINY = 1e-300


@dataclass(frozen=True, slots=True)
class Dominance:
    """Dominance D = exp(-(rate |tau|)^power), by viseme class and direction.

    tau: seconds from the phone's centre; for silence from its edge, 0 inside. rates_per_s, powers:
    (16, 2), a row for each of VISEME_CLASSES; first column before the phone's centre, second after
    it.
    """

    rates_per_s: Array
    powers: Array

    def face_at(self, phones: Sequence[PhonemeEvent], centres: Array, times_s: Array) -> Array:
        """Return faces of a whole sentence: means of its phones' faces, weighted by dominance.

        Parameters
        ----------
        phones : Sequence[PhonemeEvent]
            Phones of the sentence, in order.
        centres : Array
            (40, n_components), the face of each phoneme.
        times_s : Array
            (n,), sound times of the faces.

        Returns
        -------
        Array
            (n, n_components).
        """
        log_weights = -self.exponents(phones, times_s)
        # Divided by the largest: far from all phones every weight would be 0.
        weights = np.exp(log_weights - log_weights.max(axis=1, keepdims=True))
        targets = centres[[PHONEMES.index(p.phoneme) for p in phones]]
        return np.asarray(weights @ targets / weights.sum(axis=1, keepdims=True))

    def exponents(self, phones: Sequence[PhonemeEvent], times_s: Array) -> Array:
        """Return (rate |tau|)^power of each phone; tau is the time from its centre, `distances_s`.

        Parameters
        ----------
        phones : Sequence[PhonemeEvent]
            Phones of the sentence, in order.
        times_s : Array
            (n,), sound times of the faces.

        Returns
        -------
        Array
            (n, n_phones).
        """
        classes = [VISEME_OF[p.phoneme] for p in phones]
        tau_s = distances_s(phones, times_s)
        after = (tau_s > 0.0).astype(np.intp)
        rate, power = self.rates_per_s[classes, after], self.powers[classes, after]
        return np.asarray(np.maximum(rate * np.abs(tau_s), _TINY) ** power)


def distances_s(phones: Sequence[PhonemeEvent], times_s: Array) -> Array:
    """Return tau, the time of each frame relative to the centre of each phone: negative before it.

    Parameters
    ----------
    phones : Sequence[PhonemeEvent]
        Phones of the sentence, in order.
    times_s : Array
        (n,), sound times of the faces.

    Returns
    -------
    Array
        (n, n_phones) s.
    """
    starts_s = np.array([p.start_s for p in phones])
    ends_s = np.array([np.inf if p.end_s is None else p.end_s for p in phones])
    silent = np.array([p.phoneme == SILENCE for p in phones])
    centre_s = np.where(silent, 0.0, (starts_s + ends_s) / 2.0)
    t = np.asarray(times_s)[:, None]
    from_edge = np.where(t < starts_s, t - starts_s, np.maximum(t - ends_s, 0.0))
    return np.asarray(np.where(silent, from_edge, t - centre_s))


def fixed_reference() -> Dominance:
    """Return the fixed reference, whose error every ratio is divided by: 1.80 mm on grid_s1."""
    shape = (len(VISEME_CLASSES), 2)
    return Dominance(np.full(shape, REFERENCE_RATE_PER_S), np.full(shape, REFERENCE_POWER))


Indices = NDArray[np.int64]

#: Ridge in units of frames; any value from 10 to 1000 gives the same ratio to two digits.
_RIDGE = 100.0


@dataclass(frozen=True, slots=True)
class PlainRegression:
    """A linear regression from a phoneme context to the face.

    weights: (5 * 41 + N_TIMING + 1, n_components): what each phoneme in each slot, each timing
    feature, and the constant add.
    """

    weights: Array

    def faces(self, phonemes: Indices, times_s: Array, lookahead_s: Array) -> Array:
        """Return the faces that the regression predicts in n contexts.

        Parameters
        ----------
        phonemes : Indices
            (n, 5), as of `contexts`.
        times_s : Array
            (n, 6) s.
        lookahead_s : Array
            (n,).

        Returns
        -------
        Array
            (n, n_components).
        """
        return np.asarray(_inputs(phonemes, times_s, lookahead_s) @ self.weights)


def fit_regression(
    phonemes: Indices, times_s: Array, lookahead_s: Array, faces: Array
) -> PlainRegression:
    """Fit a linear regression from phoneme contexts to faces by least squares with a little ridge.

    Parameters
    ----------
    phonemes : Indices
        (n, 5), the phonemes around each of n instants, as from `contexts`.
    times_s : Array
        (n, 6), their times relative to the instant.
    lookahead_s : Array
        (n,), sound known beyond the instant.
    faces : Array
        (n, n_components), the faces to fit.

    Returns
    -------
    PlainRegression
        Weights of the inputs, (n_inputs, n_components).
    """
    inputs = _inputs(phonemes, times_s, lookahead_s)
    gram = inputs.T @ inputs + _RIDGE * np.eye(inputs.shape[1])
    return PlainRegression(np.asarray(np.linalg.solve(gram, inputs.T @ faces), dtype=np.float64))


def _inputs(phonemes: Indices, times_s: Array, lookahead_s: Array) -> Array:
    """Return the regression's inputs: one-hot phonemes, timing, 1; (n, 5 * 41 + N_TIMING + 1)."""
    names = np.zeros((len(phonemes), SLOTS, UNKNOWN + 1))
    np.put_along_axis(names, phonemes[:, :, None], 1.0, axis=2)
    timing = timing_features(times_s, lookahead_s)
    return np.concatenate(
        [names.reshape(len(phonemes), -1), timing, np.ones((len(phonemes), 1))], axis=1
    )


def viseme_centres(centres: Array, counts: Array) -> Array:
    """Return the faces of phonemes with each replaced by the mean of its viseme class.

    Parameters
    ----------
    centres : Array
        (40, n_components), the face of each phoneme.
    counts : Array
        (40,), how often each phoneme occurred in training.

    Returns
    -------
    Array
        (40, n_components).
    """
    classes = np.array([VISEME_OF[p] for p in PHONEMES])
    found = centres.copy()
    for number in range(classes.max() + 1):
        members = classes == number
        if counts[members].sum() > 0:
            found[members] = np.average(centres[members], axis=0, weights=counts[members])
    return found


def spline_faces(phones: Sequence[PhonemeEvent], targets: Array, times_s: Array) -> Array:
    """Return the faces of a spline through the faces of a sentence's phonemes.

    Parameters
    ----------
    phones : Sequence[PhonemeEvent]
        Phones of the sentence, in order.
    targets : Array
        (40, n_components), the face of each phoneme.
    times_s : Array
        (n,), sound times of the faces.

    Returns
    -------
    Array
        (n, n_components).
    """
    return joined_faces(phones, targets[[PHONEMES.index(p.phoneme) for p in phones]], times_s)


def joined_faces(phones: Sequence[PhonemeEvent], targets: Array, times_s: Array) -> Array:
    """Return the faces of a Catmull-Rom spline through one face for each phone.

    A phone's face is reached at its centre, that of a silence at both its edges; before the first
    and after the last it is held.

    Parameters
    ----------
    phones : Sequence[PhonemeEvent]
        Phones of the sentence, in order.
    targets : Array
        (n_phones, n_components), the face of each phone.
    times_s : Array
        (n,), sound times of the faces.

    Returns
    -------
    Array
        (n, n_components).
    """
    knots: list[tuple[float, int]] = []
    for number, phone in enumerate(phones):
        end_s = phone.start_s if phone.end_s is None else phone.end_s
        if phone.phoneme == SILENCE:
            knots += [(phone.start_s, number), (end_s, number)]
        else:
            knots.append(((phone.start_s + end_s) / 2.0, number))
    at_s = np.array([t for t, _ in knots])
    distinct = np.concatenate([[True], np.diff(at_s) > 1e-6])
    at_s, values = at_s[distinct], targets[[i for _, i in knots]][distinct]
    if len(at_s) < 2:
        return np.repeat(values[:1], len(times_s), axis=0)
    slopes = np.zeros_like(values)
    slopes[1:-1] = (values[2:] - values[:-2]) / (at_s[2:] - at_s[:-2])[:, None]
    t = np.clip(times_s, at_s[0], at_s[-1])
    i = np.clip(np.searchsorted(at_s, t, side="right") - 1, 0, len(at_s) - 2)
    width = (at_s[i + 1] - at_s[i])[:, None]
    u = (t - at_s[i])[:, None] / width
    # Cubic Hermite polynomials of the two values and slopes; u: 0 to 1 between the knots.
    faces = (1 + 2 * u) * (1 - u) ** 2 * values[i] + u**2 * (3 - 2 * u) * values[i + 1]
    faces += (u * (1 - u) ** 2 * slopes[i] + u**2 * (u - 1) * slopes[i + 1]) * width
    return np.asarray(faces)


#: The part of a model file that holds the baselines.
BASELINES_PART = "baselines"


@dataclass(frozen=True, slots=True)
class Baselines:
    """Parameters of all baselines.

    centres: (40, n_components), the mean face in the middle of each of `PHONEMES`; counts: (40,),
    how often each occurred. dominance: tuned to the training sentences.
    """

    centres: Array
    counts: Array
    dominance: Dominance
    regression: PlainRegression


def read_baselines(file: ModelFile, n_components: int) -> Baselines:
    """Read the baselines of an open model file, for a face with `n_components` components.

    Raises ModelError.
    """

    def assemble(arrays: Mapping[str, NDArray[np.generic]]) -> Baselines:
        """Return the baselines in a file's arrays; raise ValueError where `centres` is unusable."""
        found = {name: np.asarray(array, dtype=np.float64) for name, array in arrays.items()}
        centres = found["centres"]
        if centres.shape != (len(PHONEMES), n_components):
            expected = (len(PHONEMES), n_components)
            raise ValueError(f"centres has shape {centres.shape}, expected {expected}")
        if not np.isfinite(centres).all():
            raise ValueError("centres holds values that are not finite")
        return Baselines(
            centres,
            found["counts"],
            Dominance(*found["dominance"]),
            PlainRegression(found["regression"]),
        )

    return file.read(BASELINES_PART, assemble)


def baseline_arrays(baselines: Baselines) -> dict[str, NDArray[np.generic]]:
    """Return the arrays that a model file stores of the baselines.

    Parameters
    ----------
    baselines : Baselines
        To store.

    Returns
    -------
    dict[str, NDArray[np.generic]]
        By name; dominance is (2, 16, 2), rates and powers.
    """
    return {
        "centres": baselines.centres.astype(np.float32),
        "counts": baselines.counts.astype(np.float32),
        "dominance": np.stack([baselines.dominance.rates_per_s, baselines.dominance.powers]),
        "regression": baselines.regression.weights.astype(np.float32),
    }
