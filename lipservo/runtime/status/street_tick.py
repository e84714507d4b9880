"""What one tick of the street showed, and who may watch it."""

from dataclasses import dataclass
from typing import Protocol

from firmware_bridge.loop.report import TickReport
from lipsync.arrays import Array
from lipsync.face.frame import Frame
from lipsync.phonemes import Hearing
from lipsync.recognition.text_decoder import MovedBy


@dataclass(frozen=True, slots=True)
class StreetTick:
    """What one tick of the street showed. sound_s is negative before the first sound is shown.

    captured_s: when the sound was captured that the servos were moved by; None before there is one.
    hearing: the class of the sound that was settled last, which is not shown yet; None:
    no recogniser listens. moved_by: the source of the phonemes, sound that was heard, text, words,
    phonemes or visemes.
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
        """The mouth that was shown.

        Returns
        -------
        Array
            (n_components,).
        """
        return self.frame.coefficients


class TickObserver(Protocol):
    """An observer of every tick; must return at once."""

    def observe(self, tick: StreetTick) -> None:
        """Handle one tick."""
