"""What of a mouth can be measured: distances in mm, linear in the face, and how far speech goes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array
from lipsync.errors import UserError
from lipsync.face.model import FaceModel

#: Each measure is a sum over points of weight times axis (0 to the speaker's left, 1 up).
#: Landmarks are those of the usual face mesh: 61 and 291 the corners right and left, 37 and 267
#: the upper lip, 84 and 314 the lower lip beside its middle, 152 with 176 and 400 the chin.
_CHIN = (176, 152, 400)
_UP, _LEFT = 1, 0
_TERMS: dict[str, tuple[tuple[tuple[int, ...], int, float], ...]] = {
    "jaw": ((_CHIN, _UP, -1.0),),
    "upper_right": (((37,), _UP, 1.0),),
    "upper_left": (((267,), _UP, 1.0),),
    "lower_right": (((84,), _UP, -1.0), (_CHIN, _UP, 1.0)),
    "lower_left": (((314,), _UP, -1.0), (_CHIN, _UP, 1.0)),
    "corner_right": (((61,), _LEFT, -1.0),),
    "corner_left": (((291,), _LEFT, 1.0),),
}
GAP = "gap"
#: The lip gap; the jaw's drop; how far each side of the upper lip is raised, of the lower lip
#: dropped more than the jaw, and of the corners drawn apart: mm, all from the mouth at rest.
MEASURES = (GAP, *_TERMS)
#: The share of recorded frames that lies below the range's end.
_WIDEST_PERCENT = 99.0


class MeasureError(UserError):
    """A face on which the mouth cannot be measured; one line."""


@dataclass(frozen=True, slots=True)
class LipMeasures:
    """`MEASURES` of faces, in mm from the mouth at rest.

    per_face: (n_components, n_measures). rest: (n_components,). rest_gap_mm: of the mouth at rest.
    highest_mm, lowest_mm: (n_measures,), the 99th and the 1st percentile of the recorded faces.
    spread_mm: (n_measures,), their standard deviation.
    """

    per_face: Array
    rest: Array
    rest_gap_mm: float
    highest_mm: Array
    lowest_mm: Array
    spread_mm: Array

    def of(self, coefficients: Array) -> Array:
        """(..., n_components) -> (..., n_measures)."""
        return np.asarray((coefficients - self.rest) @ self.per_face)


def lip_measures(model: FaceWithAnimPhos) -> LipMeasures:
    """The measures of a model, with the ranges of its AnimPhos, which are recorded faces.

    Raises MeasureError for a layout that lacks one of the landmarks.
    """
    points = np.stack([_weights(model, name) for name in MEASURES])
    per_face = model.basis @ points.T
    touching_mm = float(model.lips_touching_mm[_UP])
    rest_mm = model.markers_mm(model.rest[None])[0].ravel()
    rest_gap_mm = float(points[MEASURES.index(GAP)] @ rest_mm) - touching_mm
    recorded_mm = (model.animphos.frames - model.rest) @ per_face
    low, high = np.percentile(recorded_mm, [100.0 - _WIDEST_PERCENT, _WIDEST_PERCENT], axis=0)
    return LipMeasures(per_face, model.rest, rest_gap_mm, high, low, recorded_mm.std(axis=0))


def _weights(model: FaceModel, name: str) -> Array:
    """(3 n_points,), so that a face's points times it are the measure."""
    weights = np.zeros((model.layout.n_points, 3))
    if name == GAP:
        weights[model.layout.upper_lip, _UP] += 1.0
        weights[model.layout.lower_lip, _UP] -= 1.0
        return weights.ravel()
    for landmarks, axis, weight in _TERMS[name]:
        weights[_points(model, landmarks), axis] += weight / len(landmarks)
    return weights.ravel()


def _points(model: FaceModel, landmarks: Sequence[int]) -> list[int]:
    missing = [n for n in landmarks if n not in model.layout.landmarks]
    if missing:
        raise MeasureError(
            f"layout {model.layout.name} has no landmark {missing[0]}, which an avatar's mouth is "
            "measured by; take a model with a shipped layout (`lipservo learn face --markers 47`)"
        )
    return [model.layout.landmarks.index(n) for n in landmarks]
