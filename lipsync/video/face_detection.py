"""Detection of faces in a picture by BlazeFace, and of the square for the landmark network.

Bazarevsky, Kartynnik, Vakunov, Raveendran and Grundmann, "BlazeFace: sub-millisecond neural face
detection on mobile GPUs", 2019: 896 anchors on grids of 16 x 16 (two a place) and 8 x 8 (six), and
boxes that overlap blended by their scores rather than suppressed (section 3.4).

The square is cut as by MediaPipe's graphs: 1.5 times as large as the face, turned so that the eyes
are level.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array

#: (height, width, 3), red, green, blue.
Picture = NDArray[np.uint8]


#: Pixels of the square picture that the network looks at.
DETECTOR_PIXELS = 128
#: Anchors: places in a row, and how many at each place.
_GRIDS = ((16, 2), (8, 6))
_LEAST_SCORE = 0.5
#: Two boxes that share this much of their union are of one face.
_SAME_FACE = 0.3


@dataclass(frozen=True, slots=True)
class Detection:
    """A face detected in a square picture; lengths are shares, 0 to 1, of the picture's side.

    box: (4,), left, top, right, bottom. eyes: (2, 2), the speaker's right one first.
    """

    score: float
    box: Array
    eyes: Array


def _anchors() -> Array:
    """Return the detector's anchors (896, 2): the middles that boxes are relative to, 0 to 1."""
    rows = []
    for n_places, n_each in _GRIDS:
        steps = (np.arange(n_places) + 0.5) / n_places
        y, x = np.meshgrid(steps, steps, indexing="ij")
        rows.append(np.repeat(np.column_stack((x.ravel(), y.ravel())), n_each, axis=0))
    return np.concatenate(rows)


_ANCHORS = _anchors()


def detections(regressors: Array, classificators: Array) -> tuple[Detection, ...]:
    """Return the faces in the outputs of the detector network, the surest first.

    Parameters
    ----------
    regressors : Array
        (896, 16), box middle, size and six points in pixels of the network's picture from the
        anchor.
    classificators : Array
        (896,), log odds of a face.

    Returns
    -------
    tuple[Detection, ...]
        Boxes and eyes in shares of the picture's side, 0 to 1; overlapping ones are blended.
    """
    scores = 1.0 / (1.0 + np.exp(-np.clip(classificators, -100.0, 100.0)))
    candidates = np.flatnonzero(scores >= _LEAST_SCORE)
    candidates = candidates[np.argsort(-scores[candidates], kind="stable")]
    raw = regressors[candidates].reshape(-1, 8, 2) / DETECTOR_PIXELS
    middles, sizes = raw[:, 0] + _ANCHORS[candidates], raw[:, 1]
    boxes = np.concatenate((middles - sizes / 2, middles + sizes / 2), axis=1)
    eyes = raw[:, 2:4] + _ANCHORS[candidates][:, None]
    return _blend_overlapping(scores[candidates], boxes, eyes)


def _blend_overlapping(scores: Array, boxes: Array, eyes: Array) -> tuple[Detection, ...]:
    """Return detections, the surest first; overlapping boxes are averaged by their scores.

    scores: (n,), falling; boxes: (n, 4); eyes: (n, 2, 2).
    """
    blended = []
    remaining = np.arange(len(scores))
    while len(remaining):
        is_same_face = _overlaps(boxes[remaining[0]], boxes[remaining]) > _SAME_FACE
        is_same_face[0] = True
        group = remaining[is_same_face]
        share = scores[group] / scores[group].sum()
        blended.append(
            Detection(
                float(scores[group[0]]),
                np.einsum("g,gi->i", share, boxes[group]),
                np.einsum("g,gij->ij", share, eyes[group]),
            )
        )
        remaining = remaining[~is_same_face]
    return tuple(blended)


def _overlaps(box: Array, boxes: Array) -> Array:
    """Return the intersection over union (n,) of a box (4,) with each of `boxes` (n, 4)."""
    low = np.maximum(box[:2], boxes[:, :2])
    high = np.minimum(box[2:], boxes[:, 2:])
    shared = np.clip(high - low, 0.0, None).prod(axis=1)
    union = (box[2:] - box[:2]).prod() + (boxes[:, 2:] - boxes[:, :2]).prod(axis=1) - shared
    ratio: Array = shared / np.maximum(union, 1e-12)
    return ratio


#: The square is so much larger than the face in it.
_MARGIN = 1.5


@dataclass(frozen=True, slots=True)
class FaceBox:
    """A square in a picture: its middle and side in pixels.

    turn_rad: angle of its x axis, clockwise to the viewer.
    """

    x_px: float
    y_px: float
    size_px: float
    turn_rad: float

    def to_picture(self, points: Array) -> Array:
        """Return points given relative to the square as pixels of the picture.

        Parameters
        ----------
        points : Array
            (n, 3), 0 to 1 across the square, z at the same scale.

        Returns
        -------
        Array
            (n, 3) pixels.
        """
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
    """Return the square around a face: 1.5 times its size, turned so that the eyes are level.

    Parameters
    ----------
    points_px : Array
        (n, 2), of the face.
    right_eye_px,left_eye_px : Array
        (2,), middles of the speaker's eyes.

    Returns
    -------
    FaceBox
        Pixels and radians.
    """
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
    """Return a square of a picture, interpolated linearly; beyond the picture its edge is repeated.

    Parameters
    ----------
    picture : Picture
        (height, width, 3).
    box : FaceBox
        The square to cut out.
    n_pixels : int
        Number of pixels of each side.

    Returns
    -------
    NDArray[np.float32]
        (n_pixels, n_pixels, 3) from 0 to 1.
    """
    height, width = picture.shape[:2]
    steps = ((np.arange(n_pixels, dtype=np.float32) + 0.5) / n_pixels - 0.5) * box.size_px
    cosine, sine = np.float32(np.cos(box.turn_rad)), np.float32(np.sin(box.turn_rad))
    # A pixel's colour is that of its middle: half a pixel from its corner.
    x = (box.x_px - 0.5 + cosine * steps)[None, :] - (sine * steps)[:, None]
    y = (box.y_px - 0.5 + sine * steps)[None, :] + (cosine * steps)[:, None]
    # Of each output pixel: the numbers of the pixel above and left of it, and the way to the next.
    left, x_fraction = _pixel_and_fraction(x, width)
    top, y_fraction = _pixel_and_fraction(y, height)
    colours = picture.reshape(-1, 3)
    first = top * width + left
    right_step, down_step = int(width > 1), width * int(height > 1)

    def row_colours(row: NDArray[np.int32]) -> NDArray[np.float32]:
        blended = colours.take(row, axis=0).astype(np.float32)
        blended += (colours.take(row + right_step, axis=0) - blended) * x_fraction
        return blended

    upper = row_colours(first)
    upper += (row_colours(first + down_step) - upper) * y_fraction
    upper *= np.float32(1 / 255)
    return upper


def _pixel_and_fraction(
    places_px: NDArray[np.floating], n_pixels: int
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Return the number of the pixel before each position, kept within `n_pixels`, and the rest.

    The rest, 0 to 1, is the fraction of the way to the next pixel, with an axis added.
    """
    inside = np.clip(places_px, 0, n_pixels - 1).astype(np.float32)
    before = np.minimum(inside.astype(np.int32), max(0, n_pixels - 2))
    return before, (inside - before).astype(np.float32)[..., None]
