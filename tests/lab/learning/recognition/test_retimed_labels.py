"""Labels laid anew by a teacher."""

import numpy as np
import pytest
from lipservo_lab.corpus.alignment_cache import AlignedUtterance
from lipservo_lab.learning.recognition import retimed_labels
from lipservo_lab.learning.recognition.augmentation import LabelledSamples
from lipservo_lab.learning.recognition.retimed_labels import retimed, taught_by

from lipsync.phonemes import PHONEMES

SIL, P, AA, T = (PHONEMES.index(name) for name in ("SIL", "P", "AA", "T"))


def heard(labels, sure=0.9):
    """Log posteriors (n, 40) of a network that is so sure of these labels."""
    others = (1.0 - sure) / (len(PHONEMES) - 1)
    posteriors = np.full((len(labels), len(PHONEMES)), others, np.float32)
    posteriors[np.arange(len(labels)), labels] = sure
    return np.log(posteriors)


def runs(*parts):
    return np.concatenate([np.full(n, label) for label, n in parts])


def test_boundaries_go_to_where_the_teacher_hears_them():
    truth = runs((SIL, 7), (P, 5), (AA, 11), (T, 4), (SIL, 6))

    assert np.array_equal(retimed([P, AA, T], heard(truth)), truth)


def test_a_silence_that_is_not_there_is_left_out():
    truth = runs((P, 5), (AA, 11), (T, 4))

    assert np.array_equal(retimed([SIL, P, SIL, AA, SIL, SIL, T, SIL], heard(truth)), truth)


def test_a_silence_between_phones_stays_and_several_in_a_row_are_one():
    truth = runs((SIL, 7), (P, 5), (AA, 11), (SIL, 20), (T, 4), (SIL, 6))

    for phones in ([P, AA, SIL, T], [SIL, P, AA, SIL, SIL, T, SIL]):
        assert np.array_equal(retimed(phones, heard(truth)), truth)


def test_phones_keep_their_order_and_last_two_frames_whatever_is_heard():
    """The T is not heard: it takes as little as it may."""
    found = retimed([P, AA, T], heard(runs((P, 10), (AA, 20))))

    assert found[found != SIL].tolist() == [P] * 10 + [AA] * 18 + [T] * 2


@pytest.mark.parametrize("n", [1, 5])
def test_more_phones_than_fit_in_are_no_text_of_this_sound(n):
    assert retimed([P, AA, T], heard(np.full(n, AA))) is None


def test_a_text_that_the_teacher_does_not_hear_teaches_nothing(monkeypatch):
    said = runs((SIL, 5), (P, 10), (AA, 10), (T, 10))
    monkeypatch.setattr(retimed_labels, "_posteriors", lambda *_: np.exp(heard(said, 0.999)))
    sound = LabelledSamples(np.zeros(160 * len(said), np.float32), said)
    own = AlignedUtterance("a", "", "default", (("P", 0, 5), ("AA", 5, 9), ("T", 9, 35)))
    other = AlignedUtterance("b", "", "default", (("K", 0, 5), ("UW", 5, 9), ("M", 9, 35)))
    told = taught_by(None, [(sound, other), (sound, own)])

    assert told.n_unspoken == 1
    assert [each.labels.tolist() for each in told.recordings] == [said.tolist()]
    assert told.taught.posteriors.shape == (35, len(PHONEMES))
    assert told.taught.posteriors[12].argmax() == P
