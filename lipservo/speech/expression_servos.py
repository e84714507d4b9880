"""The servos that show an expression: how far each turns for it, within its range and speed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lipservo.settings.settings import FaceSettings
from lipservo.speech.layers import Claim, Indices, Layer
from lipsync.face.frame import Expression

#: A corner that lips do not need moves for a smile from here on; less nobody sees.
_SMALLEST_SMILE = 0.02


@dataclass(frozen=True, slots=True)
class ExpressionServo:
    """A servo, by its number in the face, that shows a part of an expression.

    of: a name of `Expression`, or `lids`. min_deg to max_deg: its range.
    """

    index: int
    of: str
    deg_per_unit: float
    min_deg: float
    max_deg: float
    max_speed_deg_s: float
    is_mouth: bool


def expression_servos(face: FaceSettings) -> list[ExpressionServo]:
    """Those of a face's YAML, in its order."""
    return [
        ExpressionServo(
            index,
            servo.expression.of,
            servo.expression.deg_per_unit,
            servo.min_deg,
            servo.max_deg,
            servo.max_speed_deg_s,
            servo.part == "mouth",
        )
        for index, servo in enumerate(face.servos.values())
        if servo.expression is not None
    ]


class ExpressionClaims:
    """What the expression wants of its servos, one period after the other.

    Lips go before expression: the corners of the mouth smile in silence, and belong to the lips
    from the moment a word is known, over the 0.3 s of every hand-over.
    """

    def __init__(self, servos: Sequence[ExpressionServo], period_s: float) -> None:
        self._head = [servo for servo in servos if not servo.is_mouth]
        self._corners = [servo for servo in servos if servo.is_mouth]
        self._head_indices = _indices(self._head)
        self._corner_indices = _indices(self._corners)
        self._steps_deg = np.array([servo.max_speed_deg_s * period_s for servo in self._head])
        self._shown_deg = np.zeros(len(self._head))

    @property
    def any_servos(self) -> bool:
        """Whether the face has servos besides its mouth that show an expression."""
        return bool(self._head)

    def claims(self, expression: Expression, layer: Layer) -> list[Claim]:
        """For neck, eyes, lids and brows. layer: of whom the expression is."""
        if not self._head:
            return []
        wanted_deg = np.array([_wanted_deg(servo, expression) for servo in self._head])
        # A saccade is faster than any servo: asked for no more than it can, it overshoots nothing.
        step_deg = np.clip(wanted_deg - self._shown_deg, -self._steps_deg, self._steps_deg)
        self._shown_deg = self._shown_deg + step_deg
        return [Claim(layer, self._head_indices, self._shown_deg)]

    def mouth(self, expression: Expression, lips: Claim) -> list[Claim]:
        """For a silent mouth: its lips as they are, its corners moved from there by the smile."""
        smile = expression.smile or 0.0
        if not self._corners or abs(smile) < _SMALLEST_SMILE:
            return [lips]
        at_rest_deg = dict(zip(lips.servos.tolist(), lips.positions_deg.tolist(), strict=True))
        smiling_deg = [
            _within_range(servo, at_rest_deg[servo.index] + servo.deg_per_unit * smile)
            for servo in self._corners
        ]
        kept = ~np.isin(lips.servos, self._corner_indices)
        return [
            Claim(Layer.LIPS, lips.servos[kept], lips.positions_deg[kept]),
            Claim(Layer.EXPRESSION, self._corner_indices, np.array(smiling_deg)),
        ]


def _indices(servos: Sequence[ExpressionServo]) -> Indices:
    return np.array([servo.index for servo in servos], dtype=np.intp)


def _wanted_deg(servo: ExpressionServo, expression: Expression) -> float:
    if servo.of == "lids":
        value = 0.5 * ((expression.lid_left or 0.0) + (expression.lid_right or 0.0))
    else:
        value = getattr(expression, servo.of) or 0.0
    return _within_range(servo, servo.deg_per_unit * value)


def _within_range(servo: ExpressionServo, angle_deg: float) -> float:
    return min(servo.max_deg, max(servo.min_deg, angle_deg))
