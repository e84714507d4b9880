"""The result of one tick of sound, motion and servos, and the protocol of its observers."""

from dataclasses import dataclass
from typing import Protocol

from firmware_bridge.loop.report import TickReport
from lipsync.arrays import Array
from lipsync.face.frame import Frame
from lipsync.phonemes import Hearing
from lipsync.recognition.text_decoder import MovedBy


@dataclass(frozen=True, slots=True)
class StreetTick:
    """The frame shown in one tick of the live pipeline (`Street`), and the servos' report.

    sound_s: negative before the first sound. captured_s: monotonic time at which the sound that
    moves the servos was captured; None: not known, or no sound moves them yet. hearing: the class
    of the sound that was decided last, which is not shown yet; None: no recogniser listens.
    moved_by: the source of the phonemes, sound that was heard, text, words, phonemes or visemes.
    """

    sound_s: float
    phoneme: str
    frame: Frame
    report: TickReport
    captured_s: float | None = None
    hearing: Hearing | None = None
    moved_by: MovedBy | None = None

    @property
    def coefficients(self) -> Array:
        """The face coefficients of the mouth that was shown.

        Returns
        -------
        Array
            (n_components,).
        """
        return self.frame.coefficients


class TickObserver(Protocol):
    """An observer of every tick; must return at once."""

    def observe(self, tick: StreetTick) -> None:
        """Process one tick without blocking."""
