"""How far lips are apart in tracked pictures, as a corpus's reader will measure it."""

import numpy as np

from lipsync.arrays import Array, Array32
from lipsync.face.head_motion import apply_similarity, fit_similarity, refine_mean

#: Points that move with the bone alone: bridge and root of the nose, corners of the eyes, forehead,
#: temples. Head motion is removed by them.
RIGID = (
    168, 6, 197, 195, 33, 133, 362, 263, 10, 151, 9, 8,
    127, 356, 234, 454, 103, 332, 67, 297, 109, 338, 70, 300,
)  # fmt: skip
_EYES = (RIGID.index(33), RIGID.index(263))
_EYE_DISTANCE_MM = 90.0
_UPPER, _LOWER = 13, 14
#: Pictures have y down and z into them.
_TO_FACE_AXES = np.array([1.0, -1.0, -1.0])


def tracked_gaps_mm(points: Array32) -> Array:
    """(n, 478, 3) in pixels -> (n,), between the inner lips, eye corners being 90 mm apart."""
    face = points.astype(np.float64) * _TO_FACE_AXES
    rigid = face[:, RIGID]
    similarity = fit_similarity(rigid, refine_mean(rigid, (*_EYES, _EYE_DISTANCE_MM)))
    lips = apply_similarity(face[:, (_UPPER, _LOWER)], *similarity)
    gaps: Array = np.linalg.norm(lips[:, 0] - lips[:, 1], axis=1)
    return gaps
