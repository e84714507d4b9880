"""Plans, captures that are cut short, and what can be wrong with one."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_model import small_model

from calibration.calibration import CalibrationError
from calibration.capture.capture import (
    LEAD_IN_DEG,
    Capture,
    Robot,
    capture_poses,
    gather,
    least_poses,
    plan_poses,
    take_poses,
)
from calibration.capture.sanity import check_capture
from calibration.mouth_servos import JointRange
from calibration.simulated.face import POSITIVE_DIRECTIONS
from calibration.simulated.robot import SimulatedRobot, draw_robot, true_markers_mm
from lipsync.markers import MARKERS_47

SERVOS = tuple(POSITIVE_DIRECTIONS)
JOINTS = [JointRange(name, -2.0 if name == "jaw" else -30.0, 25.0) for name in SERVOS]
POSITIVE = list(POSITIVE_DIRECTIONS.values())
MODEL = small_model()


@pytest.fixture(scope="module")
def plan():
    return plan_poses(JOINTS, 60, seed=1)


@pytest.fixture
def robot():
    return new_robot()


def new_robot(**options):
    rest_mm = MODEL.markers_mm(MODEL.rest[None])[0]
    return SimulatedRobot(draw_robot(rest_mm, SERVOS, 100), **options)


@pytest.fixture(scope="module")
def capture(plan) -> Capture:
    robot = new_robot()
    return capture_poses(plan, MARKERS_47.names, robot.move, robot.measure)


@settings(deadline=None)  # machines are shared
@given(n_servos=st.integers(1, 10), more=st.integers(0, 30), seed=st.integers(0, 99))
def test_every_pose_of_every_plan_and_the_step_before_it_are_within_the_limits(
    n_servos, more, seed
):
    joints = JOINTS[:n_servos]
    plan = plan_poses(joints, least_poses(n_servos) + more, seed=seed)
    low, high = (np.array([getattr(j, k) for j in joints]) for k in ("min_deg", "max_deg"))
    for angles_deg in (plan.goals_deg, plan.start_deg):
        assert (low <= angles_deg).all()
        assert (angles_deg <= high).all()


def test_every_joint_goes_alone_to_the_same_angle_from_below_and_from_above(plan):
    for joint in range(10):
        alone = [
            row
            for row, goals in enumerate(plan.goals_deg)
            if goals[joint] and not np.delete(goals, joint).any()
        ]
        assert plan.goals_deg[alone[0], joint] == plan.goals_deg[alone[1], joint]
        assert sorted(plan.from_below[alone, joint]) == [-1.0, 1.0]


def test_the_cube_fills_the_range_of_every_joint_evenly(plan):
    """A Latin hypercube of n poses has one in each n-th of every joint's range."""
    cube = plan.goals_deg[-38:]
    again = (cube == 0.0).all(axis=1)
    assert np.flatnonzero(again).tolist() == [19, 37]  # neutral, in the middle and at the end
    cube = cube[~again]
    for joint, column in zip(JOINTS, cube.T, strict=True):
        low = min(joint.min_deg + min(LEAD_IN_DEG, (joint.max_deg - joint.min_deg) / 4), 0.0)
        width = (joint.max_deg - LEAD_IN_DEG - low) / 38
        parts = ((column - low) / width).astype(int)
        assert len(set(parts)) == 36
        assert set(parts) <= set(range(38))


def test_too_few_poses_are_refused_with_the_number_needed():
    with pytest.raises(CalibrationError, match="21 poses are too few for 10 servos; ask for 22"):
        plan_poses(JOINTS, 21)


def test_of_few_poses_each_joint_is_alone_in_one():
    few = plan_poses(JOINTS, 24)
    alone = (few.goals_deg != 0.0).sum(axis=1) == 1
    assert len(few) == 24
    assert alone.sum() == len(JOINTS)
    assert (few.from_below[alone] == 1.0).all()


def test_a_capture_cut_short_goes_on_where_it_stopped(plan, robot, tmp_path):
    keep = tmp_path / "poses.jsonl"
    looks = iter(range(25))

    def measure_until_the_power_goes():
        next(looks)  # StopIteration at the 26th
        return robot.measure()

    with pytest.raises(StopIteration):
        capture_poses(plan, MARKERS_47.names, robot.move, measure_until_the_power_goes, keep=keep)
    with keep.open("a") as file:
        file.write('{"pose": 25, "serv')  # the line that was being written
    moved = []

    def move(goal):
        moved.append(goal)
        return robot.move(goal)

    capture = capture_poses(plan, MARKERS_47.names, move, robot.measure, keep=keep)
    assert len(capture) == 60
    assert len(moved) == 2 * (60 - 25) + 1
    assert len(keep.read_text().splitlines()) == 60
    assert np.allclose(capture.goals_deg, plan.goals_deg)


def test_the_robot_is_left_in_neutral_even_when_the_tracker_fails(plan, robot):
    moved = []

    def move(goal):
        moved.append(goal)
        return robot.move(goal)

    def fail():
        raise OSError("camera unplugged")

    with pytest.raises(OSError, match="unplugged"):
        capture_poses(plan, MARKERS_47.names, move, fail)
    assert not moved[-1].any()


def test_kept_poses_of_another_plan_are_refused(plan, robot, tmp_path):
    keep = tmp_path / "poses.jsonl"
    capture_poses(plan, MARKERS_47.names, robot.move, robot.measure, keep=keep)
    other = plan_poses(JOINTS, 60, seed=2)
    with pytest.raises(CalibrationError, match=r"poses.jsonl, line \d+: not a pose of this face"):
        capture_poses(other, MARKERS_47.names, robot.move, robot.measure, keep=keep)


def test_a_kept_file_gives_the_same_capture_again(plan, robot, tmp_path):
    keep = tmp_path / "poses.jsonl"
    first = capture_poses(plan, MARKERS_47.names, robot.move, robot.measure, keep=keep)
    again = capture_poses(plan, MARKERS_47.names, robot.move, robot.measure, keep=keep)
    assert np.allclose(first.markers_mm, again.markers_mm, atol=1e-4)


def test_a_pose_that_stalls_is_left_out_and_named(plan, robot):
    def move(goal):
        reached = robot.move(goal)
        return np.where(np.arange(10) == 3, np.minimum(reached, 10.0), reached)

    capture = capture_poses(plan, MARKERS_47.names, move, robot.measure)
    n_beyond = int((plan.goals_deg[:, 3] > 13.0).sum())
    assert len(capture) == 60 - n_beyond
    assert len(capture.stalled) == n_beyond
    assert "lower_lip_left stopped at 10.0 of" in capture.stalled[0]


def test_a_sound_capture_has_nothing_to_say(capture):
    assert check_capture(capture, MODEL, POSITIVE).warnings == ()


def test_play_of_the_simulated_robot_is_a_play_operator():
    """From below the horn stands half the backlash behind the goal, from above half before it."""
    robot = new_robot(noise_mm=0.0)
    draw = draw_robot(MODEL.markers_mm(MODEL.rest[None])[0], SERVOS, 100)
    for step, side in ((-3.0, 1.0), (3.0, -1.0)):
        robot.move(np.full(10, 5.0) + step)
        robot.move(np.full(10, 5.0))
        expected = true_markers_mm(draw, (5.0 - side * draw.backlash_deg / 2)[None])[0]
        assert np.allclose(robot.measure(), expected)


@pytest.mark.parametrize("joint", range(10))
def test_a_dead_joint_is_named(plan, joint):
    robot = new_robot()
    alive = np.arange(10) != joint
    capture = capture_poses(
        plan, MARKERS_47.names, lambda goal: robot.move(goal * alive) * alive + goal * ~alive,
        robot.measure,
    )  # fmt: skip
    try:
        said = " ".join(check_capture(capture, MODEL, POSITIVE).warnings)
    except CalibrationError as error:
        said = str(error)
        assert "moves no marker" in said
    assert [name for name in SERVOS if f"servo {name!r}" in said] == [SERVOS[joint]]


@pytest.mark.parametrize("joint", range(10))
def test_a_reversed_joint_is_named_with_the_remedy(plan, joint):
    robot = new_robot()
    turn = np.where(np.arange(10) == joint, -1.0, 1.0)
    capture = capture_poses(
        plan, MARKERS_47.names, lambda goal: robot.move(goal * turn) * turn, robot.measure
    )
    with pytest.raises(
        CalibrationError, match=rf"servo '{SERVOS[joint]}' is reversed.*`us_per_deg`"
    ):
        check_capture(capture, MODEL, POSITIVE)


@pytest.mark.parametrize(
    ("one", "other"), [("outer_lip_61", "outer_lip_291"), ("outer_lip_0", "outer_lip_17")]
)
@pytest.mark.parametrize("poses", [slice(None), slice(17, 18)])
def test_swapped_markers_are_named(capture, one, other, poses):
    a, b = MARKERS_47.names.index(one), MARKERS_47.names.index(other)
    markers_mm = capture.markers_mm.copy()
    markers_mm[poses, [[a], [b]]] = capture.markers_mm[poses, [[b], [a]]]
    with pytest.raises(CalibrationError, match=rf"markers '{one}' and '{other}' have changed"):
        check_capture(dataclasses.replace(capture, markers_mm=markers_mm), MODEL)


def test_names_that_changed_places_in_one_pose_are_exchanged_where_that_is_accepted(capture):
    pair = [MARKERS_47.names.index(name) for name in ("outer_lip_61", "outer_lip_291")]
    markers_mm = capture.markers_mm.copy()
    markers_mm[17, pair] = markers_mm[17, pair[::-1]]
    swapped = dataclasses.replace(capture, markers_mm=markers_mm)
    with pytest.raises(CalibrationError, match="add --accept where it was in single poses"):
        check_capture(swapped, MODEL)
    checked = check_capture(swapped, MODEL, accept=True)
    assert any("have changed places in pose 18: exchanged" in line for line in checked.warnings)
    assert np.array_equal(checked.capture.markers_mm[17, pair], capture.markers_mm[17, pair])


def test_two_wild_readings_near_each_others_places_are_no_exchange(capture):
    """5 mm beside, where a true exchange is within noise; they are left out and counted."""
    a, b = (MARKERS_47.names.index(name) for name in ("outer_lip_61", "outer_lip_291"))
    markers_mm = capture.markers_mm.copy()
    markers_mm[17, [a, b]] = capture.markers_mm[17, [b, a]] + [0.0, 5.0, 0.0]
    checked = check_capture(dataclasses.replace(capture, markers_mm=markers_mm), MODEL)
    assert any("2 readings were far off" in line for line in checked.warnings)


@pytest.mark.parametrize("poses", [slice(None), slice(17, 18)])
def test_two_pairs_of_swapped_markers_are_in_one_report(capture, poses):
    markers_mm = capture.markers_mm.copy()
    pairs = (("outer_lip_61", "outer_lip_291"), ("outer_lip_0", "outer_lip_17"))
    for one, other in pairs:
        a, b = MARKERS_47.names.index(one), MARKERS_47.names.index(other)
        markers_mm[poses, [[a], [b]]] = capture.markers_mm[poses, [[b], [a]]]
    with pytest.raises(CalibrationError) as refused:
        check_capture(dataclasses.replace(capture, markers_mm=markers_mm), MODEL)
    for one, other in pairs:
        assert f"'{one}' and '{other}' have changed places" in str(refused.value)
    assert str(refused.value).count("changed places") == 2
    assert "\n" not in str(refused.value)


def test_lost_points_are_counted_and_a_marker_lost_too_often_is_refused(capture):
    markers_mm = capture.markers_mm.copy()
    markers_mm[4:10, 20] = np.nan
    lost = dataclasses.replace(capture, markers_mm=markers_mm)
    (warning,) = check_capture(lost, MODEL).warnings
    assert warning == f"6 points were lost by the tracker, most often {MARKERS_47.names[20]} (10%)"
    markers_mm[:40, 20] = np.nan
    with pytest.raises(CalibrationError, match=rf"marker '{MARKERS_47.names[20]}' was seen in 33%"):
        check_capture(lost, MODEL)


def test_a_capture_with_too_few_poses_left_is_refused(capture):
    few = Capture(
        capture.servo_names, MARKERS_47.names, capture.goals_deg[:12], capture.from_below[:12],
        capture.markers_mm[:12], ("pose 13: jaw stopped at 3.0 of 9.0 deg",),
    )  # fmt: skip
    with pytest.raises(CalibrationError, match=r"12 poses are too few .* jaw stopped at 3\.0"):
        check_capture(few, MODEL)


def test_lips_are_closed_no_farther_once_a_servo_is_strained(plan):
    """Poses 40 to 45 close the lips; at 42 a servo draws its cap, and 43 to 45 are left out."""
    robot, stood = new_robot(), []
    on = Robot(
        robot.move,
        robot.measure,
        arrived=lambda pose, _: stood.append(pose),
        strained=lambda: "jaw" if stood[-1] in (5, 42) else None,
    )
    poses = take_poses(plan, MARKERS_47.names, on, [], pressing=range(40, 46))
    assert stood == [pose for pose in range(60) if pose not in (43, 44, 45)]
    assert len(gather(plan, MARKERS_47.names, poses)) == 57
