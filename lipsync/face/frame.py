"""The frame, a face's pose at one instant, and the contract of every synthesiser of its mouth."""

from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array
from lipsync.phonemes import PhonemeEvent, PhonemeUpdate


@dataclass(frozen=True, slots=True)
class Expression:
    """Degrees of freedom of neck, eyes, lids and brows; None where one is not set.

    Angles are in degrees, 0 = straight ahead: pitch is positive upwards, yaw positive to the
    face's own left, roll positive towards its left shoulder. The eyes turn relative to the head,
    both alike. lid_left, lid_right: 0 = open, 1 = shut, below 0 = wider than at rest. brow: 0 =
    relaxed, 1 = raised. smile: 0 = neutral, 1 = a broad smile, -1 = corners down. lip_tuck: 1 = the
    lower lip lies behind the upper teeth and the upper lip is lifted, as for F and V.
    tongue_dental: 1 = the tongue's tip is between the teeth, as for TH. tongue_alveolar: 1 = it is
    raised behind the upper teeth, as for L. No recorded component shows these three, so that only
    drawn faces do.
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
    lip_tuck: float | None = None
    tongue_dental: float | None = None
    tongue_alveolar: float | None = None


#: Says nothing about anything but the mouth.
NO_EXPRESSION = Expression()
#: What of an expression is the speaking mouth's own, and set by the finishing step.
DRAWN_MOUTH: Final = ("lip_tuck", "tongue_dental", "tongue_alveolar")


@dataclass(frozen=True, slots=True)
class Frame:
    """The face at sound time `time_s`. coefficients: (n_components,), of the mouth."""

    time_s: float
    coefficients: Array
    expression: Expression = NO_EXPRESSION


@dataclass(frozen=True, slots=True)
class FaceWindow:
    """A frame and the faces that are expected after it, so that joints may start in time.

    times_s: (k,), seconds after the frame, ascending from 0. faces: (k, n_components), at these
    times, first the frame's. closed: (k,), whether by then lips must touch each other, or the lower
    lip the teeth. shut: (n_components,), the frame with its lips pressed together, as for a P.
    """

    times_s: Array
    faces: Array
    closed: NDArray[np.bool_]
    shut: Array


#: The times of a window that holds nothing but its frame.
_NOW: Final = np.zeros(1)
_OPEN: Final = np.zeros(1, dtype=np.bool_)


def frame_alone(frame: Frame) -> FaceWindow:
    """Return the window of a frame after which nothing is known: only its own face, not closed."""
    return FaceWindow(_NOW, frame.coefficients[None], _OPEN, frame.coefficients)


class Motion(Protocol):
    """A synthesiser of the mouth's motion: phoneme updates are pushed, frames are computed."""

    @property
    def phonemes_planned(self) -> int:
        """The number of phonemes that have moved the mouth since the last `reset`."""

    @property
    def lookahead_s(self) -> float:
        """Seconds of sound needed after an instant before its frame can be computed."""

    def reset(self) -> None:
        """Forget all phonemes and motion: the mouth is closed, and sound time begins at 0."""

    def push(self, update: PhonemeUpdate) -> None:
        """Apply a revision to the known phonemes; frames already computed are not changed."""

    def frame_at(self, time_s: float) -> Frame:
        """Return the frame at sound time `time_s`; equal times give equal frames.

        Times ascend, except for a step back of half a second at most.
        """

    def event_at(self, time_s: float) -> PhonemeEvent | None:
        """Return the phoneme at sound time `time_s` as known now, for displays; None if unknown."""


class Synthesizer(Motion, Protocol):
    """A `Motion` that can also return the faces expected after a frame."""

    def window_after(self, frame: Frame) -> FaceWindow:
        """Return `frame` and the faces expected after it by the phonemes known.

        `frame` must be the newest. The call changes no later frame.
        """
