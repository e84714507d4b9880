"""Markers of a robot's face, by the face mesh that finds people's faces in pictures.

The pictures come from a folder of photographs, one per pose, or from a camera, a few per pose. A
robot's face is found where it is human enough. Across and up are measured; forward is a network's
estimate from people's faces, and no measurement.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from calibration.calibration import CalibrationError
from calibration.capture.dots import pose_pictures
from calibration.capture.marker_files import Reading
from lipsync.arrays import Array
from lipsync.face.head_motion import apply_similarity, fit_similarity
from lipsync.markers import MARKERS_47
from lipsync.video.face_detection import Picture
from lipsync.video.face_tracker import FaceTracker
from lipsync.video.video_file import VideoError, video_pictures

#: What is to be said wherever the mesh is used.
PROTRUSION_IS_GUESSED: Final = (
    "one picture does not show protrusion: how far lips stand forward is a network's estimate"
)
NO_FACE: Final = "no face is found"
_TWO_FACES: Final = "two faces are seen; leave only the robot's in the picture"
#: A face narrower than this share of the widest one is somebody in the background.
_BACKGROUND_SHARE: Final = 0.5
#: Points that no servo of a mouth moves: nose, corners of the eyes, forehead, temples.
_RIGID: Final = (
    168, 6, 197, 195, 33, 133, 362, 263, 10, 151, 9, 8,
    127, 356, 234, 454, 103, 332, 67, 297, 109, 338, 70, 300,
)  # fmt: skip
_EYES: Final = (33, 263)
#: Pictures have y down and z into them; in a picture the robot's left is on the right.
_TO_FACE_AXES: Final = np.array([1.0, -1.0, -1.0])


class NoFaceError(CalibrationError):
    """An error: a picture does not show exactly one face; the message has the cause, no file."""


def one_face(tracker: FaceTracker, picture: Picture) -> Array:
    """Return the mesh points of the only face in a picture.

    Raises NoFaceError for no face, or for a second one at least half as wide as the widest.

    Parameters
    ----------
    tracker : FaceTracker
        Finds faces.
    picture : Picture
        (height, width, 3).

    Returns
    -------
    Array
        (478, 3) pixels.
    """
    faces = tracker.faces(picture)
    if not faces:
        raise NoFaceError(NO_FACE)
    widths = [float(np.ptp(face[:, 0])) for face in faces]
    if len(faces) > 1 and widths[1] >= _BACKGROUND_SHARE * widths[0]:
        raise NoFaceError(_TWO_FACES)
    return faces[0]


class MeshFrame:
    """The head's coordinate frame, set by a first picture, in which markers are given in mm."""

    def __init__(self, points_px: Array, eye_distance_mm: float) -> None:
        """Set the frame by points_px (478, 3) of neutral and the mm between outer eye corners."""
        face = points_px * _TO_FACE_AXES
        right, left = face[list(_EYES)]
        scale = eye_distance_mm / float(np.linalg.norm(left - right))
        self._rigid_mm = (face[list(_RIGID)] - (left + right) / 2) * scale

    def markers_mm(self, points_px: Array) -> Array:
        """Return markers in the frame of the first picture.

        The similarity that lays the rigid points on those of the first picture removes the camera's
        movement: Umeyama (IEEE PAMI 13(4), 1991), eqs. (39)-(42).

        Parameters
        ----------
        points_px : Array
            (478, 3) mesh points of a picture.

        Returns
        -------
        Array
            (47, 3) mm, in the order of `MARKERS_47`.
        """
        face = (points_px * _TO_FACE_AXES)[None]
        fit = fit_similarity(face[:, list(_RIGID)], self._rigid_mm)
        return np.asarray(apply_similarity(face[:, list(MARKERS_47.landmarks)], *fit)[0])


#: What to do about a picture without a face.
_FOLDER_REMEDY: Final = (
    "light it from the front and let it fill a third of the picture; a robot that is not human "
    "enough is found by no face mesh and needs dots (docs/calibration.md)"
)
_UNREADABLE: Final = "not readable as a picture"
#: Named in one message; the others are counted.
_MOST_NAMED: Final = 8


class MeshFolder:
    """Reader of photographs in a folder to which pictures are still added or changed."""

    def __init__(
        self,
        folder: Path,
        tracker: FaceTracker,
        eye_distance_mm: float,
        tell: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Open a folder. eye_distance_mm: between the outer eye corners, for the scale.

        tracker: finds faces; tell: called with the reason why a photograph is of no use.
        """
        self._folder, self._tracker = folder, tracker
        self._eye_distance_mm = eye_distance_mm
        self._tell = tell
        self._frame: MeshFrame | None = None
        self._unreadable: dict[Path, tuple[int, int]] = {}
        #: By file: its size and time of change, and its markers (47, 3), or why it has none.
        self._read_results: dict[Path, tuple[tuple[int, int], Array | str]] = {}

    def readings(self, pose: int) -> list[Reading]:
        """Return pose, marker and position (3,) in mm, from all usable photographs of one pose."""
        return self._read(pose)[0]

    def all_readings(self) -> list[Reading]:
        """Read every photograph in the folder; return a list of (pose, marker, position).

        The list has one tuple for each marker in each photograph: pose number, marker name and
        position, (3,) mm. Raises CalibrationError if there is no picture, or, with the names of the
        files, if any is unreadable or does not show exactly one face.
        """
        readings, useless = self._read(None)
        if useless:
            named = ", ".join(f"{name} ({why})" for name, why in useless[:_MOST_NAMED])
            more = f" and {len(useless) - _MOST_NAMED} more" if len(useless) > _MOST_NAMED else ""
            raise CalibrationError(
                f"{self._folder}: {named}{more}: take these again or remove them; {_FOLDER_REMEDY}"
            )
        return readings

    def _read(self, pose: int | None) -> tuple[list[Reading], list[tuple[str, str]]]:
        """Return the readings of photographs of a pose, and the names of useless ones with reasons.

        pose: None: of all poses.
        """
        readings: list[Reading] = []
        useless = []
        for number, path in pose_pictures(self._folder, pose):
            result = self._markers_of(path)
            if isinstance(result, str):
                useless.append((path.name, result))
            else:
                by_name = zip(MARKERS_47.names, result, strict=True)
                readings += [(number, name, np.asarray(place_mm)) for name, place_mm in by_name]
        return readings, useless

    def _markers_of(self, path: Path) -> Array | str:
        """Return a photograph's markers, (47, 3) mm, or the reason why it has none.

        A photograph is read again only after its size or time of change differs. One that is
        unreadable is read a second time before `tell` is called, as another program may be writing
        the file.
        """
        try:
            status = path.stat()
        except FileNotFoundError:
            return NO_FACE  # renamed while we look
        state = (status.st_size, status.st_mtime_ns)
        stored = self._read_results.get(path)
        if stored is None or stored[0] != state:
            result = self._read_photograph(path)
            if result is _UNREADABLE and self._unreadable.get(path) != state:
                self._unreadable[path] = state  # somebody may be writing it; looked at once more
                return result
            self._read_results[path] = (state, result)
            if isinstance(result, str):
                self._tell(f"{path.name}: {result}; take it again: {_FOLDER_REMEDY}")
        return self._read_results[path][1]

    def _read_photograph(self, path: Path) -> Array | str:
        """Read a photograph; return its markers, (47, 3) mm, or the reason why it has none.

        The first photograph that shows a face defines the coordinate frame of all others.
        """
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


#: The points (478, 3) of the one face in a picture that is taken now, in pixels. Raises
#: NoFaceError.
See = Callable[[], Array]
#: Pictures of a pose: their median is steadier than one. A face is looked for in so many more.
_N_PICTURES: Final = 5
_MOST_PICTURES: Final = 15
#: So many poses without a face, one after another, are no accident.
_MOST_LOST: Final = 5
_CAMERA_REMEDY: Final = (
    "let it look straight at the camera, lit from the front, a third of the picture wide; a robot "
    "that is not human enough is found by no face mesh and needs dots (docs/calibration.md)"
)


class CameraTracker:
    """Tracker of 47 markers with a camera; the frame is that of the robot's neutral, pose 0."""

    marker_names = MARKERS_47.names

    def __init__(self, see: See, eye_distance_mm: float, say: Callable[[str], None]) -> None:
        """Set the frame by pictures of neutral. CalibrationError unless 5 of 15 contain a face.

        see: takes a picture and returns the mesh points, (478, 3) pixels, of its face;
        eye_distance_mm: between the outer eye corners; say: called with lines for the user.
        """
        self._see, self._say = see, say
        points_px, why = self._take_pictures()
        if not points_px:
            raise CalibrationError(f"camera, pose 0 (neutral): {why}; {_CAMERA_REMEDY}")
        self._frame = MeshFrame(np.median(np.array(points_px), axis=0), eye_distance_mm)
        self._pose = self._n_lost = 0

    def arrived(self, pose: int, _reached_deg: Array) -> None:
        """Store the number of the pose that the robot holds.

        Parameters
        ----------
        pose : int
            Counted from 0.
        _reached_deg : Array
            (n_servos,), not used.
        """
        self._pose = pose + 1

    def measure(self) -> Array:
        """Return the median of the markers in 5 pictures of the pose.

        Returns
        -------
        Array
            (47, 3) mm; NaN in a pose without a face, which is reported.

        Raises
        ------
        CalibrationError
            After five poses without a face in a row.
        """
        points_px, why = self._take_pictures()
        if points_px:
            self._n_lost = 0
            seen_mm = [self._frame.markers_mm(each) for each in points_px]
            return np.asarray(np.median(np.array(seen_mm), axis=0))
        self._n_lost += 1
        if self._n_lost == _MOST_LOST:
            raise CalibrationError(
                f"camera, pose {self._pose} and the four before it: {why}; {_CAMERA_REMEDY}"
            )
        self._say(f"pose {self._pose}: {why}; the pose is left out")
        return np.full((len(self.marker_names), 3), np.nan)

    def _take_pictures(self) -> tuple[list[Array], str]:
        """Return the mesh points, (478, 3) pixels, of 5 pictures; [] if fewer of 15 contain a face.

        The second value is the reason why the last picture without a face had none; else empty.
        """
        meshes_px: list[Array] = []
        why = ""
        for _ in range(_MOST_PICTURES):
            try:
                meshes_px.append(self._see())
            except NoFaceError as error:
                why = str(error)
            if len(meshes_px) == _N_PICTURES:
                break
        return (meshes_px, why) if len(meshes_px) == _N_PICTURES else ([], why)
