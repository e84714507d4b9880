"""A planned line inside the parts that fit around every synthesiser: strength, rest, closures."""

from collections.abc import Sequence

import numpy as np

from lipsync.arrays import Array
from lipsync.face.model import FaceModel
from lipsync.motion.closing_synthesizer import ClosingSynthesizer
from lipsync.motion.closure_plan import BILABIALS, LABIODENTALS
from lipsync.motion.expected_motion import USED_LOOKAHEAD_S
from lipsync.motion.lip_closure import lip_gap_of
from lipsync.motion.live_synthesizer import STRONGEST
from lipsync.motion.resting_synthesizer import RestingSynthesizer
from lipsync.motion.scaled_synthesizer import ScaledSynthesizer
from lipsync.motion.tick_plan import TICK_S
from lipsync.motion.wrapped_synthesizer import WrappedSynthesizer
from lipsync.offline.planned_motion import PlannedMotion
from lipsync.phonemes import PHONEMES

#: How far ahead rest and closures look. They ask for the next pause and the next onset, and 200 ms
#: tell both; a line is known to its end.
_KNOWN_S = USED_LOOKAHEAD_S


def wrapped_line(face: FaceModel, planned: PlannedMotion, strength: float) -> WrappedSynthesizer:
    """Strength, rest in pauses and closed lips around a planned line; a fresh one each time."""
    scaled = ScaledSynthesizer(planned, face.rest, strength, strongest=STRONGEST)
    resting = RestingSynthesizer(scaled, face.rest, _KNOWN_S)
    closing = (*BILABIALS, *LABIODENTALS)
    return ClosingSynthesizer(
        resting,
        lip_gap_of(face),
        labiodental_gap_mm=face.labiodental_gap_mm,
        tightest_s={p: float(face.tightest_s[PHONEMES.index(p)]) for p in closing},
        known_s=_KNOWN_S,
    )


def shown_faces(line: WrappedSynthesizer, times_s: Sequence[float] | Array) -> Array:
    """Faces (n, n_components) at ascending times, decided tick by tick as a robot would."""
    found, n_ticks = [], 0
    for time_s in times_s:
        while n_ticks * TICK_S < time_s - 1e-6:
            line.frame_at(n_ticks * TICK_S)
            n_ticks += 1
        found.append(line.frame_at(float(time_s)).coefficients)
    return np.array(found)
