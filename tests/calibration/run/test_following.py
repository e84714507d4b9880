"""Lags found by step and chirp, goals sent ahead by them, and backlash made up for."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from calibration.calibration import CalibrationError
from calibration.fit.servo_response import chirp_deg, identify, lag_between_s
from calibration.mouth_servos import JointRange
from calibration.run.compensation import BacklashCompensation, LagCompensation
from calibration.simulated.servos import SimulatedServos

JOINTS = [JointRange("jaw", -2.0, 25.0), JointRange("lip", -30.0, 30.0)]
SERVOS = SimulatedServos(
    lag_s=np.array([0.050, 0.080]),
    dead_time_s=np.array([0.020, 0.020]),
    top_speed_deg_s=np.array([400.0, 250.0]),
)


def test_a_simulated_servo_answers_as_scipy_says_of_its_transfer_function():
    omega = 2.0 / 0.030
    times_s = np.arange(60) * 0.01
    goals = np.zeros((60, 2))
    goals[1:, 0] = 1.0  # a step so small that no top speed matters
    expected = signal.lsim(
        ([omega**2], [1.0, 2 * omega, omega**2]), goals[:, 0], times_s, interp=False
    )[1]
    delayed = np.concatenate([[0.0, 0.0], expected[:-2]])
    assert SERVOS.shafts_deg(goals, 100.0)[:, 0] == pytest.approx(delayed, abs=0.03)


def test_a_known_delay_is_found_between_samples_too():
    goal = chirp_deg(5.0)
    times = np.arange(len(goal))
    for lag_s in (0.0, 0.04, 0.0435, 0.09):
        seen = np.interp(times - 100.0 * lag_s, times, goal)
        assert lag_between_s(goal, seen, 100.0, until=500) == pytest.approx(lag_s, abs=0.001)


def test_lag_bandwidth_and_speed_are_found_from_the_encoders():
    """A critically damped servo is 3 dB down at 0.6436 omega / 2 pi (solve |H|^2 = 1/2)."""
    found = identify(SERVOS.encoders_deg, JOINTS, np.zeros(2))
    assert found.lag_s == pytest.approx(SERVOS.lag_s, abs=0.008)
    expected_hz = 0.6436 * 2.0 / (SERVOS.lag_s - SERVOS.dead_time_s) / (2 * np.pi)
    assert found.bandwidth_hz == pytest.approx(expected_hz, rel=0.12)
    assert found.top_speed_deg_s[1] == pytest.approx(250.0, rel=0.05)


def test_a_servo_that_does_not_follow_is_named():
    def drive(goals_deg, rate_hz):
        encoders = SERVOS.encoders_deg(goals_deg, rate_hz)
        encoders[:, 1] = 0.0
        return encoders

    with pytest.raises(CalibrationError, match="servo 'lip' does not follow its goal"):
        identify(drive, JOINTS, np.zeros(2))


@settings(deadline=None)  # machines are shared
@given(
    lags_ms=st.lists(st.floats(0, 150), min_size=1, max_size=5),
    look_ahead_ms=st.floats(0, 200),
)
def test_every_joint_is_sent_ahead_by_its_lag_as_far_as_look_ahead_allows(lags_ms, look_ahead_ms):
    """Fed a ramp of one degree a second, a joint sent ahead by t shows t degrees more."""
    early_s = np.minimum(lags_ms, look_ahead_ms) / 1e3
    lag = LagCompensation(np.array(lags_ms) / 1e3, 0.01, look_ahead_s=look_ahead_ms / 1e3)
    assert lag.advance_s == pytest.approx(early_s.max())
    for n in range(60):
        sent = lag.feed(np.full(len(lags_ms), 0.01 * n))
    shown_s = 0.01 * 59 - lag.advance_s
    assert sent == pytest.approx(shown_s + early_s, abs=1e-9)


def test_compensated_servos_are_in_time():
    """Goals through servos that are 50 and 80 ms late arrive together, within 10 ms."""
    times_s = np.arange(0.0, 6.0, 0.01)
    wanted = 5.0 * np.sin(2 * np.pi * 2.0 * times_s) + 3.0 * np.sin(2 * np.pi * 0.7 * times_s)
    lag = LagCompensation(SERVOS.lag_s, 0.01, look_ahead_s=0.2)
    goals = np.array([lag.feed(np.full(2, pose)) for pose in wanted])
    shafts = SERVOS.shafts_deg(goals, 100.0)
    for shaft in shafts.T:
        assert abs(lag_between_s(wanted, shaft, 100.0) - lag.advance_s) < 0.010


def test_servos_in_time_and_without_play_get_the_poses_as_they_are():
    lag = LagCompensation(np.zeros(3), 0.01, look_ahead_s=0.2)
    backlash = BacklashCompensation(np.zeros(3))
    poses = np.random.default_rng(0).normal(size=(20, 3))
    assert lag.advance_s == 0.0
    assert np.array_equal([lag.feed(pose) for pose in poses], poses)
    assert np.array_equal(backlash.feed(poses), poses)


@settings(deadline=None)  # machines are shared
@given(seed=st.integers(0, 1000), backlash_deg=st.floats(0.1, 2.0))
def test_horns_behind_play_stand_where_they_should_once_moving(seed, backlash_deg):
    """Backlash after its compensation: off by its width at most, within the dead band."""
    rng = np.random.default_rng(seed)
    wanted = np.interp(np.arange(200), np.arange(0, 201, 20), rng.uniform(-20, 20, 11))
    compensation = BacklashCompensation(np.array([backlash_deg]))
    horn = wanted[0] - backlash_deg / 2
    for n, angle in enumerate(wanted):
        ((goal,),) = compensation.feed(np.array([[angle]]))
        horn = np.clip(horn, goal - backlash_deg / 2, goal + backlash_deg / 2)
        assert abs(horn - angle) <= backlash_deg + 1e-9
        if n and abs(angle - wanted[n - 1]) > 0.5:
            assert horn == pytest.approx(angle)


def test_small_turns_are_not_made_up_for():
    compensation = BacklashCompensation(np.array([1.0]))
    goals = [compensation.feed(np.array([[a]]))[0, 0] for a in (0.0, 1.0, 0.9, 1.0, 0.95, 0.3)]
    assert goals == pytest.approx([0.5, 1.5, 1.4, 1.5, 1.45, -0.2])


def test_a_turn_that_comes_later_is_taken_into_account_and_not_remembered():
    """Poses of a window get the goals that they would get one after another."""
    poses = np.array([[0.0], [2.0], [1.0], [3.0]])
    one_by_one, at_once = (BacklashCompensation(np.array([1.0])) for _ in range(2))

    expected = [one_by_one.feed(pose[None])[0] for pose in poses]
    assert at_once.feed(poses) == pytest.approx(np.array(expected))
    assert np.array(expected)[:, 0] == pytest.approx([0.5, 2.5, 0.5, 3.5])
    assert at_once.feed(poses[:1]) == pytest.approx(np.array([[0.5]]))
