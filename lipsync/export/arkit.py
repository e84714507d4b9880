"""ARKit's 52 blendshapes computed from frames: from the mouth's markers and the expression.

Names and meaning: Apple, "ARFaceAnchor.BlendShapeLocation". Every coefficient is 0 at rest and 1 at
its widest; the range of a mouth's coefficient is what its speaker reaches in one frame of a
hundred, so nothing is tuned by hand.

Distances of the mouth in mm are linear in the face (`LipMeasures`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array
from lipsync.errors import UserError
from lipsync.face.frame import NO_EXPRESSION, Expression, Frame
from lipsync.face.model import FaceModel
from lipsync.motion.finishing import BILABIAL_GAP_MM

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
    """Error for a layout of points that lacks a landmark for measuring the mouth; one line."""


@dataclass(frozen=True, slots=True)
class LipMeasures:
    """The linear map from faces to the distances `MEASURES`, in mm from the mouth at rest.

    per_face: (n_components, n_measures), mm per coefficient. rest: (n_components,), the face at
    rest. rest_gap_mm: its lip gap. highest_mm, lowest_mm: (n_measures,), the 99th and the 1st
    percentile of the recorded faces. spread_mm: (n_measures,), their standard deviation.
    """

    per_face: Array
    rest: Array
    rest_gap_mm: float
    highest_mm: Array
    lowest_mm: Array
    spread_mm: Array

    def of(self, coefficients: Array) -> Array:
        """Return the distances of the mouth (lip gap, jaw drop, ...) in mm from rest.

        Parameters
        ----------
        coefficients : Array
            (..., n_components) face coefficients.

        Returns
        -------
        Array
            (..., n_measures) mm, in the order of `MEASURES`.
        """
        return np.asarray((coefficients - self.rest) @ self.per_face)


def lip_measures(model: FaceWithAnimPhos) -> LipMeasures:
    """Return the map to measures of a model's mouth, with their ranges over its recorded faces.

    Raises MeasureError for a layout that lacks one of the landmarks.
    """
    weights = np.stack([_measure_weights(model, name) for name in MEASURES])
    per_face = model.basis @ weights.T
    touching_mm = float(model.lips_touching_mm[_UP])
    rest_mm = model.markers_mm(model.rest[None])[0].ravel()
    rest_gap_mm = float(weights[MEASURES.index(GAP)] @ rest_mm) - touching_mm
    recorded_mm = (model.animphos.frames - model.rest) @ per_face
    low, high = np.percentile(recorded_mm, [100.0 - _WIDEST_PERCENT, _WIDEST_PERCENT], axis=0)
    return LipMeasures(per_face, model.rest, rest_gap_mm, high, low, recorded_mm.std(axis=0))


def _measure_weights(model: FaceModel, name: str) -> Array:
    """Return weights (3 n_points,) whose dot product with a face's points is the measure `name`."""
    weights = np.zeros((model.layout.n_points, 3))
    if name == GAP:
        weights[model.layout.upper_lip, _UP] += 1.0
        weights[model.layout.lower_lip, _UP] -= 1.0
        return weights.ravel()
    for landmarks, axis, weight in _TERMS[name]:
        weights[_point_indices(model, landmarks), axis] += weight / len(landmarks)
    return weights.ravel()


def _point_indices(model: FaceModel, landmarks: Sequence[int]) -> list[int]:
    """Return the indices of `landmarks` in the model's points; MeasureError if one is missing."""
    missing = [n for n in landmarks if n not in model.layout.landmarks]
    if missing:
        raise MeasureError(
            f"layout {model.layout.name} lacks landmark {missing[0]}, which an avatar's mouth is "
            "measured by; use a model with a shipped layout (`lipservo learn face --markers 47`)"
        )
    return [model.layout.landmarks.index(n) for n in landmarks]


#: In the order that Live Link Face sends.
ARKIT_NAMES: tuple[str, ...] = (
    "eyeBlinkLeft", "eyeLookDownLeft", "eyeLookInLeft", "eyeLookOutLeft", "eyeLookUpLeft",
    "eyeSquintLeft", "eyeWideLeft", "eyeBlinkRight", "eyeLookDownRight", "eyeLookInRight",
    "eyeLookOutRight", "eyeLookUpRight", "eyeSquintRight", "eyeWideRight", "jawForward",
    "jawLeft", "jawRight", "jawOpen", "mouthClose", "mouthFunnel", "mouthPucker", "mouthLeft",
    "mouthRight", "mouthSmileLeft", "mouthSmileRight", "mouthFrownLeft", "mouthFrownRight",
    "mouthDimpleLeft", "mouthDimpleRight", "mouthStretchLeft", "mouthStretchRight",
    "mouthRollLower", "mouthRollUpper", "mouthShrugLower", "mouthShrugUpper", "mouthPressLeft",
    "mouthPressRight", "mouthLowerDownLeft", "mouthLowerDownRight", "mouthUpperUpLeft",
    "mouthUpperUpRight", "browDownLeft", "browDownRight", "browInnerUp", "browOuterUpLeft",
    "browOuterUpRight", "cheekPuff", "cheekSquintLeft", "cheekSquintRight", "noseSneerLeft",
    "noseSneerRight", "tongueOut",
)  # fmt: skip
#: The blendshapes that speech moves.
MOUTH_NAMES: tuple[str, ...] = (
    "jawOpen", "mouthClose", "mouthFunnel", "mouthPucker", "mouthStretchLeft", "mouthStretchRight",
    "mouthLowerDownLeft", "mouthLowerDownRight", "mouthUpperUpLeft", "mouthUpperUpRight",
    "mouthRollLower",
)  # fmt: skip
#: Of a lower lip behind the upper teeth, for F and V: how far lips are parted, and the upper lip
#: lifted, at least, so that the teeth are seen.
_TUCKED_GAP, _TUCKED_UPPER_UP = 0.12, 0.3
#: So far an eye turns for a coefficient of 1. ARKit names no angle; ours, about as far as people
#: turn their eyes without turning the head.
_EYE_RANGE_DEG = 30.0

_ARKIT_INDEX = {name: i for i, name in enumerate(ARKIT_NAMES)}
_MOUTH_INDICES = np.array([_ARKIT_INDEX[name] for name in MOUTH_NAMES])
_INDEX = {name: i for i, name in enumerate(MEASURES)}


class ArkitMap:
    """A map from frames to ARKit coefficients (52,), in the order of `ARKIT_NAMES`."""

    def __init__(self, measures: LipMeasures) -> None:
        self._measures = measures
        # Lips that touch show this gap; below it they are shut.
        self._shut_mm = BILABIAL_GAP_MM - measures.rest_gap_mm
        self._narrowest_mm = -(self._lowest("corner_left") + self._lowest("corner_right"))

    def values(self, frame: Frame) -> Array:
        """Return the 52 ARKit blendshapes of a frame: the mouth's, and those of its expression.

        Parameters
        ----------
        frame : Frame
            The mouth and the expression of an instant.

        Returns
        -------
        Array
            (52,), each from 0 to 1, in the order of `ARKIT_NAMES`.
        """
        values = np.zeros(len(ARKIT_NAMES))
        values[_MOUTH_INDICES] = self.mouth(frame.coefficients, frame.expression.lip_tuck or 0.0)
        if frame.expression != NO_EXPRESSION:
            _add_expression(values, frame.expression)
        return values

    def mouth(self, coefficients: Array, lip_tuck: float = 0.0) -> Array:
        """Return the blendshapes of the mouth, in the order of `MOUTH_NAMES`.

        jawOpen minus mouthClose is the visible gap: lips that touch do so whatever the jaw
        does, and it never falls while the gap grows.

        Parameters
        ----------
        coefficients : Array
            (n_components,) face coefficients.
        lip_tuck : float
            How far the lower lip lies behind the upper teeth, 0 to 1, as in `Expression`.

        Returns
        -------
        Array
            (11,), each from 0 to 1.
        """
        mm = self._measures.of(coefficients)
        gap = _share(mm[_INDEX[GAP]] - self._shut_mm, self._highest(GAP) - self._shut_mm)
        # With a tucked lower lip lips and jaw are open at least so far that the teeth are seen.
        gap = max(gap, _TUCKED_GAP * lip_tuck)
        jaw = max(_share(mm[_INDEX["jaw"]], self._highest("jaw")), _TUCKED_GAP * lip_tuck)
        narrowed_mm = -(mm[_INDEX["corner_left"]] + mm[_INDEX["corner_right"]])
        rounding = _share(narrowed_mm, self._narrowest_mm)

        def range_share(name: str) -> float:
            return _share(mm[_INDEX[name]], self._highest(name))

        return np.array(
            [
                jaw,
                max(0.0, jaw - gap),
                rounding * gap,
                rounding * (1.0 - gap),
                range_share("corner_left"),
                range_share("corner_right"),
                # Lips that touch are not drawn apart, wherever they are.
                (1.0 - lip_tuck) * min(gap, range_share("lower_left")),
                (1.0 - lip_tuck) * min(gap, range_share("lower_right")),
                max(min(gap, range_share("upper_left")), _TUCKED_UPPER_UP * lip_tuck),
                max(min(gap, range_share("upper_right")), _TUCKED_UPPER_UP * lip_tuck),
                lip_tuck,
            ]
        )

    def _highest(self, name: str) -> float:
        return float(self._measures.highest_mm[_INDEX[name]])

    def _lowest(self, name: str) -> float:
        return float(self._measures.lowest_mm[_INDEX[name]])


def vowels(values: Array) -> dict[str, float]:
    """Return the mouth as weights of VRM's five vowels.

    An open mouth is A, rounded O, wide E; a nearly closed one is U if it is rounded, I if wide.

    Parameters
    ----------
    values : Array
        (52,) ARKit coefficients.

    Returns
    -------
    dict[str, float]
        By vowel, 0 to 1; together 1 at most.
    """
    jaw, closed, funnel, pucker, left, right = values[_MOUTH_INDICES[:6]].tolist()
    opened, rounded = max(0.0, jaw - closed), min(1.0, funnel + pucker)
    wide = 0.5 * (left + right) * (1.0 - rounded)
    return {
        "A": opened * (1.0 - rounded - wide),
        "I": (1.0 - opened) * wide,
        "U": (1.0 - opened) * rounded,
        "E": opened * wide,
        "O": opened * rounded,
    }


def _share(value: float, full: float) -> float:
    """Return `value` / `full`, clipped to 0 to 1; 0 where `full` is not positive."""
    return min(max(float(value) / full, 0.0), 1.0) if full > 0.0 else 0.0


def _add_expression(blendshapes: Array, expression: Expression) -> None:
    """Write the eyes, lids and brows that are not None into `blendshapes` (52,), in place."""
    values = {
        "eyeBlinkLeft": expression.lid_left,
        "eyeBlinkRight": expression.lid_right,
        "browInnerUp": expression.brow,
        "browOuterUpLeft": expression.brow,
        "browOuterUpRight": expression.brow,
    }
    pitch_deg, yaw_deg = expression.eye_pitch_deg, expression.eye_yaw_deg
    if pitch_deg is not None:
        for side in ("Left", "Right"):
            values[f"eyeLookUp{side}"] = pitch_deg / _EYE_RANGE_DEG
            values[f"eyeLookDown{side}"] = -pitch_deg / _EYE_RANGE_DEG
    if yaw_deg is not None:  # to the face's own left: outwards for its left eye
        for name, sign in (("OutLeft", 1), ("InRight", 1), ("InLeft", -1), ("OutRight", -1)):
            values[f"eyeLook{name}"] = sign * yaw_deg / _EYE_RANGE_DEG
    for name, value in values.items():
        if value is not None:
            blendshapes[_ARKIT_INDEX[name]] = _share(value, 1.0)
