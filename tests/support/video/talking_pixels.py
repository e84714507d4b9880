"""Clips of pixel faces (pixel_video.py) that say the end of the bundled recording."""

from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np
from lipservo_lab.video.clip_labels import label_clip
from lipservo_lab.video.sound_shift import ExpectedLips
from pixel_video import PixelFace, picture, write_video

from lipsync.audio.file import read_speech

TEXT = "my lips move with every word maple fever five brave bumblebees"
_FROM = round(4.05 * 16_000)


@cache
def speech() -> np.ndarray:
    with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as path:
        return read_speech(path)[_FROM:]


@cache
def gaps_mm() -> np.ndarray:
    """(n,) every 10 ms: lips that move as the shipped model's, with a tracker's noise."""
    samples = speech()
    labels = label_clip(samples, TEXT)
    gaps = ExpectedLips().gaps_mm(labels.phones, len(samples) / 16_000)
    return np.maximum(0, gaps + np.random.default_rng(0).normal(0, 0.3, len(gaps)))


def even_times_s() -> np.ndarray:
    return np.arange(0, len(speech()) / 16_000, 0.04)


def write_clip(
    path: Path,
    times_s: np.ndarray | None = None,
    *,
    sound_late_s: float = 0.0,
    with_sound: bool = True,
    **face: int,
) -> Path:
    """sound_late_s: the same moment is heard so much later than it is seen."""
    times_s = even_times_s() if times_s is None else times_s
    seen_mm = np.interp(times_s, np.arange(len(gaps_mm())) * 0.01, gaps_mm())
    pictures = [picture([PixelFace(gap, **face)]) for gap in seen_mm]
    late = np.concatenate((np.zeros(round(sound_late_s * 16_000), np.float32), speech()))
    samples = late[: len(speech())] if with_sound else None
    return write_video(path, pictures, times_s, samples)


def write_pictures(path: Path, *faces: PixelFace) -> Path:
    """The same faces, none of which moves, in each of 30 pictures."""
    times_s = even_times_s()[:30]
    return write_video(path, [picture(faces)] * len(times_s), times_s, speech())
