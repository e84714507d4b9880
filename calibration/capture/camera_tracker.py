"""Markers by a camera that looks at the robot's face: a face mesh in a few pictures a pose."""

from collections.abc import Callable
from typing import Final

import numpy as np

from calibration.calibration import CalibrationError
from calibration.capture.mesh_markers import (
    MeshFrame,
    NoFaceError,
    median_markers_mm,
)
from lipsync.arrays import Array
from lipsync.markers import MARKERS_47

#: The points (478, 3) of the one face in a picture that is taken now, in pixels. Raises
#: NoFaceError.
See = Callable[[], Array]
#: Pictures of a pose: their median is steadier than one. A face is looked for in so many more.
_N_PICTURES: Final = 5
_MOST_PICTURES: Final = 15
#: So many poses without a face, one after another, are no accident.
_MOST_LOST: Final = 5
_REMEDY: Final = (
    "let it look straight at the camera, lit from the front, a third of the picture wide; a robot "
    "that is not human enough is found by no face mesh and needs dots (docs/calibration.md)"
)


class CameraTracker:
    """Sees 47 markers or none. Pose 0 is the robot in neutral, to which all is referred."""

    marker_names = MARKERS_47.names

    def __init__(self, see: See, eye_distance_mm: float, say: Callable[[str], None]) -> None:
        """Look at neutral. Raises CalibrationError where no face is found there."""
        self._see, self._say = see, say
        points_px, why = self._pictures()
        if not points_px:
            raise CalibrationError(f"camera, pose 0 (neutral): {why}; {_REMEDY}")
        self._frame = MeshFrame(np.median(np.array(points_px), axis=0), eye_distance_mm)
        self._pose = self._n_lost = 0

    def arrived(self, pose: int, _reached_deg: Array) -> None:
        """Remember which pose stands."""
        self._pose = pose + 1

    def measure(self) -> Array:
        """(47, 3) mm; NaN in a pose without a face, which is told.

        Raises CalibrationError after five such poses in a row.
        """
        points_px, why = self._pictures()
        if points_px:
            self._n_lost = 0
            return median_markers_mm([self._frame.markers_mm(each) for each in points_px])
        self._n_lost += 1
        if self._n_lost == _MOST_LOST:
            raise CalibrationError(
                f"camera, pose {self._pose} and the four before it: {why}; {_REMEDY}"
            )
        self._say(f"pose {self._pose}: {why}; the pose is left out")
        return np.full((len(self.marker_names), 3), np.nan)

    def _pictures(self) -> tuple[list[Array], str]:
        """Faces, and why there were none in the last picture that had none."""
        found: list[Array] = []
        why = ""
        for _ in range(_MOST_PICTURES):
            try:
                found.append(self._see())
            except NoFaceError as error:
                why = str(error)
            if len(found) == _N_PICTURES:
                break
        return (found, why) if len(found) == _N_PICTURES else ([], why)
