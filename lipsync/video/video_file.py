"""Video files by PyAV: pictures with their times, and the sound on the same axis of time.

Whatever FFmpeg decodes. Pictures come upright and with square pixels, one at a time: a minute of
them would fill a gigabyte.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import soxr
from numpy.typing import NDArray

from lipsync.audio.file import read_speech
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.errors import UserError, check_extra
from lipsync.video.face_detection import Picture

#: Endings of video files in a folder.
VIDEO_ENDINGS = (
    ".avi", ".m4v", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".mts", ".ts", ".webm", ".wmv",
)  # fmt: skip
#: Sound whose time stamps leave a hole longer than this is filled up with silence there, s.
_HOLE_S = 0.02


class VideoError(UserError):
    """Error for a video that cannot be used; the message is one line: which, why, what to do."""


@dataclass(frozen=True, slots=True)
class VideoSound:
    """The sound of a video.

    samples: (n,) in [-1, 1] at 16 kHz, mono; begins_s: time of the first one on the pictures' axis.
    """

    samples: NDArray[np.float32]
    begins_s: float


def video_pictures(path: Path) -> Iterator[tuple[float, Picture]]:
    """Yield every picture with its time stamp in seconds, in order. Raises VideoError."""
    with _open_video(path) as video:
        if not video.streams.video:
            raise VideoError(f"{path}: has no pictures; give a video")
        stream = video.streams.video[0]
        stream.thread_type = "AUTO"
        aspect = float(stream.sample_aspect_ratio or 1)
        for frame in video.decode(stream):
            if frame.time is not None:
                yield float(frame.time), _upright(frame, aspect)


def video_sound(path: Path) -> VideoSound:
    """Return a video's sound: that of NAME.wav if it is beside the video, else the video's own.

    NAME.wav counts as begun at the first picture. Raises VideoError for a video without sound, or
    with digital silence alone.
    """
    separate = path.with_suffix(".wav")
    if separate.is_file():
        first_picture_s = next((time_s for time_s, _ in video_pictures(path)), 0.0)
        sound = VideoSound(read_speech(separate), first_picture_s)
    else:
        sound = _own_sound(path)
    if not sound.samples.any():
        raise VideoError(f"{path}: every sample of its sound is zero; film again")
    return sound


def video_duration_s(path: Path) -> float:
    """Return the duration in s in a video file's header, 0 if none is. Raises VideoError."""
    with _open_video(path) as video:
        duration: float = (video.duration or 0) / _import_av().time_base
        return duration


def _own_sound(path: Path) -> VideoSound:
    """Return a video's sound track, mono at 16 kHz; holes of over 20 ms are filled with silence.

    Raises VideoError for a video without a sound track, or with an empty one.
    """
    pieces: list[NDArray[np.float32]] = []
    begins_s, n_samples, rate_hz = 0.0, 0, 0
    with _open_video(path) as video:
        if not video.streams.audio:
            raise VideoError(f"{path}: has no sound; put {path.stem}.wav beside it, or film again")
        resampler = _import_av().AudioResampler(format="fltp")
        for frame in video.decode(video.streams.audio[0]):
            if not pieces:
                begins_s, rate_hz = float(frame.time or 0.0), frame.sample_rate
            n_missing = 0
            if frame.time is not None:
                n_missing = round((frame.time - begins_s) * rate_hz) - n_samples
            if n_missing > _HOLE_S * rate_hz:
                pieces.append(np.zeros(n_missing, np.float32))
                n_samples += n_missing
            for planar in resampler.resample(frame):
                pieces.append(planar.to_ndarray().mean(axis=0, dtype=np.float32))
                n_samples += len(pieces[-1])
    if not pieces:
        raise VideoError(f"{path}: its sound track is empty; film again")
    samples = np.clip(np.nan_to_num(np.concatenate(pieces)), -1.0, 1.0)
    if rate_hz != SAMPLE_RATE_HZ:
        samples = np.clip(soxr.resample(samples, rate_hz, SAMPLE_RATE_HZ), -1.0, 1.0)
    return VideoSound(samples.astype(np.float32), begins_s)


def _upright(frame: Any, aspect: float) -> Picture:
    """Return a decoded frame as an upright picture with square pixels.

    aspect: width of the frame's pixels divided by their height.
    """
    width = round(frame.width * aspect)
    picture: Picture = frame.to_ndarray(format="rgb24", width=width, height=frame.height)
    n_right_angles = round(frame.rotation / 90) % 4
    return np.ascontiguousarray(np.rot90(picture, n_right_angles)) if n_right_angles else picture


@contextmanager
def _open_video(path: Path) -> Iterator[Any]:
    """Yield an open video; errors of FFmpeg, while opening or reading, are raised as VideoError."""
    av = _import_av()
    try:
        with av.open(str(path)) as video:
            yield video
    except FileNotFoundError:
        raise VideoError(f"{path}: no such file") from None
    except av.FFmpegError as error:
        raise VideoError(f"{path}: cannot be read as video ({error.strerror})") from error


def _import_av() -> Any:
    check_extra("av", "reading video")
    import av

    return av
