import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lipsync.phonemes import PhonemeEvent, PhonemeUpdate
from lipsync.timeline import PhonemeTimeline


def update(replace_from_s, heard_until_s, final_until_s, *events):
    return PhonemeUpdate(
        replace_from_s, heard_until_s, final_until_s, tuple(PhonemeEvent(*e) for e in events)
    )


def told_after(*updates):
    timeline = PhonemeTimeline()
    for each in updates:
        timeline.apply(each)
    return [(e.phoneme, e.start_s, e.end_s) for e in timeline.events]


def test_a_later_belief_replaces_the_earlier_one_from_its_border_on():
    assert told_after(
        update(0.0, 0.4, 0.0, ("P", 0.0, 0.2), ("AA", 0.2, 0.3), ("T", 0.3, None)),
        update(0.2, 0.5, 0.3, ("OW", 0.2, None)),
    ) == [("P", 0.0, 0.2), ("OW", 0.2, None)]


def test_an_event_that_goes_on_across_the_border_stays_one_event():
    assert told_after(
        update(0.0, 0.5, 0.3, ("AA", 0.1, None)),
        update(0.3, 0.9, 0.7, ("AA", 0.2, 0.8), ("T", 0.8, None)),
    ) == [("AA", 0.1, 0.8), ("T", 0.8, None)]


def test_the_same_phoneme_begun_anew_is_a_second_event():
    assert told_after(
        update(0.0, 0.3, 0.3, ("S", 0.1, 0.3)), update(0.3, 0.5, 0.5, ("S", 0.3, None))
    ) == [("S", 0.1, 0.3), ("S", 0.3, None)]


def test_the_event_at_a_time_and_those_after_it():
    timeline = PhonemeTimeline()
    timeline.apply(update(0.0, 1.0, 1.0, ("M", 0.1, 0.2), ("AA", 0.3, 0.4), ("P", 0.4, None)))

    names = [(e.phoneme if e else None) for e in map(timeline.event_at, (0, 0.1, 0.2, 0.3, 0.4, 9))]
    assert names == [None, "M", None, "AA", "P", "P"]
    assert [e.phoneme for e in timeline.events_after(0.1)] == ["AA", "P"]


def test_what_was_forgotten_does_not_come_back():
    timeline = PhonemeTimeline()
    timeline.apply(update(0.0, 1.0, 0.0, ("M", 0.1, 0.2), ("AA", 0.2, 0.6), ("P", 0.6, None)))
    timeline.forget_before(0.4)
    timeline.apply(update(0.0, 1.1, 0.0, ("B", 0.0, 0.3), ("UW", 0.3, None)))

    told = [(e.phoneme, e.start_s, e.end_s) for e in timeline.events]
    assert told == [("AA", 0.2, 0.4), ("UW", 0.4, None)]


@pytest.mark.parametrize(
    ("events", "said"),
    [
        ([("P", 0.2, 0.3), ("AA", 0.1, 0.2)], "begins before"),
        ([("P", 0.1, 0.3), ("AA", 0.2, 0.4)], "begins before"),
        ([("P", 0.1, None), ("AA", 0.2, 0.4)], "begins before"),
        ([("P", 0.3, 0.2)], "ends before it begins"),
    ],
)
def test_an_update_out_of_order_is_refused(events, said):
    with pytest.raises(ValueError, match=said):
        told_after(update(0.0, 1.0, 0.0, *events))


@st.composite
def streams(draw):
    """Updates of a source that keeps no promise except that its own events are in order."""
    stream, heard = [], 0
    for _ in range(draw(st.integers(1, 25))):
        heard += draw(st.integers(0, 30))
        start = replace_from = draw(st.integers(0, heard))
        events = []
        for length in draw(st.lists(st.integers(1, 20), max_size=6)):
            start += draw(st.integers(0, 3))
            phoneme = draw(st.sampled_from(["SIL", "P", "AA"]))
            events.append(PhonemeEvent(phoneme, start / 100, (start + length) / 100))
            start += length
        if events and draw(st.booleans()):
            events[-1] = PhonemeEvent(events[-1].phoneme, events[-1].start_s, None)
        final = draw(st.integers(0, heard))
        stream.append(PhonemeUpdate(replace_from / 100, heard / 100, final / 100, tuple(events)))
    return stream


def phoneme_at(timeline, frame):
    event = timeline.event_at((frame + 0.5) / 100)
    return event.phoneme if event else None


@given(streams())
def test_any_stream_leaves_events_in_order_bounded_and_final_ones_as_they_were(stream):
    timeline, final = PhonemeTimeline(horizon_s=0.5), {}
    for each in stream:
        timeline.apply(each)
        events = timeline.events

        assert all(e.end_s is not None and e.start_s < e.end_s for e in events[:-1])
        assert all(a.end_s <= b.start_s for a, b in itertools.pairwise(events))
        oldest = round(max(0.0, each.heard_until_s - 0.5) * 100)
        assert all((e.end_s or 1e9) > oldest / 100 - 1e-9 for e in events)
        for frame in range(oldest, round(timeline.final_until_s * 100)):
            phoneme = phoneme_at(timeline, frame)
            assert final.setdefault(frame, phoneme) == phoneme
