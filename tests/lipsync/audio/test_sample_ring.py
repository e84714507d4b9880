"""What is written comes out once and in order, however the two sides take turns."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from lipsync.audio.loudspeaker import FADE_S, RING_S, SampleRing

RATE_HZ = 8_000
BLOCK = RATE_HZ // 100


def taken(ring, n):
    frames = np.full((n, 1), np.nan, dtype=np.float32)
    return frames, ring.take_into(frames)


def numbers(first, n):
    """Samples that are their own places on the timeline, from 1."""
    return np.arange(first + 1, first + n + 1, dtype=np.float32)


turns = st.lists(st.tuples(st.integers(0, 700), st.integers(1, 700)), max_size=60)


@given(turns)
def test_every_sample_comes_out_once_and_zeros_in_between_move_no_time(turns):
    ring = SampleRing(RATE_HZ)
    out = []
    for n_written, n_wanted in turns:
        room = round(RING_S * RATE_HZ) - (ring.n_written - ring.n_taken)
        ring.write(numbers(ring.n_written, min(n_written, room)))
        before = ring.n_taken
        frames, n = taken(ring, n_wanted)
        assert ring.n_taken == before + n
        assert not np.any(frames[n:])
        out.append(frames[:n, 0])
    heard = np.concatenate([*out, np.zeros(0)])
    np.testing.assert_array_equal(heard, numbers(0, ring.n_taken))
    assert ring.n_lost == 0


def test_what_waits_too_long_is_lost_and_counted_and_the_timeline_goes_on_behind_it():
    ring = SampleRing(RATE_HZ)
    n_all = round(2.5 * RATE_HZ)
    for first in range(0, n_all, BLOCK):
        ring.write(numbers(first, BLOCK))
    frames, _ = taken(ring, BLOCK)

    assert ring.n_lost == n_all - round(RING_S * RATE_HZ)
    assert frames[0, 0] == ring.n_lost + 1
    assert ring.n_taken == ring.n_lost + BLOCK


def test_an_underrun_is_counted_once_however_long_it_lasts():
    ring = SampleRing(RATE_HZ)
    taken(ring, BLOCK)
    assert ring.n_underruns == 0, "nothing is missing before the first sample"
    for _ in range(2):
        ring.write(numbers(0, BLOCK))
        for _ in range(5):
            taken(ring, BLOCK)
    assert ring.n_underruns == 2


@given(st.integers(0, 3_000), st.integers(0, 3_000), st.integers(0, 200), st.integers(0, 3_000))
def test_after_a_cut_it_fades_to_silence_where_it_says(n_written, n_taken, n_untouched, n_more):
    """And what is written later is played again."""
    ring = SampleRing(RATE_HZ)
    ring.write(np.ones(n_written, np.float32))
    taken(ring, n_taken)
    n_before = ring.n_taken
    n_silent = ring.silence_rest(n_untouched)
    ring.write(np.full(n_more, 0.5, np.float32))
    frames, n = taken(ring, n_written + n_more)

    assert n == n_written - n_before + n_more
    left, later = np.split(frames[:n, 0], [n_written - n_before])
    n_heard = n_silent - n_before
    n_fade = round(FADE_S * RATE_HZ)
    assert 0 <= n_heard <= n_untouched + n_fade
    assert not np.any(left[n_heard:])
    assert np.all(left[: max(0, n_heard - n_fade)] == 1.0)
    if len(left) >= n_untouched + n_fade:
        steps = np.diff(left, append=0.0)
        assert np.all(steps <= 0.0)
        assert np.max(-steps) < 0.05, "nothing clicks"
    np.testing.assert_array_equal(later, 0.5)


def test_a_cut_of_more_than_the_ring_holds_leaves_nothing_of_it():
    ring = SampleRing(RATE_HZ)
    for _ in range(250):
        ring.write(np.ones(BLOCK, np.float32))
    n_silent = ring.silence_rest(BLOCK)
    frames, n = taken(ring, round(RING_S * RATE_HZ))

    n_lost = 250 * BLOCK - round(RING_S * RATE_HZ)
    assert (ring.n_lost, n) == (n_lost, round(RING_S * RATE_HZ))
    assert n_silent == n_lost + BLOCK + round(FADE_S * RATE_HZ)
    assert not np.any(frames[n_silent - n_lost :])
