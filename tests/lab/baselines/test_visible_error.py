import numpy as np
import pytest
from lipservo_lab.baselines.visible_error import (
    visible_distances_mm,
    visible_error_mm,
    visible_error_table,
)
from lipservo_lab.evaluation.recognition.recognition_scores import Score

from lipsync.phonemes import PHONEMES, VISEME_CLASSES, VISEME_OF


def labels(text):
    return np.array([PHONEMES.index(phone) for phone in text.split()])


def apart_mm(one, other):
    return visible_distances_mm()[VISEME_OF[one], VISEME_OF[other]]


def test_distances_are_those_of_shapes():
    distances = visible_distances_mm()

    assert np.array_equal(distances, distances.T)
    assert not np.diag(distances).any()
    # The triangle inequality: no way over a third shape is shorter.
    assert (distances[:, None] <= distances[:, :, None] + distances.T[None] + 1e-9).all()


def test_a_closure_lost_in_an_open_vowel_is_seen_and_a_t_for_a_k_is_not():
    assert apart_mm("P", "AA") > 5.0
    assert apart_mm("T", "K") < 1.0
    assert apart_mm("UW", "IY") > apart_mm("UW", "W")


def test_a_worked_example_frame_by_frame():
    """Of six frames one P is heard as AA and one S as silence; D for T is right."""
    score = Score()
    score.add(labels("SIL AA P D D SIL"), labels("SIL P P T T S"))
    expected_mm = (apart_mm("P", "AA") + apart_mm("S", "SIL")) / 6

    assert score.figures()["visible_error_mm"] == pytest.approx(expected_mm)
    closure = visible_error_table(score.confusion)["P B M"]
    assert closure["frames"] == 2
    assert closure["visible_error_mm"] == pytest.approx(apart_mm("P", "AA") / 2)
    assert list(closure["heard_as"]) == ["AA AH AY AW", "P B M"]
    assert closure["heard_as"]["P B M"] == {"share": 0.5, "visible_error_mm": 0.0}


def test_nothing_heard_is_no_error():
    nothing = np.zeros((len(VISEME_CLASSES),) * 2, np.int64)

    assert visible_error_mm(nothing) == 0.0
    assert visible_error_table(nothing) == {}
