"""What is said beside a sound: ordered, bounded, and corrected from where a correction begins."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lipsync.phonemes import PhonemeEvent
from lipsync.spoken_text import (
    LONGEST_LABEL,
    LONGEST_TEXT,
    MOST_CHARACTERS,
    MOST_UNITS,
    SpokenText,
    SpokenTextError,
    SpokenUnit,
)

RATE_HZ = 16_000


def words(*units):
    return SpokenText("word", tuple(SpokenUnit(*unit) for unit in units), RATE_HZ)


def text(label, *place):
    return SpokenText("text", (SpokenUnit(label, *place),), RATE_HZ)


def test_a_correction_replaces_what_was_said_from_its_first_sample_on():
    first = words(("recognise", 0, 8_000), ("speech", 8_000, 16_000), ("please", 16_000, 20_000))
    later = words(("wreck", 0, 3_000), ("a", 3_000, 4_000), ("nice", 4_000, 8_000))

    assert [u.label for u in first.revised(later).units] == ["wreck", "a", "nice"]
    tail = words(("beach", 8_000, 14_000))
    assert [u.label for u in first.revised(tail).units] == ["recognise", "beach"]


def test_units_without_times_follow_those_that_are_there():
    revised = words(("good", 0, 10)).revised(words(("day",)))
    assert [u.label for u in revised.units] == ["good", "day"]


def test_phonemes_with_times_are_events_in_seconds():
    units = SpokenUnit("HH", 0, 1_600), SpokenUnit("AY", 1_600, 8_000)
    said = SpokenText("phoneme", units, RATE_HZ)

    assert said.events() == (PhonemeEvent("HH", 0.0, 0.1), PhonemeEvent("AY", 0.1, 0.5))


def test_visemes_that_only_begin_last_until_the_next_and_the_last_a_while():
    units = SpokenUnit("M", 1_600), SpokenUnit("AA", 3_200), SpokenUnit("SIL", 4_800)
    events = SpokenText("viseme", units, RATE_HZ).events()

    told = [(event.phoneme, event.start_s, event.end_s) for event in events]
    assert told == [("M", 0.1, 0.2), ("AA", 0.2, 0.3), ("SIL", 0.3, 0.6)]


def test_a_text_without_times_is_corrected_from_the_first_sample_on():
    again = text("Recognise speech.", 0)

    assert text("Wreck a nice beach.").revised(again).units == again.units


def test_of_more_text_than_an_hour_has_the_newest_is_kept():
    said = page = text("x" * LONGEST_TEXT)
    for _ in range(9):
        said = said.revised(page)

    assert len(said.units) == MOST_CHARACTERS // LONGEST_TEXT


def test_text_that_goes_on_corrects_nothing_however_long_it_was():
    said = text("x" * LONGEST_TEXT, 0)
    for n in range(1, 9):
        later = text("x" * LONGEST_TEXT, 100 * n)
        assert not said.is_corrected_by(later)
        said = said.revised(later)

    assert said.is_corrected_by(text("y", 750))


def test_visemes_at_a_thousand_a_second_are_a_hundred():
    units = [SpokenUnit(("M", "AA")[n % 2], 16 * n, 16 * n + 16) for n in range(1_000)]
    said = SpokenText("viseme", tuple(units), RATE_HZ)
    events = said.events()
    assert len(events) == 100
    assert all(e.end_s == pytest.approx(e.start_s + 0.01) for e in events)
    assert said.events(8_000, 9_599) == events[50:60]


@pytest.mark.parametrize(
    ("kind", "units", "says"),
    [
        ("phoneme", (SpokenUnit("Q", 0, 1),), "'Q' is not an ARPAbet phoneme"),
        ("word", (SpokenUnit("", 0, 1),), "word 0 has 0 characters"),
        ("word", (SpokenUnit("x" * (LONGEST_LABEL + 1)),), "word 0 has 101 characters"),
        ("text", (SpokenUnit("x" * 1_000_000),), "text 0 has 1000000 characters; 1 to 20000"),
        ("text", (SpokenUnit("x" * LONGEST_TEXT),) * 6, "at most 100000"),
        ("word", (SpokenUnit("a", 5, 9), SpokenUnit("b", 8, 12)), "word 1: sample 8 is before 9"),
        ("word", (SpokenUnit("a", 5, 4),), "word 0: sample 4 is before 5"),
        ("word", (SpokenUnit("a", -1, 4),), "word 0: sample -1 is before 0"),
        ("word", (SpokenUnit("a"),) * (MOST_UNITS + 1), "at most"),
    ],
)
def test_what_cannot_be_said_is_refused_with_its_place(kind, units, says):
    with pytest.raises(SpokenTextError, match=says):
        SpokenText(kind, units, RATE_HZ)


def test_words_move_no_mouth_by_themselves():
    with pytest.raises(SpokenTextError, match="need times"):
        words(("hello", 0, 10)).events()
    with pytest.raises(SpokenTextError, match="cannot continue"):
        words(("hello", 0, 10)).revised(text("hello"))


SPANS = st.lists(st.integers(0, 1_000), max_size=30).map(sorted)


@given(SPANS, SPANS)
def test_whatever_revises_whatever_the_result_is_in_order(first, later):
    def units(samples):
        pairs = zip(samples[::2], samples[1::2], strict=False)
        return words(*(("a", start, end) for start, end in pairs))

    revised = units(first).revised(units(later))

    n_later = len(units(later).units)
    assert revised.units[len(revised.units) - n_later :] == units(later).units
