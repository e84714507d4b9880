"""Markers of a robot's face by the face mesh that finds people's faces in pictures.

A robot's face is found where it is human enough. Across and up are seen; forward is a network's
estimate of what people's faces look like, and no measurement.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from calibration.calibration import CalibrationError
from lipsync.arrays import Array
from lipsync.face.head_motion import apply_similarity, fit_similarity
from lipsync.markers import MARKERS_47
from lipsync.video.tracking.face_tracker import FaceTracker, Picture

#: What is to be said wherever the mesh is used.
PROTRUSION_IS_GUESSED: Final = (
    "one picture does not show protrusion: how far lips stand forward is a network's estimate"
)
NO_FACE: Final = "no face is found"
_TWO_FACES: Final = "two faces are seen; leave only the robot's in the picture"
#: A face narrower than this share of the widest one is somebody in the background.
_BACKGROUND: Final = 0.5
#: Points that no servo of a mouth moves: nose, corners of the eyes, forehead, temples.
_RIGID: Final = (
    168, 6, 197, 195, 33, 133, 362, 263, 10, 151, 9, 8,
    127, 356, 234, 454, 103, 332, 67, 297, 109, 338, 70, 300,
)  # fmt: skip
_EYES: Final = (33, 263)
#: Pictures have y down and z into them; in a picture the robot's left is on the right.
_TO_FACE_AXES: Final = np.array([1.0, -1.0, -1.0])


class NoFaceError(CalibrationError):
    """Nothing in a picture that is one face; says what is there, not where."""


def one_face(tracker: FaceTracker, picture: Picture) -> Array:
    """Points (478, 3) of the only face, in pixels. Raises NoFaceError."""
    faces = tracker.faces(picture)
    if not faces:
        raise NoFaceError(NO_FACE)
    widths = [float(np.ptp(face[:, 0])) for face in faces]
    if len(faces) > 1 and widths[1] >= _BACKGROUND * widths[0]:
        raise NoFaceError(_TWO_FACES)
    return faces[0]


class MeshFrame:
    """The head as it was in a first picture: lays every other one on it, in millimetres."""

    def __init__(self, points_px: Array, eye_distance_mm: float) -> None:
        """points_px: (478, 3), of neutral; eye_distance_mm: between the outer corners."""
        face = points_px * _TO_FACE_AXES
        right, left = face[list(_EYES)]
        scale = eye_distance_mm / float(np.linalg.norm(left - right))
        self._rigid_mm = (face[list(_RIGID)] - (left + right) / 2) * scale

    def markers_mm(self, points_px: Array) -> Array:
        """(47, 3), in the order of `MARKERS_47`.

        The similarity that lays what is rigid on the first picture takes away how the camera was
        held: Umeyama (IEEE PAMI 13(4), 1991), eqs. (39)-(42).
        """
        face = (points_px * _TO_FACE_AXES)[None]
        fit = fit_similarity(face[:, list(_RIGID)], self._rigid_mm)
        return np.asarray(apply_similarity(face[:, list(MARKERS_47.landmarks)], *fit)[0])


def median_markers_mm(seen_mm: Sequence[Array]) -> Array:
    """Of several pictures of one pose (47, 3) each: the median."""
    return np.asarray(np.median(np.array(seen_mm), axis=0))
