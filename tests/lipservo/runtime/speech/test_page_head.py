"""The head on the page: its lips round for OW and UW, whose talker hardly rounds hers."""

from types import SimpleNamespace

import numpy as np
import pytest
from lipservo_lab.evaluation.motion.measures import lip_shapes_mm
from lipservo_lab.learning.motion.trained_model import load_trained_model
from spoken_phonemes import spoken

from lipservo.runtime.speech.speech_side import SpeechBoard
from lipservo.runtime.status.live_board import EXPRESSION_NAMES
from lipsync.motion.live_synthesizer import LiveSynthesizer
from lipsync.motion.tick_plan import TICK_S
from lipsync.phonemes import PhonemeUpdate

MODEL = load_trained_model()


class SpokenVowel:
    """A face that says a vowel of 0.2 s from 0.4 s on, as `Speech` shows it."""

    expression = None
    is_cut_off = False

    def __init__(self, vowel: str) -> None:
        events = spoken(("SIL", 0.4), (vowel, 0.2), ("T", 0.08), ("SIL", 0.4))
        self._motion = LiveSynthesizer(MODEL, MODEL.expectation)
        self._motion.push(PhonemeUpdate(0.0, np.inf, np.inf, events))
        self.event_at = self._motion.event_at

    def sound_time_s(self, now_s: float) -> float:
        return now_s

    def shown_at(self, sound_s: float):
        event = self.event_at(sound_s)
        return "SIL" if event is None else event.phoneme, self._motion.frame_at(sound_s)


def in_the_middle_mm(vowel: str) -> np.ndarray:
    """(3,): gap, width, protrusion of the page's lips in the middle of a vowel."""
    written = []
    board = SimpleNamespace(write_speech=lambda _peaks, **values: written.append(values))
    head, speech = SpeechBoard(board, MODEL), SpokenVowel(vowel)
    for tick in range(51):
        head.tell(tick * TICK_S, speech)
    return lip_shapes_mm(MODEL, MODEL.markers_mm(written[-1]["coefficients"][None]))[0]


@pytest.mark.parametrize("vowel", ["OW", "UW"])
def test_on_the_page_a_round_vowel_looks_unlike_aa_and_iy(vowel):
    round_mm, aa_mm, iy_mm = (in_the_middle_mm(v) for v in (vowel, "AA", "IY"))
    assert round_mm[0] <= 0.75 * aa_mm[0]
    assert round_mm[1] <= 0.8 * iy_mm[1]


def test_a_mouth_that_is_cut_off_in_an_f_does_not_keep_its_lip_tucked():
    written = []
    board = SimpleNamespace(write_speech=lambda _peaks, **values: written.append(values))
    head, speech = SpeechBoard(board, MODEL), SpokenVowel("F")
    for speech.is_cut_off in (False, True):
        head.tell(0.5, speech)
    tucked, cut_off = (dict(zip(EXPRESSION_NAMES, w["expression"], strict=True)) for w in written)
    assert tucked["lip_tuck"] > 0.4
    assert np.isnan(cut_off["lip_tuck"])
