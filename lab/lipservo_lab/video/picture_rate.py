"""Pictures at a constant rate, and the sound that belongs to them.

Cameras of telephones and computers film at the rate that the light allows. Points are interpolated
between the pictures' time stamps, never the pictures themselves.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lipservo_lab.video.face_track import FaceTrack
from lipsync.arrays import Array, Array32
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.video.video_file import VideoSound

#: Rates that cameras mean when their time stamps are rounded.
_USUAL_HZ = (24000 / 1001, 24.0, 25.0, 30000 / 1001, 30.0, 50.0, 60000 / 1001, 60.0)
_SAME_RATE = 2e-3
#: Time stamps this far from a constant rate are rounding (Matroska's are whole milliseconds).
_STEADY_S = 2.5e-3


@dataclass(frozen=True, slots=True)
class SteadyClip:
    """Points (n, 478, 3) at i / rate_hz, and samples at 16 kHz from the same moment on, as long.

    from_s: where in the sound given it begins. was_steady: whether no point had to be interpolated
    for the sake of the rate.
    """

    points: Array32
    rate_hz: float
    samples: NDArray[np.float32]
    from_s: float
    was_steady: bool


def usual_step_s(times_s: Array) -> float:
    """The mean time from picture to picture, pauses left out. times_s: (n,), n >= 2."""
    steps_s = np.diff(times_s)
    median_s = float(np.median(steps_s))
    return float(steps_s[steps_s < 1.5 * median_s].mean()) if median_s > 0 else median_s


def picture_rate_hz(times_s: Array) -> float:
    """The constant rate that time stamps (n,) are nearest to; a usual one where it is that."""
    rate_hz = 1.0 / usual_step_s(times_s)
    nearest = min(_USUAL_HZ, key=lambda usual: abs(usual - rate_hz))
    return nearest if abs(nearest / rate_hz - 1) < _SAME_RATE else round(rate_hz, 2)


def steady_clip(track: FaceTrack, sound: VideoSound, rate_hz: float) -> SteadyClip:
    """What pictures and sound have in common, at a constant rate.

    It begins with a picture, and ends with one. Pictures without a face are bridged by those around
    them. track: with a face in some picture. The clip may be empty (0 frames).
    """
    seen = track.n_faces > 0
    times_s, points = track.times_s[seen], track.points[seen]
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
    """Linearly between the pictures before and after; points (n, 478, 3)."""
    after = np.clip(np.searchsorted(times_s, grid_s), 1, len(times_s) - 1)
    before = after - 1
    step_s = times_s[after] - times_s[before]
    share = np.clip((grid_s - times_s[before]) / step_s, 0.0, 1.0)[:, None, None]
    mixed = points[before] * (1 - share) + points[after] * share
    return np.asarray(mixed, np.float32)
