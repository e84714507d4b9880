"""A weak joint is told from a dead one, by a second look where a first does not tell."""

import numpy as np
import pytest

from calibration.calibration import CouplingRule
from calibration.capture.capture import Capture, plan_poses
from calibration.capture.joint_health import (
    doubtful_joints,
    extra_poses,
    is_dead,
    joint_signal,
    moved_alone_mm,
)
from calibration.capture.straight_lines import straight_lines
from calibration.mouth_servos import JointRange

JOINTS = (JointRange("jaw", -3.0, 24.0), JointRange("left", -30.0, 30.0))
NAMES = tuple(f"dot_{n}" for n in range(20))
NOISE_MM = 0.5
#: (n_servos, n_markers, 3), mm a degree: the jaw moves all; `left` three dots by 0.025 a degree,
#: which is 0.45 mm in a sweep.
EFFECT = np.zeros((2, 20, 3))
EFFECT[0, :, 1] = -0.6
EFFECT[1, :3, 1] = 0.025


def seen(goals_deg, from_below, effect, seed):
    noise = np.random.default_rng(seed).normal(0.0, NOISE_MM, (len(goals_deg), 20, 3))
    markers_mm = np.tensordot(goals_deg, effect, axes=1) + noise
    return Capture(("jaw", "left"), NAMES, goals_deg, from_below, markers_mm)


def first_look(effect, seed):
    plan = plan_poses(JOINTS, 12)
    return seen(plan.goals_deg, plan.from_below, effect, seed)


def both_looks(effect, seed):
    looks = (plan_poses(JOINTS, 12), extra_poses(JOINTS, [1]))
    goals_deg = np.concatenate([plan.goals_deg for plan in looks])
    return seen(goals_deg, np.concatenate([plan.from_below for plan in looks]), effect, seed)


DEAD_LEFT = EFFECT * np.array([1.0, 0.0])[:, None, None]


@pytest.mark.parametrize("seed", range(12))
def test_a_second_look_tells_a_weak_joint_from_a_dead_one(seed):
    weak, dead = both_looks(EFFECT, seed), both_looks(DEAD_LEFT, seed)
    assert not is_dead(weak, straight_lines(weak), 1)
    assert is_dead(dead, straight_lines(dead), 1)
    assert doubtful_joints(weak, [1]) == []
    assert doubtful_joints(dead, [1]) == [1]
    assert not is_dead(dead, straight_lines(dead), 0)


def test_a_first_look_leaves_both_in_doubt_and_never_the_jaw():
    for effect in (EFFECT, DEAD_LEFT):
        capture = first_look(effect, 0)
        assert doubtful_joints(capture) == [1]
    capture = first_look(EFFECT, 0)
    assert joint_signal(straight_lines(capture), 0) > 100.0


def test_a_second_look_moves_one_joint_at_a_time_between_its_ends_within_the_rules():
    rule = CouplingRule(np.array([1.0, 0.0]), 10.0)
    plan = extra_poses(JOINTS, [1, 0], rules=(rule,))
    assert len(plan) == 24
    assert plan.servo_names == ("jaw", "left")
    assert plan.goals_deg[:12].tolist() == [[0.0, -27.0], [0.0, 27.0]] * 6
    assert (plan.goals_deg[12:, 1] == 0.0).all()
    assert plan.goals_deg[:, 0].max() == 10.0
    assert (plan.from_below == 1.0).all()
    limits = np.array([[j.min_deg, j.max_deg] for j in JOINTS]).T
    assert ((limits[0] <= plan.start_deg) & (plan.start_deg <= limits[1])).all()


def test_what_a_joint_does_alone_is_measured_between_its_ends():
    capture = both_looks(EFFECT, 3)
    moved_mm = moved_alone_mm(capture, 1)
    assert moved_mm[:3, 1] == pytest.approx(np.full(3, 54 * 0.025), abs=0.8)
    capture.markers_mm[:, 5] = np.nan
    assert np.isnan(moved_alone_mm(capture, 1)[5]).all()


def test_poses_of_a_program_of_its_own_in_which_nothing_moves_alone_say_nothing():
    goals_deg = np.random.default_rng(0).uniform(1.0, 20.0, (20, 2))
    capture = seen(goals_deg, np.ones((20, 2)), EFFECT, 0)
    assert np.isnan(moved_alone_mm(capture, 0)).all()
    assert not is_dead(capture, straight_lines(capture), 0)
