"""How far the shipped model would open the lips for phonemes that are known."""

from collections.abc import Sequence

import numpy as np

from lipsync.arrays import Array
from lipsync.expectation.expectation_file import read_expectation
from lipsync.face.model import FaceModel, read_face
from lipsync.face.model_file import open_model
from lipsync.motion.expected_motion import USED_LOOKAHEAD_S
from lipsync.motion.live_synthesizer import LiveSynthesizer, Style
from lipsync.motion.tick_plan import TICK_S
from lipsync.phonemes import PhonemeEvent, PhonemeUpdate


class ExpectedLips:
    """The shipped model, asked about whole sentences."""

    def __init__(self) -> None:
        with open_model(None) as file:
            self._face: FaceModel = read_face(file)
            self._expectation = read_expectation(file, self._face.n_components)

    def gaps_mm(self, phones: Sequence[PhonemeEvent], duration_s: float) -> Array:
        """(n,) every `TICK_S` from 0 s on."""
        style = Style(lookahead_s=USED_LOOKAHEAD_S)
        synthesizer = LiveSynthesizer(self._face, self._expectation, style)
        synthesizer.push(PhonemeUpdate(0.0, np.inf, np.inf, tuple(phones)))
        times_s = np.arange(max(1, round(duration_s / TICK_S))) * TICK_S
        faces = np.array([synthesizer.frame_at(float(t)).coefficients for t in times_s])
        return self._face.lip_gaps_mm(self._face.markers_mm(faces))
