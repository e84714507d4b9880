"""AnimPhos near the expectation as their callers see them: in time, continuous, joined."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lipservo_lab.learning.motion.trained_model import load_trained_model
from small_model import small_model
from spoken_phonemes import spoken, update_streams

from lipsync.animpho.selection import MOVED_SHARE, GuidedSelection
from lipsync.animpho.units import AnimPhoUnits, IndexLists
from lipsync.expectation.expectation import track_of
from lipsync.motion.finishing import Style
from lipsync.motion.live_synthesizer import LiveSynthesizer
from lipsync.motion.tick_plan import TICK_S
from lipsync.motion.unit_motion import UnitMotion
from lipsync.phonemes import PHONEMES, PhonemeUpdate
from lipsync.recognition.scripted import ScriptedPhonemes

MODEL = load_trained_model()
SMALL = small_model()
SELECTION = GuidedSelection(MODEL.animphos)
#: With a phone that GRID never says (ZH), and one that two others stand in for (OY).
SENTENCE = spoken(
    ("SIL", 0.3), ("B", 0.07), ("OY", 0.2), ("T", 0.05), ("ZH", 0.1), ("AE", 0.3), ("SIL", 0.4)
)


def shipped(lookahead_s: float, unit_share: float) -> LiveSynthesizer:
    style = Style(lookahead_s, unit_share=unit_share)
    return LiveSynthesizer(MODEL, MODEL.expectation, style, SELECTION)


def whole(events) -> PhonemeUpdate:
    return PhonemeUpdate(0.0, math.inf, math.inf, events)


def faces(synthesizer, start_s: float, end_s: float, step_s: float = TICK_S) -> np.ndarray:
    times_s = np.arange(round((end_s - start_s) / step_s)) * step_s + start_s
    return np.array([synthesizer.frame_at(float(t)).coefficients for t in times_s])


@pytest.mark.parametrize("lookahead_s", [0.0, 0.05, 0.1, 0.2])
def test_what_is_said_after_the_look_ahead_makes_no_difference(lookahead_s):
    same = (("SIL", 0.3), ("B", 0.07), ("OY", 0.18), ("IY", 0.05))
    a, b = (shipped(lookahead_s, 1.0) for _ in "ab")
    a.push(whole(spoken(*same, ("M", 0.1), ("AA", 0.3))))
    b.push(whole(spoken(*same, ("UW", 0.25), ("T", 0.3))))
    until_s = 0.60 - lookahead_s - TICK_S
    np.testing.assert_array_equal(faces(a, 0.0, until_s), faces(b, 0.0, until_s))
    assert not np.array_equal(a.frame_at(0.65).coefficients, b.frame_at(0.65).coefficients)


def test_told_one_by_one_or_all_at_once_gives_the_same_faces():
    at_once, one_by_one = (shipped(0.1, 1.0) for _ in "ab")
    at_once.push(whole(SENTENCE))
    source = ScriptedPhonemes(SENTENCE, 0.1)
    for tick in range(140):
        for update in source.updates(tick * TICK_S + 1e-6):
            one_by_one.push(update)
        np.testing.assert_allclose(
            one_by_one.frame_at(tick * TICK_S).coefficients,
            at_once.frame_at(tick * TICK_S).coefficients,
        )


@pytest.mark.parametrize("lookahead_s", [0.0, 0.1])
def test_a_share_of_nothing_is_the_expectation_exactly(lookahead_s):
    without = LiveSynthesizer(MODEL, MODEL.expectation, Style(lookahead_s))
    mixed = shipped(lookahead_s, 0.0)
    for synthesizer in (without, mixed):
        synthesizer.push(whole(SENTENCE))
    np.testing.assert_array_equal(faces(mixed, 0.0, 1.4, 0.007), faces(without, 0.0, 1.4, 0.007))


def constant(times_s: np.ndarray, _known_until_s: float) -> np.ndarray:
    """The same face is expected at all times."""
    return np.tile(SMALL.rest + 3.0, (len(times_s), 1))


def test_between_a_known_onset_and_end_the_mouth_becomes_the_animpho_moved_towards_it():
    motion = UnitMotion(GuidedSelection(SMALL.animphos), constant, 0.2)
    track = track_of(spoken(("SIL", 0.4), ("AA", 0.12), ("UW", 0.04), ("AA", 0.3)))
    shown = np.array([motion.at(n * TICK_S, track) for n in range(16)])
    for n in range(16, 56):
        motion.at(n * TICK_S, track)
    samples = SMALL.animphos.samples[SMALL.animphos.of_phoneme("UW")]
    # The tick in which UW begins belongs to it: its 0.04 s are played from 0.51 on.
    moved = MOVED_SHARE * (SMALL.rest + 3.0 - samples.mean(axis=1))
    away = motion.at(0.55, track) - (samples[:, -1] + moved - (SMALL.rest + 3.0))
    assert np.abs(away).max(axis=1).min() < 1e-9
    assert np.abs(shown).max() < 1e-9


def test_an_animpho_that_is_what_is_expected_changes_nothing():
    """What planning costs: nothing, however late ends become known."""
    still = replace(
        one_animpho(), samples=np.tile(SMALL.rest + 3.0, (*one_animpho().samples.shape[:2], 1))
    )
    motion = UnitMotion(GuidedSelection(still), constant, 0.05)
    track = track_of(SENTENCE)
    away = [motion.at(n * TICK_S, track) for n in range(140)]
    np.testing.assert_allclose(away, 0.0, atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(update_streams(), st.floats(0.0, 0.3), st.floats(0.0, 1.0))
def test_position_and_speed_are_continuous_whatever_arrives(updates, ahead_s, unit_share):
    """Of any phones, most of which the small model has never heard."""
    style = Style(ahead_s, unit_share=unit_share)
    synthesizer = LiveSynthesizer(SMALL, SMALL.expectation, style, GuidedSelection(SMALL.animphos))
    tick, step_s = 0, 1e-7
    for update in updates:
        synthesizer.push(update)
        while tick * TICK_S < update.heard_until_s - ahead_s:
            shown = synthesizer.frame_at(tick * TICK_S).coefficients
            assert np.abs(shown).max() < 500.0
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


def one_animpho() -> AnimPhoUnits:
    """Return a single AnimPho (recorded piece of motion), of AA, which nothing follows."""
    nothing = IndexLists.from_pairs(np.empty(0, int), np.empty(0, int), 1)
    aa = np.array([PHONEMES.index("AA")])
    return replace(
        SMALL.animphos,
        samples=SMALL.animphos.samples[SMALL.animphos.of_phoneme("AA")[:1]],
        successors=nothing,
        predecessors=nothing,
        phoneme_table=IndexLists.from_pairs(aa, np.array([0]), len(PHONEMES)),
    )


def test_a_model_of_one_animpho_speaks_all_phones_and_rests_in_silence():
    style = Style(0.1, unit_share=1.0)
    synthesizer = LiveSynthesizer(SMALL, SMALL.expectation, style, GuidedSelection(one_animpho()))
    synthesizer.push(whole(spoken(*((p, 0.08) for p in PHONEMES), ("SIL", 1.0))))
    shown = faces(synthesizer, 0.0, 4.2)
    assert np.isfinite(shown).all()
    assert np.abs(shown[:320] - SMALL.rest).max() > 10.0
    np.testing.assert_allclose(shown[-1], SMALL.rest, atol=1e-6)


def test_the_same_time_gives_the_same_face_also_after_a_revision_and_reset_forgets_everything():
    synthesizer = shipped(0.1, 0.5)
    synthesizer.push(whole(SENTENCE))
    shown = faces(synthesizer, 0.0, 0.7, 0.013)
    synthesizer.push(whole(spoken(("SIL", 0.4), ("M", 0.4))))
    again = faces(synthesizer, 0.39, 0.7, 0.013)[: len(shown) - 30]
    np.testing.assert_allclose(again, shown[30:], atol=1e-6)
    synthesizer.reset()
    synthesizer.push(whole(SENTENCE))
    np.testing.assert_array_equal(faces(synthesizer, 0.0, 0.7, 0.013), shown)


def test_the_share_may_change_while_the_mouth_moves():
    changed, units, without = (shipped(0.1, share) for share in (0.0, 1.0, 0.0))
    for synthesizer in (changed, units, without):
        synthesizer.push(whole(SENTENCE))
    before = faces(changed, 0.0, 0.5)
    changed.adjust("unit_share", 1.0)
    after = faces(changed, 0.5, 1.0)
    np.testing.assert_array_equal(before, faces(without, 0.0, 0.5))
    expected = faces(units, 0.0, 1.0)
    np.testing.assert_allclose(after[32:], expected[82:], atol=1e-6)
    steps = np.linalg.norm(np.diff(np.concatenate([before, after]), axis=0), axis=1)
    assert steps[49] < 1.5 * np.linalg.norm(np.diff(expected, axis=0), axis=1).max()
