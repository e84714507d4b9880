"""Speeds by where servos stood."""

import numpy as np
import pytest

from lipsync.recognition.own_noise import ServoSpeeds


def test_a_servo_that_turns_evenly_has_that_speed_at_the_middle_of_its_readings():
    speeds, found = ServoSpeeds(), []
    for n in range(10):
        found.append(speeds.take(0.01 * n, np.array([120.0 * 0.01 * n, -5.0])))
    assert found[:3] == [None] * 3
    for n, (time_s, told) in enumerate(found[3:], start=3):
        assert time_s == pytest.approx(0.01 * n - 0.015)
        assert told == pytest.approx([120.0, 0.0])


def test_slow_readings_and_gaps():
    speeds = ServoSpeeds()
    speeds.take(0.0, np.array([0.0]))
    assert speeds.take(1 / 30, np.array([3.0]))[1] == pytest.approx([90.0])
    assert speeds.take(1 / 30, np.array([9.0])) is None, "the same reading again"
    assert speeds.take(2.0, np.array([9.0])) is None, "nobody knows what was in between"
    assert speeds.take(2.05, np.array([9.0, 1.0])) is None, "another robot"
    assert np.isnan(speeds.take(2.10, np.array([np.nan, 1.0]))[1][0])
