"""What a face shows at one instant, and the contract of every synthesiser of its mouth."""

from dataclasses import dataclass
from typing import Protocol

from lipsync.arrays import Array
from lipsync.phonemes import PhonemeEvent, PhonemeUpdate


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


class Synthesizer(Protocol):
    """Phonemes in, frames out. What wraps a synthesiser is one itself."""

    @property
    def phonemes_planned(self) -> int:
        """How many phonemes have moved the mouth."""

    @property
    def lookahead_s(self) -> float:
        """How much sound after an instant must have been heard before its frame is asked for."""

    def reset(self) -> None:
        """Forget everything; the mouth is closed and the stream begins anew at sound time 0."""

    def push(self, update: PhonemeUpdate) -> None:
        """Take a revision of the phonemes; what has been shown stays as it is."""

    def frame_at(self, time_s: float) -> Frame:
        """The frame at a sound time; the same time gives the same frame.

        Times ascend, but for a step back of half a second at most.
        """

    def event_at(self, time_s: float) -> PhonemeEvent | None:
        """The phoneme believed at a time, for displays."""
