"""Lips against sound, of what a synthesiser says, at the encoders of simulated servos."""

import numpy as np
import pytest
from lipservo_lab.bench.sync.speech_timing import performances_of, speech_timing

from lipsync.text_to_speech.synthesis import SynthesisError
from lipsync.text_to_speech.synthesizers import synthesizer_for

#: Of lips that are late; where they are early it takes 125 ms to be noticed (ITU-R BT.1359).
NOTICED_S = 0.045


@pytest.fixture(scope="module")
def texts():
    try:
        voice = synthesizer_for()
    except SynthesisError as missing:
        pytest.skip(str(missing))
    return [voice.speak(text) for text in ("Happy Bob.", "Maybe.")]


@pytest.mark.slow
@pytest.mark.parametrize("is_rendered", [False, True], ids=["said", "performed"])
def test_lips_close_and_part_with_the_sound_of_two_short_sentences(texts, is_rendered):
    performances = performances_of(texts) if is_rendered else None
    timing = speech_timing(texts, performances=performances)
    assert timing.n_wanted >= 4
    assert timing.n_unmatched == 0
    assert np.abs(timing.errors_s).max() <= NOTICED_S
    assert timing.n_hits == timing.n_closures >= 4
