"""ARKit blendshapes from frames: what the markers and the expression of a frame say of the 52.

Names and meaning: Apple, "ARFaceAnchor.BlendShapeLocation". Every coefficient is 0 at rest and 1 at
its widest; the range of a mouth's is what its speaker reaches in one frame of a hundred, so nothing
is tuned by hand.
"""

import numpy as np

from lipsync.arrays import Array
from lipsync.export.lip_measures import GAP, MEASURES, LipMeasures
from lipsync.face.frame import NO_EXPRESSION, Expression, Frame
from lipsync.motion.lip_closure import BILABIAL_GAP_MM

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
#: Those that speech moves.
MOUTH_NAMES: tuple[str, ...] = (
    "jawOpen", "mouthClose", "mouthFunnel", "mouthPucker", "mouthStretchLeft", "mouthStretchRight",
    "mouthLowerDownLeft", "mouthLowerDownRight", "mouthUpperUpLeft", "mouthUpperUpRight",
)  # fmt: skip
#: So far an eye turns for a coefficient of 1. ARKit names no angle; ours, about as far as people
#: turn their eyes without turning the head.
_EYE_RANGE_DEG = 30.0

_AT = {name: i for i, name in enumerate(ARKIT_NAMES)}
_OUT = np.array([_AT[name] for name in MOUTH_NAMES])
_IN = {name: i for i, name in enumerate(MEASURES)}


class ArkitMap:
    """Frames become ARKit coefficients (52,), in the order of `ARKIT_NAMES`."""

    def __init__(self, measures: LipMeasures) -> None:
        self._measures = measures
        # Lips that touch show this gap; below it they are shut.
        self._shut_mm = BILABIAL_GAP_MM - measures.rest_gap_mm
        self._narrowest_mm = -(self._lowest("corner_left") + self._lowest("corner_right"))

    def values(self, frame: Frame) -> Array:
        """(52,), each from 0 to 1."""
        found = np.zeros(len(ARKIT_NAMES))
        found[_OUT] = self.mouth(frame.coefficients)
        if frame.expression != NO_EXPRESSION:
            _add_expression(found, frame.expression)
        return found

    def mouth(self, coefficients: Array) -> Array:
        """(n_components,) -> (10,), the coefficients of `MOUTH_NAMES`.

        jawOpen less mouthClose is what is seen of the gap: lips that touch do so whatever the jaw
        does, and it never falls while the gap grows.
        """
        mm = self._measures.of(coefficients)
        gap = _share(mm[_IN[GAP]] - self._shut_mm, self._highest(GAP) - self._shut_mm)
        jaw = _share(mm[_IN["jaw"]], self._highest("jaw"))
        narrowed_mm = -(mm[_IN["corner_left"]] + mm[_IN["corner_right"]])
        rounding = _share(narrowed_mm, self._narrowest_mm)

        def side(name: str) -> float:
            return _share(mm[_IN[name]], self._highest(name))

        return np.array(
            [
                jaw,
                max(0.0, jaw - gap),
                rounding * gap,
                rounding * (1.0 - gap),
                side("corner_left"),
                side("corner_right"),
                # Lips that touch are not drawn apart, wherever they are.
                min(gap, side("lower_left")),
                min(gap, side("lower_right")),
                min(gap, side("upper_left")),
                min(gap, side("upper_right")),
            ]
        )

    def _highest(self, name: str) -> float:
        return float(self._measures.highest_mm[_IN[name]])

    def _lowest(self, name: str) -> float:
        return float(self._measures.lowest_mm[_IN[name]])


def _share(value: float, full: float) -> float:
    """`value` of `full`, from 0 to 1; 0 where the speaker never goes there."""
    return min(max(float(value) / full, 0.0), 1.0) if full > 0.0 else 0.0


def _add_expression(found: Array, expression: Expression) -> None:
    """Set eyes, lids and brows where something is said of them. found: (52,)."""
    said = {
        "eyeBlinkLeft": expression.lid_left,
        "eyeBlinkRight": expression.lid_right,
        "browInnerUp": expression.brow,
        "browOuterUpLeft": expression.brow,
        "browOuterUpRight": expression.brow,
    }
    pitch_deg, yaw_deg = expression.eye_pitch_deg, expression.eye_yaw_deg
    if pitch_deg is not None:
        for side in ("Left", "Right"):
            said[f"eyeLookUp{side}"] = pitch_deg / _EYE_RANGE_DEG
            said[f"eyeLookDown{side}"] = -pitch_deg / _EYE_RANGE_DEG
    if yaw_deg is not None:  # to the face's own left: outwards for its left eye
        for name, sign in (("OutLeft", 1), ("InRight", 1), ("InLeft", -1), ("OutRight", -1)):
            said[f"eyeLook{name}"] = sign * yaw_deg / _EYE_RANGE_DEG
    for name, value in said.items():
        if value is not None:
            found[_AT[name]] = _share(value, 1.0)
