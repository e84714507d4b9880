"""Joints that stop or slip half-way are named; where none is to blame nobody is accused."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.capture.capture import Capture
from calibration.capture.joint_health import JointFault, joint_fault
from calibration.capture.straight_lines import straight_lines
from lipsync.markers import MARKERS_47

N_POSES, N_MARKERS, MIDDLE = 60, 12, 30
NOISE_MM = 0.3
SERVOS = ("jaw", "upper", "lower", "corner")


def capture_of(seed=0, n_servos=4, n_poses=N_POSES, given=lambda _, goal_deg: goal_deg):
    """A slightly curved face; `given` says where its horns go instead of to the goal."""
    rng = np.random.default_rng(seed)
    by_deg = 0.1 * rng.normal(size=(n_servos, N_MARKERS, 3))
    bends = 0.0005 * rng.normal(size=by_deg.shape)
    goals_deg = rng.uniform(-20, 20, (n_poses, n_servos))
    at_deg = np.array([given(pose, goal.copy()) for pose, goal in enumerate(goals_deg)])
    markers_mm = np.einsum("ns,smk->nmk", at_deg, by_deg)
    markers_mm += np.einsum("ns,smk->nmk", at_deg**2, bends)
    markers_mm += rng.normal(0.0, NOISE_MM, markers_mm.shape)
    names = MARKERS_47.names[:N_MARKERS]
    return Capture(SERVOS[:n_servos], names, goals_deg, np.ones_like(goals_deg), markers_mm)


def fault_of(capture: Capture) -> JointFault | None:
    return joint_fault(capture, straight_lines(capture))


def stuck(joint, at_deg=0.0, since=MIDDLE):
    def given(pose, goal_deg):
        if pose >= since:
            goal_deg[joint] = at_deg
        return goal_deg

    return given


def slipped(joint, by_deg, since=MIDDLE):
    def given(pose, goal_deg):
        if pose >= since:
            goal_deg[joint] += by_deg
        return goal_deg

    return given


@pytest.mark.parametrize("seed", range(6))
def test_of_a_sound_robot_nothing_is_said(seed):
    assert fault_of(capture_of(seed)) is None


@pytest.mark.parametrize("joint", range(4))
@pytest.mark.parametrize("at_deg", [0.0, 17.0])
def test_a_joint_that_stops_is_named_with_its_pose(joint, at_deg):
    found = fault_of(capture_of(joint, given=stuck(joint, at_deg)))
    assert (found.kind, found.joint) == ("stopped", joint)
    assert abs(found.pose - (MIDDLE + 1)) <= 2
    assert f"servo {SERVOS[joint]!r} stopped moving at about pose" in found.description(SERVOS)


@pytest.mark.parametrize("joint", range(4))
@pytest.mark.parametrize("by_deg", [12.0, -12.0])
def test_a_joint_that_slips_is_named_with_its_pose(joint, by_deg):
    found = fault_of(capture_of(joint, given=slipped(joint, by_deg)))
    assert (found.kind, found.joint) == ("slipped", joint)
    assert abs(found.pose - (MIDDLE + 1)) <= 2
    assert f"servo {SERVOS[joint]!r} slipped on its shaft" in found.description(SERVOS)


def test_a_tracker_that_was_knocked_is_no_joints_fault():
    capture = capture_of()
    moved_mm = capture.markers_mm.copy()
    moved_mm[MIDDLE:] += [5.0, -3.0, 2.0]
    found = fault_of(replace(capture, markers_mm=moved_mm))
    assert (found.kind, found.joint, found.pose) == ("shifted", -1, MIDDLE + 1)
    said = found.description(SERVOS)
    assert f"from pose {MIDDLE + 1} on" in said
    assert not any(name in said for name in SERVOS)


def test_two_joints_that_do_the_same_are_not_told_apart():
    """Whichever of them slipped, naming the other would send somebody to the wrong horn."""
    rng = np.random.default_rng(3)
    goals_deg = rng.uniform(-20, 20, (N_POSES, 2))
    at_deg = goals_deg.copy()
    at_deg[MIDDLE:, 1] += 12.0
    markers_mm = at_deg.sum(axis=1)[:, None, None] * 0.1 * rng.normal(size=(N_MARKERS, 3))
    markers_mm += rng.normal(0.0, NOISE_MM, markers_mm.shape)
    names = MARKERS_47.names[:N_MARKERS]
    found = fault_of(Capture(("a", "b"), names, goals_deg, np.ones_like(goals_deg), markers_mm))
    assert (found.kind, found.joint) == ("shifted", -1)


def test_lost_points_hide_nothing_and_accuse_nobody():
    lost = np.random.default_rng(9).random((N_POSES, N_MARKERS)) < 0.1
    for given, wanted in ((lambda _, goal_deg: goal_deg, None), (stuck(2, 17.0), 2)):
        capture = capture_of(2, given=given)
        capture.markers_mm[lost] = np.nan
        found = fault_of(capture)
        assert (None if found is None else found.joint) == wanted


@pytest.mark.parametrize("n_servos", [1, 2, 4])
@pytest.mark.parametrize("n_poses", range(8, 24))
def test_short_captures_of_few_servos_are_sound_or_too_short(n_servos, n_poses):
    assert fault_of(capture_of(1, n_servos, n_poses)) is None
