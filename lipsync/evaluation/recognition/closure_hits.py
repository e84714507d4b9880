"""How many of the P, B, M and F, V that are spoken the mouth closes for, by recognised phonemes."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lipsync.evaluation.motion.measures import CLOSING, closes, is_bilabial
from lipsync.evaluation.motion.methods import LiveMethod
from lipsync.evaluation.recognition.recognized_file import recognize_file
from lipsync.motion.tick_plan import TICK_S
from lipsync.phonemes import LiveRecognizer, PhonemeEvent
from lipsync.training.trained_model import TrainedModel


@dataclass(frozen=True, slots=True)
class Closure:
    """A phone that closes the mouth, as it was spoken, and whether the mouth closed for it."""

    phone: PhonemeEvent
    was_met: bool


def closure_hits(
    recording: Path,
    phones: Iterable[PhonemeEvent],
    recognizer: LiveRecognizer,
    model: TrainedModel,
    lookahead_s: float,
) -> list[Closure]:
    """Every closure among the phones spoken in a recording, in order, with the motion at 100 Hz.

    A closure is met as in `bench motion` (docs/motion.md): lips at most 1 mm apart, or for F V
    4.6 mm, at some instant from 40 ms before the phone to 40 ms after it.
    """
    heard = recognize_file(recognizer, recording)
    n_ticks = round((heard.events[-1].end_s or 0.0) / TICK_S)
    times_s = np.arange(n_ticks, dtype=np.float64) * TICK_S
    faces = LiveMethod().faces(model, heard, times_s, lookahead_s)
    gaps_mm = model.lip_gaps_mm(model.markers_mm(faces))
    return [
        Closure(phone, closes(phone, times_s, gaps_mm))
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
