"""Build a state model of a corpus: states of the mouth, what each looks like, which may follow it.

After Edge, Hilton and Jackson, in these steps.

The parameters of motion ("Data", steps 1 and 2): principal components, their speed, and one scale
for each of both. The paper finds the components by EM (Roweis, "EM Algorithms for PCA and SPCA",
NIPS 1997), which approaches the space of the leading eigenvectors of the covariance without ever
forming it: necessary for 60,000 coordinates a frame, and used here for dense scans. Markers have
141: their covariance is formed and its eigenvectors are exact, and the same at every run.

The speech manifold (step 3): frames described by how far they are from each other. PCA of the
matrix of Euclidean distances between all frames; each row of the matrix is one frame, its principal
components are the coordinates. (Classical scaling squares and centres the distances first; with
Euclidean distances that returns the frames themselves, rotated, and nothing would be gained.) The
matrix of 70,000 frames has 4.9e9 entries. Its columns are samples of one smooth function of a
frame, so that some hundreds of them, for landmark frames evenly spread over the recordings, suffice
(de Silva and Tenenbaum, "Sparse multidimensional scaling using landmark points", 2004; Nystrom's
method for the symmetric case). With every frame a landmark it is the exact form.

The states (steps 4, 5 and the Gaussians of step 6): clusters of the manifold, which follows which,
and the mean and covariance of each.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist
from sklearn.cluster import BisectingKMeans
from sklearn.decomposition import PCA
from threadpoolctl import threadpool_limits

from lipservo_lab.corpus.utterance import Utterance
from lipsync.arrays import Array, Indices
from lipsync.errors import UserError
from lipsync.offline.line_synthesis import frames_between, joined_phones, unit_spans
from lipsync.offline.offline_model import StateModel, Units
from lipsync.phonemes import PHONEMES

#: The coordinates that are kept hold this share of the variance, as in the paper.
KEPT_SHARE = 0.99
#: Of 2,999 frames of grid_s1 the distances by 800 landmarks are those of the exact form within
#: 0.7 % (root mean square), by 200 within 1.5 %; both keep 8 dimensions.
N_LANDMARKS = 800


def landmark_frames(n_frames: int, n_landmarks: int) -> Indices:
    """Return evenly spread frame numbers as landmarks, (min(n_frames, n_landmarks),)."""
    if n_frames <= n_landmarks:
        return np.arange(n_frames)
    return np.linspace(0, n_frames - 1, n_landmarks).round().astype(np.int64)


def speech_manifold(
    parameters: Array, n_landmarks: int | None = N_LANDMARKS, kept_share: float = KEPT_SHARE
) -> Array:
    """Return coordinates of frames by PCA of their distances to landmark frames.

    D_ij = || z_i - z_j || with j over the landmarks, equation (M1). The coordinates are the leading
    principal components of the rows of D that hold `kept_share` of their variance, equation (M2),
    divided by the root of the number of landmarks, so that their size does not depend on it.

    Parameters
    ----------
    parameters : Array
        z, (n, m), parameters of motion of n frames.
    n_landmarks : int | None
        Number of landmark frames; None takes every frame, the exact form.
    kept_share : float
        0 to 1.

    Returns
    -------
    Array
        (n, d), as many coordinates d as hold the share.
    """
    landmarks = landmark_frames(len(parameters), n_landmarks or len(parameters))
    distances = cdist(parameters, parameters[landmarks]).astype(np.float32)
    distances -= distances.mean(axis=0)
    covariance = (distances.T @ distances).astype(np.float64) / len(parameters)
    variances, vectors = np.linalg.eigh(covariance)
    variances, vectors = np.maximum(variances[::-1], 0.0), vectors[:, ::-1]
    held_shares = np.cumsum(variances) / max(float(variances.sum()), np.finfo(float).tiny)
    n_kept = int(np.searchsorted(held_shares, kept_share)) + 1
    # A direction has no sign of its own: the largest entry is made positive.
    vectors = vectors[:, :n_kept]
    vectors = vectors * np.sign(vectors[np.abs(vectors).argmax(axis=0), np.arange(n_kept)])
    return np.asarray(distances @ vectors / np.sqrt(len(landmarks)), dtype=np.float64)


#: Up to so many coordinates a frame the covariance is formed: 18 MB, and its eigenvectors 5 s.
MOST_FOR_COVARIANCE = 1_500
#: EM carries this many components more than asked for: each round it comes nearer by the ratio of
#: two variances, of the first component that it leaves out and of the last that is kept.
_SPARE = 20
#: EM ends when the variance held grows by less than this share; the space is then off by about its
#: square root.
_TOLERANCE = 1e-11
_MOST_ROUNDS = 300


@dataclass(frozen=True, slots=True)
class Components:
    """Principal components: mean_mm (n_coordinates,), basis (n_components, n_coordinates).

    The rows of the basis are orthonormal. share: of the variance of all frames that they hold.
    """

    mean_mm: Array
    basis: Array
    share: float

    def of(self, frames_mm: NDArray[np.floating]) -> Array:
        """Return the components of frames, x = B (f - mean), equation (P1).

        Parameters
        ----------
        frames_mm : NDArray[np.floating]
            (n, n_coordinates).

        Returns
        -------
        Array
            (n, n_components).
        """
        return np.asarray((frames_mm - self.mean_mm) @ self.basis.T, dtype=np.float64)


def find_components(sentences_mm: Sequence[NDArray[np.floating]], n_components: int) -> Components:
    """Return the leading principal components of all frames of sentences.

    Exact up to `MOST_FOR_COVARIANCE` coordinates, by EM beyond.

    Parameters
    ----------
    sentences_mm : Sequence[NDArray[np.floating]]
        (n_frames, n_coordinates) each.
    n_components : int
        Number of components.

    Returns
    -------
    Components
        Basis of shape (n_components, n_coordinates).
    """
    if sentences_mm[0].shape[1] > MOST_FOR_COVARIANCE:
        return components_by_em(sentences_mm, n_components)
    frames_mm = np.concatenate(sentences_mm).astype(np.float64, copy=False)
    pca = PCA(n_components, svd_solver="covariance_eigh").fit(frames_mm)
    return Components(pca.mean_, pca.components_, float(pca.explained_variance_ratio_.sum()))


def components_by_em(sentences_mm: Sequence[NDArray[np.floating]], n_components: int) -> Components:
    """Return the leading principal components by EM, one sentence in memory as float64 at a time.

    Roweis, section 3.1: X = (C' C)^-1 C' Y, then C = Y X' (X X')^-1. With the columns of C kept
    orthonormal, both steps together lead to the space spanned by Y Y' C; only this space matters.
    The first C is made of frames evenly spread over the recordings, so the same frames give the
    same result.

    Parameters
    ----------
    sentences_mm : Sequence[NDArray[np.floating]]
        (n_frames, n_coordinates) each.
    n_components : int
        Number of components.

    Returns
    -------
    Components
        Basis of shape (n_components, n_coordinates).
    """
    n_frames = sum(map(len, sentences_mm))
    sums = sum(points_mm.sum(axis=0, dtype=np.float64) for points_mm in sentences_mm)
    mean_mm = np.asarray(sums / n_frames, dtype=np.float64)

    def centred_sentences() -> Iterator[Array]:
        for points_mm in sentences_mm:
            yield points_mm.astype(np.float64) - mean_mm

    n_carried = min(n_components + _SPARE, n_frames, len(mean_mm))
    chosen = np.linspace(0, n_frames - 1, n_carried).round().astype(np.int64)
    starts = np.cumsum([0, *map(len, sentences_mm)])
    at_sentence = np.searchsorted(starts, chosen, side="right") - 1
    first_mm = [sentences_mm[i][n - starts[i]] for i, n in zip(at_sentence, chosen, strict=True)]
    scattered = (np.array(first_mm, dtype=np.float64) - mean_mm).T
    held = 0.0
    for _ in range(_MOST_ROUNDS):
        space = np.linalg.qr(scattered)[0]
        scattered = np.zeros_like(space)
        # Y Y' C, sentence by sentence.
        for centred_mm in centred_sentences():
            scattered += centred_mm.T @ (centred_mm @ space)
        # Eigenvalues within the space: sums of squares along its principal directions.
        within = space.T @ scattered
        values, rotation = np.linalg.eigh((within + within.T) / 2)
        before, held = held, float(values[::-1][:n_components].sum())
        if held - before <= _TOLERANCE * held:
            break
    basis = (space @ rotation[:, ::-1])[:, :n_components].T
    # A direction has no sign of its own: the largest entry is made positive.
    signs = np.sign(basis[np.arange(len(basis)), np.abs(basis).argmax(axis=1)])
    total_variance = sum(float((centred_mm**2).sum()) for centred_mm in centred_sentences())
    share = held / max(total_variance, np.finfo(float).tiny)
    return Components(mean_mm, basis * signs[:, None], share)


def velocities(positions: Array) -> Array:
    """Return speeds x'_i = x_{i+1} - x_i, equation (P2); the last frame repeats the last speed.

    Parameters
    ----------
    positions : Array
        (n, p).

    Returns
    -------
    Array
        (n, p), per frame; 0 for a single frame.
    """
    steps = np.diff(positions, axis=0)
    last = steps[-1:] if len(steps) else np.zeros_like(positions[:1])
    return np.concatenate([steps, last])


def joint_parameters(sentences: Sequence[Array]) -> Array:
    """Return z_i = (x_i / s, x'_i / s') of the frames of all sentences, equation (P3).

    The scales s and s' make the variance of all positions together 1, and of all speeds. One scale
    for each component would enlarge the noise of the last ones to the size of the jaw's motion.

    Parameters
    ----------
    sentences : Sequence[Array]
        Components (n_frames, p) of each.

    Returns
    -------
    Array
        (n, 2 p).
    """
    blocks = [np.concatenate(sentences), np.concatenate([velocities(x) for x in sentences])]
    scaled = []
    for block in blocks:
        scale = float(np.sqrt(block.var(axis=0).sum()))
        scaled.append(block / (scale if scale > 0.0 else 1.0))
    return np.concatenate(scaled, axis=1)


def bisected_states(coordinates: Array, n_states: int, seed: int) -> Indices:
    """Return the state of each frame by bisecting k-means on the manifold, equation (S1).

    The cluster with the largest squared error is split in two until there are `n_states`
    (Steinbach, Karypis and Kumar, "A comparison of document clustering techniques", 2000).

    Parameters
    ----------
    coordinates : Array
        (n, d) of the manifold.
    n_states : int
        Number of states.
    seed : int
        Seed of the splits.

    Returns
    -------
    Indices
        (n,), 0 to n_states - 1.
    """
    kmeans = BisectingKMeans(n_states, random_state=seed, n_init=1)
    return np.asarray(kmeans.fit_predict(coordinates), dtype=np.int64)


def transitions(sentences: Sequence[Indices], n_states: int) -> NDArray[np.bool_]:
    """Return T, equation (S2): T_ij is whether a frame in state i is ever followed by one in j.

    Binary on purpose: a transition that occurred once is as possible as a common one.

    Parameters
    ----------
    sentences : Sequence[Indices]
        The states (n_frames,) of each sentence, in order of time.
    n_states : int
        Number of states.

    Returns
    -------
    NDArray[np.bool_]
        (n_states, n_states).
    """
    follows = np.zeros((n_states, n_states), dtype=np.bool_)
    for states in sentences:
        follows[states[:-1], states[1:]] = True
    return follows


def state_gaussians(
    positions: Array, speeds: Array, states: Indices, n_states: int, shrinkage: float
) -> tuple[Array, Array]:
    """Return mean and covariance of y = (x, x') in each state, equation (S3).

    A few frames do not determine a covariance of 2 p numbers. So each is mixed with the mean
    covariance within all states, as if the state had `shrinkage` more frames with that covariance.

    Parameters
    ----------
    positions, speeds : Array
        (n, p).
    states : Indices
        (n,), of each frame.
    n_states : int
        Number of states.
    shrinkage : float
        Number of frames.

    Returns
    -------
    tuple[Array, Array]
        (n_states, 2 p) and (n_states, 2 p, 2 p).
    """
    y = np.concatenate([positions, speeds], axis=1)
    counts = np.bincount(states, minlength=n_states).astype(np.float64)
    means = np.zeros((n_states, y.shape[1]))
    np.add.at(means, states, y)
    means /= np.maximum(counts, 1.0)[:, None]
    residuals = y - means[states]
    within = residuals.T @ residuals / len(y)
    # Small multiple of the identity: keeps every covariance invertible.
    floor = 1e-6 * max(float(np.trace(within)) / len(within), 1e-12) * np.eye(len(within))
    scatter = np.zeros((n_states, y.shape[1], y.shape[1]))
    for state in range(n_states):
        of_state = residuals[states == state]
        scatter[state] = of_state.T @ of_state
    weights = (counts + shrinkage)[:, None, None]
    return means, (scatter + shrinkage * (within + floor)) / weights + floor


Progress = Callable[[str], None]


class BuildingError(UserError):
    """A corpus that no state model can be made of; one line."""


@dataclass(frozen=True, slots=True)
class Recipe:
    """What the paper leaves open, chosen on inner splits (docs/decisions/scripted-lines.md)."""

    n_components: int = 10
    n_states: int = 100
    n_landmarks: int = N_LANDMARKS
    shrinkage: float = 20.0
    seed: int = 0


def build_states(
    utterances: Sequence[Utterance],
    cepstra: Sequence[Array],
    recipe: Recipe | None = None,
    progress: Progress = lambda _: None,
) -> StateModel:
    """Build a state model of labelled sentences.

    Parameters
    ----------
    utterances : Sequence[Utterance]
        Sentences with phone labels.
    cepstra : Sequence[Array]
        Cepstra (n_frames, m) at the frames of each sentence.
    recipe : Recipe | None
        Sizes and seed; None: the usual ones.
    progress : Progress
        Called with a line about each step.

    Returns
    -------
    StateModel
        The model, with all of the utterances' points.

    Raises
    ------
    BuildingError
        Too few frames, or sentences at different rates.
    """
    recipe = recipe or Recipe()
    rates = {u.frame_rate_hz for u in utterances}
    if len(rates) != 1:
        raise BuildingError(f"the sentences have {len(rates)} frame rates; record all at one")
    frame_rate_hz = rates.pop()
    frames = [_flat(u) for u in utterances]
    borders = np.concatenate([[0], np.cumsum([len(each) for each in frames])])
    _check_numbers(recipe, int(borders[-1]), frames[0].shape[1])
    with threadpool_limits(limits=1):  # several threads add up in changing order
        progress("principal components")
        components = find_components(frames, recipe.n_components)
        sentences = [components.of(each) for each in frames]
        motion = np.concatenate(sentences)
        progress("speech manifold")
        manifold = speech_manifold(joint_parameters(sentences), recipe.n_landmarks)
        progress(f"{recipe.n_states} states in {manifold.shape[1]} dimensions")
        states = bisected_states(manifold, recipe.n_states, recipe.seed)
        speeds = np.concatenate([velocities(x) for x in sentences])
        means, covariances = state_gaussians(
            motion, speeds, states, recipe.n_states, recipe.shrinkage
        )
    return StateModel(
        frame_rate_hz=frame_rate_hz,
        borders=borders,
        cepstra=np.concatenate(cepstra).astype(np.float32),
        states=states,
        units=_units(utterances, borders),
        follows=transitions(
            [states[r.start : r.stop] for r in frames_between(borders)], recipe.n_states
        ),
        means=means,
        covariances=covariances,
        mean_mm=components.mean_mm,
        basis=components.basis,
    )


def _units(utterances: Sequence[Utterance], borders: Array) -> Units:
    """Return the phones of all sentences as spans of frames of the joined corpus.

    borders: first frame of each sentence in the joined corpus, and the number of all its frames.
    """
    phonemes, first, end = [], [], []
    for utterance, start in zip(utterances, borders, strict=False):
        n_frames = len(utterance.markers_mm)
        phones = joined_phones(utterance.phones, n_frames / utterance.frame_rate_hz)
        spans = unit_spans(phones, n_frames, utterance.frame_rate_hz)
        phonemes += [PHONEMES.index(p) for p in spans.phonemes]
        first.append(spans.first + start)
        end.append(spans.end + start)
    return Units(np.array(phonemes), np.concatenate(first), np.concatenate(end))


def _check_numbers(recipe: Recipe, n_frames: int, n_coordinates: int) -> None:
    """Raise BuildingError where a corpus has too few frames for so many states or components."""
    if n_frames < 2 * recipe.n_states:
        raise BuildingError(
            f"{n_frames} frames are too few for {recipe.n_states} states: record more, or ask "
            f"for {n_frames // 2} at most (--states)"
        )
    most = min(n_frames - 1, n_coordinates)
    if recipe.n_components > most:
        raise BuildingError(
            f"{recipe.n_components} components: {n_frames} frames of {n_coordinates // 3} points "
            f"have {most} at most (--components)"
        )


def _flat(utterance: Utterance) -> NDArray[np.float32]:
    """Return the markers as (n_frames, 3 n_points) without a copy: dense scans take a gigabyte."""
    return utterance.markers_mm.reshape(len(utterance.markers_mm), -1)
