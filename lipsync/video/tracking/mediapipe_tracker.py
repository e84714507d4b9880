"""Face points by mediapipe's own face mesh, whose network its wheel carries.

Only the versions before 0.10.30 have it (docs/decisions/0026-video-and-face-tracking.md).
"""

from typing import Any

import numpy as np

from lipsync.arrays import Array
from lipsync.extras import check_extra
from lipsync.video.tracking.face_tracker import Picture

_MOST_FACES = 3


class MediapipeTracker:
    """The face mesh with attention, on every picture alone."""

    def __init__(self) -> None:
        check_extra("mediapipe", "tracking without --landmarker")
        import mediapipe

        self._mesh: Any = mediapipe.solutions.face_mesh.FaceMesh(
            static_image_mode=True, max_num_faces=_MOST_FACES, refine_landmarks=True
        )
        self._name = f"mediapipe {mediapipe.__version__}"

    @property
    def name(self) -> str:
        """Library and version."""
        return self._name

    def faces(self, picture: Picture) -> tuple[Array, ...]:
        """See `FaceTracker`."""
        height, width = picture.shape[:2]
        found = self._mesh.process(picture).multi_face_landmarks or ()
        scale = np.array([width, height, width], dtype=np.float64)
        faces = [np.array([[p.x, p.y, p.z] for p in face.landmark]) * scale for face in found]
        return tuple(sorted(faces, key=lambda points: -float(np.ptp(points[:, 0]))))
