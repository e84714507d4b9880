"""Visemes of a vendor alone, without sound or phonemes: the mouth that they drive."""

import json
from pathlib import Path

import numpy as np
import pytest
from lipservo_lab.evaluation.motion.measures import CLOSING, closes
from lipservo_lab.evaluation.motion.methods import Heard, LiveMethod
from lipservo_lab.learning.motion.trained_model import load_trained_model

from lipsync.alphabets import viseme_sets
from lipsync.animpho.units import load_face_with_animphos
from lipsync.export.arkit import ArkitMap, lip_measures
from lipsync.face.frame import Frame
from lipsync.motion.finishing import DEFAULT_LOOKAHEAD_S
from lipsync.motion.tick_plan import TICK_S
from lipsync.phoneme_files.label_file import LabelFile
from lipsync.phoneme_files.reader import labels_in
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
    content = json.dumps({"alphabet": name, "visemes": told}).encode()
    events = labels_in(content, LabelFile(Path(name))).phones
    assert all(closures_met(events, model, spoken))


def test_blendshapes_at_60_hz_close_the_lips_but_for_one(model, spoken):
    """Those that our own face shows for the sentence, as an avatar would get them."""
    arkit = ArkitMap(lip_measures(load_face_with_animphos(None)))
    shown = shown_faces(spoken.phonemes, model, np.arange(0.0, spoken.duration_s, 1 / 60))
    frames = [arkit.values(Frame(0.0, face)).tolist() for face in shown]

    events = labels_in(
        json.dumps({"BlendShapes": frames}).encode(), LabelFile(Path("arkit"))
    ).phones
    assert closures_met(events, model, spoken).count(False) <= 1


def shown_faces(events, model, times_s):
    return LiveMethod().faces(model, Heard(tuple(events)), times_s, DEFAULT_LOOKAHEAD_S)


def closures_met(events, model, spoken):
    times_s = np.arange(0.0, spoken.duration_s, TICK_S)
    gaps_mm = model.lip_gaps_mm(model.markers_mm(shown_faces(events, model, times_s)))
    closing = [each for each in spoken.phonemes if each.phoneme in CLOSING]
    met = [closes(each, times_s, gaps_mm) for each in closing]

    assert len(met) > 15
    assert gaps_mm.max() > 5.0
    return met
