"""What the face detector's network says, as boxes: BlazeFace for short range.

Bazarevsky, Kartynnik, Vakunov, Raveendran and Grundmann, "BlazeFace: sub-millisecond neural face
detection on mobile GPUs", 2019: 896 anchors on grids of 16 x 16 (two a place) and 8 x 8 (six), and
boxes that overlap blended by their scores rather than suppressed (section 3.4).
"""

from dataclasses import dataclass

import numpy as np

from lipsync.arrays import Array

#: Pixels of the square picture that the network looks at.
DETECTOR_PIXELS = 128
#: Anchors: places in a row, and how many at each place.
_GRIDS = ((16, 2), (8, 6))
_LEAST_SCORE = 0.5
#: Two boxes that share this much of their union are of one face.
_SAME_FACE = 0.3


@dataclass(frozen=True, slots=True)
class Detection:
    """A face in a square picture, all in parts of its side.

    box: (4,), left, top, right, bottom. eyes: (2, 2), the speaker's right one first.
    """

    score: float
    box: Array
    eyes: Array


def _anchors() -> Array:
    """(896, 2): the middles that boxes are told from."""
    rows = []
    for n_places, n_each in _GRIDS:
        steps = (np.arange(n_places) + 0.5) / n_places
        down, across = np.meshgrid(steps, steps, indexing="ij")
        rows.append(np.repeat(np.column_stack((across.ravel(), down.ravel())), n_each, axis=0))
    return np.concatenate(rows)


_ANCHORS = _anchors()


def detections(regressors: Array, classificators: Array) -> tuple[Detection, ...]:
    """Faces, the surest first.

    regressors: (896, 16), box middle, size and six points in pixels of the network's picture from
    the anchor; classificators: (896,), log odds of a face.
    """
    scores = 1.0 / (1.0 + np.exp(-np.clip(classificators, -100.0, 100.0)))
    likely = np.flatnonzero(scores >= _LEAST_SCORE)
    likely = likely[np.argsort(-scores[likely], kind="stable")]
    raw = regressors[likely].reshape(-1, 8, 2) / DETECTOR_PIXELS
    middle, size = raw[:, 0] + _ANCHORS[likely], raw[:, 1]
    boxes = np.concatenate((middle - size / 2, middle + size / 2), axis=1)
    eyes = raw[:, 2:4] + _ANCHORS[likely][:, None]
    return _blended(scores[likely], boxes, eyes)


def _blended(scores: Array, boxes: Array, eyes: Array) -> tuple[Detection, ...]:
    found = []
    left = np.arange(len(scores))
    while len(left):
        same = _overlaps(boxes[left[0]], boxes[left]) > _SAME_FACE
        same[0] = True
        group = left[same]
        share = scores[group] / scores[group].sum()
        found.append(
            Detection(
                float(scores[group[0]]),
                np.einsum("g,gi->i", share, boxes[group]),
                np.einsum("g,gij->ij", share, eyes[group]),
            )
        )
        left = left[~same]
    return tuple(found)


def _overlaps(box: Array, boxes: Array) -> Array:
    """(n,): the shared area of a box (4,) with each of (n, 4) over that of their union."""
    low = np.maximum(box[:2], boxes[:, :2])
    high = np.minimum(box[2:], boxes[:, 2:])
    shared = np.clip(high - low, 0.0, None).prod(axis=1)
    both = (box[2:] - box[:2]).prod() + (boxes[:, 2:] - boxes[:, :2]).prod(axis=1) - shared
    ratio: Array = shared / np.maximum(both, 1e-12)
    return ratio
