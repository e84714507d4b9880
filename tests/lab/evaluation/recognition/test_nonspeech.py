"""The mouth while nobody speaks: counted by hand, and played to a recogniser that is told what to
say."""

import numpy as np
import pytest
import soundfile
from lipservo_lab.evaluation.recognition.nonspeech_answers import (
    MouthDuringSound,
    mouth_during,
    nonspeech_figures,
)
from lipservo_lab.learning.motion.trained_model import load_trained_model

from lipsync.phonemes import PhonemeEvent, PhonemeUpdate


def test_shares_are_of_the_time_of_all_sounds_together():
    mouths = [MouthDuringSound(10.0, 1.0, 2.0, 3, 5.0), MouthDuringSound(30.0, 1.0, 0.0, 1, 9.0)]
    assert nonspeech_figures(mouths) == {
        "open_share": 0.05,
        "speech_share": 0.05,
        "openings_per_min": 6.0,
        "widest_mm": 9.0,
        "files": 2,
        "seconds": 40.0,
    }


class Told:
    """A recogniser that hears AA from 1.0 to 1.5 s in anything, or nothing."""

    latency_s = 0.095

    def __init__(self, hears_aa):
        self._hears_aa = hears_aa
        self.reset()

    def reset(self):
        self._heard_s = 0.0

    def feed(self, block):
        self._heard_s = block.end_s

    def updates(self):
        until_s = self._heard_s - self.latency_s
        events = [PhonemeEvent("SIL", 0.0, None)]
        if self._hears_aa and until_s > 1.0:
            events = [PhonemeEvent("SIL", 0.0, 1.0), PhonemeEvent("AA", 1.0, None)]
            if until_s > 1.5:
                events[-1:] = [PhonemeEvent("AA", 1.0, 1.5), PhonemeEvent("SIL", 1.5, None)]
        return [PhonemeUpdate(0.0, self._heard_s, max(0.0, until_s), tuple(events))]


@pytest.mark.parametrize("hears_aa", [True, False])
def test_the_mouth_opens_for_what_is_taken_for_speech_and_for_nothing_else(tmp_path, hears_aa):
    noise = np.random.default_rng(0).uniform(-0.1, 0.1, 3 * 16_000)
    soundfile.write(tmp_path / "noise.wav", noise, 16_000)
    mouth = mouth_during(tmp_path / "noise.wav", Told(hears_aa), load_trained_model(), 0.1)
    assert mouth.seconds == pytest.approx(3.0)
    assert mouth.n_openings == int(hears_aa)
    assert mouth.speech_s == pytest.approx(0.5 if hears_aa else 0.0, abs=0.02)
    if hears_aa:
        assert 0.3 < mouth.open_s < 0.9
        assert mouth.widest_mm > 5.0
    else:
        assert mouth.open_s == 0.0
        assert mouth.widest_mm == pytest.approx(0.0, abs=0.05)
