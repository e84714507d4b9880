"""The live synthesiser as its callers see it: in time, continuous, closed where it must be."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lipservo_lab.learning.motion.trained_model import load_trained_model
from small_model import small_model
from spoken_phonemes import spoken, update_streams

from lipsync.motion.finishing import Style, StyleError
from lipsync.motion.live_synthesizer import LEAD, LiveSynthesizer
from lipsync.motion.tick_plan import TICK_S
from lipsync.phonemes import PHONEMES, FramePosteriors, PhonemeEvent, PhonemeUpdate
from lipsync.recognition.scripted import ScriptedPhonemes


def shipped(style: Style | None = None) -> LiveSynthesizer:
    model = load_trained_model()
    return LiveSynthesizer(model, model.expectation, style)


def known(synthesizer: LiveSynthesizer, *phones: tuple[str, float]) -> None:
    synthesizer.push(PhonemeUpdate(0.0, math.inf, math.inf, spoken(*phones)))


def faces(synthesizer: LiveSynthesizer, start_s: float, end_s: float, step_s=0.001) -> np.ndarray:
    times_s = np.arange(start_s, end_s, step_s)
    return np.array([synthesizer.frame_at(float(t)).coefficients for t in times_s])


@pytest.mark.parametrize("lookahead_s", [0.0, 0.1, 0.2])
def test_the_future_beyond_the_look_ahead_makes_no_difference(lookahead_s):
    """Two sentences alike until 0.60 s give the same faces until 0.60 s - look-ahead."""
    same = (("SIL", 0.4), ("AA", 0.15), ("IY", 0.05))
    a, b = (shipped(Style(lookahead_s)) for _ in "ab")
    known(a, *same, ("M", 0.1), ("AA", 0.3))
    known(b, *same, ("UW", 0.2), ("T", 0.3))
    until_s = 0.60 - lookahead_s - TICK_S
    np.testing.assert_array_equal(faces(a, 0.0, until_s, TICK_S), faces(b, 0.0, until_s, TICK_S))
    assert not np.array_equal(a.frame_at(0.65).coefficients, b.frame_at(0.65).coefficients)


@pytest.mark.parametrize("spoiled", ["nan", "rate"])
def test_posteriors_that_turn_bad_in_speech_are_as_none_and_no_jump(spoiled, caplog):
    """Doubted until 0.5 s, then no posteriors of ours: the mouth goes over to decided phonemes."""
    model = load_trained_model()
    told = spoken(("SIL", 0.3), ("AA", 0.4), ("IY", 0.4))
    values = np.zeros((10, 1, len(PHONEMES)), np.float32)
    values[..., [PHONEMES.index("AA"), PHONEMES.index("UW")]] = 0.5
    good = FramePosteriors(100, 0, (0,), values)
    bad = replace(
        good, **{"nan": {"values": values * np.nan}, "rate": {"frames_per_s": 50}}[spoiled]
    )

    def shown(later: FramePosteriors | None) -> np.ndarray:
        synthesizer, moved = LiveSynthesizer(model, model.expectation, soft=model.soft), []
        for n in range(10):
            end_s = 0.1 * (n + 1)
            now = good if n < 5 else later
            believed = now and replace(now, first_frame=10 * n)
            synthesizer.push(PhonemeUpdate(0.0, end_s, end_s, told, believed))
            moved.append(faces(synthesizer, end_s - 0.2, end_s - 0.1, TICK_S))
        return np.concatenate(moved)

    found = shown(bad)
    (record,) = caplog.records  # once, not at every update
    assert "probabilities of phonemes from the recogniser are not used" in record.getMessage()
    np.testing.assert_array_equal(found, shown(None))
    assert not np.array_equal(found, shown(good))
    assert len(caplog.records) == 1
    gaps_mm = np.array([model.lip_gap_mm(face) for face in found])
    assert np.abs(np.diff(gaps_mm)).max() <= 4.5


def test_a_phoneme_moves_the_mouth_before_its_end_is_known():
    model = small_model()
    synthesizer = LiveSynthesizer(model, model.expectation, Style(0.0))
    events = (PhonemeEvent("SIL", 0.0, 0.5), PhonemeEvent("AA", 0.5, None))
    synthesizer.push(PhonemeUpdate(0.0, 0.6, 0.6, events))
    assert model.lip_gap_mm(synthesizer.frame_at(0.49).coefficients) < 0.1
    assert model.lip_gap_mm(synthesizer.frame_at(0.53).coefficients) > 5.0


def test_a_step_of_the_expectation_is_extrapolated_for_one_recorded_frame_and_then_forgotten():
    model = small_model()
    synthesizer = LiveSynthesizer(model, model.expectation, Style(0.0))
    known(synthesizer, ("SIL", 0.4), ("AA", 0.2), ("UW", 0.3), ("SIL", 0.4))
    ah, uw = (model.baselines.centres[PHONEMES.index(p)] for p in ("AA", "UW"))
    shown = faces(synthesizer, 0.5, 0.8, TICK_S)
    np.testing.assert_allclose(shown[9], ah, atol=1e-9)
    np.testing.assert_allclose(shown[13], uw + LEAD * (uw - ah), atol=1e-9)
    np.testing.assert_allclose(shown[15], uw, atol=1e-9)


@pytest.mark.parametrize("strength", [0.0, 0.5, 1.0, 1.5])
@pytest.mark.parametrize("lookahead_s", [0.0, 0.1])
@pytest.mark.parametrize("phoneme", ["P", "B", "M"])
def test_lips_touch_within_every_labial_at_any_strength(phoneme, lookahead_s, strength):
    model = load_trained_model()
    synthesizer = LiveSynthesizer(model, model.expectation, Style(lookahead_s, strength))
    known(synthesizer, ("SIL", 0.4), ("AA", 0.2), (phoneme, 0.06), ("AE", 0.2), ("SIL", 0.4))
    gaps_mm = [model.lip_gap_mm(c) for c in faces(synthesizer, 0.60, 0.66)]
    assert min(gaps_mm) <= 1.0


@pytest.mark.parametrize("strength", [0.5, 1.5])
@pytest.mark.parametrize("phoneme", ["F", "V"])
def test_the_lower_lip_rises_as_far_as_in_the_recordings_in_f_and_v(phoneme, strength):
    model = load_trained_model()
    synthesizer = LiveSynthesizer(model, model.expectation, Style(0.1, strength))
    known(synthesizer, ("SIL", 0.4), ("AA", 0.2), (phoneme, 0.1), ("AA", 0.2), ("SIL", 0.4))
    gaps_mm = [model.lip_gap_mm(c) for c in faces(synthesizer, 0.60, 0.70)]
    assert min(gaps_mm) <= model.labiodental_gap_mm


def test_a_labial_told_late_still_closes_the_lips():
    model = load_trained_model()
    synthesizer = LiveSynthesizer(model, model.expectation, Style(0.0))
    believed = (PhonemeEvent("SIL", 0.0, 0.4), PhonemeEvent("AA", 0.4, None))
    synthesizer.push(PhonemeUpdate(0.0, 0.65, 0.4, believed))
    faces(synthesizer, 0.0, 0.65)
    corrected = (PhonemeEvent("AA", 0.4, 0.6), PhonemeEvent("B", 0.6, None))
    synthesizer.push(PhonemeUpdate(0.4, 0.65, 0.6, corrected))
    assert min(model.lip_gap_mm(c) for c in faces(synthesizer, 0.65, 0.72)) <= 1.0


def test_a_long_pause_ends_in_the_closed_mouth():
    model = load_trained_model()
    synthesizer = LiveSynthesizer(model, model.expectation)
    known(synthesizer, ("SIL", 0.4), ("AA", 0.2), ("SIL", 2.0))
    np.testing.assert_allclose(synthesizer.frame_at(1.5).coefficients, model.rest, atol=1e-6)


def test_the_mouth_leaves_rest_and_returns_to_it_over_several_ticks():
    model = load_trained_model()
    synthesizer = LiveSynthesizer(model, model.expectation, Style(0.1))
    known(synthesizer, ("SIL", 0.6), ("AA", 0.2), ("SIL", 2.0))
    for start_s, end_s in ((0.4, 0.6), (1.05, 1.5)):
        moved = faces(synthesizer, start_s, end_s, TICK_S)
        way = np.linalg.norm(moved[-1] - moved[0])
        steps = np.linalg.norm(np.diff(moved, axis=0), axis=1)
        assert way > 1.0
        assert steps.max() < 0.4 * way
    np.testing.assert_allclose(synthesizer.frame_at(0.5).coefficients, model.rest)


def test_without_look_ahead_the_mouth_leaves_rest_at_the_onset_and_no_tick_later():
    model = load_trained_model()
    synthesizer = LiveSynthesizer(model, model.expectation, Style(0.0))
    known(synthesizer, ("SIL", 0.6), ("AA", 0.3))
    faces(synthesizer, 0.0, 0.59, TICK_S)
    np.testing.assert_allclose(synthesizer.frame_at(0.59).coefficients, model.rest)
    assert np.linalg.norm(synthesizer.frame_at(0.6).coefficients - model.rest) > 1.0


def test_strength_zero_keeps_the_mouth_at_rest_and_one_and_a_half_opens_it_further():
    model = load_trained_model()
    gaps_mm = []
    for strength in (0.0, 1.0, 1.5):
        synthesizer = LiveSynthesizer(model, model.expectation, Style(0.1, strength))
        known(synthesizer, ("SIL", 0.4), ("AA", 0.3), ("SIL", 0.4))
        gaps_mm.append(max(model.lip_gap_mm(c) for c in faces(synthesizer, 0.4, 0.7)))
    assert gaps_mm[0] == pytest.approx(model.lip_gap_mm(model.rest))
    assert gaps_mm[2] > 1.2 * gaps_mm[1]


def test_smoothness_takes_acceleration_away():
    def acceleration(smoothness: float) -> float:
        synthesizer = shipped(Style(0.1, 1.0, smoothness))
        known(synthesizer, ("SIL", 0.4), ("AA", 0.1), ("T", 0.1), ("UW", 0.1), ("AA", 0.3))
        return float((np.diff(faces(synthesizer, 0.3, 0.9, 0.01), n=2, axis=0) ** 2).sum())

    assert acceleration(1.0) < acceleration(0.5) < acceleration(0.0)


def test_the_same_time_gives_the_same_face_also_after_a_revision():
    synthesizer = shipped()
    known(synthesizer, ("SIL", 0.4), ("AA", 0.2), ("UW", 0.2))
    shown = faces(synthesizer, 0.45, 0.70, 0.013)
    synthesizer.push(PhonemeUpdate(0.0, 0.8, 0.8, spoken(("SIL", 0.4), ("M", 0.4))))
    np.testing.assert_array_equal(shown, faces(synthesizer, 0.45, 0.70, 0.013))


@settings(max_examples=40, deadline=None)
@given(
    wrong=st.sampled_from([p for p in PHONEMES if p != "SIL"]),
    duration_s=st.floats(0.03, 0.3),
    ahead_s=st.sampled_from([0.0, 0.1, 0.2]),
)
def test_a_wrong_phoneme_put_right_leaves_nothing_after_an_eighth_of_a_second(
    wrong, duration_s, ahead_s
):
    """The context is right at once; what remains is to part lips that were closed for nothing."""
    before, after = [("SIL", 0.4), ("AA", 0.12), ("T", 0.1)], [("IY", 0.12), ("UW", 0.4)]
    model = load_trained_model()
    mistaken, untouched = (LiveSynthesizer(model, model.expectation, Style(ahead_s)) for _ in "ab")
    phones = [*before, ("EH", duration_s), *after]
    known(untouched, *phones)
    mistaken.push(PhonemeUpdate(0.0, 0.715, 0.6, spoken(*before, (wrong, duration_s), *after)))
    until_s = 0.715 - ahead_s
    faces(mistaken, 0.0, until_s, TICK_S)
    faces(untouched, 0.0, until_s, TICK_S)
    mistaken.push(PhonemeUpdate(0.6, 0.715, 0.715, spoken(*phones)))
    later_s = until_s + 0.125
    np.testing.assert_allclose(
        faces(mistaken, later_s, 1.2, TICK_S), faces(untouched, later_s, 1.2, TICK_S), atol=1e-9
    )


def test_reset_forgets_everything():
    model = load_trained_model()
    used, fresh = (
        LiveSynthesizer(model, model.expectation),
        LiveSynthesizer(model, model.expectation),
    )
    known(used, ("AA", 0.5))
    used.frame_at(0.4)
    used.reset()
    for synthesizer in (used, fresh):
        known(synthesizer, ("SIL", 0.3), ("UW", 0.3))
    np.testing.assert_array_equal(faces(used, 0.0, 0.6), faces(fresh, 0.0, 0.6))


@pytest.mark.parametrize(
    ("name", "value"), [("strength", 1.6), ("smoothness", -0.1), ("lookahead_s", math.nan)]
)
def test_a_style_out_of_range_says_what_is_allowed(name, value):
    with pytest.raises(StyleError, match=f"{name} is .*; allowed: 0 to"):
        Style(**{name: value})


def test_told_one_by_one_or_all_at_once_gives_the_same_faces():
    """What lies beyond the look-ahead is not used even where it is known."""
    events = spoken(("SIL", 0.4), ("B", 0.07), ("AA", 0.2), ("F", 0.1), ("IY", 0.2), ("SIL", 0.3))
    at_once, one_by_one = (shipped(Style(0.1)) for _ in "ab")
    at_once.push(PhonemeUpdate(0.0, math.inf, math.inf, events))
    source = ScriptedPhonemes(events, 0.1)
    for tick in range(120):
        for update in source.updates(tick * TICK_S + 1e-6):
            one_by_one.push(update)
        np.testing.assert_allclose(
            one_by_one.frame_at(tick * TICK_S).coefficients,
            at_once.frame_at(tick * TICK_S).coefficients,
        )


@settings(max_examples=30, deadline=None)
@given(update_streams(), st.floats(0.0, 0.3), st.floats(0.0, 1.5), st.floats(0.0, 1.0))
def test_position_and_speed_are_continuous_whatever_arrives(updates, ahead_s, strength, smoothness):
    """Within a tick the face follows a smooth curve, and neighbours meet in place and speed."""
    synthesizer = LiveSynthesizer(
        small_model(), small_model().expectation, Style(ahead_s, strength, smoothness)
    )
    tick, step_s = 0, 1e-7
    for update in updates:
        synthesizer.push(update)
        while tick * TICK_S < update.heard_until_s - ahead_s:
            synthesizer.frame_at(tick * TICK_S)
            if tick > 1:
                joint_s = (tick - 1) * TICK_S
                a, b, c, d = (
                    synthesizer.frame_at(joint_s + k * step_s).coefficients for k in (-2, -1, 1, 2)
                )
                before, after = (b - a) / step_s, (d - c) / step_s
                # 60 mm in a tick is more than the small model's range: 6000 mm/s.
                assert np.abs(c - b).max() <= 6000.0 * 1.5 * 3 * step_s
                assert np.abs(after - before).max() <= 5.0
            tick += 1
