"""The speech manifold: frames laid out by how far they are from each other.

Edge, Hilton and Jackson, steps 3: PCA of the matrix of Euclidean distances between all frames. Each
row of the matrix is one frame, told by its distances to all others; its principal components are
the coordinates. (Classical scaling squares and centres the distances first; of Euclidean ones that
gives back the frames themselves, rotated, and nothing would be gained.)

The matrix of 70,000 frames has 4.9e9 entries. Its columns are samples of one smooth function of a
frame, so that some hundreds of them, taken at landmarks that lie evenly in the recordings, hold
what all do (de Silva and Tenenbaum, "Sparse multidimensional scaling using landmark points", 2004;
Nystrom's method for the symmetric case). With every frame a landmark it is the exact form.
"""

import numpy as np
from scipy.spatial.distance import cdist

from lipsync.arrays import Array, Indices

#: Coordinates that hold this share of the variance are kept, as in the paper.
KEPT_SHARE = 0.99
#: Of 2,999 frames of grid_s1 the distances by 800 landmarks are those of the exact form within
#: 0.7 % (root mean square), by 200 within 1.5 %; both keep 8 dimensions.
N_LANDMARKS = 800


def landmark_frames(n_frames: int, n_landmarks: int) -> Indices:
    """Numbers of the landmarks, evenly over the recordings: (min(n_frames, n_landmarks),)."""
    if n_frames <= n_landmarks:
        return np.arange(n_frames)
    return np.linspace(0, n_frames - 1, n_landmarks).round().astype(np.int64)


def speech_manifold(
    parameters: Array, n_landmarks: int | None = N_LANDMARKS, kept_share: float = KEPT_SHARE
) -> Array:
    """Coordinates (n, d) of frames with parameters (n, m), by PCA of their distances.

    D_ij = || z_i - z_j || with j over the landmarks, equation (M1); coordinates: the leading
    principal components of the rows of D that hold `kept_share` of their variance, equation (M2),
    divided by the root of the number of landmarks, so that they are as large whatever that is.
    n_landmarks: None takes every frame, the exact form.
    """
    numbers = landmark_frames(len(parameters), n_landmarks or len(parameters))
    distances = cdist(parameters, parameters[numbers]).astype(np.float32)
    distances -= distances.mean(axis=0)
    covariance = (distances.T @ distances).astype(np.float64) / len(parameters)
    values, vectors = np.linalg.eigh(covariance)
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    held = np.cumsum(values) / max(float(values.sum()), np.finfo(float).tiny)
    n_kept = int(np.searchsorted(held, kept_share)) + 1
    # A direction has no sign of its own: the largest entry is made positive.
    vectors = vectors[:, :n_kept]
    vectors = vectors * np.sign(vectors[np.abs(vectors).argmax(axis=0), np.arange(n_kept)])
    return np.asarray(distances @ vectors / np.sqrt(len(numbers)), dtype=np.float64)
