"""What is known when, and what the networks make of it."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lipservo_lab.corpus.grid import read_grid
from lipservo_lab.learning.expectation.expectation_training import (
    Schedule,
    TrainingSet,
    articulation_table,
    articulatory_features,
    collect_training_set,
    fit,
    fit_expectation,
    forward,
    gradients,
    initial_layers,
    joined,
    phoneme_features,
)
from small_corpus import write_corpus
from spoken_phonemes import spoken

from lipsync.expectation.expectation import (
    N_WINDOWS,
    UNKNOWN,
    constant_expectation,
    context_at,
    contexts,
    timing_features,
    timing_features_at,
    track_of,
    window_shares,
)
from lipsync.phonemes import PHONEMES, VISEME_CLASSES, PhonemeEvent

SENTENCE = spoken(("SIL", 0.4), ("B", 0.07), ("AA", 0.2), ("T", 0.1), ("SIL", 0.5))


def names(numbers: list[int]) -> list[str]:
    return ["?" if n == UNKNOWN else PHONEMES[n] for n in numbers]


def test_with_no_look_ahead_the_end_of_the_running_phone_is_not_known():
    phonemes, times_s = context_at(track_of(SENTENCE), 0.50, 0.50)
    assert names(phonemes) == ["SIL", "B", "AA", "?", "?"]
    assert times_s[:3] == pytest.approx([math.inf, 0.10, 0.03])
    assert np.isnan(times_s[3:]).all()


def test_an_end_is_known_as_soon_as_it_lies_within_the_look_ahead():
    phonemes, times_s = context_at(track_of(SENTENCE), 0.60, 0.70)
    assert names(phonemes) == ["SIL", "B", "AA", "T", "?"]
    assert times_s[3] == pytest.approx(0.07)
    assert np.isnan(times_s[4:]).all()


def test_gaps_are_silence_and_silences_are_joined():
    events = (PhonemeEvent("SIL", 0.1, 0.2), PhonemeEvent("AA", 0.5, 0.6))
    track = track_of((*events, PhonemeEvent("SIL", 0.6, 0.7), PhonemeEvent("SIL", 0.7, None)))
    assert names(list(track.phonemes)) == ["SIL", "AA", "SIL"]
    assert track.starts_s == (-math.inf, 0.5, 0.6)


@settings(max_examples=50, deadline=None)
@given(
    st.lists(st.tuples(st.sampled_from(PHONEMES), st.floats(0.02, 0.3)), min_size=2, max_size=9),
    st.floats(0.0, 1.0),
    st.floats(0.0, 0.2),
)
def test_nothing_beyond_the_look_ahead_reaches_a_context(phones, time_s, lookahead_s):
    """Events cut at t + L, the last left open, give the same context as the whole sentence."""
    events = spoken(*phones)
    limit_s = time_s + lookahead_s
    heard = [
        e if e.end_s <= limit_s else PhonemeEvent(e.phoneme, e.start_s, None)
        for e in events
        if e.start_s <= limit_s
    ]
    if events[-1].end_s <= limit_s + 1e-6:
        return
    whole = context_at(track_of(events), time_s, limit_s)
    cut = context_at(track_of(heard), time_s, limit_s)
    assert whole[0] == cut[0]
    np.testing.assert_array_equal(whole[1], cut[1])


def test_windows_are_filled_by_what_is_heard_in_them():
    """AA from 40 ms ago, known to end in 20 ms; T goes on beyond the 100 ms that are known."""
    times_s = np.array([[math.inf, 0.1, 0.04, 0.02, math.nan, math.nan]])
    filled = window_shares(times_s, np.array([0.1]))[0]
    assert filled.shape == (N_WINDOWS, 5)
    assert filled[6].tolist() == pytest.approx([0, 0, 1, 0, 0]), "the 40 ms before now are AA"
    assert filled[7].tolist() == pytest.approx([0, 0, 0.5, 0.5, 0]), "then half AA, half T"
    assert filled[9].tolist() == pytest.approx([0, 0, 0, 0.5, 0]), "until 100 ms"
    assert not filled[10:].any()


def test_every_phoneme_differs_from_every_other_in_articulation_but_for_none():
    features = articulatory_features()
    assert len(np.unique(features, axis=0)) == len(PHONEMES)


def test_phonemes_of_one_class_are_nearer_to_one_another_than_to_the_rest_on_average():
    features = articulatory_features()
    distance = np.linalg.norm(features[:, None] - features[None], axis=2)
    classes = np.array([next(i for i, c in enumerate(VISEME_CLASSES) if p in c) for p in PHONEMES])
    same = classes[:, None] == classes[None]
    np.fill_diagonal(same, False)
    assert distance[same].mean() < 0.7 * distance[~same].mean()


def test_gradients_are_those_of_finite_differences():
    rng = np.random.default_rng(0)
    layers = [layer.astype(np.float64) for layer in initial_layers((4, 6, 5, 2), rng)]
    inputs, targets = rng.normal(size=(7, 4)), rng.normal(size=(7, 2))

    def loss() -> float:
        return 0.5 * float(((forward(layers, inputs)[-1] - targets) ** 2).sum()) / 7

    for layer, slope in zip(layers, gradients(layers, inputs, targets), strict=True):
        flat, flat_slope = layer.reshape(-1), slope.reshape(-1)
        for i in range(0, flat.size, 3):
            before = flat[i]
            flat[i] = before + 1e-6
            up = loss()
            flat[i] = before - 1e-6
            down = loss()
            flat[i] = before
            assert flat_slope[i] == pytest.approx((up - down) / 2e-6, abs=1e-5)


def test_a_network_learns_what_no_linear_map_can():
    rng = np.random.default_rng(0)
    inputs = rng.uniform(-1, 1, (4000, 2)).astype(np.float32)
    targets = (inputs[:, :1] * inputs[:, 1:] * 3.0).astype(np.float32)
    layers = initial_layers((2, 32, 16, 1), rng)
    fit(layers, inputs, targets, Schedule(60, 1e-5), rng)
    error = forward(layers, inputs)[-1] - targets
    assert error.var() < 0.1 * targets.var()


def some_training_set(n: int = 900) -> TrainingSet:
    """Return contexts at random times, half of them with look-ahead; phonemes set their faces."""
    rng = np.random.default_rng(1)
    events = spoken(*[(PHONEMES[i % 40], 0.1) for i in range(3 * n // 10)])
    found = [contexts(track_of(events), rng.uniform(1.0, n * 0.03, n // 3), L) for L in (0, 0.1)]
    phonemes = np.concatenate([p for p, _ in found])
    faces = np.stack([phonemes[:, 2] % 3, phonemes[:, 1] % 2], axis=1) * 5.0
    return TrainingSet(
        phonemes, np.concatenate([t for _, t in found]), np.repeat([0.0, 0.1], n // 3), faces
    )


def test_what_is_exported_says_what_the_lessons_say():
    """Tables and folded scaling reproduce targets that depend on two phonemes only."""
    training_set = some_training_set(6000)
    expectation = fit_expectation(training_set, np.zeros((40, 2)), seed=0)
    made = expectation.faces(training_set.phonemes, training_set.times_s, training_set.lookahead_s)
    assert ((made - training_set.faces) ** 2).mean() < 0.2 * training_set.faces.var()


def test_one_context_gives_the_same_face_as_many():
    known = some_training_set()
    expectation = fit_expectation(known, np.zeros((40, 2)), seed=0)
    many = expectation.faces(known.phonemes[:5], known.times_s[:5], known.lookahead_s[:5])
    for i in range(5):
        one = expectation.at(
            known.phonemes[i].tolist(), known.times_s[i].tolist(), known.lookahead_s[i]
        )
        np.testing.assert_allclose(one, many[i])


def test_the_same_lessons_and_seed_give_the_same_expectation():
    a, b = (fit_expectation(some_training_set(), np.zeros((40, 2)), seed=4) for _ in "ab")
    for name, values in a.arrays().items():
        np.testing.assert_array_equal(values, b.arrays()[name])


def test_too_few_lessons_give_the_centre_of_the_phoneme():
    training_set = some_training_set(60)
    centres = np.random.default_rng(0).normal(size=(40, 2))
    expectation = fit_expectation(training_set, centres, seed=0)
    made = expectation.faces(training_set.phonemes, training_set.times_s, training_set.lookahead_s)
    np.testing.assert_allclose(made, centres[training_set.phonemes[:, 2]])


def test_a_stack_of_the_wrong_shape_is_refused():
    expectation = constant_expectation(np.zeros((40, 5)))
    expectation.check(5)
    with pytest.raises(ValueError, match="slots_output has shape"):
        expectation.check(4)


def test_unknown_has_no_features():
    for table in (articulation_table(), *phoneme_features()):
        assert not table[UNKNOWN].any()


def test_timing_features_are_bounded_however_long_a_phone_lasts():
    long = np.array([[math.inf, 900.0, 80.0, 70.0, 80.0, 90.0], [0.0] * 6, [math.nan] * 6])
    features = timing_features(long, np.array([0.2, 0.0, 0.1]))
    assert np.isfinite(features).all()
    assert features.min() >= -2.0
    assert features.max() <= 4.0


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.floats(0.0, 2.0) | st.just(math.inf), min_size=3, max_size=3),
    st.lists(st.floats(0.0, 2.0), max_size=3),
    st.floats(0.0, 0.2),
)
def test_timing_features_of_one_context_are_those_of_many(since_s, until_s, lookahead_s):
    times_s = sorted(since_s, reverse=True) + sorted(until_s) + [math.nan] * (3 - len(until_s))
    many = timing_features(np.array([times_s] * 2), np.full(2, lookahead_s))
    np.testing.assert_allclose(timing_features_at(times_s, lookahead_s), many[1], atol=1e-12)


def test_the_pace_is_told_by_what_the_last_two_phonemes_took():
    """AA for 200 ms, then T for 50 ms, now 30 ms ago; the mean of 2.0 and 0.5 usual phonemes."""
    times_s = np.array([[0.28, 0.08, 0.03, math.nan, math.nan, math.nan]])
    pace = timing_features(times_s, np.array([0.0]))[0, -3:]
    assert pace.tolist() == pytest.approx([2.0, 0.5, math.log(1.25)])


def test_what_was_misheard_teaches_once_for_every_three_times_a_label_does(tmp_path):
    """A sentence without sound teaches by its labels alone."""
    corpus = read_grid(write_corpus(tmp_path / "c", 2))
    motion = [np.ones((len(u.markers_mm), 3)) * i for i, u in enumerate(corpus.utterances)]
    labels = collect_training_set(corpus.utterances, motion)
    heard = {"s1": corpus.utterances[1].phones}
    misheard = collect_training_set(corpus.utterances, motion, heard)
    assert set(misheard.faces[:, 0]) == {1.0}
    assert len(labels.faces) == 2 * 3 * len(misheard.faces)
    both = joined([labels, misheard])
    assert len(both.phonemes) == len(both.times_s) == len(both.faces)
