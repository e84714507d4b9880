"""A robot mouth to practise on: geometry, backlash and noise drawn from a seed, all hidden.

A calibration uses `move` and `measure` only, as with a real robot before a tracker. Scores are
measured against `true_markers_mm`, which has no noise.
Not simulated: gravity, load, lips that stop each other (they may overlap), skin that creeps.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

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
    """A simulated robot drawn from a seed: its skin, and the faults that calibration must find.

    zero_deg: (n_servos,), the horns' angles with servos at 0; backlash_deg: (n_servos,).
    """

    face: SimulatedFace
    zero_deg: Array
    backlash_deg: Array
    noise_stream: tuple[int, ...] = ()

    def seen_mm(self, output_deg: Array, _n_moves: int) -> Array:
        """Return the markers of a pose without noise.

        Parameters
        ----------
        output_deg : Array
            (n_servos,) degrees of the horns, backlash included.
        _n_moves : int
            Not used.

        Returns
        -------
        Array
            (47, 3) mm.
        """
        return np.asarray(true_markers_mm(self, output_deg[None])[0])


def draw_robot(rest_mm: Array, servo_names: Sequence[str], seed: int) -> RobotDraw:
    """Return a robot like the simulated face, but of other size, strength, direction and skin.

    Parameters
    ----------
    rest_mm : Array
        (47, 3) mm, markers of a closed mouth.
    servo_names : Sequence[str]
        Names of the n_servos servos.
    seed : int
        Seed of the draw.

    Returns
    -------
    RobotDraw
        The drawn robot, lengths in mm.

    Raises
    ------
    ValueError
        A servo is unknown to the simulated face.
    """
    rng = np.random.default_rng(seed)
    middle_mm = rest_mm.mean(axis=0)
    neutral_mm = middle_mm + (rest_mm - middle_mm) * rng.uniform(*_SIZE, size=3)
    face = simulated_face(neutral_mm, servo_names)
    n_servos = len(servo_names)
    is_jaw = np.array([name == JAW for name in servo_names])
    drawn = replace(
        face,
        pulls=np.array([_altered_pull(pull, rng) for pull in face.pulls]).reshape(-1, 47, 3),
        jaw_share=face.jaw_share ** rng.uniform(*_SKIN),
        jaw_axis_mm=face.jaw_axis_mm + rng.normal(0.0, _AXIS_MM, 3),
    )
    return RobotDraw(
        face=drawn,
        zero_deg=rng.normal(0.0, np.where(is_jaw, _JAW_ZERO_DEG, _ZERO_DEG)),
        backlash_deg=rng.uniform(*BACKLASH_DEG, size=n_servos),
    )


def _altered_pull(pull: Array, rng: np.random.Generator) -> Array:
    """Return a horn's pull, (47, 3), with strength, skin width and direction altered by `rng`."""
    weight = np.linalg.norm(pull, axis=1, keepdims=True)
    direction = pull / np.maximum(weight, 1e-12)
    tilt = np.tan(np.deg2rad(_DIRECTION_DEG)) * rng.normal(size=3)
    new_direction = direction + tilt * (weight > 0.0)
    new_direction /= np.maximum(np.linalg.norm(new_direction, axis=1, keepdims=True), 1e-12)
    return np.asarray(rng.uniform(*_STRENGTH) * weight ** rng.uniform(*_SKIN) * new_direction)


class Skin(Protocol):
    """The interface of the face of a simulated robot, of either family."""

    @property
    def backlash_deg(self) -> Array:
        """The backlash of the robot's gears.

        Returns
        -------
        Array
            (n_servos,) degrees.
        """

    @property
    def noise_stream(self) -> tuple[int, ...]:
        """Numbers added to the seed of a tracker's noise, so that families have different noise."""

    def seen_mm(self, output_deg: Array, n_moves: int) -> Array:
        """Return the markers of a pose without noise, after `n_moves` moves.

        Parameters
        ----------
        output_deg : Array
            (n_servos,) degrees of the horns, backlash included.
        n_moves : int
            Number of moves since the robot was cold.

        Returns
        -------
        Array
            (47, 3) mm.
        """


class SimulatedRobot:
    """A simulated robot: servos with backlash, a skin of either family, and a noisy tracker."""

    def __init__(
        self,
        skin: Skin,
        *,
        noise_seed: int = 0,
        noise_mm: float = SENSOR_NOISE_MM,
    ) -> None:
        """Make a cold robot, all servos at 0, in the middle of their backlash.

        skin: of the drawn robot; noise_seed, noise_mm: of the tracker, standard deviation in each
        axis.
        """
        self._skin = skin
        self._noise = np.random.default_rng([noise_seed, *skin.noise_stream])
        self._noise_mm = noise_mm
        self._output_deg = np.zeros(len(skin.backlash_deg))
        self._n_moves = 0

    def move(self, positions_deg: Array) -> Array:
        """Move to a pose at once; the horns stay behind by up to half the backlash.

        Parameters
        ----------
        positions_deg : Array
            (n_servos,) degrees.

        Returns
        -------
        Array
            (n_servos,) degrees: the encoders' angles, equal to the goals.
        """
        half_deg = self._skin.backlash_deg / 2
        self._output_deg = np.clip(
            self._output_deg, positions_deg - half_deg, positions_deg + half_deg
        )
        self._n_moves += 1
        return np.asarray(positions_deg, dtype=np.float64).copy()

    @property
    def output_deg(self) -> Array:
        """The angles of the horns, backlash included, for tests.

        Returns
        -------
        Array
            (n_servos,) degrees.
        """
        return self._output_deg.copy()

    def measure(self) -> Array:
        """Return one noisy measurement of the markers, as a tracker would make it.

        Returns
        -------
        Array
            (47, 3) mm.
        """
        return self.true_markers_mm() + self._noise.normal(0.0, self._noise_mm, (47, 3))

    def true_markers_mm(self) -> Array:
        """Return the true marker positions, which no calibration may use.

        Returns
        -------
        Array
            (47, 3) mm.
        """
        return self._skin.seen_mm(self._output_deg, self._n_moves)


def true_markers_mm(draw: RobotDraw, output_deg: Array) -> Array:
    """Return the markers of a drawn robot without noise.

    Parameters
    ----------
    draw : RobotDraw
        The drawn robot.
    output_deg : Array
        (n, n_servos) degrees of the horns, backlash included.

    Returns
    -------
    Array
        (n, 47, 3) mm.
    """
    return marker_positions_mm(draw.face, output_deg + draw.zero_deg)
