"""Stored units and equation (1)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lipsync.offline.line_synthesis import joined_phones, unit_spans, warped_distances
from lipsync.phonemes import PhonemeEvent

#: Three phones of 80, 160 and 160 ms in ten frames of 40 ms: centres at 40, 160 and 320 ms.
PHONES = (
    PhonemeEvent("B", 0.0, 0.08),
    PhonemeEvent("AA", 0.08, 0.24),
    PhonemeEvent("T", 0.24, 0.40),
)


def test_a_unit_runs_from_the_centre_before_to_the_centre_after():
    spans = unit_spans(PHONES, 10, 25.0)

    assert spans.phonemes == ("B", "AA", "T")
    assert list(zip(spans.first, spans.end, strict=True)) == [(0, 4), (1, 8), (4, 10)]


def test_every_frame_lies_in_the_units_of_the_phones_whose_centres_are_around_it():
    left, right = unit_spans(PHONES, 10, 25.0).neighbours(10, 25.0)

    assert left.tolist() == [0, 0, 0, 0, 1, 1, 1, 1, 2, 2]
    assert right.tolist() == [0, 1, 1, 1, 2, 2, 2, 2, 2, 2]


@given(st.lists(st.integers(1, 40), min_size=1, max_size=12), st.integers(1, 60))
def test_every_frame_lies_in_both_its_units_and_no_unit_is_empty(durations, n_frames):
    ends = np.cumsum(durations) / sum(durations) * n_frames / 25.0
    starts = [0.0, *ends[:-1]]
    phones = [PhonemeEvent("AA", float(a), float(b)) for a, b in zip(starts, ends, strict=True)]
    spans = unit_spans(phones, n_frames, 25.0)

    assert (spans.first < spans.end).all()
    for units in spans.neighbours(n_frames, 25.0):
        frames = np.arange(n_frames)
        assert (spans.first[units] <= frames).all()
        assert (frames < spans.end[units]).all()


@given(st.integers(0, 2**32 - 1))
def test_warping_is_the_recursion_of_equation_1(seed):
    rng = np.random.default_rng(seed)
    target = rng.normal(size=(rng.integers(1, 6), 3))
    stored = rng.normal(size=(rng.integers(1, 6), 3))
    d = np.linalg.norm(target[:, None] - stored, axis=2)
    cost = np.full((len(target) + 1, len(stored) + 1), np.inf)
    cost[0, 0] = 0.0
    for i in range(1, len(target) + 1):
        for j in range(1, len(stored) + 1):
            before = min(cost[i - 1, j], cost[i - 1, j - 1], cost[i, j - 1])
            cost[i, j] = d[i - 1, j - 1] + before

    found = warped_distances(target, [stored, target])
    assert found == pytest.approx([cost[-1, -1], 0.0])


def spans(events):
    return [(event.phoneme, event.start_s, event.end_s) for event in events]


def test_gaps_and_ends_of_a_line_are_silence_and_what_goes_on_beyond_the_sound_is_cut():
    events = (PhonemeEvent("B", 0.2, 0.3), PhonemeEvent("AA", 0.4, None))
    joined = [("SIL", 0.0, 0.2), ("B", 0.2, 0.3), ("SIL", 0.3, 0.4), ("AA", 0.4, 1.0)]
    assert spans(joined_phones(events, 1.0)) == joined

    events = (PhonemeEvent("B", 0.0, 0.3), PhonemeEvent("SIL", 0.3, 0.6), PhonemeEvent("T", 2, 3))
    assert spans(joined_phones(events, 1.0)) == [("B", 0.0, 0.3), ("SIL", 0.3, 1.0)]
