"""A design's calibration on another unit of it: how the unit's joints stand to the design's.

Horns are put on a few degrees apart, links are a few percent longer, lips meet a little earlier. So
the design's angle of a joint is taken for `zero + scale * angle of the unit`, and lips for meeting
some tenths of a millimetre later; all else of the design's map holds. These numbers follow from a
few poses by penalised least squares (Gelman et al., Bayesian Data Analysis, 2013, section 14.8):
a number that the poses do not tell stays what the design says.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calibration.calibration import Calibration, CalibrationError
from calibration.closure import pairs
from lipsync.arrays import Array

#: How far units of a design are apart, standard deviations: horns, links, contact, and dots that
#: are put on again. Where a tracker stands is not known at all.
_ZERO_DEG, _SCALE, _LATER_MM, _DOT_MM = 4.0, 0.08, 0.7, 0.5
_SHIFT_MM, _TURN_RAD = 100.0, 0.5
#: What a person's eye is off in a joint of a pose.
_EYE_DEG = 3.0
#: Half of what a tooth of a horn turns it (25 teeth), and what a fit may err.
_TOOTH_DEG = 9.0
#: Poses that are so many times farther off than the design's own are of something else.
_MISFIT, _EYE_MISFIT = 2.0, 6.0
#: No link is longer by so much: beyond it a servo is reversed.
_MOST_SCALE = 0.7


@dataclass(frozen=True, slots=True)
class Unit:
    """How a unit differs from its design, whose angle is zero_deg + scale * the unit's angle.

    zero_deg, scale: (n_servos,). later_mm: how much farther lips close until they meet.
    """

    zero_deg: Array
    scale: Array
    later_mm: float

    def design_deg(self, unit_deg: Array) -> Array:
        """Return the design's angles of the unit's, (n, n_servos) degrees each.

        Parameters
        ----------
        unit_deg : Array
            (n, n_servos) degrees.
        """
        return np.asarray(self.zero_deg + self.scale * unit_deg)

    def unit_deg(self, design_deg: Array) -> Array:
        """Return the unit's angles of the design's, (n, n_servos) degrees each.

        Parameters
        ----------
        design_deg : Array
            (n, n_servos) degrees.
        """
        return np.asarray((design_deg - self.zero_deg) / self.scale)

    def calibration(self, design: Calibration, limits_deg: tuple[Array, Array]) -> Calibration:
        """Return the unit's calibration; grade and hand poses, which were another unit's, are gone.

        Parameters
        ----------
        design : Calibration
            The design's calibration.
        limits_deg : tuple[Array, Array]
            The unit's limits, (n_servos,) degrees each.
        """
        column = self.scale[:, None]
        closure, touch = design.closure, design.touch
        if closure is not None:
            first, second = pairs(len(self.scale))
            closure = replace(
                closure,
                at_deg=self.unit_deg(closure.at_deg),
                gaps_mm=closure.gaps_mm + self.later_mm,
                slopes=closure.slopes * self.scale,
                bends=closure.bends * self.scale[first] * self.scale[second],
                turns_deg=closure.turns_deg / column,
            )
        if touch is not None:
            touch_deg = np.clip(self.unit_deg(touch.positions_deg), *limits_deg)
            touch = replace(touch, positions_deg=touch_deg)
        return replace(
            design,
            rest_deg=self.unit_deg(design.rest_deg),
            weights=design.weights / column,
            quadratic_weights=design.quadratic_weights / column,
            min_deg=limits_deg[0],
            max_deg=limits_deg[1],
            trim={viseme: deg / self.scale for viseme, deg in design.trim.items()},
            closure=closure,
            touch=touch,
            hand_poses={},
            grade=None,
        )

    def check_horns(self, names: Sequence[str]) -> None:
        """Raise CalibrationError, naming the joints, for horns that must be a tooth off."""
        zeros_deg = zip(names, self.zero_deg.tolist(), strict=True)
        off = [f"{name} {deg:+.0f} deg" for name, deg in zeros_deg if abs(deg) > _TOOTH_DEG]
        if off:
            raise CalibrationError(
                f"off the design by more than half a tooth of a horn: {', '.join(off)}; put it on "
                "a tooth farther, or correct zero_offset_deg"
            )


@dataclass(frozen=True, slots=True)
class SeenUnit:
    """A unit as a tracker saw it, and where its dots are from the design's.

    turn: (3, 3), of the tracker, about middle_mm, (3,); dots_mm: (n_markers, 3), what then lacks.
    """

    unit: Unit
    turn: Array
    middle_mm: Array
    dots_mm: Array

    def markers_mm(self, design_mm: Array) -> Array:
        """Return the unit's markers of the design's, (n, n_markers, 3) mm each.

        Parameters
        ----------
        design_mm : Array
            (n, n_markers, 3) mm.
        """
        turned_mm = (design_mm - self.middle_mm) @ self.turn.T
        return np.asarray(turned_mm + self.middle_mm + self.dots_mm)


def unit_by_markers(
    markers_of: Callable[[Array, float], Array],
    horns_deg: Array,
    seen_mm: Array,
    noise_mm: float,
) -> SeenUnit:
    """Return the unit whose markers are most like those seen. Raises CalibrationError if none is.

    Parameters
    ----------
    markers_of : Callable[[Array, float], Array]
        The design's markers, (n, n_markers, 3) mm, by its angles (n, n_servos) in degrees and by
        how many mm later its lips meet.
    horns_deg : Array
        (n, n_servos) degrees, the unit's poses without backlash.
    seen_mm : Array
        (n, n_markers, 3) mm, NaN where lost.
    noise_mm : float
        Error of the design's markers in a pose of its own, rms in each axis.
    """
    n_poses, n_servos = horns_deg.shape
    middle_mm = _mean_of_seen(seen_mm.reshape(-1, 3))
    spreads = [_ZERO_DEG, _SCALE, _LATER_MM, _SHIFT_MM, _TURN_RAD]
    spread = np.repeat(spreads, [n_servos, n_servos, 1, 3, 3])
    # The dots lie off the design's by what is the same in all poses.
    dots_mm = np.hypot(_DOT_MM, noise_mm / np.sqrt(n_poses))

    def unit_of(unknowns: Array) -> SeenUnit:
        zero_deg, scale, later_mm, shift_mm, turn = np.split(
            unknowns * spread, np.cumsum([n_servos, n_servos, 1, 3])
        )
        unit = Unit(zero_deg, 1.0 + scale, float(later_mm[0]))
        return SeenUnit(unit, Rotation.from_rotvec(turn).as_matrix(), middle_mm, shift_mm)

    def off_mm(seen: SeenUnit) -> tuple[Array, Array]:
        """Return what all poses are off alike, and each one beyond that, (n, n_markers, 3) mm."""
        design_mm = markers_of(seen.unit.design_deg(horns_deg), seen.unit.later_mm)
        apart_mm = seen_mm - seen.markers_mm(design_mm)
        alike_mm = _mean_of_seen(apart_mm)
        return alike_mm, np.nan_to_num(apart_mm - alike_mm)

    def residuals(unknowns: Array) -> Array:
        alike_mm, beyond_mm = off_mm(unit_of(unknowns))
        return np.concatenate([alike_mm.ravel() / dots_mm, beyond_mm.ravel() / noise_mm, unknowns])

    found = unit_of(least_squares(residuals, np.zeros(len(spread))).x)
    alike_mm, beyond_mm = off_mm(found)
    if (rms_mm := float(np.sqrt(np.mean(beyond_mm**2)))) > _MISFIT * noise_mm:
        worst = int(np.square(beyond_mm).mean(axis=(1, 2)).argmax())
        raise CalibrationError(
            f"the poses do not fit the design, by {rms_mm:.1f} mm where {noise_mm:.1f} is usual, "
            f"worst in pose {worst + 1}: check markers and rods, or measure this unit anew with "
            "`lipservo calibrate measure`"
        )
    return replace(found, dots_mm=found.dots_mm + alike_mm)


def _mean_of_seen(values: Array) -> Array:
    """Return the mean over the first axis of what is not NaN; 0 where nothing is."""
    return np.asarray(np.nansum(values, axis=0) / np.maximum(np.isfinite(values).sum(axis=0), 1))


def unit_by_eye(design: Calibration, design_deg: Array, made_deg: Array) -> Unit:
    """Return the unit that a person's poses tell. Raises CalibrationError if they do not fit.

    Parameters
    ----------
    design : Calibration
        The design's calibration.
    design_deg : Array
        (n, n_servos) degrees, the design's poses.
    made_deg : Array
        (n, n_servos) degrees, what a person made of them on the unit; first the closed mouth, with
        lips that just touch.
    """
    penalties = (_EYE_DEG / np.array([_ZERO_DEG, _SCALE])) ** 2
    zero_deg, scale = np.zeros(made_deg.shape[1]), np.ones(made_deg.shape[1])
    for joint, wanted_deg in enumerate(design_deg.T):
        # The person errs, not the design: so the unit's angles by the design's.
        inputs = np.column_stack([np.ones_like(wanted_deg), wanted_deg])
        moved_deg = made_deg[:, joint] - wanted_deg
        found = np.linalg.solve(inputs.T @ inputs + np.diag(penalties), inputs.T @ moved_deg)
        rms_deg = float(np.sqrt(np.mean((moved_deg - inputs @ found) ** 2)))
        scale[joint] = 1.0 / (1.0 + found[1])
        zero_deg[joint] = -found[0] * scale[joint]
        if rms_deg > _EYE_MISFIT * _EYE_DEG or abs(found[1]) > _MOST_SCALE:
            raise CalibrationError(
                f"the poses of {design.servo_names[joint]} do not fit the design (off "
                f"by {rms_deg:.0f} deg, at a scale of {scale[joint]:.1f}): is its servo reversed? "
                "Then correct `sign`, delete the poses and make them again"
            )
    unit = Unit(zero_deg, scale, 0.0)
    if design.closure is None:
        return unit
    return replace(
        unit, later_mm=-float(design.closure.open_mm(unit.design_deg(made_deg[:1]))[0, 0])
    )
