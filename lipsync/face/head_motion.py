"""Removal of the head's motion from the motion of the face.

Every frame is laid on a mean head by the similarity (rotation, translation, scale) that fits its
bone-fixed points best; the mean is refined until it no longer moves. This is the SVD-based shape
analysis of Wei and Deng; the closed form is Umeyama's (IEEE PAMI 13(4), 1991, eqs. 39-42).
"""

import numpy as np

from lipsync.arrays import Array

# The fit converges by a factor of about ten a round; ten rounds are exact to rounding.
_ROUNDS = 10


def fit_similarity(points: Array, reference: Array) -> tuple[Array, Array, Array]:
    """Return the similarities that fit each frame's points to the reference by least squares.

    Umeyama, eqs. (40)-(42): the fitted points are `scale * points @ rotation.T + translation`.

    Parameters
    ----------
    points : Array
        (n_frames, n_points, 3) positions.
    reference : Array
        (n_points, 3) positions.

    Returns
    -------
    tuple[Array, Array, Array]
        Scale (n_frames,), rotation (n_frames, 3, 3), translation (n_frames, 3).
    """
    centre = points.mean(axis=1, keepdims=True)
    reference_centre = reference.mean(axis=0)
    # Shapes (n_frames, n_points, 3) and (n_points, 3).
    centred, reference_centred = points - centre, reference - reference_centre
    u, d, vt = np.linalg.svd(np.einsum("pi,fpj->fij", reference_centred, centred))
    # A mirrored head fits better than a turned one when points are few; forbid it.
    handedness = np.sign(np.linalg.det(u @ vt))
    u[:, :, 2] *= handedness[:, None]
    d[:, 2] *= handedness
    rotation = u @ vt
    scale = d.sum(axis=1) / (centred**2).sum(axis=(1, 2))
    translation = reference_centre - scale[:, None] * np.einsum(
        "fij,fj->fi", rotation, centre[:, 0]
    )
    return scale, rotation, translation


def apply_similarity(points: Array, scale: Array, rotation: Array, translation: Array) -> Array:
    """Return each frame's points moved: `scale * points @ rotation.T + translation`.

    Parameters
    ----------
    points : Array
        (n_frames, n, 3) positions.
    scale : Array
        (n_frames,) factors.
    rotation : Array
        (n_frames, 3, 3) matrices.
    translation : Array
        (n_frames, 3) vectors.

    Returns
    -------
    Array
        (n_frames, n, 3) transformed positions.
    """
    turned: Array = np.einsum("fij,fpj->fpi", rotation, points)
    return scale[:, None, None] * turned + translation[:, None, :]


def refine_mean(points: Array, scale_mm: tuple[int, int, float]) -> Array:
    """Return the mean shape of a head's bone-fixed points over all frames, without its motion.

    Frames are fitted to the mean and averaged anew, from the first frame on.

    Parameters
    ----------
    points : Array
        (n_frames, n_points, 3) positions of bone-fixed points.
    scale_mm : tuple[int, int, float]
        Two point indices and their distance in mm, which fixes the size.

    Returns
    -------
    Array
        (n_points, 3) mm, centred on its own mean.
    """
    first, second, distance_mm = scale_mm
    mean: Array = points[0]
    for _ in range(_ROUNDS):
        mean = apply_similarity(points, *fit_similarity(points, mean)).mean(axis=0)
        mean = mean - mean.mean(axis=0)
        mean = mean * (distance_mm / np.linalg.norm(mean[first] - mean[second]))
    return mean
