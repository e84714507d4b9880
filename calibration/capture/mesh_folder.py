"""A folder of photographs of one robot's face, one a pose, looked at by a face mesh."""

from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from calibration.calibration import CalibrationError
from calibration.capture.mesh_markers import NO_FACE, MeshFrame, NoFaceError, one_face
from calibration.capture.pose_pictures import pose_pictures
from lipsync.arrays import Array
from lipsync.markers import MARKERS_47
from lipsync.video.tracking.face_tracker import FaceTracker
from lipsync.video.video_file import VideoError, video_pictures

Reading = tuple[int, str, Array]

#: What to do about a picture without a face.
_REMEDY: Final = (
    "light it from the front and let it fill a third of the picture; a robot that is not human "
    "enough is found by no face mesh and needs dots (docs/calibration.md)"
)
_UNREADABLE: Final = "not readable as a picture"
#: Named in one message; the others are counted.
_MOST_NAMED: Final = 8


class MeshFolder:
    """Photographs as they come. `readings` looks at each file once, and again when it changes."""

    def __init__(
        self,
        folder: Path,
        tracker: FaceTracker,
        eye_distance_mm: float,
        tell: Callable[[str], None] = lambda _: None,
    ) -> None:
        """tell: hears why a photograph is of no use."""
        self._folder, self._tracker = folder, tracker
        self._eye_distance_mm = eye_distance_mm
        self._tell = tell
        self._frame: MeshFrame | None = None
        self._doubtful: dict[Path, tuple[int, int]] = {}
        #: By file: its size and time of change, and its markers (47, 3), or why it has none.
        self._seen: dict[Path, tuple[tuple[int, int], Array | str]] = {}

    def readings(self, pose: int) -> list[Reading]:
        """What is seen of one pose; nothing where there is no photograph or no face in it."""
        readings = []
        for number, path in pose_pictures(self._folder):
            if number == pose:
                found = self._markers(path)
                if not isinstance(found, str):
                    readings += _named(pose, found)
        return readings

    def all_readings(self) -> list[Reading]:
        """Of every photograph. Raises CalibrationError, naming each that is of no use."""
        pictures = pose_pictures(self._folder)
        if not pictures:
            raise CalibrationError(f"{self._folder}: no picture in it; expected pose_1.jpg, ...")
        readings, useless = [], []
        for pose, path in pictures:
            found = self._markers(path)
            if isinstance(found, str):
                useless.append((path.name, found))
            else:
                readings += _named(pose, found)
        if useless:
            named = ", ".join(f"{name} ({why})" for name, why in useless[:_MOST_NAMED])
            more = f" and {len(useless) - _MOST_NAMED} more" if len(useless) > _MOST_NAMED else ""
            raise CalibrationError(
                f"{self._folder}: {named}{more}: take these again or remove them; {_REMEDY}"
            )
        return readings

    def _markers(self, path: Path) -> Array | str:
        try:
            status = path.stat()
        except FileNotFoundError:
            return NO_FACE  # renamed while we look
        state = (status.st_size, status.st_mtime_ns)
        before = self._seen.get(path)
        if before is None or before[0] != state:
            found = self._look(path)
            if (
                isinstance(found, str)
                and found == _UNREADABLE
                and self._doubtful.get(path) != state
            ):
                self._doubtful[path] = state  # somebody may be writing it; looked at once more
                return found
            self._seen[path] = (state, found)
            if isinstance(found, str):
                self._tell(f"{path.name}: {found}; take it again: {_REMEDY}")
        return self._seen[path][1]

    def _look(self, path: Path) -> Array | str:
        try:
            picture = next((each for _, each in video_pictures(path)), None)
            if picture is None:
                return _UNREADABLE
            points_px = one_face(self._tracker, picture)
        except VideoError:
            return _UNREADABLE
        except NoFaceError as error:
            return str(error)
        if self._frame is None:
            self._frame = MeshFrame(points_px, self._eye_distance_mm)
        return self._frame.markers_mm(points_px)


def _named(pose: int, markers_mm: Array) -> list[Reading]:
    return [
        (pose, name, np.asarray(place_mm))
        for name, place_mm in zip(MARKERS_47.names, markers_mm, strict=True)
    ]
