import time
from itertools import islice

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_bridge.clock import ManualClock, MonotonicClock, ticks


def test_after_a_stall_comes_one_fresh_tick_back_on_the_grid_and_the_misses_are_counted():
    clock = ManualClock()
    grid = ticks(clock, rate_hz=10.0)

    assert [next(grid) for _ in range(3)] == [(0.0, 0), (0.1, 0), (0.2, 0)]

    clock.advance(0.55)

    assert [next(grid) for _ in range(2)] == [(0.7, 4), (0.8, 0)]


def test_a_stall_that_ends_exactly_on_a_tick_yields_that_tick_once():
    clock = ManualClock()
    grid = ticks(clock, rate_hz=4.0)
    next(grid)

    clock.advance(0.75)

    assert [next(grid), next(grid)] == [(0.75, 2), (1.0, 0)]


def test_the_grid_starts_when_the_first_tick_is_asked_for():
    clock = ManualClock()
    grid = ticks(clock, rate_hz=100.0)
    clock.advance(2.0)

    assert next(grid) == (2.0, 0)


@given(
    start_s=st.floats(0.0, 1e8),  # three years of uptime
    rate_hz=st.floats(30.0, 200.0),
    stalls_s=st.lists(st.floats(0.0, 0.2), min_size=1, max_size=30),
)
def test_every_tick_is_on_the_grid_and_yielded_or_counted_exactly_once(start_s, rate_hz, stalls_s):
    clock = ManualClock(start_s)
    n_passed = 0
    for stall_s, (time_s, late) in zip(stalls_s, ticks(clock, rate_hz), strict=False):
        n_passed += 1 + late
        index = n_passed - 1

        assert time_s == start_s + index / rate_hz
        assert time_s <= clock.now() < start_s + (index + 1) / rate_hz

        clock.advance(stall_s)


def test_ten_minutes_on_a_manual_clock_take_every_tick():
    clock = ManualClock()
    last_s, late = list(islice(ticks(clock, rate_hz=30.0), 18_001))[-1]

    assert (last_s, late) == (600.0, 0)


def test_a_manual_clock_never_runs_backwards():
    clock = ManualClock(5.0)
    clock.sleep_until(3.0)

    assert clock.now() == 5.0
    with pytest.raises(ValueError, match="cannot go back"):
        clock.advance(-0.1)


def test_the_monotonic_clock_takes_up_a_sleep_that_ended_early(monkeypatch):
    now_s = 0.0

    def sleep_half(seconds):
        nonlocal now_s
        now_s += max(seconds / 2, 1e-3)

    monkeypatch.setattr(time, "monotonic", lambda: now_s)
    monkeypatch.setattr(time, "sleep", sleep_half)

    MonotonicClock().sleep_until(1.0)

    assert now_s >= 1.0
