"""Simulated servos of the robot that listens: their noise goes with their speeds."""

import numpy as np
import pytest
from lipservo_lab.evaluation.recognition.conditions import (
    ConditionError,
    encoder_readings_deg,
    parse_condition,
    servo_noise,
)

RATE_HZ = 16_000


def test_it_is_as_loud_as_the_servos_are_fast():
    sound, speeds = servo_noise(np.random.default_rng(0), 20 * RATE_HZ)
    assert len(speeds) == 2_000
    level = np.sqrt(np.mean(sound.reshape(-1, 160) ** 2, axis=1))
    fastest = np.abs(speeds).max(axis=1)
    assert level[fastest > 100].mean() > 20 * level[fastest == 0.0].mean()
    assert np.corrcoef(np.sqrt(fastest), level)[0, 1] > 0.7


@pytest.mark.slow
def test_the_same_robot_moves_otherwise_and_another_sounds_otherwise():
    def spectrum(seed, robot):
        sound, _ = servo_noise(np.random.default_rng(seed), 20 * RATE_HZ, robot)
        power = np.abs(np.fft.rfft(sound)) ** 2
        return np.log([part.mean() for part in np.array_split(power, 40)])

    first, moved, other = spectrum(0, 0), spectrum(1, 0), spectrum(0, 1)
    assert np.abs(first - moved).mean() < 0.5 * np.abs(first - other).mean()


def test_encoders_follow_the_speeds_in_their_steps():
    _, speeds = servo_noise(np.random.default_rng(2), 5 * RATE_HZ)
    read = encoder_readings_deg(speeds)
    assert np.abs(np.diff(read, axis=0) * 100 - speeds[1:]).max() < 9.0
    steps = read / (360 / 4096)
    assert steps == pytest.approx(np.rint(steps), abs=1e-6)


def test_the_bench_tells_of_the_servos_that_it_lets_hear():
    told = parse_condition("servos:10", tells_servos=True)
    speech = 0.1 * np.random.default_rng(0).standard_normal(RATE_HZ).astype(np.float32)
    noise = told.apply(speech, "a name", []) - speech
    assert 10 * np.log10(np.mean(speech**2) / np.mean(noise**2)) == pytest.approx(10.0, abs=0.1)
    assert told.servo_positions_deg("a name", len(speech)).shape == (100, 8)
    assert parse_condition("servos:10").servo_positions_deg("a name", len(speech)) is None
    with pytest.raises(ConditionError, match="for the noise of servos"):
        parse_condition("white:10", tells_servos=True)
