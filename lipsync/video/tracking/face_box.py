"""The square around a face that a landmark network looks at, and the picture inside it.

As MediaPipe's graphs cut it: half as large again as the face, turned so that the eyes are level.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array
from lipsync.video.tracking.face_tracker import Picture

#: The square is so much larger than the face in it.
_MARGIN = 1.5


@dataclass(frozen=True, slots=True)
class FaceBox:
    """A square in a picture, in pixels; turn_rad: of its x axis, clockwise as one looks at it."""

    x_px: float
    y_px: float
    size_px: float
    turn_rad: float

    def to_picture(self, points: Array) -> Array:
        """(n, 3) in the square, 0 to 1, z at the same scale, as pixels of the picture."""
        cosine, sine = np.cos(self.turn_rad), np.sin(self.turn_rad)
        x, y = (points[:, :2] - 0.5).T * self.size_px
        return np.column_stack(
            (
                self.x_px + cosine * x - sine * y,
                self.y_px + sine * x + cosine * y,
                points[:, 2] * self.size_px,
            )
        )


def box_around(points_px: Array, right_eye_px: Array, left_eye_px: Array) -> FaceBox:
    """The square for a face of these points (n, 2); eyes (2,), the speaker's right one first."""
    low, high = points_px.min(axis=0), points_px.max(axis=0)
    x_px, y_px = (low + high) / 2
    across_px, down_px = left_eye_px - right_eye_px
    return FaceBox(
        float(x_px),
        float(y_px),
        float((high - low).max() * _MARGIN),
        float(np.arctan2(down_px, across_px)),
    )


def cut_out(picture: Picture, box: FaceBox, n_pixels: int) -> NDArray[np.float32]:
    """(n_pixels, n_pixels, 3) from 0 to 1, interpolated linearly; the picture's edge goes on."""
    height, width = picture.shape[:2]
    steps = ((np.arange(n_pixels, dtype=np.float32) + 0.5) / n_pixels - 0.5) * box.size_px
    cosine, sine = np.float32(np.cos(box.turn_rad)), np.float32(np.sin(box.turn_rad))
    # A pixel's colour is that of its middle: half a pixel from its corner.
    x = (box.x_px - 0.5 + cosine * steps)[None, :] - (sine * steps)[:, None]
    y = (box.y_px - 0.5 + sine * steps)[None, :] + (cosine * steps)[:, None]
    left, to_right = _split(x, width)
    top, to_bottom = _split(y, height)
    colours = picture.reshape(-1, 3)
    first = top * width + left
    across, down = int(width > 1), width * int(height > 1)

    def mixed(row: NDArray[np.int32]) -> NDArray[np.float32]:
        near = colours.take(row, axis=0).astype(np.float32)
        near += (colours.take(row + across, axis=0) - near) * to_right
        return near

    upper = mixed(first)
    upper += (mixed(first + down) - upper) * to_bottom
    upper *= np.float32(1 / 255)
    return upper


def _split(
    places_px: NDArray[np.floating], n_pixels: int
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """The pixel before each place, kept in the picture, and how far it is to the next one."""
    inside = np.clip(places_px, 0, n_pixels - 1).astype(np.float32)
    before = np.minimum(inside.astype(np.int32), max(0, n_pixels - 2))
    return before, (inside - before).astype(np.float32)[..., None]
