"""Statistics of recorded frames for a face model: rest, closures, weights, components. Offline.

- How and when the speaker's lips close.
- Weights for learning that has none: of n things in their order, round(n w) are chosen at even
  distances (systematic sampling), so that a weight of 2 takes each twice, 0.5 every second.
- Principal components of frames with weights.
- The closed mouth of silence: the face at rest, on which motion of other speakers is laid.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator, eigsh

from lipservo_lab.corpus.utterance import Utterance
from lipservo_lab.learning.expectation.expectation_training import (
    TrainingSet,
    collect_training_set,
    joined,
)
from lipsync.arrays import Array
from lipsync.markers import CLOSED_GAP_MM, PointLayout
from lipsync.phonemes import PHONEMES, SILENCE, PhonemeEvent

_CLOSING = ("P", "B", "M", "F", "V")
#: The tightest moment is looked for this far around the phone: labels are good to a few tens of ms.
_AROUND_S = 0.04
#: Frames whose gap is within this of the smallest gap count as equally tight: the tracker's jitter
#: is about 0.1 mm.
_AS_TIGHT_MM = 0.15
_STEP_S = 0.005
#: A phoneme with fewer phones takes the median of all closing phones.
_FEWEST = 5


@dataclass(frozen=True, slots=True)
class Closures:
    """When and how far the lips close; see `FaceModel`.

    labiodental_gap_mm: the mean gap of F and V at that time. tightest_s: (40,), s from a phone's
    start until the lips are nearest; 0 for phonemes that do not close.
    """

    labiodental_gap_mm: float
    tightest_s: Array


def observe_closures(
    utterances: Iterable[Utterance], lip_gaps_mm: Callable[[NDArray[np.floating]], Array]
) -> Closures:
    """Return when the lips are nearest in P, B, M, F and V, and how near in F and V.

    The time is the median over a phoneme's phones; a phoneme with fewer than five takes the median
    of all closing phones.

    Parameters
    ----------
    utterances : Iterable[Utterance]
        Sentences with phone labels.
    lip_gaps_mm : Callable[[NDArray[np.floating]], Array]
        Returns for markers (n_frames, n_points, 3) the distance of the lips, (n_frames,) mm.

    Returns
    -------
    Closures
        Gap in mm and times in s.
    """
    tightest_of: dict[str, list[float]] = {phoneme: [] for phoneme in _CLOSING}
    labiodental: list[tuple[str, Array, Array]] = []
    for utterance in utterances:
        gaps_mm = lip_gaps_mm(utterance.markers_mm)
        frames_s = np.arange(len(gaps_mm)) / utterance.frame_rate_hz
        for phone in utterance.phones:
            if phone.phoneme not in _CLOSING or phone.end_s is None:
                continue
            times_s = np.arange(phone.start_s - _AROUND_S, phone.end_s + _AROUND_S, _STEP_S)
            around_mm = np.interp(times_s, frames_s, gaps_mm)
            # All times at which the gap is about the smallest; their mean is the time of closure.
            tight = around_mm <= around_mm.min() + _AS_TIGHT_MM
            tightest_of[phone.phoneme].append(float(times_s[tight].mean() - phone.start_s))
            if phone.phoneme in ("F", "V"):
                labiodental.append((phone.phoneme, times_s - phone.start_s, around_mm))
    all_s = [time_s for found_s in tightest_of.values() for time_s in found_s] or [0.0]
    tightest_s = np.zeros(len(PHONEMES))
    for phoneme, found_s in tightest_of.items():
        chosen_s = found_s if len(found_s) >= _FEWEST else all_s
        # Inside the phone, or a closure would belong to the phone before.
        tightest_s[PHONEMES.index(phoneme)] = max(0.0, float(np.median(chosen_s)))
    gaps_then_mm = [
        np.interp(tightest_s[PHONEMES.index(phoneme)], since_s, around_mm)
        for phoneme, since_s, around_mm in labiodental
    ]
    gap_mm = float(np.mean(gaps_then_mm)) if gaps_then_mm else CLOSED_GAP_MM
    return Closures(gap_mm, tightest_s)


def counted(n: int, weight: float) -> NDArray[np.int64]:
    """Return indices of n things in their order, each taken `weight` times on average.

    Parameters
    ----------
    n : int
        Number of things.
    weight : float
        How often each is taken; 1: each once, 0.5: every second.

    Returns
    -------
    NDArray[np.int64]
        (round(n weight),) indices, ascending; at least one unless n is 0.
    """
    n_taken = max(1, round(n * weight)) if n else 0
    return np.minimum((np.arange(n_taken) + 0.5) * n / max(n_taken, 1), n - 1).astype(np.int64)


def counted_training_set(
    utterances: Sequence[Utterance],
    coefficients: Sequence[Array],
    heard: Mapping[str, Sequence[PhonemeEvent]] | None = None,
) -> TrainingSet:
    """Return `collect_training_set` with each context repeated or thinned by its sentence's weight.

    Parameters
    ----------
    utterances : Sequence[Utterance]
        Sentences with phone labels.
    coefficients : Sequence[Array]
        Face coefficients (n_frames, n_components) of each.
    heard : Mapping[str, Sequence[PhonemeEvent]] | None
        Recognised phonemes by sentence name, in place of the labels; None: the labels.

    Returns
    -------
    TrainingSet
        Contexts of shape (n, 5), and faces.
    """
    sets = []
    for weight in dict.fromkeys(u.weight for u in utterances):
        of_weight = [i for i, u in enumerate(utterances) if u.weight == weight]
        found = collect_training_set(
            [utterances[i] for i in of_weight], [coefficients[i] for i in of_weight], heard
        )
        rows = counted(len(found.faces), weight)
        sets.append(
            TrainingSet(
                found.phonemes[rows],
                found.times_s[rows],
                found.lookahead_s[rows],
                found.faces[rows],
            )
        )
    return joined(sets)


def counted_sentences(utterances: Sequence[Utterance]) -> list[int]:
    """Return the indices of the utterances, repeated or thinned by their weights.

    Indices of utterances with the same weight follow one another.
    """
    chosen: list[int] = []
    for weight in dict.fromkeys(u.weight for u in utterances):
        of_weight = [i for i, u in enumerate(utterances) if u.weight == weight]
        chosen += [of_weight[i] for i in counted(len(of_weight), weight)]
    return chosen


#: Of more values the covariance is not formed: dense scans have 20,000.
_MOST_FOR_COVARIANCE = 1_500


@dataclass(frozen=True, slots=True)
class PrincipalComponents:
    """mean (n_values,); basis (n_components, n_values), rows orthonormal, the largest first.

    variance_held: the share of the variance that they hold.
    """

    mean: Array
    basis: Array
    variance_held: float

    def coefficients(self, frames: Array) -> Array:
        """Return the coefficients of frames, (frame - mean) times the basis.

        Parameters
        ----------
        frames : Array
            (n_frames, n_values).

        Returns
        -------
        Array
            (n_frames, n_components).
        """
        return np.asarray(frames @ self.basis.T - self.mean @ self.basis.T)


def principal_components(frames: Array, weights: Array, n_components: int) -> PrincipalComponents:
    """Return the leading eigenvectors of the weighted covariance.

    The entry with the largest amount in each component is positive, so that the same frames give
    the same signs.

    Parameters
    ----------
    frames : Array
        (n_frames, n_values).
    weights : Array
        (n_frames,), a frame of weight 2 counts as two.
    n_components : int
        Number of components.

    Returns
    -------
    PrincipalComponents
        Basis of shape (n_components, n_values).
    """
    total = weights.sum()
    mean = (frames * weights[:, None]).sum(axis=0) / total
    if frames.shape[1] > _MOST_FOR_COVARIANCE:
        return _lanczos(frames - mean, mean, weights, n_components)
    weighted = frames * np.sqrt(weights)[:, None]
    scatter = weighted.T @ weighted - total * np.outer(mean, mean)
    variances, vectors = np.linalg.eigh(scatter)
    variances, basis = np.maximum(variances[::-1], 0.0), vectors.T[::-1]
    held = float(variances[:n_components].sum() / variances.sum())
    return PrincipalComponents(mean, _with_fixed_signs(basis)[:n_components].copy(), held)


def _lanczos(centred: Array, mean: Array, weights: Array, n_components: int) -> PrincipalComponents:
    """Return the leading components by Lanczos' method, without forming the covariance.

    centred: frames less their mean, (n_frames, n_values); weights: (n_frames,).
    """
    n_values = centred.shape[1]
    operator = LinearOperator(
        (n_values, n_values), matvec=lambda v: centred.T @ (weights * (centred @ v.ravel()))
    )
    variances, vectors = eigsh(operator, k=n_components, v0=np.ones(n_values))
    variances, basis = np.maximum(variances[::-1], 0.0), vectors.T[::-1]
    total = float((weights * np.einsum("ij,ij->i", centred, centred)).sum())
    return PrincipalComponents(mean, _with_fixed_signs(basis), float(variances.sum()) / total)


def _with_fixed_signs(basis: Array) -> Array:
    """Return components (n, n_values), each with its largest entry by amount made positive."""
    largest = np.take_along_axis(basis, np.abs(basis).argmax(axis=1)[:, None], axis=1)
    return np.ascontiguousarray(basis * np.sign(largest))


#: In silence the speaker of grid_s1 has the lips within 1 mm in a third of the frames.
_CLOSED_SHARE = 1.0 / 3.0


def mean_at_rest(
    utterances: Iterable[Utterance], motion: Sequence[Array], layout: PointLayout
) -> Array:
    """Return the mean of silent frames with closed lips, at least of the tenth with smallest gaps.

    Without silence: the mean of all frames.

    Parameters
    ----------
    utterances : Iterable[Utterance]
        Sentences with phone labels.
    motion : Sequence[Array]
        (n_frames, n) of each: the values to be averaged, for example coefficients.
    layout : PointLayout
        Of the utterances' markers.

    Returns
    -------
    Array
        (n,).
    """
    silent, gap_mm = _silent_frames(utterances, motion, layout)
    if not len(silent):
        silent, gap_mm = np.concatenate(motion), np.zeros(sum(map(len, motion)))
    threshold = max(CLOSED_GAP_MM, float(np.quantile(gap_mm, 0.1)))
    return np.asarray(silent[gap_mm <= threshold].mean(axis=0))


def closed_mouth_mm(utterances: Sequence[Utterance], layout: PointLayout) -> Array:
    """Return the mean face of the third of all silent frames that has the smallest lip gaps.

    A share decides, not a distance in mm, so that it is the same mouth on a face of another size.
    Without silence all frames count.

    Parameters
    ----------
    utterances : Sequence[Utterance]
        Sentences with phone labels.
    layout : PointLayout
        Of the utterances' markers.

    Returns
    -------
    Array
        (n_points, 3) mm.
    """
    motion = [u.markers_mm.reshape(len(u.markers_mm), -1).astype(np.float64) for u in utterances]
    silent, gap_mm = _silent_frames(utterances, motion, layout)
    if not len(silent):
        silent = np.concatenate(motion)
        gap_mm = np.linalg.norm(layout.gap_vectors_mm(silent.reshape(len(silent), -1, 3)), axis=1)
    closed: Array = silent[gap_mm <= np.quantile(gap_mm, _CLOSED_SHARE)]
    return np.asarray(closed.mean(axis=0).reshape(-1, 3))


def _silent_frames(
    utterances: Iterable[Utterance], motion: Sequence[Array], layout: PointLayout
) -> tuple[Array, Array]:
    """Return the silent frames of all utterances, (n, ...), and their lip gaps, (n,) mm.

    Frames outside all phones but SIL are silent. motion: values (n_frames, ...) of each utterance.
    """
    silent, gaps_mm = [], []
    for utterance, frames in zip(utterances, motion, strict=True):
        times_s = np.arange(len(frames)) / utterance.frame_rate_hz
        spoken = np.zeros(len(frames), dtype=bool)
        for phone in utterance.phones:
            if phone.phoneme != SILENCE and phone.end_s is not None:
                spoken |= (times_s >= phone.start_s) & (times_s < phone.end_s)
        lips = layout.gap_vectors_mm(utterance.markers_mm)
        silent.append(frames[~spoken])
        gaps_mm.append(np.linalg.norm(lips[~spoken], axis=1))
    return np.concatenate(silent), np.concatenate(gaps_mm)
