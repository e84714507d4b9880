"""The robot's own servos: told of their speeds, a recogniser does not take them for a voice."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lipsync.recognition.own_noise import OwnNoise

N_SERVOS, N_BANDS = 3, 40
REST = np.zeros(N_SERVOS)


def noise_of(speeds_deg_s, rng):
    """Log-mel power: each servo in bands of its own, louder with its speed; 2 dB of scatter."""
    power = np.full(N_BANDS, 1e-4)
    for servo, speed in enumerate(speeds_deg_s):
        power[10 * servo : 10 * servo + 12] += 1e-2 * (speed / 100.0) ** 2
    return (np.log(power) + 0.5 * rng.standard_normal(N_BANDS)).astype(np.float32)


def run_servos(own, rng, n_frames, *, louder=0.0, learns=True):
    """Feed frames of servos that start and stop; return the share taken as the servos' noise.

    The first quarter of the frames is not counted. louder: added to the frames, natural log of
    power. learns: whether the noise is learned from each frame.
    """
    explained = []
    for n in range(n_frames):
        time_s = 0.01 * n
        speeds = 150.0 * np.abs(np.sin(0.05 * n + np.arange(N_SERVOS))) ** 2
        own.note_speeds(time_s, speeds)
        frame = noise_of(speeds, rng) + np.float32(louder)
        explained.append(own.is_own_noise(frame, time_s, is_awake=False))
        if learns:
            own.learn(0)
    return np.mean(explained[n_frames // 4 :])


@pytest.fixture
def taught():
    own = OwnNoise(20)
    run_servos(own, np.random.default_rng(0), 1_500)
    return own


def test_what_was_learned_explains_the_servos_and_no_voice(taught):
    rng = np.random.default_rng(1)
    taught.begin()
    assert run_servos(taught, rng, 400, learns=False) > 0.95
    taught.begin()
    assert run_servos(taught, rng, 400, louder=np.log(10.0), learns=False) == 0.0


def test_before_anything_was_learned_nothing_is_explained():
    assert run_servos(OwnNoise(20), np.random.default_rng(0), 200, learns=False) == 0.0


def test_while_somebody_speaks_it_takes_half_a_second(taught):
    """A closure beside servos is as quiet as they are, and is not the end of the voice."""
    rng = np.random.default_rng(2)
    taught.begin()
    found = []
    for n in range(90):
        taught.note_speeds(0.01 * n, np.full(N_SERVOS, 100.0))
        frame = noise_of(np.full(N_SERVOS, 100.0), rng)
        found.append(taught.is_own_noise(frame, 0.01 * n, is_awake=True))
    assert not any(found[:49])
    assert all(found[75:])


@pytest.mark.parametrize(
    ("told_s", "speeds"),
    [(None, REST), (0.0, REST), (0.0, np.full(N_SERVOS, np.nan)), (-0.5, np.full(N_SERVOS, 90.0))],
    ids=["never told", "at rest", "no answer", "told long ago"],
)
def test_servos_of_which_nothing_is_known_explain_nothing(taught, told_s, speeds):
    taught.begin()
    if told_s is not None:
        taught.note_speeds(told_s, speeds)
    assert not taught.is_own_noise(np.full(N_BANDS, -12.0, np.float32), 0.0, is_awake=False)


def test_another_number_of_servos_is_another_robot(taught):
    taught.note_speeds(0.0, np.full(5, 100.0))
    frame = noise_of(np.full(N_SERVOS, 100.0), np.random.default_rng(3))
    assert not taught.is_own_noise(frame, 0.0, is_awake=False)


@settings(max_examples=60, deadline=None)
@given(
    speeds=st.lists(
        st.floats(allow_nan=True, allow_infinity=True, width=32), min_size=2, max_size=2
    ),
    level=st.floats(-20.0, 15.0),
    gap=st.integers(0, 40),
)
def test_whatever_is_told_it_stays_a_number(speeds, level, gap):
    own = OwnNoise(20)
    with np.errstate(invalid="raise", divide="raise", over="raise"):
        for n in range(30):
            own.note_speeds(0.01 * n, np.array(speeds))
            frame = np.full(N_BANDS, level, np.float32)
            assert own.is_own_noise(frame, 0.01 * n, is_awake=n % 2 == 0) in (True, False)
            own.learn(gap)
