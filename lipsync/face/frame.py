"""What a face shows at one instant: the mouth as coefficients, the rest of the head by name."""

from dataclasses import dataclass

from lipsync.arrays import Array


@dataclass(frozen=True, slots=True)
class Expression:
    """Degrees of freedom of neck, eyes, lids and brows; None where nothing is said about one.

    Angles are in degrees, 0 = straight ahead: pitch is positive upwards, yaw positive to the
    face's own left, roll positive towards its left shoulder. The eyes turn relative to the head,
    both alike. lid_left, lid_right: 0 = open, 1 = shut, below 0 = wider than at rest. brow: 0 =
    relaxed, 1 = raised. smile: 0 = neutral, 1 = a broad smile, -1 = corners down.
    """

    neck_pitch_deg: float | None = None
    neck_yaw_deg: float | None = None
    neck_roll_deg: float | None = None
    eye_pitch_deg: float | None = None
    eye_yaw_deg: float | None = None
    lid_left: float | None = None
    lid_right: float | None = None
    brow: float | None = None
    smile: float | None = None


#: Says nothing about anything but the mouth.
NO_EXPRESSION = Expression()


@dataclass(frozen=True, slots=True)
class Frame:
    """The face that belongs to sound time `time_s`. coefficients: (n_components,), of the mouth."""

    time_s: float
    coefficients: Array
    expression: Expression = NO_EXPRESSION
