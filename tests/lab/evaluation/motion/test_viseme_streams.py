"""Visemes of a vendor alone, without sound or phonemes: the mouth that they drive."""

import json

import numpy as np
import pytest
from lipservo_lab.evaluation.motion.measures import CLOSING, closes
from lipservo_lab.evaluation.motion.methods import Heard, LiveMethod
from lipservo_lab.learning.motion.trained_model import load_trained_model

from lipsync.alphabets import viseme_sets
from lipsync.motion.finishing import DEFAULT_LOOKAHEAD_S
from lipsync.motion.tick_plan import TICK_S
from lipsync.phoneme_files.reader import phonemes_in
from lipsync.phonemes import VISEME_OF
from lipsync.text_to_speech.synthesis import SynthesisError
from lipsync.text_to_speech.synthesizers import synthesizer_for

TEXT = "My baby bumped the lamp, Bob. Five very funny men spoke of vapour and foam."


@pytest.fixture(scope="module")
def model():
    return load_trained_model()


@pytest.fixture(scope="module")
def spoken():
    try:
        return synthesizer_for().speak(TEXT)
    except SynthesisError as missing:
        pytest.skip(str(missing))


def viseme_for(phoneme, rows):
    """The viseme whose phone is that of the phoneme, or looks like it, or else any open vowel."""
    alike = [v for v, (phone, _) in rows.items() if VISEME_OF[phone] == VISEME_OF[phoneme]]
    exact = [v for v, (phone, _) in rows.items() if phone == phoneme]
    opened = [v for v, (phone, _) in rows.items() if phone in ("AA", "AH")]
    return (exact or alike or opened)[0]


@pytest.mark.parametrize("name", ["azure", "polly", "ovr", "inworld"])
def test_visemes_with_starts_alone_close_the_lips_for_every_p_b_m_f_v(name, model, spoken):
    rows = viseme_sets()[name]
    told = [
        {"viseme": viseme_for(each.phoneme, rows), "start": each.start_s}
        for each in spoken.phonemes
    ]
    events = phonemes_in(json.dumps({"alphabet": name, "visemes": told}).encode(), name)
    times_s = np.arange(0.0, spoken.duration_s, TICK_S)
    faces = LiveMethod().faces(model, Heard(events), times_s, DEFAULT_LOOKAHEAD_S)
    gaps_mm = model.lip_gaps_mm(model.markers_mm(faces))

    closing = [each for each in spoken.phonemes if each.phoneme in CLOSING]
    met = [closes(each, times_s, gaps_mm) for each in closing]
    assert len(met) > 15
    assert all(met)
    assert gaps_mm.max() > 5.0
