"""How long a phone is taken to last, and which AnimPhos stand for it."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from spoken_phonemes import spoken

from lipsync.expectation.expectation import context_at, track_of
from lipsync.motion.unit_motion import LONGER_S, LONGEST_S, PhoneSpan, guessed_s, span_at
from lipsync.phonemes import PHONEMES, stand_in

ALL = frozenset(PHONEMES)


def span(events, time_s: float, known_s: float, known=ALL) -> PhoneSpan:
    return span_at(context_at(track_of(events), time_s, time_s + known_s), time_s, known_s, known)


def test_an_end_within_the_look_ahead_is_the_phones_own_and_a_later_one_a_guess():
    events = spoken(("SIL", 0.4), ("AA", 0.2), ("T", 0.1))
    assert span(events, 0.5, 0.1) == PhoneSpan(
        "AA", *(pytest.approx(t) for t in (0.4, 0.4, 0.6)), True
    )
    assert span(events, 0.41, 0.0).end_s == pytest.approx(0.4 + 0.13), "as long as AA usually is"
    late = span(events, 0.48, 0.1)
    assert (late.end_s, late.is_known) == (pytest.approx(0.48 + 0.1 + LONGER_S), False)


@pytest.mark.parametrize(("each_s", "pace"), [(0.05, 0.5**0.5), (0.1, 1.0), (0.4, 2.0**0.5)])
def test_an_end_is_guessed_by_the_phoneme_and_by_how_fast_the_speaker_goes(each_s, pace):
    """G and P usually take 100 ms, AA 130; of the pace half is believed, to twice as slow."""
    events = spoken(("SIL", 0.4), ("G", each_s), ("P", each_s), ("AA", 0.3))
    time_s = 0.4 + 2 * each_s + 0.01
    assert guessed_s(*context_at(track_of(events), time_s, time_s)) == pytest.approx(0.13 * pace)


def test_a_phone_that_is_not_known_is_played_by_its_stand_ins_one_after_the_other():
    events = spoken(("SIL", 0.4), ("OY", 0.2), ("T", 0.1))
    known = ALL - {"OY"}
    assert stand_in("OY", known) == ("AO", "IY")
    first, second = (span(events, time_s, 0.2, known) for time_s in (0.45, 0.55))
    assert (first.phoneme, first.end_s) == ("AO", pytest.approx(0.5))
    assert (second.phoneme, second.start_s, second.end_s) == (
        "IY", pytest.approx(0.5), pytest.approx(0.6),
    )  # fmt: skip
    assert first.onset_s == second.onset_s == pytest.approx(0.4)


def test_a_long_silence_is_a_pause_until_its_end_is_known_and_then_an_animpho_fills_the_end_of_it():
    events = spoken(("AA", 0.3), ("SIL", 1.0), ("AA", 0.3))
    assert span(events, 0.35, 0.1).phoneme == "SIL"
    assert span(events, 1.0, 0.1).phoneme is None
    leaving = span(events, 1.25, 0.1)
    assert (leaving.phoneme, leaving.start_s) == ("SIL", pytest.approx(1.3 - LONGEST_S))
    assert span(events, 1.25, 0.1, ALL - {"SIL"}).phoneme is None, "no AnimPho of silence"
    assert span((), 0.5, 0.1) == PhoneSpan(None, -math.inf, -math.inf, math.inf, False)


@given(st.floats(0.03, 0.6), st.sampled_from([0.0, 0.05, 0.1, 0.2]))
def test_parts_never_go_back_however_late_the_end_becomes_known(duration_s, known_s):
    events = spoken(("SIL", 0.4), ("OY", duration_s), ("SIL", 1.0))
    times_s = [0.4 + 0.01 * n for n in range(int(duration_s / 0.01))]
    spans = [span(events, t, known_s, ALL - {"OY"}) for t in times_s]
    numbers = [["AO", "IY"].index(s.phoneme) for s in spans]
    assert numbers == sorted(numbers)
    assert all(s.end_s > t - 1e-9 for s, t in zip(spans, times_s, strict=True))
