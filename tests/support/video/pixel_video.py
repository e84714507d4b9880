"""Video of faces made of pixels, and a tracker that sees them: no network, no camera.

A face is a red rectangle. How wide it is says how large the face is, a green column in it how far
the lips are apart, and its blue how far it is turned. The tracker is faked at its protocol, as a
sound device is; all else is real: PyAV writes and reads the files.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

SIZE = (120, 200)
FACE_PX = 80
#: Pixels of green for a millimetre of lip gap, where eye corners are 90 mm apart.
_GREEN_PER_MM = 2
_TEMPLATE_EYES = 60.0
_CLOCK = Fraction(1, 1000)
_OTHER_POINTS = np.random.default_rng(0).normal(0.0, 15.0, (478, 3))


@dataclass(frozen=True)
class PixelFace:
    """left_px: where the rectangle begins; yaw_deg: 0 to 90; gap_mm: 0 to 40."""

    gap_mm: float
    left_px: int = 20
    width_px: int = FACE_PX
    yaw_deg: int = 0


def picture(faces: Sequence[PixelFace]) -> np.ndarray:
    pixels = np.zeros((*SIZE, 3), np.uint8)
    for face in faces:
        columns = slice(face.left_px, face.left_px + face.width_px)
        pixels[10:110, columns, 0] = 255
        pixels[10:110, columns, 2] = face.yaw_deg
        pixels[10 : 10 + round(face.gap_mm * _GREEN_PER_MM), face.left_px + 5, 1] = 255
    return pixels


def write_video(
    path: Path,
    pictures: Sequence[np.ndarray],
    times_s: Sequence[float],
    samples: np.ndarray | None,
    sound_from_s: float = 0.0,
) -> Path:
    """Lossless Matroska. samples: (n,) at 16 kHz, or None for a video without sound."""
    with av.open(str(path), "w") as file:
        video = file.add_stream("ffv1", rate=25)
        video.width, video.height, video.pix_fmt = SIZE[1], SIZE[0], "bgr0"
        video.time_base = video.codec_context.time_base = _CLOCK
        audio = None
        if samples is not None:
            audio = file.add_stream("pcm_s16le", rate=16_000, layout="mono")
        for pixels, time_s in zip(pictures, times_s, strict=True):
            frame = av.VideoFrame.from_ndarray(pixels, format="rgb24")
            frame.pts, frame.time_base = round(time_s * 1000), _CLOCK
            file.mux(video.encode(frame))
        file.mux(video.encode(None))
        if audio is not None:
            pcm = np.rint(samples * 32767).astype(np.int16)
            for first in range(0, len(pcm), 1600):
                piece = av.AudioFrame.from_ndarray(
                    pcm[None, first : first + 1600], format="s16", layout="mono"
                )
                piece.sample_rate, piece.time_base = 16_000, Fraction(1, 16_000)
                piece.pts = first + round(sound_from_s * 16_000)
                file.mux(audio.encode(piece))
            file.mux(audio.encode(None))
    return path


class PixelTracker:
    """Sees the rectangles. Implements `FaceTracker`."""

    name = "pixels"

    def faces(self, pixels: np.ndarray) -> tuple[np.ndarray, ...]:
        red = (pixels[60, :, 0] > 128).astype(int)
        edges = np.flatnonzero(np.diff(red, prepend=0, append=0))
        found = [self._points(pixels, *pair) for pair in edges.reshape(-1, 2)]
        return tuple(sorted(found, key=lambda points: -float(np.ptp(points[:, 0]))))

    def _points(self, pixels: np.ndarray, left: int, right: int) -> np.ndarray:
        gap_mm = (pixels[:, left + 5, 1] > 128).sum() / _GREEN_PER_MM
        points = face_points(gap_mm)
        yaw = np.radians(int(pixels[100, left, 2]))
        turned = np.array(
            [[np.cos(yaw), 0, -np.sin(yaw)], [0, 1, 0], [np.sin(yaw), 0, np.cos(yaw)]]
        )
        return points @ turned.T * ((right - left) / FACE_PX) + [(left + right) / 2, 60.0, 0.0]


def face_points(gap_mm: float) -> np.ndarray:
    """(478, 3): a symmetric face whose outer eye corners are 60 pixels apart."""
    points = _OTHER_POINTS.copy()
    half = _TEMPLATE_EYES / 2
    for right, left, x, y in ((33, 263, half, -15), (127, 356, 38, -12), (234, 454, 40, 0)):
        points[right], points[left] = (-x, y, 0), (x, y, 0)
    points[10], points[152] = (0, -45, 0), (0, 45, 0)
    gap_px = gap_mm * _TEMPLATE_EYES / 90.0
    points[13], points[14] = (0, 25 - gap_px / 2, -10), (0, 25 + gap_px / 2, -10)
    return points
