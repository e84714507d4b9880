"""A room of six walls, against what acoustics say of it."""

import numpy as np
import pytest
from lipservo_lab.evaluation.recognition.conditions import (
    impulse_response,
    in_room,
    parse_condition,
)

from lipsync.audio_block import SAMPLE_RATE_HZ

SPOKEN_M, HEARD_M = np.array([1.5, 2.0, 1.4]), np.array([3.1, 2.3, 1.3])


def test_the_direct_sound_comes_as_late_as_it_is_far_and_the_floor_after_it():
    response = impulse_response(SPOKEN_M, HEARD_M)
    direct_m = np.linalg.norm(SPOKEN_M - HEARD_M)
    by_floor_m = np.linalg.norm(SPOKEN_M * [1, 1, -1] - HEARD_M)
    first, *others = np.flatnonzero(response)
    assert first == round(direct_m / 343.0 * SAMPLE_RATE_HZ)
    assert round(by_floor_m / 343.0 * SAMPLE_RATE_HZ) in others
    assert response[first] == pytest.approx(1 / direct_m)
    assert response.argmax() == first


def test_sound_falls_by_60_db_in_half_a_second():
    """Schroeder's backward integral, from -5 to -25 dB."""
    response = impulse_response(SPOKEN_M, HEARD_M)
    left_db = 10 * np.log10(np.cumsum(response[::-1] ** 2)[::-1] / np.sum(response**2))
    falls_s = (np.argmax(left_db < -25) - np.argmax(left_db < -5)) / SAMPLE_RATE_HZ
    assert 3 * falls_s == pytest.approx(0.5, abs=0.1)


def test_speech_keeps_its_time_and_is_the_same_each_time():
    click = np.zeros(SAMPLE_RATE_HZ, dtype=np.float32)
    click[3000] = 1.0
    heard = in_room(np.random.default_rng(1), click)
    assert heard.shape == click.shape
    assert heard[3000] == pytest.approx(1.0, abs=1e-5)
    assert np.abs(heard[:3000]).max() < 1e-5
    room = parse_condition("room")
    again = [room.apply(click, "1089-1", []) for _ in range(2)]
    assert np.array_equal(*again)
    assert not np.array_equal(again[0], room.apply(click, "1089-2", []))


def test_of_a_talker_farther_away_less_is_direct():
    """2.5 times as far: 8 dB less direct sound beside much the same room."""
    click = np.zeros(SAMPLE_RATE_HZ, dtype=np.float32)
    click[3000] = 1.0

    def direct_db(condition):
        rooms = [parse_condition(condition).apply(click, str(name), []) for name in range(10)]
        return np.mean([-10 * np.log10(np.sum(heard[3001:] ** 2)) for heard in rooms])

    assert direct_db("room:1") - direct_db("room:2.5") == pytest.approx(8.0, abs=3.0)
