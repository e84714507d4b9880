"""When closures of the lips are planned."""

import pytest
from spoken_phonemes import spoken

from lipsync.expectation.expectation import track_of
from lipsync.motion.finishing import OPEN, closures, plan_closure
from lipsync.phonemes import PHONEMES, PhonemeEvent

MOMENTS = {PHONEMES.index("M"): 0.03, PHONEMES.index("P"): 0.03}
TICK_S = 0.01


def amounts(events, lookahead_s: float, until_s: float) -> dict[float, float]:
    """Return how far lips are closed, 0 to 1, by the time in s of each tick of 10 ms."""
    track, now, shares = track_of(events), OPEN, {}
    for tick in range(round(until_s / TICK_S)):
        time_s = tick * TICK_S
        now = plan_closure(now, MOMENTS, track, time_s, time_s + lookahead_s)
        shares[round(time_s, 3)] = now.share(time_s)
    return shares


def test_lips_are_shut_at_the_tightest_moment_and_open_again_after_the_phone():
    found = amounts(spoken(("AA", 0.5), ("M", 0.08), ("AA", 0.5)), 0.1, 1.0)
    assert found[0.53] == 1.0
    assert found[0.45] == 0.0
    assert found[0.62] == 0.0


def test_a_short_f_closes_in_its_middle_but_after_a_vowel_at_its_recorded_moment():
    """As in the recordings: the V of `v` is tightest early, that of `five` at its end."""
    moments = {PHONEMES.index("V"): 0.06}
    for before, moment_s in (("AA", 0.56), ("S", 0.53)):
        track = track_of(spoken((before, 0.5), ("V", 0.06), ("IY", 0.5)))
        (from_s, until_s), *_ = closures(0.5, moments, track, 0.5, 1.0)
        assert (from_s + until_s) / 2.0 == pytest.approx(moment_s)


def test_without_look_ahead_they_shut_as_soon_as_the_phone_is_heard():
    found = amounts(spoken(("AA", 0.5), ("M", 0.08), ("AA", 0.5)), 0.0, 1.0)
    assert found[0.50] == 0.0
    assert max(found[round(0.5 + k * TICK_S, 3)] for k in range(8)) == 1.0


def test_a_closure_once_begun_is_completed_even_when_the_phone_is_over():
    found = amounts(spoken(("AA", 0.5), ("M", 0.02), ("AA", 0.5)), 0.0, 1.0)
    assert max(found.values()) == 1.0


def test_the_second_of_two_labials_is_not_held_to_its_end_as_if_told_late():
    found = amounts(spoken(("AA", 0.5), ("M", 0.05), ("P", 0.2), ("AA", 0.5)), 0.1, 1.0)
    assert found[0.58] == 1.0  # its own tightest moment
    assert found[0.70] == 0.0


def test_lips_stay_shut_as_long_as_an_m_sounds():
    found = amounts(spoken(("AA", 0.5), ("M", 0.3), ("AA", 0.5)), 0.1, 1.0)
    shut_s = [time_s for time_s, amount in found.items() if amount == 1.0]
    assert (min(shut_s), max(shut_s)) == (0.52, 0.77)
    assert len(shut_s) == 26  # without a gap
    assert found[0.45] == 0.0
    assert found[0.84] == 0.0


def test_an_m_whose_end_nobody_knows_is_held_as_far_as_it_is_known_to_go_on():
    going_on = [*spoken(("AA", 0.5)), PhonemeEvent("M", 0.5, None)]
    assert amounts(going_on, 0.1, 2.0)[1.99] == 1.0
    assert amounts(going_on, 0.0, 2.0)[1.99] == 0.0


def test_without_a_labial_nothing_closes():
    assert not any(amounts(spoken(("AA", 0.5), ("F", 0.2), ("AA", 0.5)), 0.1, 1.0).values())
