"""The measures: checked against worked examples and other libraries."""

from pathlib import Path

import numpy as np
import pytest
from lipservo_lab.corpus.utterance import Utterance, Word, speech_frames
from lipservo_lab.evaluation.motion.measures import (
    SUMS,
    Motion,
    confidence_intervals,
    figures,
    paired_differences,
    sentence_sums,
)
from lipservo_lab.evaluation.motion.methods import REFERENCE, Heard, all_methods
from lipservo_lab.evaluation.motion.minimal_pairs import (
    find_pairs,
    made_persistence,
    recorded_persistence,
)
from lipservo_lab.evaluation.motion.motion_scores import Scores, add_scores
from lipservo_lab.evaluation.motion.recovery import (
    NEVER_S,
    wrong_phoneme_persistence,
)
from lipservo_lab.learning.motion.frame_statistics import observe_closures
from lipservo_lab.learning.motion.trained_model import load_trained_model
from recorded_phrase import recorded
from small_model import small_model
from spoken_phonemes import spoken

from lipsync.motion.live_synthesizer import LIVE_STRATEGY
from lipsync.phonemes import PHONEMES
from lipsync.recognition.network import LATENCY_S


def measured(utterance: Utterance, faces: np.ndarray) -> dict[str, float]:
    model = small_model()
    motion = Motion(utterance.markers_mm, model.coefficients(utterance.markers_mm))
    made = Motion(model.markers_mm(faces), faces)
    rest = np.repeat(model.rest[None], len(faces), axis=0)
    reference = Motion(model.markers_mm(rest), rest)
    scored = speech_frames(utterance)
    return figures(sentence_sums(model, utterance, scored, motion, made, reference))


def test_the_recording_itself_scores_perfectly():
    utterance = recorded()
    found = measured(utterance, small_model().coefficients(utterance.markers_mm))
    assert found["rmse_mm"] < 1e-5
    assert found["gap_r"] == pytest.approx(1.0)
    assert found["acceleration_ratio"] == pytest.approx(1.0)


def test_figures_are_those_computed_directly():
    utterance, model = recorded(), small_model()
    rng = np.random.default_rng(5)
    faces = model.coefficients(utterance.markers_mm) + rng.normal(
        0, 3, (len(utterance.markers_mm), 5)
    )
    found = measured(utterance, faces)
    speech = speech_frames(utterance)
    distance = np.linalg.norm(model.markers_mm(faces) - utterance.markers_mm, axis=2)[speech]
    still = np.linalg.norm(model.markers_mm(model.rest[None]) - utterance.markers_mm, axis=2)[
        speech
    ]
    gaps = model.lip_gaps_mm(model.markers_mm(faces)), model.lip_gaps_mm(utterance.markers_mm)
    gaps = gaps[0][speech], gaps[1][speech]
    assert found["rmse_mm"] == pytest.approx(np.sqrt((distance**2).mean()))
    assert found["ratio"] == pytest.approx(np.sqrt((distance**2).sum() / (still**2).sum()))
    assert found["gap_r"] == pytest.approx(np.corrcoef(*gaps)[0, 1])
    assert found["gap_rmse_mm"] == pytest.approx(np.sqrt(((gaps[0] - gaps[1]) ** 2).mean()))


def test_an_offset_is_in_the_errors_and_not_in_those_without_the_sentences_mean():
    """The recorded face, always 2 more on the component of width."""
    utterance, model = recorded(), small_model()
    faces = model.coefficients(utterance.markers_mm)
    faces[:, 1] += 2.0
    found = measured(utterance, faces)
    speech = speech_frames(utterance)
    made_mm, recorded_mm = model.markers_mm(faces)[speech], utterance.markers_mm[speech]
    width_mm = [np.ptp(x[:, list(model.layout.lips), 0], axis=1) for x in (made_mm, recorded_mm)]
    assert found["rmse_mm"] > 0.2
    assert found["width_rmse_mm"] == pytest.approx((width_mm[0] - width_mm[1]).mean(), rel=1e-4)
    assert found["width_rmse_mm"] > 1.0
    for name in ("rmse_free_mm", "rmse_lips_free_mm", "gap_free_rmse_mm", "width_free_rmse_mm"):
        assert found[name] < 1e-4
    assert found["protrusion_free_rmse_mm"] < 1e-4


def test_errors_without_the_mean_are_standard_deviations():
    utterance, model = recorded(), small_model()
    rng = np.random.default_rng(6)
    faces = model.coefficients(utterance.markers_mm) + rng.normal(1.0, 2.0, (36, 5))
    found = measured(utterance, faces)
    speech = speech_frames(utterance)
    away_mm = (model.markers_mm(faces) - utterance.markers_mm)[speech]
    assert found["rmse_free_mm"] == pytest.approx(np.sqrt((away_mm.std(axis=0) ** 2).sum(1).mean()))
    middle = [model.layout.upper_lip, model.layout.lower_lip]
    forward_mm = away_mm[:, middle, 2].mean(axis=1)
    assert found["protrusion_free_rmse_mm"] == pytest.approx(forward_mm.std(), rel=1e-5)
    assert found["protrusion_rmse_mm"] == pytest.approx(np.sqrt((forward_mm**2).mean()), rel=1e-5)


def test_half_the_motion_of_the_finer_components_has_half_their_deviation():
    """The small model has one of them, the fifth."""
    utterance, model = recorded(), small_model()
    faces = model.coefficients(utterance.markers_mm)
    faces[:, 4] += np.random.default_rng(7).normal(0.0, 3.0, len(faces))
    moving = Utterance("u", model.markers_mm(faces), 25.0, Path(), utterance.phones, ())
    halved = faces.copy()
    halved[:, 4] = 5.0 + 0.5 * faces[:, 4]
    assert measured(moving, halved)["fine_deviation"] == pytest.approx(0.5)
    assert measured(moving, faces)["fine_deviation"] == pytest.approx(1.0)


def test_a_mouth_glued_shut_hits_every_closure_and_is_found_out():
    utterance, model = recorded(), small_model()
    found = measured(utterance, np.repeat(model.rest[None], len(utterance.markers_mm), axis=0))
    assert found["closure_hits"] == 1.0
    assert found["false_closures"] == 1.0
    assert found["gap_r"] == 0.0
    assert found["ratio"] == pytest.approx(1.0)


def test_a_mouth_always_open_hits_no_closure():
    utterance = recorded()
    wide = np.repeat(small_model().baselines.centres[PHONEMES.index("AA")][None], 36, axis=0)
    assert measured(utterance, wide)["closure_hits"] == 0.0


def test_a_bootstrap_of_equal_sentences_has_no_spread_and_of_unequal_ones_holds_the_mean():
    rng = np.random.default_rng(0)
    sums = np.abs(rng.normal(10.0, 3.0, (200, len(SUMS))))
    same = np.repeat(sums[:1], 20, axis=0)
    low, high = confidence_intervals(same, ["rmse_mm"])["rmse_mm"]
    assert low == pytest.approx(high)
    low, high = confidence_intervals(sums, ["rmse_mm"])["rmse_mm"]
    assert low < figures(sums.sum(axis=0))["rmse_mm"] < high
    assert high - low < 0.2


def test_differences_are_of_the_same_samples_of_sentences():
    sums = np.abs(np.random.default_rng(0).normal(10.0, 3.0, (200, len(SUMS))))
    farther = sums.copy()
    farther[:, SUMS.index("squared_mm2")] *= 1.21
    whole, (low, high) = paired_differences(farther, sums, ["rmse_mm"])["rmse_mm"]
    rmse_mm = figures(sums.sum(axis=0))["rmse_mm"]
    assert whole == pytest.approx(0.1 * rmse_mm)
    ends_mm = confidence_intervals(sums, ["rmse_mm"])["rmse_mm"]
    assert (low, high) == pytest.approx([0.1 * end for end in ends_mm])


def test_only_the_words_asked_for_count():
    words = (Word("ma", 0.4, 0.72), Word("oom", 0.72, 1.04))
    utterance = recorded(words=words)
    assert speech_frames(utterance).sum() == 16
    assert np.flatnonzero(speech_frames(utterance, frozenset({"ma"}))).tolist() == list(
        range(10, 18)
    )


SENTENCE = spoken(
    ("SIL", 0.4), *[("AA", 0.1), ("T", 0.08), ("UW", 0.1), ("L", 0.08)] * 4, ("SIL", 0.4)
)


def made_by_ours(events, name="u") -> Utterance:
    """An utterance that the live method would play without an error."""
    model = load_trained_model()
    times_s = np.arange(round(events[-1].end_s * 25)) / 25.0
    faces = all_methods()[LIVE_STRATEGY].faces(model, Heard(events), times_s, 0.1)
    return Utterance(name, model.markers_mm(faces), 25.0, Path(), events, ())


def test_a_wrong_phoneme_is_forgotten_and_sooner_when_it_is_put_right():
    model, ours = load_trained_model(), all_methods()[LIVE_STRATEGY]
    few = [made_by_ours(SENTENCE)] * 4
    delays_s = (NEVER_S, LATENCY_S, 0.0)
    never, late, at_once = wrong_phoneme_persistence(model, few, ours, delays_s, lookahead_s=0.1)
    assert never.shares[0] == 1.0
    assert never.shares[3] < 0.3
    assert (late.shares[:3] < 0.5 * never.shares[:3]).all()
    assert not at_once.shares.any()
    assert (never.intervals[:, 0] <= never.shares + 1e-9).all()


def test_what_a_phoneme_leaves_behind_is_read_off_minimal_pairs():
    """Faces made so that the first phoneme moves its own by 2, the next by 1, no other."""
    model = small_model()
    rest = (("UW", 0.2), ("IY", 0.2), ("UW", 0.2), ("AA", 0.2), ("SIL", 0.2))
    utterances = []
    for number, first in enumerate(("AA", "AA", "M", "M")):
        events = spoken(("SIL", 0.4), ("IY", 0.2), (first, 0.2), *rest)
        times_s = np.arange(round(events[-1].end_s * 100)) / 100.0
        faces = np.zeros((len(times_s), 5))
        faces[:, 1] = 0.1 * number  # the offset of a take, which repetitions have as well
        faces[:, 0] = (first == "M") * np.select(
            [times_s < 0.6, times_s < 0.8005, times_s < 1.0005], [0.0, 2.0, 1.0]
        )
        utterances.append(
            Utterance(str(number), model.markers_mm(faces), 100.0, Path(), events, ())
        )
    pairs = find_pairs(utterances)
    assert sorted(pairs.differ) == [False] * 2 + [True] * 4
    assert pairs.weights[pairs.differ].sum() == pytest.approx(1.0), "one kind: AA and M"
    assert pairs.weights[~pairs.differ].sum() == pytest.approx(1.0)
    left = recorded_persistence(model, utterances, pairs)
    # Four pairs of offsets 0.1 to 0.3 against repetitions of 0.1; one of five instants lies on the
    # border.
    extra = (0.01 + 0.04 + 0.04 + 0.09) / 4 - 0.01
    squares = np.array([4.0, (4.0 + 4 * 1.0) / 5, 1.0 / 5, 0.0, 0.0]) + extra
    np.testing.assert_allclose(left.shares, np.sqrt(squares / squares[0]), atol=0.01)
    assert left.counted == 4


def test_methods_are_asked_for_the_sentences_of_the_pairs():
    """A method that knows no context leaves nothing behind, beside the joint of two phonemes."""
    mean_face = all_methods()["catmull-rom"]
    phones = [
        (("AA", 0.2), *[("UW", 0.2), ("IY", 0.2)] * 3),
        (("M", 0.2), *[("UW", 0.2), ("IY", 0.2)] * 3),
    ]
    utterances = [
        recorded(spoken(("SIL", 0.4), ("T", 0.2), *p, ("SIL", 0.4)), name=str(i))
        for i, p in enumerate([phones[0], phones[1], phones[0]])
    ]
    left = made_persistence(
        small_model(), utterances, find_pairs(utterances), mean_face, lookahead_s=0.0
    )
    assert left.shares[0] == 1.0
    assert 0.0 < left.shares[1] < 1.0
    assert not left.shares[3:].any()
    alone = find_pairs(utterances[:1])
    assert recorded_persistence(small_model(), utterances[:1], alone) is None


def test_moments_of_closure_are_read_off_the_recording():
    """Lips are tightest in the middle of each M, 60 ms after its onset."""
    many = observe_closures([recorded(name=str(i)) for i in range(5)], small_model().lip_gaps_mm)
    assert many.tightest_s[PHONEMES.index("M")] == pytest.approx(0.06, abs=0.02)
    assert many.tightest_s[PHONEMES.index("AA")] == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", [25.0, 30.0, 60.0, 120.0])
def test_every_method_scores_at_every_frame_rate(rate_hz):
    scores = Scores()
    methods = list(all_methods().values())
    add_scores(scores, small_model(), [recorded(rate_hz=rate_hz)], methods, (0, 100))
    for name in all_methods():
        for lookahead_ms in (0, 100):
            row = scores.row(name, lookahead_ms)
            assert row["sentences"] == 1
            assert np.isfinite(row["ratio"])
    assert scores.row(REFERENCE, 0)["ratio"] == pytest.approx(1.0)
