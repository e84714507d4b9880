"""The parameters of motion: principal components, their speed, and one scale for each.

Edge, Hilton and Jackson, "Data" and steps 1 and 2 of the digest's numbering. They find the
components by EM (Roweis, "EM Algorithms for PCA and SPCA", NIPS 1997), which walks towards the
space of the leading eigenvectors of the covariance without ever forming it: the way to go for
60,000 coordinates a frame, and taken here for dense scans. Markers have 141: their covariance is
formed and its eigenvectors are exact, and the same at every run.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sklearn.decomposition import PCA

from lipsync.arrays import Array

#: Up to so many coordinates a frame the covariance is formed: 18 MB, and its eigenvectors 5 s.
MOST_FOR_COVARIANCE = 1_500
#: EM carries this many components more than asked for: it comes nearer by the ratio of the variance
#: of the first that it leaves out to that of the last that is kept, every round.
_SPARE = 20
#: It ends when the variance held grows by less than this share; the space is then off by the root.
_TOLERANCE = 1e-11
_MOST_ROUNDS = 300


@dataclass(frozen=True, slots=True)
class Components:
    """mean_mm (n_coordinates,), basis (n_components, n_coordinates), rows orthonormal.

    share: of the variance of all frames that the components hold.
    """

    mean_mm: Array
    basis: Array
    share: float

    def of(self, frames_mm: NDArray[np.floating]) -> Array:
        """(n, n_coordinates) -> (n, n_components): equation (P1), x = B (f - mean)."""
        return np.asarray((frames_mm - self.mean_mm) @ self.basis.T, dtype=np.float64)


def find_components(sentences_mm: Sequence[NDArray[np.floating]], n_components: int) -> Components:
    """The leading principal components of all frames of sentences (n_frames, n_coordinates).

    Exact up to `MOST_FOR_COVARIANCE` coordinates, by EM beyond.
    """
    if sentences_mm[0].shape[1] > MOST_FOR_COVARIANCE:
        return components_by_em(sentences_mm, n_components)
    frames_mm = np.concatenate(sentences_mm).astype(np.float64, copy=False)
    pca = PCA(n_components, svd_solver="covariance_eigh").fit(frames_mm)
    return Components(pca.mean_, pca.components_, float(pca.explained_variance_ratio_.sum()))


def components_by_em(sentences_mm: Sequence[NDArray[np.floating]], n_components: int) -> Components:
    """The same by EM, one sentence in memory as float64 at a time.

    Roweis, section 3.1: X = (C' C)^-1 C' Y, then C = Y X' (X X')^-1. With the columns of C kept
    orthonormal, both together lead to the space of Y Y' C, which is all that matters of C. It
    starts from frames that lie evenly in the recordings, so the same frames give the same result.
    """
    n_frames = sum(map(len, sentences_mm))
    sums = sum(each.sum(axis=0, dtype=np.float64) for each in sentences_mm)
    mean_mm = np.asarray(sums / n_frames, dtype=np.float64)

    def centred() -> Iterator[Array]:
        for each in sentences_mm:
            yield each.astype(np.float64) - mean_mm

    n_carried = min(n_components + _SPARE, n_frames, len(mean_mm))
    chosen = np.linspace(0, n_frames - 1, n_carried).round().astype(np.int64)
    starts = np.cumsum([0, *map(len, sentences_mm)])
    at_sentence = np.searchsorted(starts, chosen, side="right") - 1
    first = [sentences_mm[i][n - starts[i]] for i, n in zip(at_sentence, chosen, strict=True)]
    scattered = (np.array(first, dtype=np.float64) - mean_mm).T
    held = 0.0
    for _ in range(_MOST_ROUNDS):
        space = np.linalg.qr(scattered)[0]
        scattered = np.zeros_like(space)
        for y in centred():
            scattered += y.T @ (y @ space)
        within = space.T @ scattered
        values, turn = np.linalg.eigh((within + within.T) / 2)
        before, held = held, float(values[::-1][:n_components].sum())
        if held - before <= _TOLERANCE * held:
            break
    basis = (space @ turn[:, ::-1])[:, :n_components].T
    # A direction has no sign of its own: the largest entry is made positive.
    signs = np.sign(basis[np.arange(len(basis)), np.abs(basis).argmax(axis=1)])
    everything = sum(float((y**2).sum()) for y in centred())
    share = held / max(everything, np.finfo(float).tiny)
    return Components(mean_mm, basis * signs[:, None], share)


def velocities(positions: Array) -> Array:
    """x'_i = x_{i+1} - x_i, (n, p) -> (n, p), equation (P2); the last frame keeps the last step."""
    steps = np.diff(positions, axis=0)
    last = steps[-1:] if len(steps) else np.zeros_like(positions[:1])
    return np.concatenate([steps, last])


def joint_parameters(sentences: Sequence[Array]) -> Array:
    """z_i = (x_i / s, x'_i / s'), (n, 2 p) over all sentences, equation (P3).

    s and s' make the variance of each block 1 in all: one scale a block. A scale for every
    component would blow the jitter of the last ones up to the size of the jaw.
    """
    blocks = [np.concatenate(sentences), np.concatenate([velocities(x) for x in sentences])]
    scaled = []
    for block in blocks:
        scale = float(np.sqrt(block.var(axis=0).sum()))
        scaled.append(block / (scale if scale > 0.0 else 1.0))
    return np.concatenate(scaled, axis=1)
