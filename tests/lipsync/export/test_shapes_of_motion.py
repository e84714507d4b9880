"""Mouth shapes from motion: steady, closed where lips touch, like the mouths of their phones."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lipsync.animpho.units import load_face_with_animphos
from lipsync.export.arkit import lip_measures
from lipsync.export.shapes_of_motion import (
    SHORTEST_CS,
    lips_shut,
    motion_cues,
    sampling_times_s,
    shape_prototypes,
)
from lipsync.motion.finishing import lip_gap_of

MODEL = load_face_with_animphos()
MEASURES = lip_measures(MODEL)
PROTOTYPES = shape_prototypes(MODEL, MEASURES)


def drawn(faces):
    faces = np.asarray(faces)
    return motion_cues(PROTOTYPES, faces, lips_shut(MEASURES, faces), len(faces) / 100)


def median_face(phoneme):
    units = MODEL.animphos
    return np.median(units.samples[units.of_phoneme(phoneme), 2], axis=0)


@pytest.mark.parametrize(("phoneme", "shape"), [("K", "B"), ("AA", "D"), ("UW", "F"), ("F", "G")])
def test_the_mouth_of_a_phone_is_drawn_as_its_shape(phoneme, shape):
    (cue,) = drawn([median_face(phoneme)] * 50)
    assert cue.shape == shape


def test_lips_that_touch_in_speech_are_a_and_in_a_pause_x():
    opened = [median_face("AA")] * 30
    cues = drawn([MODEL.rest] * 20 + opened + [MODEL.rest] * 10 + opened + [MODEL.rest] * 40)
    closed = [(cue.shape, cue.start_cs) for cue in cues if cue.shape in "AX"]
    assert closed == [("X", 0), ("A", 50), ("X", 90)]


def test_a_closure_of_one_frame_is_drawn_and_as_long_as_anything():
    closed = lip_gap_of(MODEL).narrowed(median_face("AA"), 0.3, 1.0)
    cues = drawn([median_face("AA")] * 30 + [closed] + [median_face("AA")] * 30)
    (closure,) = [cue for cue in cues if cue.shape == "A"]
    assert closure.start_cs <= 30 < closure.end_cs
    assert closure.end_cs - closure.start_cs == SHORTEST_CS


@given(st.lists(st.integers(0, len(MODEL.animphos.frames) - 1), min_size=1, max_size=120))
def test_nothing_flickers_and_nothing_is_left_out(numbers):
    cues = drawn(MODEL.animphos.frames[numbers])
    assert cues[0].start_cs == 0
    assert cues[-1].end_cs == len(numbers)
    assert all(a.end_cs == b.start_cs and a.shape != b.shape for a, b in pairwise(cues))
    assert all(c.end_cs - c.start_cs >= min(SHORTEST_CS, len(numbers)) for c in cues)


def test_a_motion_shorter_than_the_sound_is_refused():
    assert len(sampling_times_s(1.0)) == 100
    with pytest.raises(ValueError, match="99 frames of motion; this sound needs 100"):
        motion_cues(PROTOTYPES, np.zeros((99, 8)), np.zeros(99, dtype=bool), 1.0)
