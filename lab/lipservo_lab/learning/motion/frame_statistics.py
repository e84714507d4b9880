"""The closed mouth of silence: what a face rests in, and what others' motion is laid on.

How and when the speaker's lips close: read off the recordings. Offline.

Weights where learning knows none: what counts twice is there twice, what counts half is thinned.

Systematic sampling: of n things in their order, round(n w) at even distances.

Principal components of frames that do not all count alike.
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
#: Frames this near to the smallest gap are as tight: the tracker's jitter is about 0.1 mm.
_AS_TIGHT_MM = 0.15
_STEP_S = 0.005
#: A phone seen fewer times is not asked for its own moment.
_FEWEST = 5


@dataclass(frozen=True, slots=True)
class Closures:
    """labiodental_gap_mm: the mean gap of F and V; tightest_s: (40,); see FaceModel."""

    labiodental_gap_mm: float
    tightest_s: Array


def observe_closures(
    utterances: Iterable[Utterance], lip_gaps_mm: Callable[[NDArray[np.floating]], Array]
) -> Closures:
    """Return medians over all closing phones; a phoneme too rare takes the median of all.

    Parameters
    ----------
    utterances : Iterable[Utterance]
        Labelled.
    lip_gaps_mm : Callable[[NDArray[np.floating]], Array]
        (n_frames, n_points, 3) to (n_frames,), how far the lips are apart.

    Returns
    -------
    Closures
        Gap in mm and times in s.
    """
    at_s: dict[str, list[float]] = {phoneme: [] for phoneme in _CLOSING}
    labiodental: list[tuple[str, Array, Array]] = []
    for utterance in utterances:
        gaps_mm = lip_gaps_mm(utterance.markers_mm)
        frames_s = np.arange(len(gaps_mm)) / utterance.frame_rate_hz
        for phone in utterance.phones:
            if phone.phoneme not in _CLOSING or phone.end_s is None:
                continue
            times_s = np.arange(phone.start_s - _AROUND_S, phone.end_s + _AROUND_S, _STEP_S)
            around_mm = np.interp(times_s, frames_s, gaps_mm)
            tight = around_mm <= around_mm.min() + _AS_TIGHT_MM
            at_s[phone.phoneme].append(float(times_s[tight].mean() - phone.start_s))
            if phone.phoneme in ("F", "V"):
                labiodental.append((phone.phoneme, times_s - phone.start_s, around_mm))
    everything = [m for list_ in at_s.values() for m in list_] or [0.0]
    tightest_s = np.zeros(len(PHONEMES))
    for phoneme, list_ in at_s.items():
        enough = list_ if len(list_) >= _FEWEST else everything
        # Inside the phone, or a closure would belong to the phone before.
        tightest_s[PHONEMES.index(phoneme)] = max(0.0, float(np.median(enough)))
    at_moment_mm = [
        np.interp(tightest_s[PHONEMES.index(phoneme)], since_s, around_mm)
        for phoneme, since_s, around_mm in labiodental
    ]
    gap_mm = float(np.mean(at_moment_mm)) if at_moment_mm else CLOSED_GAP_MM
    return Closures(gap_mm, tightest_s)


def counted(n: int, weight: float) -> NDArray[np.int64]:
    """Return indices of n things, each taken `weight` times on average; weight 1: each once.

    Parameters
    ----------
    n : int
        Things.
    weight : float
        How often each.

    Returns
    -------
    NDArray[np.int64]
        (k,) numbers, ascending.
    """
    wanted = max(1, round(n * weight)) if n else 0
    return np.minimum((np.arange(wanted) + 0.5) * n / max(wanted, 1), n - 1).astype(np.int64)


def counted_training_set(
    utterances: Sequence[Utterance],
    coefficients: Sequence[Array],
    heard: Mapping[str, Sequence[PhonemeEvent]] | None = None,
) -> TrainingSet:
    """Return `collect_training_set` with every context there as often as its speaker counts.

    Parameters
    ----------
    utterances : Sequence[Utterance]
        Labelled.
    coefficients : Sequence[Array]
        (n_frames, n_components) of each.
    heard : Mapping[str, Sequence[PhonemeEvent]] | None
        Recognised phonemes, by name; None: the labels.

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
    """Return the utterances' numbers, each as often as its speaker counts."""
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
        """Return the coefficients of frames.

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
    """Return the eigenvectors of the weighted covariance.

    The largest number of each component is positive, so that the same frames give the same signs.

    Parameters
    ----------
    frames : Array
        (n_frames, n_values).
    weights : Array
        (n_frames,), a frame of weight 2 counts as two.
    n_components : int
        How many.

    Returns
    -------
    PrincipalComponents
        Basis of shape (n_components, n_values).
    """
    total = weights.sum()
    mean = (frames * weights[:, None]).sum(axis=0) / total
    if frames.shape[1] > _MOST_FOR_COVARIANCE:
        return _leading(frames - mean, mean, weights, n_components)
    weighted = frames * np.sqrt(weights)[:, None]
    scatter = weighted.T @ weighted - total * np.outer(mean, mean)
    variances, vectors = np.linalg.eigh(scatter)
    variances, basis = np.maximum(variances[::-1], 0.0), vectors.T[::-1]
    held = float(variances[:n_components].sum() / variances.sum())
    return PrincipalComponents(mean, _signed(basis)[:n_components].copy(), held)


def _leading(centred: Array, mean: Array, weights: Array, n_components: int) -> PrincipalComponents:
    """Return the eigenvectors by Lanczos' method, from the frames alone."""
    n_values = centred.shape[1]
    operator = LinearOperator(
        (n_values, n_values), matvec=lambda v: centred.T @ (weights * (centred @ v.ravel()))
    )
    variances, vectors = eigsh(operator, k=n_components, v0=np.ones(n_values))
    variances, basis = np.maximum(variances[::-1], 0.0), vectors.T[::-1]
    everything = float((weights * np.einsum("ij,ij->i", centred, centred)).sum())
    return PrincipalComponents(mean, _signed(basis), float(variances.sum()) / everything)


def _signed(basis: Array) -> Array:
    largest = np.take_along_axis(basis, np.abs(basis).argmax(axis=1)[:, None], axis=1)
    return np.ascontiguousarray(basis * np.sign(largest))


#: In silence the speaker of grid_s1 has the lips within 1 mm in a third of the frames.
_CLOSED_SHARE = 1.0 / 3.0


def mean_at_rest(
    utterances: Iterable[Utterance], motion: Sequence[Array], layout: PointLayout
) -> Array:
    """Return the mean of silent frames with closed lips, or of their most closed tenth.

    The tenth counts where fewer have closed lips. Without silence: the mean of all frames.

    Parameters
    ----------
    utterances : Iterable[Utterance]
        Labelled.
    motion : Sequence[Array]
        (n_frames, n) of each, whatever is to be averaged.
    layout : PointLayout
        Of the points.

    Returns
    -------
    Array
        (n,).
    """
    still, gap_mm = _silent_frames(utterances, motion, layout)
    if not len(still):
        still, gap_mm = np.concatenate(motion), np.zeros(sum(map(len, motion)))
    threshold = max(CLOSED_GAP_MM, float(np.quantile(gap_mm, 0.1)))
    return np.asarray(still[gap_mm <= threshold].mean(axis=0))


def closed_mouth_mm(utterances: Sequence[Utterance], layout: PointLayout) -> Array:
    """Return the mean of the most closed third of all silent frames.

    No distance in mm decides, so that the result is the same mouth on a face of another size.
    Without silence: of all frames.

    Parameters
    ----------
    utterances : Sequence[Utterance]
        Labelled.
    layout : PointLayout
        Of the points.

    Returns
    -------
    Array
        (n_points, 3).
    """
    motion = [u.markers_mm.reshape(len(u.markers_mm), -1).astype(np.float64) for u in utterances]
    still, gap_mm = _silent_frames(utterances, motion, layout)
    if not len(still):
        still = np.concatenate(motion)
        gap_mm = np.linalg.norm(layout.gap_vectors_mm(still.reshape(len(still), -1, 3)), axis=1)
    closed: Array = still[gap_mm <= np.quantile(gap_mm, _CLOSED_SHARE)]
    return np.asarray(closed.mean(axis=0).reshape(-1, 3))


def _silent_frames(
    utterances: Iterable[Utterance], motion: Sequence[Array], layout: PointLayout
) -> tuple[Array, Array]:
    """Return the silent frames of `motion`, (n, ...), and their lip gaps, (n,) mm.

    Silent are frames outside all phones.
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
