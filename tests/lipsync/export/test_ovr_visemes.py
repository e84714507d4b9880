"""OVR visemes: weights that add up, and lips that are full when the robot's are shut."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from lipsync.export.ovr_visemes import OVR_NAMES, viseme_weights
from lipsync.face.model import load_face
from lipsync.phonemes import PHONEMES, PhonemeEvent

TIGHTEST_S = load_face().tightest_s
TIMES_S = np.arange(0.0, 1.2, 0.01)


def weights_of(*events):
    values = viseme_weights([PhonemeEvent(*each) for each in events], TIMES_S, TIGHTEST_S)
    return {name: values[:, i] for i, name in enumerate(OVR_NAMES)}


def test_one_viseme_passes_into_the_next_around_their_border():
    weights = weights_of(("SIL", 0.0, 0.3), ("AA", 0.3, 0.6), ("S", 0.6, 0.9), ("SIL", 0.9, 1.2))
    assert weights["aa"][30] == 0.5
    assert weights["sil"][30] == 0.5
    assert weights["aa"][45] == weights["SS"][75] == weights["sil"][110] == 1.0


def test_lips_are_full_when_the_robots_are_tightest_and_held_until_then():
    weights = weights_of(("AA", 0.0, 0.5), ("M", 0.5, 0.6), ("AA", 0.6, 1.0))
    tightest = 0.5 + TIGHTEST_S[PHONEMES.index("M")]
    full_s = TIMES_S[weights["PP"] > 0.999]
    assert full_s.min() <= tightest <= full_s.max() + 0.01
    assert np.interp(tightest - 0.06, TIMES_S, weights["PP"]) < 0.1


def test_a_diphthong_has_two_ends_and_hh_looks_like_what_follows():
    weights = weights_of(("HH", 0.2, 0.3), ("OW", 0.3, 0.8))
    assert weights["oh"][25] == 1.0
    assert weights["oh"][50] == 1.0
    assert weights["ou"][70] == 1.0
    assert weights["sil"][0] == weights["sil"][119] == 1.0


@given(
    st.lists(st.tuples(st.sampled_from(PHONEMES), st.floats(0.001, 0.5)), max_size=30),
    st.booleans(),
)
def test_weights_are_a_mixture_at_every_time(phones, is_open):
    events, now_s = [], 0.0
    for phoneme, duration_s in phones:
        events.append(PhonemeEvent(phoneme, now_s, now_s + duration_s))
        now_s += duration_s
    if events and is_open:
        last = events.pop()
        events.append(PhonemeEvent(last.phoneme, last.start_s, None))
    values = viseme_weights(events, TIMES_S, TIGHTEST_S)
    assert values.min() >= -1e-12
    assert np.allclose(values.sum(axis=1), 1.0)
