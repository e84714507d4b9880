"""Where phonemes meet that never met in training a fixed method has a share."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from lipservo_lab.baselines.baselines import fixed_reference
from lipservo_lab.corpus.utterance import Utterance
from lipservo_lab.learning.motion.face_training import diphones
from lipservo_lab.learning.motion.trained_model import load_trained_model
from spoken_phonemes import spoken

from lipsync.expectation.back_off import BACK_OFF_SHARE, BackOff
from lipsync.expectation.expectation import (
    UNKNOWN,
    constant_expectation,
    context_at,
    expectation_of,
    track_of,
)
from lipsync.motion.live_synthesizer import ExpectedMotion
from lipsync.phonemes import PHONEMES, FramePosteriors, PhonemeEvent, PhonemeUpdate

CENTRES = np.random.default_rng(0).normal(size=(len(PHONEMES), 3))
SENTENCE = spoken(("SIL", 0.3), ("B", 0.08), ("AA", 0.12), ("T", 0.06), ("SIL", 0.4))
TRACK = track_of(SENTENCE)
B, AA, T = (PHONEMES.index(phoneme) for phoneme in ("B", "AA", "T"))


def all_but(*, never: tuple[int, int] | None = None) -> BackOff:
    pairs = np.ones((UNKNOWN + 1, UNKNOWN + 1), dtype=np.bool_)
    if never is not None:
        pairs[never] = False
    return BackOff(CENTRES, pairs)


def test_where_a_diphone_is_new_the_fixed_method_has_a_fifth():
    # 10 ms into AA, all known: the benchmarks' reference, which is written apart, is the oracle.
    time_s = 0.39
    context = context_at(TRACK, time_s, 9.0)
    fixed = fixed_reference().face_at(SENTENCE, CENTRES, np.array([time_s]))[0]
    face = np.array([1.0, -2.0, 0.5])
    mixed = all_but(never=(B, AA)).mixed(face, *context, 9.0)
    np.testing.assert_allclose(mixed, 0.8 * face + 0.2 * fixed, atol=1e-12)


@pytest.mark.parametrize(
    ("never", "time_s", "share"),
    [
        ((B, AA), 0.31, 0.0),  # in B: how it begins is known
        ((B, AA), 0.41, BACK_OFF_SHARE),
        ((B, AA), 0.51, 0.0),  # in T: B and AA are past
        ((AA, B), 0.41, 0.0),
    ],
)
def test_the_phoneme_before_counts(never, time_s, share):
    phonemes, _ = context_at(TRACK, time_s, time_s + 0.1)
    assert all_but(never=never).share(phonemes) == share


def test_known_contexts_play_the_networks_alone_to_the_last_bit():
    model = load_trained_model()
    assert model.expectation.back_off is not None
    alone = replace(model.expectation, back_off=None)
    everything_known = replace(alone, back_off=BackOff(model.baselines.centres, all_but().diphones))
    times_s = np.arange(0.0, 0.9, 0.01)
    faces = everything_known.faces_after(TRACK, times_s, 0.5)
    assert np.array_equal(faces, alone.faces_after(TRACK, times_s, 0.5))


def test_one_instant_and_many_back_off_alike():
    expectation = replace(constant_expectation(CENTRES), back_off=all_but(never=(B, AA)))
    for time_s in (0.31, 0.41, 0.51):
        known_s = 0.1
        context = context_at(TRACK, time_s, time_s + known_s)
        after = expectation.faces_after(TRACK, np.array([time_s]), time_s + known_s)[0]
        np.testing.assert_allclose(expectation.at(*context, known_s), after, atol=1e-12)
        assert np.array_equal(after, CENTRES[context[0][2]]) == (time_s != 0.41)


def test_a_phoneme_held_for_an_hour_has_a_face():
    held = track_of([PhonemeEvent("B", 0.0, 0.1), PhonemeEvent("AA", 0.1, None)])
    context = context_at(held, 3600.0, 3600.1)
    face = all_but(never=(B, AA)).mixed(np.zeros(3), *context, 0.1)
    np.testing.assert_allclose(face, BACK_OFF_SHARE * CENTRES[AA], atol=1e-9)


def test_a_model_file_keeps_it_and_one_without_it_still_loads():
    expectation = replace(constant_expectation(CENTRES), back_off=all_but(never=(B, AA)))
    arrays = expectation.arrays()
    again = expectation_of(arrays).back_off
    assert again is not None
    assert not again.diphones[B, AA]
    assert again.diphones.sum() == again.diphones.size - 1
    older = {name: array for name, array in arrays.items() if name not in ("centres", "diphones")}
    assert expectation_of(older).back_off is None


def test_a_damaged_table_is_refused_by_name():
    short = BackOff(CENTRES, np.ones((40, 40), dtype=np.bool_))
    with pytest.raises(ValueError, match="array diphones has shape"):
        replace(constant_expectation(CENTRES), back_off=short).check(3)


def test_gaps_between_phones_count_as_the_silence_that_they_are():
    phones = (PhonemeEvent("B", 0.1, 0.2), PhonemeEvent("AA", 0.3, 0.4))
    still = np.zeros((10, 47, 3), np.float32)
    pairs = diphones([Utterance("u", still, 25.0, Path("u.flac"), phones, ())])
    silence = PHONEMES.index("SIL")
    assert pairs[silence, B]
    assert pairs[B, silence]
    assert not pairs[B, AA]


def test_of_phonemes_that_are_heard_a_new_pair_is_taken_for_a_mistake():
    backing_off = replace(constant_expectation(CENTRES), back_off=all_but(never=(B, AA)))
    motion = ExpectedMotion(backing_off, np.zeros(3), lookahead_s=0.1, smoothness=0.0)

    def face(posteriors: FramePosteriors | None) -> np.ndarray:
        motion.reset()
        motion.push(PhonemeUpdate(0.0, 1.0, 1.0, SENTENCE, posteriors))
        return motion.frame_at(0.44).coefficients

    sure = np.ones((1, 1, len(PHONEMES)), np.float32) / len(PHONEMES)
    np.testing.assert_allclose(face(FramePosteriors(100, 0, (0,), sure)), CENTRES[AA])
    known = face(None)
    assert not np.allclose(known, CENTRES[AA])
    np.testing.assert_array_equal(known, face(None))


def test_phonemes_that_are_known_are_not_taken_for_a_mistake_after_others_were_heard():
    backing_off = replace(constant_expectation(CENTRES), back_off=all_but(never=(B, AA)))
    sure = np.ones((1, 1, len(PHONEMES)), np.float32) / len(PHONEMES)
    heard = PhonemeUpdate(0.0, 1.0, 1.0, SENTENCE, FramePosteriors(100, 0, (0,), sure))
    known = replace(heard, posteriors=None)

    def face(*updates: PhonemeUpdate) -> np.ndarray:
        motion = ExpectedMotion(backing_off, np.zeros(3), lookahead_s=0.1, smoothness=0.0)
        for update in updates:
            motion.push(update)
        return motion.frame_at(0.44).coefficients

    np.testing.assert_array_equal(face(heard, known), face(known))
    assert not np.allclose(face(known), face(heard))
