"""Track the face in a video: the points of the face in every picture, with times.

`tracked_gaps_mm`: how far the lips are apart, as the reader of a corpus will measure it.

`steady_clip`: pictures at a constant rate, and their sound. Cameras of phones and computers film at
the rate that the light allows. Points are interpolated between the pictures' time stamps, never the
pictures themselves.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array, Array32
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.face.head_motion import apply_similarity, fit_similarity, refine_mean
from lipsync.markers import N_LANDMARKS
from lipsync.video.face_detection import FaceBox, Picture, cut_out
from lipsync.video.face_tracker import FaceTracker
from lipsync.video.video_file import VideoSound, video_pictures

#: A face narrower than this share of the widest one is of a person in the background.
_BACKGROUND = 0.5
#: One picture every so many seconds is kept for the picture sheet, of so many pixels.
_SAMPLE_EVERY_S = 2.0
_SAMPLE_PIXELS = 160
#: Size of such a picture, in sizes of the face.
_SAMPLE_MARGIN = 1.3


@dataclass(frozen=True, slots=True)
class FaceSample:
    """A picture of a face, for the picture sheet.

    picture: (160, 160, 3), 8-bit; points: (478, 2) in its pixels.
    """

    time_s: float
    picture: Picture
    points: Array


@dataclass(frozen=True, slots=True)
class FaceTrack:
    """The widest face of every picture.

    times_s: (n,), the pictures' time stamps; n_faces: (n,), faces in each, without those in the
    background; points: (n, 478, 3), pixels as of `FaceTracker`, NaN without a face.
    """

    times_s: Array
    n_faces: NDArray[np.int64]
    points: Array32
    samples: tuple[FaceSample, ...]

    def between(self, start_s: float, end_s: float) -> "FaceTrack":
        """Return the track of the pictures from start_s to before end_s."""
        inside = (self.times_s >= start_s) & (self.times_s < end_s)
        return replace(
            self,
            times_s=self.times_s[inside],
            n_faces=self.n_faces[inside],
            points=self.points[inside],
            samples=tuple(s for s in self.samples if start_s <= s.time_s < end_s),
        )


def track_face(path: Path, tracker: FaceTracker, advance: Callable[[float], None]) -> FaceTrack:
    """Track the face in a video.

    advance: called with the time of every picture, s. Raises VideoError for a video that cannot be
    read.
    """
    times_s: list[float] = []
    n_faces: list[int] = []
    points: list[Array32] = []
    samples: list[FaceSample] = []
    for time_s, picture in video_pictures(path):
        if times_s and time_s <= times_s[-1]:
            continue  # damaged files have the same time stamp twice
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
    """Return the part of a picture around a face, 8-bit, with the face's points in its pixels.

    face: (n, 2 or more), columns x and y in pixels of the whole picture.
    """
    low, high = face[:, :2].min(axis=0), face[:, :2].max(axis=0)
    x_px, y_px = (low + high) / 2
    size_px = float((high - low).max()) * _SAMPLE_MARGIN
    box = FaceBox(float(x_px), float(y_px), size_px, 0.0)
    cut = (cut_out(picture, box, _SAMPLE_PIXELS) * 255).astype(np.uint8)
    corner = np.array([x_px, y_px]) - size_px / 2
    return FaceSample(time_s, cut, (face[:, :2] - corner) * (_SAMPLE_PIXELS / size_px))


#: Points that only move with the skull: bridge and root of the nose, corners of the eyes, forehead,
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
    """Return the gap between the inner lips, (n,) mm, of points (n, 478, 3) in pixels.

    The outer eye corners count as 90 mm apart.
    """
    face = points.astype(np.float64) * _TO_FACE_AXES
    rigid = face[:, RIGID]
    similarity = fit_similarity(rigid, refine_mean(rigid, (*_EYES, _EYE_DISTANCE_MM)))
    lips = apply_similarity(face[:, (_UPPER, _LOWER)], *similarity)
    gaps: Array = np.linalg.norm(lips[:, 0] - lips[:, 1], axis=1)
    return gaps


#: Exact rates of cameras, whose time stamps are rounded.
_USUAL_HZ = (24000 / 1001, 24.0, 25.0, 30000 / 1001, 30.0, 50.0, 60000 / 1001, 60.0)
_SAME_RATE = 2e-3
#: Time stamps within this of a constant rate are only rounded (Matroska's are whole milliseconds).
_STEADY_S = 2.5e-3


@dataclass(frozen=True, slots=True)
class SteadyClip:
    """Points at a constant rate, and the sound from the same instant on, equally long.

    points: (n, 478, 3), at i / rate_hz; samples: at 16 kHz. from_s: time in the original sound at
    which the clip begins. was_steady: whether the pictures had this rate already, so that points
    were not interpolated.
    """

    points: Array32
    rate_hz: float
    samples: NDArray[np.float32]
    from_s: float
    was_steady: bool


def usual_step_s(times_s: Array) -> float:
    """Return the mean time from picture to picture, without pauses; times_s: (n,), n >= 2."""
    steps_s = np.diff(times_s)
    median_s = float(np.median(steps_s))
    return float(steps_s[steps_s < 1.5 * median_s].mean()) if median_s > 0 else median_s


def picture_rate_hz(times_s: Array) -> float:
    """Return the rate of time stamps (n,), Hz: a usual camera rate if one is near enough."""
    rate_hz = 1.0 / usual_step_s(times_s)
    nearest = min(_USUAL_HZ, key=lambda usual: abs(usual - rate_hz))
    return nearest if abs(nearest / rate_hz - 1) < _SAME_RATE else round(rate_hz, 2)


def steady_clip(track: FaceTrack, sound: VideoSound, rate_hz: float) -> SteadyClip:
    """Return pictures and sound of the time that both have, with pictures at a constant rate.

    The clip begins and ends with a picture. Pictures without a face are interpolated from those
    around them. track: has a face in some picture. The clip may be empty (0 frames).
    """
    has_face = track.n_faces > 0
    times_s, points = track.times_s[has_face], track.points[has_face]
    sound_end_s = sound.begins_s + len(sound.samples) / SAMPLE_RATE_HZ
    later = times_s[times_s >= sound.begins_s - 1e-4]
    if not len(later):
        return SteadyClip(points[:0], rate_hz, sound.samples[:0], 0.0, True)
    start_s = float(later[0])
    n = 1 + int(np.floor((times_s[-1] - start_s) * rate_hz + _STEADY_S * rate_hz))
    n = min(n, 1 + int(np.floor((sound_end_s - start_s) * rate_hz + 1e-6)))
    grid_s = start_s + np.arange(max(n, 0)) / rate_hz
    after = np.clip(np.searchsorted(times_s, grid_s), 1, max(1, len(times_s) - 1))
    nearest = np.where(
        np.abs(times_s[after - 1] - grid_s) <= np.abs(times_s[after % len(times_s)] - grid_s),
        after - 1,
        after % len(times_s),
    )
    is_steady = bool((np.abs(times_s[nearest] - grid_s) <= _STEADY_S).all())
    steady = points[nearest] if is_steady else _interpolated(times_s, points, grid_s)
    from_s = start_s - sound.begins_s
    first = max(0, round(from_s * SAMPLE_RATE_HZ))
    n_samples = round(len(grid_s) / rate_hz * SAMPLE_RATE_HZ)
    return SteadyClip(steady, rate_hz, sound.samples[first : first + n_samples], from_s, is_steady)


def _interpolated(times_s: Array, points: Array32, grid_s: Array) -> Array32:
    """Return points (n, 478, 3) interpolated linearly between the pictures before and after.

    times_s: of the pictures; grid_s: (n,), wanted times.
    """
    after = np.clip(np.searchsorted(times_s, grid_s), 1, len(times_s) - 1)
    before = after - 1
    step_s = times_s[after] - times_s[before]
    share = np.clip((grid_s - times_s[before]) / step_s, 0.0, 1.0)[:, None, None]
    mixed = points[before] * (1 - share) + points[after] * share
    return np.asarray(mixed, np.float32)
