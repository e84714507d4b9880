"""Lips against what truly leaves a loudspeaker whose clock is not the computer's."""

import numpy as np
import pytest
from lipservo_lab.bench.sync.speaking_robot import SimulatedLoudspeaker

from lipsync.audio.playback_clock import OwnPlaybackClock
from lipsync.audio.playout import Playout

LEAD_S = 0.23
RATE_HZ = 8_000


def speak(speaker, duration_s):
    """Play silence as the live loop does, 100 times a second; return times of each turn, (n, 2) s.

    Monotonic time, and the sound time that the recogniser has then.
    """
    clock, playout = OwnPlaybackClock(LEAD_S), Playout(speaker)
    clock.begin(100.0)
    speaker.write(np.zeros(round(LEAD_S * RATE_HZ), np.float32))
    told = []
    for n in range(round(duration_s * 100)):
        now_s = 100.0 + n * 0.01
        speaker.advance(now_s)
        report = speaker.position()
        if report is not None:
            # The recogniser's time begins a lead after the timeline's.
            clock.played(report[0], report[1] - LEAD_S)
        sound_s = clock.sound_s(now_s)
        playout.blocks(sound_s)
        told.append((now_s, sound_s))
    return np.array(told)


def error_s(speaker, told):
    """How far the sound that is heard is behind the clock's, at each moment told."""
    _, left_s = speaker.played()
    moments_s, sound_s = told[told[:, 0] < left_s[-1]].T
    timeline_s = np.interp(moments_s, left_s, np.arange(len(left_s)) / RATE_HZ)
    return sound_s - timeline_s


@pytest.mark.slow
@pytest.mark.parametrize("skew", [200e-6, -200e-6])
def test_after_ten_minutes_on_a_skewed_clock_lips_and_sound_are_within_5_ms(skew):
    """Of 10 minutes 200 parts in a million are 120 ms. Callbacks and reports jitter by 8 ms."""
    rng = np.random.default_rng(7)
    speaker = SimulatedLoudspeaker(RATE_HZ, 0.06, skew, 0.008, rng)
    told = speak(speaker, 600.0)
    error = error_s(speaker, told)

    assert speaker.n_underruns == 0
    assert np.max(np.abs(error[500:])) < 0.005


def test_a_device_that_stalls_makes_the_mouth_wait_and_loses_nothing():
    speaker = SimulatedLoudspeaker(RATE_HZ)
    speaker.stall(102.0, 103.0)
    told = speak(speaker, 6.0)
    error = error_s(speaker, told)

    samples, left_s = speaker.played()
    assert np.max(np.diff(left_s)) == pytest.approx(1.0, abs=0.01)
    assert abs(error[-50]) < 0.005
    during = told[(told[:, 0] > 102.5) & (told[:, 0] < 103.0)]
    assert np.ptp(during[:, 1]) < 0.06, "it stands still"
    assert len(samples) == pytest.approx(5.0 * RATE_HZ, abs=0.1 * RATE_HZ)


def test_what_was_written_leaves_in_order_at_the_rate_of_the_device():
    speaker = SimulatedLoudspeaker(RATE_HZ, latency_s=0.1, skew=0.5)
    speaker.write(np.arange(240, dtype=np.float32))
    for n in range(5):
        speaker.advance(n * 0.01)
    samples, left_s = speaker.played()

    np.testing.assert_array_equal(samples, np.arange(240))
    np.testing.assert_allclose(left_s, 0.1 + np.arange(240) / (1.5 * RATE_HZ))
    assert speaker.n_underruns == 1


def test_a_cut_is_played_where_it_says():
    speaker = SimulatedLoudspeaker(RATE_HZ)
    speaker.write(np.ones(1_600, np.float32))
    for n in range(4):
        speaker.advance(n * 0.01)
    silent_s = speaker.silence_rest()
    speaker.advance(1.0)
    samples, _ = speaker.played()

    assert silent_s == pytest.approx(0.055)
    assert np.flatnonzero(samples)[-1] < round(silent_s * RATE_HZ)
    assert len(samples) == 1_600
