"""Poses that were taken twice: what slipped, stopped or tore meanwhile, and who is to blame."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.capture.capture import Capture, joined, plan_poses
from calibration.capture.joint_health import JointFault
from calibration.capture.repeated_poses import (
    changed_poses,
    confirms,
    face_change,
    is_repeated,
    poses_to_repeat,
    repeats,
)
from calibration.capture.straight_lines import straight_lines
from calibration.mouth_servos import JointRange
from lipsync.markers import MARKERS_47

JOINTS = tuple(JointRange(name, -25.0, 30.0) for name in ("jaw", "upper", "lower", "corner"))
NAMES = tuple(joint.name for joint in JOINTS)
PLAN = plan_poses(JOINTS, 40)
TWICE = joined(PLAN, poses_to_repeat(PLAN))
N_MARKERS, NOISE_MM, MIDDLE = 20, 0.5, 25


def capture_of(seed=0, given=lambda _, goal_deg: goal_deg, shifted_mm=0.0, plan=TWICE):
    """A face so crooked that no line fits; `given` says where its horns go in place of the goal."""
    rng = np.random.default_rng(seed)
    by_deg = 0.1 * rng.normal(size=(4, N_MARKERS, 3))
    at_deg = np.array([given(pose, goal.copy()) for pose, goal in enumerate(plan.goals_deg)])
    at_deg = at_deg - plan.from_below / 2
    bent_deg = at_deg + 0.02 * at_deg * np.abs(at_deg) + 0.01 * at_deg * at_deg[:, ::-1]
    markers_mm = np.einsum("ns,smk->nmk", bent_deg, by_deg)
    markers_mm[MIDDLE:] += shifted_mm
    markers_mm += rng.normal(0.0, NOISE_MM, markers_mm.shape)
    names = MARKERS_47.names[:N_MARKERS]
    return Capture(NAMES, names, plan.goals_deg, plan.from_below, markers_mm)


def change_of(capture):
    return face_change(changed_poses(capture, straight_lines(capture)))


def from_middle(change):
    return lambda pose, goal_deg: change(goal_deg) if pose >= MIDDLE else goal_deg


def test_the_first_part_is_neutral_and_every_joint_alone_from_either_side():
    part = poses_to_repeat(PLAN)
    assert len(part) == 2 + 2 * len(JOINTS)
    assert (np.count_nonzero(part.goals_deg, axis=1) <= 1).all()
    assert len(repeats(capture_of())) == len(part)


def test_a_plan_that_repeats_only_a_mixed_pose_is_not_compared():
    """A plan of the user's own may repeat any pose; what each joint does alone is not in it."""
    mixed = int(np.flatnonzero((PLAN.goals_deg != 0.0).all(axis=1))[0])
    goals_deg = np.vstack([PLAN.goals_deg, PLAN.goals_deg[mixed]])
    from_below = np.vstack([PLAN.from_below, PLAN.from_below[mixed]])
    capture = capture_of(plan=replace(PLAN, goals_deg=goals_deg, from_below=from_below))

    assert len(repeats(capture)) >= 1
    assert not is_repeated(capture)
    assert is_repeated(capture_of())


@pytest.mark.parametrize("seed", range(8))
def test_of_a_sound_crooked_face_nothing_is_said(seed):
    assert change_of(capture_of(seed)) is None


@pytest.mark.parametrize("joint", range(4))
@pytest.mark.parametrize("by_deg", [15.0, -15.0])
def test_a_horn_that_slips_is_named_with_its_degrees(joint, by_deg):
    slip = from_middle(lambda goal_deg: goal_deg + by_deg * (np.arange(4) == joint))
    found = change_of(capture_of(joint, slip))
    assert (found.kind, found.joint) == ("slipped", joint)
    assert found.by == pytest.approx(by_deg, abs=6.0)
    assert found.first < MIDDLE < found.last
    assert f"{NAMES[joint]!r} slipped on its shaft" in found.description(NAMES)


@pytest.mark.parametrize("joint", range(4))
def test_a_rod_that_tears_is_named(joint):
    tear = from_middle(lambda goal_deg: np.where(np.arange(4) == joint, 0.5, goal_deg))
    found = change_of(capture_of(joint, tear))
    assert (found.kind, found.joint) == ("stopped", joint)
    assert found.by > 0.8


def test_a_face_that_is_another_than_before_accuses_no_joint():
    found = change_of(capture_of(shifted_mm=3.0))
    assert (found.kind, found.joint) == ("shifted", -1)
    assert "the face is another one than before, by " in found.description(NAMES)


def test_without_repeated_poses_nothing_can_be_said():
    capture = capture_of(plan=PLAN)
    assert changed_poses(capture, straight_lines(capture)) is None


def test_a_suspicion_is_borne_out_by_the_joint_that_stopped_and_by_no_other():
    tear = from_middle(lambda goal_deg: np.where(np.arange(4) == 2, 0.5, goal_deg))
    capture = capture_of(2, tear)
    changed = changed_poses(capture, straight_lines(capture))
    borne = [confirms(changed, JointFault("stopped", joint, MIDDLE)) for joint in range(4)]
    assert borne == [False, False, True, False]
    assert not confirms(changed, JointFault("shifted", -1, MIDDLE))


def test_a_jaw_alone_that_tears_its_rod_is_named_though_every_pose_is_off_by_another_amount():
    plan = plan_poses(JOINTS[:1], 40)
    plan = joined(plan, poses_to_repeat(plan))
    rng = np.random.default_rng(4)
    jaw_deg = np.where(np.arange(len(plan)) < len(plan) // 2, plan.goals_deg[:, 0], 0.0)
    markers_mm = jaw_deg[:, None, None] * 0.1 * rng.normal(size=(N_MARKERS, 3))
    markers_mm += rng.normal(0.0, NOISE_MM, markers_mm.shape)
    names = MARKERS_47.names[:N_MARKERS]

    found = change_of(Capture(NAMES[:1], names, plan.goals_deg, plan.from_below, markers_mm))

    assert (found.kind, found.joint) == ("stopped", 0)


def test_nobody_is_blamed_who_would_have_had_to_turn_by_half_a_turn():
    changed = changed_poses(capture_of(), straight_lines(capture_of()))
    ways = replace(changed, did_mm=np.array([10.0, 10.0, 10.0, 0.8]), turned_deg=np.full(4, 25.0))
    slid_mm = np.array([0.0, 0.0, 0.0, 6.0])
    blamed = replace(ways, slid_mm=slid_mm, alike=np.array([0.0, 0.0, 0.0, 0.9]))
    blamed = replace(blamed, lost_error_mm=np.full(4, 0.1), does_mm=blamed.did_mm)

    assert blamed.slipped_deg[3] > 180.0
    assert face_change(blamed) is None
