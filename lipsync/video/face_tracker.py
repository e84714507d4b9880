"""Face trackers, which find the points of faces in pictures, and the choice of a tracker.

Points are numbered as the 478-point face mesh does (`lipsync/markers.py`).

One tracker uses the networks inside a `face_landmarker.task`, run by `ai-edge-litert`: Grishchenko,
Ablavatski, Kartynnik, Raveendran and Grundmann, "Attention mesh: high-fidelity face mesh prediction
in real-time", 2020. The file is the user's (docs/own-face.md): a zip archive of TensorFlow Lite
networks. Everything around the networks is here: the squares of the picture that are their inputs,
and the positions of their outputs in the picture.

The other uses mediapipe's own face mesh, whose network its wheel contains: only the versions before
0.10.30 have it (docs/decisions/faces-from-recordings.md).
"""

import zipfile
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lipsync.array_archive import UNREADABLE
from lipsync.arrays import Array
from lipsync.errors import UserError, check_extra
from lipsync.markers import N_LANDMARKS
from lipsync.video.face_detection import (
    DETECTOR_PIXELS,
    Detection,
    FaceBox,
    Picture,
    box_around,
    cut_out,
    detections,
)


class TrackerError(UserError):
    """Error for a tracker that cannot be used; the message is one line: what is missing, remedy."""


class FaceTracker(Protocol):
    """A tracker that finds the points of every face in a picture."""

    @property
    def name(self) -> str:
        """The tracker's name, as printed and stored with its results."""

    def faces(self, picture: Picture) -> tuple[Array, ...]:
        """Return the points of each face, the largest face first; () if there is no face.

        Pictures are independent of each other: nothing is smoothed over time.

        Parameters
        ----------
        picture : Picture
            (height, width, 3).

        Returns
        -------
        tuple[Array, ...]
            (478, 3) pixels each: x right, y down, z away from the viewer.
        """


_DETECTOR, _LANDMARKS = "face_detector.tflite", "face_landmarks_detector.tflite"
_LANDMARK_PIXELS = 256
#: Least probability of a face, by the landmark network, with which its points are used.
_LEAST_PRESENCE = 0.5
#: Faces searched in one picture.
_MOST_FACES = 3
#: Of each network, unpacked; they have a few.
_MOST_BYTES = 64_000_000


class LitertTracker:
    """A tracker by the networks of a landmarker file.

    Raises TrackerError for another file, MissingExtraError without `ai-edge-litert`.
    """

    def __init__(self, landmarker: Path) -> None:
        """Load both networks of the file `landmarker`. Raises as the class says."""
        check_extra("ai_edge_litert", "--landmarker")
        networks = _read_networks(landmarker)
        try:
            self._detector = _Network(networks[_DETECTOR])
            self._landmarks = _Network(networks[_LANDMARKS])
        except (ValueError, RuntimeError) as error:
            raise TrackerError(
                f"{landmarker}: its networks cannot be run ({str(error).splitlines()[0]}); get the "
                "file again (docs/own-face.md)"
            ) from error
        self._name = f"{landmarker.name} by ai-edge-litert"

    @property
    def name(self) -> str:
        """The tracker's name: file name of the landmarker, and library."""
        return self._name

    def faces(self, picture: Picture) -> tuple[Array, ...]:
        """Return the (478, 3) points of each face, the largest first; see `FaceTracker`.

        Parameters
        ----------
        picture : Picture
            (height, width, 3).
        """
        faces = []
        for detection, square in self._detect(picture):
            points = self._points(picture, _face_box(detection, square))
            if points is not None:
                faces.append(points)
        faces.sort(key=lambda points: -float(np.ptp(points[:, 0])))
        return tuple(faces)

    def _detect(self, picture: Picture) -> list[tuple[Detection, FaceBox]]:
        """Return up to three faces, the surest first, each with the square its lengths refer to."""
        height, width = picture.shape[:2]
        square = FaceBox(width / 2, height / 2, float(max(width, height)), 0.0)
        outputs = self._detector.run(cut_out(picture, square, DETECTOR_PIXELS) * 2 - 1)
        regressors = next(output for output in outputs if output.shape[-1] == 16)
        scores = next(output for output in outputs if output.shape[-1] == 1)
        faces = detections(regressors[0].astype(float), scores[0, :, 0].astype(float))
        return [(face, square) for face in faces[:_MOST_FACES]]

    def _points(self, picture: Picture, box: FaceBox) -> Array | None:
        """Return the points (478, 3) in pixels of the face in `box`; None if none is there."""
        outputs = self._landmarks.run(cut_out(picture, box, _LANDMARK_PIXELS))
        presence = next(output for output in outputs if output.shape == (1, 1, 1, 1))
        if 1.0 / (1.0 + np.exp(-float(presence.item()))) < _LEAST_PRESENCE:
            return None
        flat = next(output for output in outputs if output.size == N_LANDMARKS * 3)
        return box.to_picture(flat.reshape(N_LANDMARKS, 3).astype(float) / _LANDMARK_PIXELS)


def _face_box(detection: Detection, square: FaceBox) -> FaceBox:
    """Return the square for the landmark network; `square`: that of the detection's lengths."""
    corners = detection.box.reshape(2, 2)
    inside = np.column_stack((np.concatenate((corners, detection.eyes)), np.zeros(4)))
    points_px = square.to_picture(inside)[:, :2]
    return box_around(points_px[:2], points_px[2], points_px[3])


class _Network:
    """One TensorFlow Lite network with one input."""

    def __init__(self, content: bytes) -> None:
        """Load the network from the bytes of a .tflite file. Raises ValueError or RuntimeError."""
        from ai_edge_litert.interpreter import Interpreter

        self._interpreter: Any = Interpreter(model_content=content, num_threads=1)
        self._interpreter.allocate_tensors()
        self._input = self._interpreter.get_input_details()[0]["index"]
        self._outputs = [each["index"] for each in self._interpreter.get_output_details()]

    def run(self, picture: NDArray[np.float32]) -> list[NDArray[np.float32]]:
        """Return the network's outputs for a square picture (n, n, 3)."""
        self._interpreter.set_tensor(self._input, picture[None])
        self._interpreter.invoke()
        return [self._interpreter.get_tensor(output) for output in self._outputs]


def _read_networks(landmarker: Path) -> dict[str, bytes]:
    """Return the two networks in a landmarker file, by name. Raises TrackerError."""
    try:
        with zipfile.ZipFile(landmarker) as file:
            for name in (_DETECTOR, _LANDMARKS):
                if file.getinfo(name).file_size > _MOST_BYTES:
                    raise ValueError(f"array {name} has more than {_MOST_BYTES // 10**6} MB")
            return {name: file.read(name) for name in (_DETECTOR, _LANDMARKS)}
    except FileNotFoundError:
        raise TrackerError(
            f"{landmarker}: no such file; docs/own-face.md says how to get a face_landmarker.task"
        ) from None
    except (KeyError, *UNREADABLE) as error:
        raise TrackerError(
            f"{landmarker}: not a face_landmarker.task ({error}); get one (docs/own-face.md)"
        ) from error


class MediapipeTracker:
    """A tracker by mediapipe's face mesh with attention, each picture by itself.

    Raises ImportError without mediapipe, AttributeError with one from 0.10.30 on.
    """

    def __init__(self) -> None:
        """Load mediapipe and its face mesh. Raises as the class says."""
        import mediapipe

        self._mesh: Any = mediapipe.solutions.face_mesh.FaceMesh(
            static_image_mode=True, max_num_faces=_MOST_FACES, refine_landmarks=True
        )
        self._name = f"mediapipe {mediapipe.__version__}"

    @property
    def name(self) -> str:
        """The tracker's name: library and version."""
        return self._name

    def faces(self, picture: Picture) -> tuple[Array, ...]:
        """Return the (478, 3) points of each face, the largest first; see `FaceTracker`.

        Parameters
        ----------
        picture : Picture
            (height, width, 3).
        """
        height, width = picture.shape[:2]
        landmarks = self._mesh.process(picture).multi_face_landmarks or ()
        scale = np.array([width, height, width], dtype=np.float64)
        faces = [np.array([[p.x, p.y, p.z] for p in face.landmark]) * scale for face in landmarks]
        return tuple(sorted(faces, key=lambda points: -float(np.ptp(points[:, 0]))))


def open_tracker(landmarker: Path | None) -> FaceTracker:
    """Return a tracker by the landmarker file `landmarker`; None: by mediapipe.

    Raises TrackerError for an unusable file or without a mediapipe that has this mesh,
    MissingExtraError without the library that runs the file.
    """
    if landmarker is not None:
        return LitertTracker(landmarker)
    try:
        return MediapipeTracker()
    except (ImportError, AttributeError) as error:
        raise TrackerError(
            f"mediapipe older than 0.10.30 is needed and cannot be loaded ({error}): up to Python "
            "3.12 `pip install 'lipservo[video]'` brings it; or give --landmarker FILE, a "
            "face_landmarker.task (docs/own-face.md)"
        ) from error
