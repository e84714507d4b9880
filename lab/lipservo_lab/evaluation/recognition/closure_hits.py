"""How many of the P, B, M and F, V that are spoken the mouth closes for, by recognised phonemes."""

from collections.abc import Iterable
from dataclasses import dataclass

from lipservo_lab.evaluation.motion.measures import CLOSING, closes, is_bilabial
from lipservo_lab.evaluation.recognition.heard_motion import HeardMotion
from lipsync.face.model import FaceModel
from lipsync.phonemes import PhonemeEvent


@dataclass(frozen=True, slots=True)
class Closure:
    """A phone that closes the mouth, as it was spoken, and whether the mouth closed for it."""

    phone: PhonemeEvent
    was_met: bool


def closure_hits(
    motion: HeardMotion, phones: Iterable[PhonemeEvent], model: FaceModel
) -> list[Closure]:
    """Every closure among the phones spoken in a recording, in order, in the motion it gave.

    A closure is met as in `bench motion` (docs/motion.md): lips at most 1 mm apart, or for F V
    4.6 mm, at some instant from 40 ms before the phone to 40 ms after it.
    """
    gaps_mm = model.lip_gaps_mm(model.markers_mm(motion.faces))
    return [
        Closure(phone, closes(phone, motion.times_s, gaps_mm))
        for phone in phones
        if phone.phoneme in CLOSING
    ]


def closure_figures(closures: Iterable[Closure]) -> dict[str, object]:
    """Counts and shares, P B M and F V apart; None where nothing was spoken that closes."""
    figures: dict[str, object] = {}
    found = list(closures)
    for name, wanted in (("closure", True), ("labiodental", False)):
        met = [c.was_met for c in found if is_bilabial(c.phone.phoneme) == wanted]
        figures[f"{name}s"] = len(met)
        figures[f"{name}s_met"] = sum(met)
        figures[f"{name}_hits"] = sum(met) / len(met) if met else None
    return figures
