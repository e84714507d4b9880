"""Which sound is heard when: files, devices that are late, and what the program plays itself."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lipsync.audio.playback_clock import ArrivalClock, OwnPlaybackClock, SteadyClock, clock_for
from lipsync.audio.source import SilentSource

#: Sound passes at most at 1.5 times the speed of time.
FASTEST = 1.5


def test_the_sound_of_a_file_passes_as_time_does_from_its_beginning():
    clock = SteadyClock()
    clock.begin(100.0)
    assert clock.sound_s(102.5) == 2.5
    assert clock.sound_s(99.0) == -1.0
    assert clock.monotonic_s(2.5) == clock.captured_s(2.5) == 102.5


def test_a_device_that_is_two_tenths_late_is_heard_two_tenths_later():
    clock = ArrivalClock()
    clock.begin(100.0)
    for n in range(1, 200):
        clock.arrived(100.0 + n * 0.01, max(0.0, n * 0.01 - 0.2))
    assert clock.sound_s(101.99) == pytest.approx(1.79)
    assert clock.monotonic_s(1.79) == pytest.approx(101.99)
    assert clock.captured_s(1.0) == pytest.approx(101.2)


def test_before_any_sound_has_come_none_was_captured():
    assert ArrivalClock().captured_s(0.0) is None


def test_a_live_source_brings_a_clock_that_waits_for_it():
    class Device(SilentSource):
        is_live = True

    assert isinstance(clock_for(Device()), ArrivalClock)
    assert isinstance(clock_for(SilentSource()), SteadyClock)


def test_what_is_played_is_handed_to_the_recogniser_a_lead_before():
    clock = OwnPlaybackClock(0.3)
    clock.begin(100.0)
    for n in range(100):
        clock.played(100.3 + n * 0.01, n * 0.01)
    assert clock.sound_s(101.3) == pytest.approx(1.3)
    assert clock.monotonic_s(1.0) == pytest.approx(101.0)


def test_after_an_underrun_the_sound_waits_for_the_device_and_follows_it_again():
    """The device plays a second, stands still for a second, and goes on."""
    clock = OwnPlaybackClock(0.0)
    clock.begin(0.0)
    heard_s = []
    for n in range(500):
        now_s = n * 0.01
        clock.played(now_s, now_s if now_s < 1.0 else max(1.0, now_s - 1.0))
        heard_s.append(clock.sound_s(now_s))
    assert heard_s[199] == pytest.approx(1.0, abs=0.25)
    assert heard_s[-1] == pytest.approx(3.99, abs=0.001)


ticks = st.lists(st.floats(0.0, 0.2), min_size=2, max_size=60)


@given(
    ticks,
    st.lists(st.tuples(st.floats(-0.3, 0.3), st.floats(-2.0, 2.0)) | st.none(), max_size=60),
    st.floats(0.0, 0.5),
)
def test_what_is_asked_never_goes_back_and_never_leaps_whatever_the_device_reports(
    steps_s, reports, lead_s
):
    """Reports in error by seconds, dated before or after they come, or missing."""
    clock = OwnPlaybackClock(lead_s)
    clock.begin(10.0)
    now_s, last_s = 10.0, clock.sound_s(10.0)
    for n, step_s in enumerate(steps_s):
        now_s += step_s
        report = reports[n] if n < len(reports) else None
        if report is not None:
            dated_s, error_s = report
            clock.played(now_s + dated_s, now_s - 10.0 + error_s)
        sound_s = clock.sound_s(now_s)
        assert -1e-9 <= sound_s - last_s <= FASTEST * step_s + 1e-9
        assert clock.monotonic_s(sound_s) == pytest.approx(now_s)
        last_s = sound_s


@given(ticks, st.lists(st.floats(0.0, 1.0), min_size=60, max_size=60))
def test_a_device_late_by_any_amount_never_turns_the_sound_back(steps_s, late_s):
    clock = ArrivalClock()
    clock.begin(0.0)
    now_s, last_s = 0.0, -math.inf
    for step_s, late in zip(steps_s, late_s, strict=False):
        now_s += step_s
        clock.arrived(now_s, max(0.0, now_s - late))
        sound_s = clock.sound_s(now_s)
        assert sound_s >= last_s - 1e-12
        last_s = sound_s
