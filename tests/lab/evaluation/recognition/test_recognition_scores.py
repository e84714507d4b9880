import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lipservo_lab.evaluation.recognition.recognition_scores import Score, edit_distance

from lipsync.phonemes import PHONEMES


def labels(text):
    return np.array([PHONEMES.index(phone) for phone in text.split()])


def plain_distance(a, b):
    """Levenshtein's recursion as in the text books, row by row."""
    row = list(range(len(b) + 1))
    for i, x in enumerate(a, start=1):
        left = [i]
        for j, y in enumerate(b, start=1):
            left.append(min(row[j] + 1, left[-1] + 1, row[j - 1] + (x != y)))
        row = left
    return row[-1]


def test_kitten_becomes_sitting_in_three_edits():
    assert edit_distance([ord(c) for c in "kitten"], [ord(c) for c in "sitting"]) == 3


@given(st.lists(st.integers(0, 3), max_size=12), st.lists(st.integers(0, 3), max_size=12))
def test_edit_distance_equals_the_text_book_recursion(a, b):
    assert edit_distance(a, b) == plain_distance(a, b)


def test_a_worked_example():
    """Ten frames, eight of them speech; the P is two frames late, T is heard as D, S as silence."""
    score = Score()
    score.add(
        labels("SIL SIL SIL P P AA D D SIL SIL"),
        labels("SIL P P P AA AA T T S SIL"),
    )
    figures = score.figures()

    assert figures["phone_all"] == pytest.approx(4 / 10)
    assert figures["viseme_all"] == pytest.approx(6 / 10)
    assert figures["phone_speech"] == pytest.approx(2 / 8)
    assert figures["viseme_speech"] == pytest.approx(4 / 8)
    assert figures["closure_recall"] == figures["closure_precision"] == 1.0
    # P AA T S against P AA D: one substitution, one deletion.
    assert figures["per"] == pytest.approx(2 / 4)


def test_nothing_heard_is_no_division_by_zero():
    assert set(Score().figures().values()) == {0.0}
