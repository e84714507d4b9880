"""What the networks of sound read, and that they learn from it."""

from dataclasses import replace

import numpy as np
import pytest
from lipservo_lab.corpus.utterance import Utterance
from lipservo_lab.learning.expectation.expectation_training import articulatory_features
from lipservo_lab.learning.offline.offline_training import (
    fit_sound_expectation,
    with_sound_deviation,
)
from spoken_phonemes import spoken

from lipsync.offline.offline_model import line_inputs

ARTICULATION = articulatory_features().astype(np.float32)
EVENTS = spoken(("SIL", 0.2), ("AA", 0.2), ("B", 0.1), ("SIL", 0.3))


def inputs(cepstra, times_s, events=EVENTS):
    return line_inputs(events, cepstra, np.asarray(times_s), ARTICULATION)


def test_windows_tell_how_much_of_each_is_filled_by_what():
    """At 0.2 s the window from 0 to 40 ms is all AA, the one from -40 ms all silence."""
    row = inputs(np.zeros((80, 13)), [0.2])[0]
    windows = row[: 16 * 22].reshape(16, 22)
    silence, vowel, openness = windows[:, 0], windows[:, 1], windows[:, 3]

    assert silence[7] == 1.0
    assert vowel[7] == 0.0
    assert (vowel[8], openness[8]) == (1.0, 1.0)


def test_a_border_inside_a_window_parts_it():
    row = inputs(np.zeros((80, 13)), [0.19])[0]

    assert row[: 16 * 22].reshape(16, 22)[8, 1] == pytest.approx(0.75)


def test_sound_is_read_around_the_moment_and_its_ends_are_repeated():
    cepstra = np.tile(np.arange(80.0)[:, None], 13)

    sound = inputs(cepstra, [0.0, 0.4])[:, 16 * 22 + 40 :].reshape(2, -1, 13)[:, :, 0]

    middle = sound.shape[1] // 2
    assert sound[1, middle] == 40.0
    assert sound[1, middle + 1] - sound[1, middle] == 2.0
    assert sound[0, : middle + 1].tolist() == [0.0] * (middle + 1)


def sentences(n=80):
    """Return n sentences in which the mouth opens as the second cepstrum says.

    Returned are lists of utterances, motions (20, 2), lip gaps (20,) and cepstra (80, 13).
    """
    rng = np.random.default_rng(0)
    utterances, motions, gaps, sounds = [], [], [], []
    for number in range(n):
        sound = np.repeat(rng.normal(size=(20, 13)), 4, axis=0)
        face = np.stack([3.0 * sound[::4, 1], np.zeros(20)], axis=1)
        markers = np.zeros((20, 47, 3), np.float32)
        utterances.append(Utterance(f"s{number}", markers, 25.0, None, EVENTS, ()))
        motions.append(face)
        gaps.append(np.abs(face[:, 0]))
        sounds.append(sound)
    return utterances, motions, gaps, sounds


def test_it_learns_what_sound_tells_and_gives_the_same_twice():
    learned = fit_sound_expectation(*sentences(), seed=3)
    again = fit_sound_expectation(*sentences(), seed=3)
    _, motions, _, sounds = sentences(84)

    told = np.concatenate(
        [learned.faces(EVENTS, sound, np.arange(20) / 25.0) for sound in sounds[80:]]
    )

    assert np.corrcoef(told[:, 0], np.concatenate(motions[80:])[:, 0])[0, 1] > 0.4
    for one, other in zip(learned.layers, again.layers, strict=True):
        np.testing.assert_array_equal(one, other)


def test_what_is_told_moves_as_far_as_what_is_expected_live():
    """At least .8 of the recordings' deviation in speech, about the same mean, at most doubled."""
    utterances, motions, gaps, sounds = sentences(8)
    learned = fit_sound_expectation(utterances, motions, gaps, sounds, seed=3)
    spoken_s = np.arange(5, 13) / 25.0

    def told(expectation):
        return [expectation.faces(EVENTS, sound, spoken_s) for sound in sounds]

    def deviation(faces):
        squares = [(face - face.mean(axis=0)) ** 2 for face in faces]
        return float(np.sqrt(np.concatenate(squares).mean(axis=0))[0])

    recorded = deviation([motion[5:13] for motion in motions])
    for share, reached in ((0.6, 0.8), (0.3, 0.6)):
        timid = scaled(learned, share * recorded / deviation(told(learned)))
        louder = with_sound_deviation(timid, utterances, motions, sounds)
        assert deviation(told(timid)) == pytest.approx(share * recorded, rel=1e-4)
        assert deviation(told(louder)) == pytest.approx(reached * recorded, rel=1e-4)
        np.testing.assert_allclose(
            np.mean(told(louder), axis=(0, 1)), np.mean(told(timid), axis=(0, 1)), atol=1e-4
        )


def scaled(expectation, factor):
    """All that is told times a factor."""
    last = (np.float32(factor) * each for each in expectation.layers[-2:])
    return replace(expectation, layers=(*expectation.layers[:-2], *last))


def test_without_speech_nothing_is_changed():
    learned = fit_sound_expectation(*sentences(4), seed=3)
    silent = Utterance("s", np.zeros((20, 47, 3), np.float32), 25.0, None, EVENTS[:1], ())

    assert (
        with_sound_deviation(learned, [silent], [np.ones((20, 2))], [np.zeros((80, 13))]) is learned
    )
