"""Where the points of a face are in every picture of a video."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array, Array32
from lipsync.face_mesh import N_LANDMARKS
from lipsync.video.tracking.face_box import FaceBox, cut_out
from lipsync.video.tracking.face_tracker import FaceTracker, Picture
from lipsync.video.video_file import video_pictures

#: A face narrower than this share of the widest one is somebody in the background.
_BACKGROUND = 0.5
#: One picture in so many seconds is kept for the picture sheet, so large.
_SAMPLE_EVERY_S = 2.0
_SAMPLE_PIXELS = 160
#: How much of a sample lies around the face.
_SAMPLE_MARGIN = 1.3


@dataclass(frozen=True, slots=True)
class FaceSample:
    """A face as it was filmed: picture (160, 160, 3), points (478, 2) in its pixels."""

    time_s: float
    picture: Picture
    points: Array


@dataclass(frozen=True, slots=True)
class FaceTrack:
    """The widest face of every picture.

    times_s: (n,), the pictures' time stamps; n_faces: (n,), how many faces are in each, those in
    the background aside; points: (n, 478, 3), pixels as `FaceTracker` has them, NaN without a face.
    """

    times_s: Array
    n_faces: NDArray[np.int64]
    points: Array32
    samples: tuple[FaceSample, ...]

    def between(self, start_s: float, end_s: float) -> "FaceTrack":
        """The pictures from start_s to before end_s."""
        inside = (self.times_s >= start_s) & (self.times_s < end_s)
        return replace(
            self,
            times_s=self.times_s[inside],
            n_faces=self.n_faces[inside],
            points=self.points[inside],
            samples=tuple(s for s in self.samples if start_s <= s.time_s < end_s),
        )


def track_face(path: Path, tracker: FaceTracker, advance: Callable[[float], None]) -> FaceTrack:
    """Track a video; `advance` is told the time of every picture, in s. Raises VideoError."""
    times_s: list[float] = []
    n_faces: list[int] = []
    points: list[Array32] = []
    samples: list[FaceSample] = []
    for time_s, picture in video_pictures(path):
        if times_s and time_s <= times_s[-1]:
            continue  # a damaged file tells the same moment twice
        faces = tracker.faces(picture)
        widths = [float(np.ptp(face[:, 0])) for face in faces]
        times_s.append(time_s)
        n_faces.append(sum(width >= _BACKGROUND * widths[0] for width in widths))
        face = faces[0] if faces else np.full((N_LANDMARKS, 3), np.nan)
        points.append(face.astype(np.float32))
        if faces and (not samples or time_s - samples[-1].time_s >= _SAMPLE_EVERY_S):
            samples.append(_sample(time_s, picture, face))
        advance(time_s)
    stacked = np.stack(points) if points else np.zeros((0, N_LANDMARKS, 3), np.float32)
    return FaceTrack(np.array(times_s), np.array(n_faces, np.int64), stacked, tuple(samples))


def _sample(time_s: float, picture: Picture, face: Array) -> FaceSample:
    low, high = face[:, :2].min(axis=0), face[:, :2].max(axis=0)
    x_px, y_px = (low + high) / 2
    size_px = float((high - low).max()) * _SAMPLE_MARGIN
    box = FaceBox(float(x_px), float(y_px), size_px, 0.0)
    seen = (cut_out(picture, box, _SAMPLE_PIXELS) * 255).astype(np.uint8)
    corner = np.array([x_px, y_px]) - size_px / 2
    return FaceSample(time_s, seen, (face[:, :2] - corner) * (_SAMPLE_PIXELS / size_px))
