"""The sources of marker positions: files, typed numbers, photographs, or a camera's face mesh."""

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from calibration.calibration import CalibrationError
from calibration.capture.capture import Capture
from calibration.capture.dots import (
    PROTRUSION_IS_UNSEEN,
    DotsFolder,
    holds_pictures,
    is_dots_folder,
)
from calibration.capture.face_mesh import PROTRUSION_IS_GUESSED, CameraTracker, MeshFolder, one_face
from calibration.capture.marker_files import Reading, read_capture, read_readings
from calibration.capture.trackers import FileTracker, ReadPose, Tracker
from firmware_bridge.clock import Clock, MonotonicClock
from lipservo.calibrating.calibration_setup import CalibrationSetup
from lipservo.calibrating.camera import AvCamera, CameraFeed
from lipservo.calibrating.measured_calibration import (
    CalibrationResult,
    Save,
    Take,
    calibrate_on_servos,
    computed_tracker,
    say,
)
from lipservo.runtime.servos.held_face import HeldFace
from lipsync.errors import UserError
from lipsync.video.face_detection import Picture
from lipsync.video.face_tracker import FaceTracker

CAMERA: Final = "camera"
_WARN_AT_READING: Final = 2
_LOOK_EVERY_S: Final = 0.01
_PATIENCE_S: Final = 10.0
#: Pictures that a device keeps for whoever is late.
_MOST_OLD_PICTURES: Final = 4
MakeTracker = Callable[[HeldFace], Tracker]
#: The readings of all poses: pose, marker, place (3,) in mm.
ReadAll = Callable[[], list[Reading]]


@dataclass(frozen=True, slots=True)
class MeshOptions:
    """Options for markers from pictures without dots, in which networks find the face.

    open_tracker: loads the networks. eye_distance_mm: between the outer corners of the eyes; None:
    not given. camera: as `AvCamera`. landmarker_given: whether the user named a network's file.
    """

    open_tracker: Callable[[], FaceTracker]
    eye_distance_mm: float | None = None
    camera: str = "0"
    landmarker_given: bool = False


def is_mesh_folder(folder: Path, mesh: MeshOptions) -> bool:
    """Return whether a folder contains, or will contain, photographs of a face without dots.

    A folder without pictures will, if `mesh` has an eye distance or a network's file.
    """
    if not folder.is_dir() or is_dots_folder(folder):
        return False
    if any(path.suffix.lower() == ".c3d" for path in folder.iterdir()):
        return False
    return mesh.landmarker_given or mesh.eye_distance_mm is not None or holds_pictures(folder)


def is_seen_from_the_front(source: Path, mesh: MeshOptions) -> bool:
    """Return whether `source` measures no depth: a camera, photographs, or pictures of dots.

    mesh: options for pictures without dots.
    """
    is_camera = str(source) == CAMERA
    return is_camera or is_mesh_folder(source, mesh) or (source.is_dir() and is_dots_folder(source))


def mesh_folder(folder: Path, setup: CalibrationSetup, mesh: MeshOptions) -> MeshFolder:
    """Return the reader of a folder of photographs of this robot; print that protrusion is guessed.

    mesh: the face mesh's options. Raises UserError if the eye distance or the tracker's software is
    missing.
    """
    eye_distance_mm = _eye_distance_mm(setup, mesh)
    say(PROTRUSION_IS_GUESSED)
    return MeshFolder(folder, mesh.open_tracker(), eye_distance_mm, say)


def picture_reader(markers: Path, setup: CalibrationSetup, mesh: MeshOptions) -> ReadAll | None:
    """Return a function that reads all pictures in the folder `markers`.

    None if it is a file or folder of marker positions, not of pictures. mesh: options for pictures
    without dots. Raises UserError.
    """
    if is_mesh_folder(markers, mesh):
        return mesh_folder(markers, setup, mesh).all_readings
    if markers.is_dir() and is_dots_folder(markers):
        return dots_folder(markers).readings
    return None


def read_recorded(
    setup: CalibrationSetup, plan: Path, markers: Path, axes: str, mesh: MeshOptions
) -> tuple[CalibrationSetup, Capture]:
    """Return the capture of a plan's file and recorded markers, and the setup for what saw them.

    axes: of C3D files; mesh: options for pictures without dots. Raises UserError.
    """
    read = picture_reader(markers, setup, mesh)
    new_setup = replace(setup, sees_forward=not is_seen_from_the_front(markers, mesh))
    return new_setup, read_capture(plan, markers, setup.servos.names, axes=axes, read=read)


@contextmanager
def tracker_source(
    setup: CalibrationSetup, source: str | None, axes: str, mesh: MeshOptions
) -> Iterator[MakeTracker]:
    """Yield a function that, called with the held servos, makes the source of marker positions.

    source: `camera`, a folder of pictures, or a file or folder that another program fills; None:
    markers are computed, a rehearsal. axes:
    those of C3D files that point left, up and forward, as `x z -y`; mesh: options for pictures
    without dots. Raises UserError for missing files and extras at once, before servos
    move.
    """
    if source is None:
        yield lambda _: computed_tracker(setup)
        return
    folder = Path(source)
    if source == CAMERA:
        eye_distance_mm = _eye_distance_mm(setup, mesh)
        tracker = mesh.open_tracker()
        with CameraFeed(AvCamera(mesh.camera)) as feed:
            say(PROTRUSION_IS_GUESSED)
            clock = MonotonicClock()

            def camera(face: HeldFace) -> Tracker:
                def see() -> np.ndarray:
                    return one_face(tracker, next_picture(feed, clock))

                return CameraTracker(lambda: face.hold_while(see), eye_distance_mm, say)

            yield camera
        return
    if is_mesh_folder(folder, mesh):
        yield _tracker_of(folder, setup.servos.names, mesh_folder(folder, setup, mesh).readings)
    elif folder.is_dir() and is_dots_folder(folder):
        yield _tracker_of(folder, setup.servos.names, _skip_faulty(dots_folder(folder).readings))
    else:
        if not folder.is_dir() and folder.suffix.lower() not in (".csv", ".json"):
            raise CalibrationError(f"--tracker {source} must be a .csv or .json file, or a folder")
        names, kept = setup.servos.names, setup.kept.markers_mm()

        def reader(face: HeldFace) -> Tracker:
            # All files are read at every look: longer than servos may go without goals.
            def read(_pose: int) -> list[Reading]:
                return face.hold_while(lambda: read_readings(folder, axes))

            return FileTracker(folder, names, face.hold, say, axes=axes, kept=kept, read=read)

        yield reader


def calibrate_seen(
    setup: CalibrationSetup,
    source: str | None,
    axes: str,
    mesh: MeshOptions,
    save: Save = lambda _: None,
    take: Take | None = None,
) -> CalibrationResult:
    """Capture, fit and grade a calibration with markers of a source, then measure the lags.

    source, axes, mesh: as for `tracker_source`; save, take: as for `calibrate_on_servos`. Raises
    UserError.
    """
    if source is not None:
        setup = replace(setup, sees_forward=not is_seen_from_the_front(Path(source), mesh))
    with tracker_source(setup, source, axes, mesh) as make_tracker:
        return calibrate_on_servos(setup, make_tracker, save=save, take=take)


def dots_folder(folder: Path) -> DotsFolder:
    """Return the reader of pictures of dots in a folder; print that protrusion is unseen.

    Raises CalibrationError.
    """
    say(PROTRUSION_IS_UNSEEN)
    return DotsFolder(folder, say)


def _tracker_of(folder: Path, names: tuple[str, ...], read: ReadPose) -> MakeTracker:
    """Return a function that makes a tracker of the pictures in `folder`, one picture a pose.

    names: of the servos. read: returns the readings of a pose; runs in a thread, while the held
    servos get goals.
    """

    def tracker(face: HeldFace) -> Tracker:
        # Reading a picture takes longer than servos may go without goals.
        return FileTracker(
            folder, names, face.hold, say, read=lambda pose: face.hold_while(lambda: read(pose))
        )

    return tracker


def _skip_faulty(read: ReadPose) -> ReadPose:
    """Return `read` changed so that a faulty picture gives no markers instead of an error.

    The error is printed once, at the second reading: at the first the file may be half written.
    """
    n_errors: Counter[str] = Counter()

    def readings(pose: int) -> list[Reading]:
        """Return the readings of a pose; [] for a faulty picture."""
        try:
            return read(pose)
        except CalibrationError as error:
            n_errors[str(error)] += 1
            if n_errors[str(error)] == _WARN_AT_READING:
                say(str(error))
            return []

    return readings


def next_picture(feed: CameraFeed, clock: Clock) -> Picture:
    """Return the first picture of `feed` taken from now on, (height, width, 3) RGB.

    Up to four pictures with older time stamps are skipped; the fifth counts in any case. Raises
    CameraError if the camera fails, and UserError after ten seconds without a picture.
    """
    # Pictures taken before this call are dropped.
    feed.take_frames()
    requested_s = clock.now()
    n_arrived = 0
    while clock.now() < requested_s + _PATIENCE_S:
        for time_s, frame in feed.take_frames():
            n_arrived += 1
            if time_s >= requested_s or n_arrived > _MOST_OLD_PICTURES:
                picture: Picture = frame.to_ndarray(format="rgb24")
                return picture
        clock.sleep_until(clock.now() + _LOOK_EVERY_S)
    raise UserError(f"camera {feed.camera.name!r} gives no pictures; plug it in again")


def _eye_distance_mm(setup: CalibrationSetup, mesh: MeshOptions) -> float:
    """Return the distance of the robot's outer eye corners, by option or YAML; else UserError."""
    found = mesh.eye_distance_mm or setup.settings.eye_distance_mm
    if found is None:
        raise UserError(
            "the size of the face is unknown; give --eye-distance-mm, from outer corner to outer "
            "corner of the robot's eyes, or write `eye_distance_mm:` in the face's YAML"
        )
    return found
