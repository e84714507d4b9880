"""Context visemes, by hand on a few phones, and their splines beside another library's."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lipservo_lab.baselines.baselines import joined_faces
from lipservo_lab.baselines.context_visemes import recorded_visemes
from lipservo_lab.corpus.utterance import Utterance
from scipy.interpolate import CubicHermiteSpline
from spoken_phonemes import spoken

from lipsync.phonemes import PHONEMES, VISEME_OF

RATE_HZ = 25.0


def sentence(*phones):
    """An utterance whose one component is the number of the frame."""
    events = spoken(*phones)
    n_frames = round(events[-1].end_s * RATE_HZ) + 1
    motion = np.arange(n_frames, dtype=float)[:, None]
    return Utterance("u", np.zeros((n_frames, 1, 3)), RATE_HZ, Path(), events, ()), motion


def learned(*sentences):
    return recorded_visemes(*zip(*sentences, strict=True))


RECORDED = (
    sentence(("SIL", 0.4), ("B", 0.08), ("AA", 0.2), ("T", 0.12), ("SIL", 0.4)),
    sentence(("SIL", 0.4), ("M", 0.08), ("AH", 0.2), ("S", 0.12), ("SIL", 0.4)),
    sentence(("SIL", 0.4), ("F", 0.08), ("AA", 0.4), ("T", 0.12), ("SIL", 0.4)),
    sentence(("SIL", 0.4), ("F", 0.08), ("AA", 0.3), ("T", 0.12), ("SIL", 0.4)),
)


def best(phones, number):
    """Which recorded phone stands for one of a line's: its sentence and its place."""
    found = int(learned(*RECORDED).best_for(spoken(*phones))[number])
    return divmod(found, 5)


def test_a_phone_in_the_middle_of_the_same_visemes_wins_over_the_same_phone():
    # P AH D: M AH S has both neighbours of the same classes, and so has B AA T; AH is the same.
    assert best([("P", 0.1), ("AH", 0.1), ("D", 0.1)], 1) == (1, 2)
    # P AA D: both fit by class, and B AA T is the same phoneme.
    assert best([("P", 0.1), ("AA", 0.1), ("D", 0.1)], 1) == (0, 2)
    # V AH D: only F AA T has both neighbours, though AH itself was recorded after M.
    assert best([("V", 0.1), ("AH", 0.31), ("D", 0.1)], 1) == (3, 2)


def test_among_equals_the_same_neighbours_then_the_duration_decide():
    assert best([("V", 0.1), ("AA", 0.39), ("D", 0.1)], 1) == (2, 2)
    assert best([("V", 0.1), ("AA", 0.32), ("D", 0.1)], 1) == (3, 2)
    # S AA M: neighbours fit nowhere by class; F AA T, F AA T and B AA T are left, by duration.
    assert best([("SIL", 0.1), ("S", 0.1), ("AA", 0.19), ("M", 0.1)], 2) == (0, 2)
    # SIL B AA: the same neighbour after it wins over M's.
    assert best([("SIL", 0.4), ("B", 0.5), ("AA", 0.1)], 1) == (0, 1)


def test_a_class_that_was_never_recorded_is_played_by_a_stand_in():
    # HH looks like AH.
    assert best([("SIL", 0.4), ("HH", 0.1), ("S", 0.1)], 1) == (1, 2)


def test_the_face_of_an_example_is_that_of_its_centre():
    # AA of the first sentence goes from 0.48 s to 0.68 s: its centre is at frame 14.5.
    wanted = spoken(("P", 0.1), ("AA", 0.1), ("D", 0.1))
    assert learned(*RECORDED).targets(wanted)[1] == pytest.approx([14.5])


phones = st.lists(
    st.tuples(st.sampled_from(PHONEMES), st.sampled_from([0.04, 0.1, 0.2])), min_size=1, max_size=8
)


@given(phones)
def test_what_was_recorded_is_found_again_in_its_own_context(said):
    utterance, motion = sentence(("SIL", 0.2), *said, ("SIL", 0.2))
    visemes = learned(*RECORDED, (utterance, motion))
    found = visemes.best_for(utterance.phones)
    chosen = visemes.phonemes[found]
    np.testing.assert_array_equal(chosen, visemes.phonemes[-len(utterance.phones) :])
    for phone, number in zip(utterance.phones, chosen[:, 1], strict=True):
        assert VISEME_OF[PHONEMES[number]] == VISEME_OF[phone.phoneme]


@given(phones, st.integers(0, 2**31))
def test_the_spline_is_the_hermite_spline_of_another_library(said, seed):
    said = [(name, lasts) for name, lasts in said if name != "SIL"] or [("AA", 0.1)]
    line = spoken(("SIL", 0.3), *said, ("SIL", 0.3))
    targets = np.random.default_rng(seed).normal(size=(len(line), 4))
    knots_s = [0.0, line[0].end_s]
    knots_s += [(p.start_s + p.end_s) / 2.0 for p in line[1:-1]]
    knots_s = np.array([*knots_s, line[-1].start_s, line[-1].end_s])
    values = targets[[0, *range(len(line)), len(line) - 1]]
    slopes = np.zeros_like(values)
    slopes[1:-1] = (values[2:] - values[:-2]) / (knots_s[2:] - knots_s[:-2])[:, None]
    times_s = np.linspace(0.0, line[-1].end_s, 60)
    np.testing.assert_allclose(
        joined_faces(line, targets, times_s),
        CubicHermiteSpline(knots_s, values, slopes)(times_s),
        atol=1e-9,
    )
