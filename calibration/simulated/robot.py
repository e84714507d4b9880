"""A robot mouth to practise on: geometry, backlash and noise drawn from a seed, none of it told.

What calibrates it sees `move` and `measure` only, as with a real robot before a tracker. Scores are
taken against `true_markers_mm`, which knows no noise.
Not simulated: gravity, load, lips that stop each other (they may overlap), skin that creeps.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.simulated.face import (
    JAW,
    SimulatedFace,
    marker_positions_mm,
    simulated_face,
)
from lipsync.arrays import Array

#: rms of the tracker's noise in each axis (the bar of the benchmark).
SENSOR_NOISE_MM = 0.5
#: Backlash is drawn between these: about 1 degree, as printed gears and horns have.
BACKLASH_DEG = (0.6, 1.4)
#: How far a drawn face is from the design: sizes, strengths and skin widths as factors, the rest as
#: standard deviations. Our choice: visibly another face, still a mouth.
_SIZE, _STRENGTH, _SKIN = (0.88, 1.15), (0.8, 1.2), (0.7, 1.4)
_DIRECTION_DEG, _AXIS_MM = 8.0, 5.0
#: Horns are pressed on spline by spline: 0 degrees is not quite the closed mouth.
_ZERO_DEG, _JAW_ZERO_DEG = 1.5, 0.4


@dataclass(frozen=True, slots=True)
class RobotDraw:
    """What the seed decided. zero_deg, backlash_deg: (n_servos,)."""

    face: SimulatedFace
    zero_deg: Array
    backlash_deg: Array


def draw_robot(rest_mm: Array, servo_names: Sequence[str], seed: int) -> RobotDraw:
    """A face like the simulated one, but of other size, strength, direction and skin.

    rest_mm: (47, 3), a closed mouth. Raises ValueError for a servo unknown to the simulated face.
    """
    rng = np.random.default_rng(seed)
    middle_mm = rest_mm.mean(axis=0)
    neutral_mm = middle_mm + (rest_mm - middle_mm) * rng.uniform(*_SIZE, size=3)
    face = simulated_face(neutral_mm, servo_names)
    n_servos = len(servo_names)
    is_jaw = np.array([name == JAW for name in servo_names])
    drawn = replace(
        face,
        pulls=np.array([_other_pull(pull, rng) for pull in face.pulls]).reshape(-1, 47, 3),
        jaw_share=face.jaw_share ** rng.uniform(*_SKIN),
        jaw_axis_mm=face.jaw_axis_mm + rng.normal(0.0, _AXIS_MM, 3),
    )
    return RobotDraw(
        face=drawn,
        zero_deg=rng.normal(0.0, np.where(is_jaw, _JAW_ZERO_DEG, _ZERO_DEG)),
        backlash_deg=rng.uniform(*BACKLASH_DEG, size=n_servos),
    )


def _other_pull(pull: Array, rng: np.random.Generator) -> Array:
    """(47, 3): the same horn with another strength, skin width and direction."""
    weight = np.linalg.norm(pull, axis=1, keepdims=True)
    direction = pull / np.maximum(weight, 1e-12)
    bend = np.tan(np.deg2rad(_DIRECTION_DEG)) * rng.normal(size=3)
    turned = direction + bend * (weight > 0.0)
    turned /= np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-12)
    return np.asarray(rng.uniform(*_STRENGTH) * weight ** rng.uniform(*_SKIN) * turned)


class SimulatedRobot:
    """Servos with backlash behind a skin, and a noisy tracker before it."""

    def __init__(
        self,
        draw: RobotDraw,
        *,
        noise_seed: int = 0,
        noise_mm: float = SENSOR_NOISE_MM,
    ) -> None:
        """All servos at 0, in the middle of their backlash."""
        self._draw = draw
        self._noise = np.random.default_rng(noise_seed)
        self._noise_mm = noise_mm
        self._output_deg = np.zeros(len(draw.zero_deg))

    def move(self, positions_deg: Array) -> Array:
        """Go there and settle; the encoders then, (n_servos,). Backlash: the horn lags behind."""
        half_deg = self._draw.backlash_deg / 2
        self._output_deg = np.clip(
            self._output_deg, positions_deg - half_deg, positions_deg + half_deg
        )
        return np.asarray(positions_deg, dtype=np.float64).copy()

    def measure(self) -> Array:
        """(47, 3): one look of the tracker."""
        return self.true_markers_mm() + self._noise.normal(0.0, self._noise_mm, (47, 3))

    def true_markers_mm(self) -> Array:
        """(47, 3): where the markers are, which nobody who calibrates is told."""
        return np.asarray(true_markers_mm(self._draw, self._output_deg[None])[0])


def true_markers_mm(draw: RobotDraw, output_deg: Array) -> Array:
    """(n, n_servos), angles behind the backlash -> (n, 47, 3), without noise."""
    return marker_positions_mm(draw.face, output_deg + draw.zero_deg)
