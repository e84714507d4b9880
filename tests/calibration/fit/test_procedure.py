"""What is captured of a robot: a joint in doubt is looked at again, and lips as wide as they go."""

from dataclasses import replace

import numpy as np
import pytest
from linear_face import MODEL as SMALL
from linear_face import SERVOS, LinearFace
from lipservo_lab.bench.calibration.elastic_draws import draw_elastic_robot

from calibration.calibration import CalibrationError
from calibration.capture.capture import (
    NOT_KEPT,
    CapturedPose,
    KeptPoses,
    Robot,
    capture_poses,
    joined,
    plan_around,
    plan_rows,
    take_poses,
    usual_poses,
)
from calibration.capture.joint_health import MOST_FRAMES, unseen_alone
from calibration.capture.sanity import check_capture
from calibration.fit.measured import fit_measured
from calibration.fit.procedure import Procedure, machine_poses, take_grade
from calibration.fit.retargeting import RobotMouth, correspond, widest_pose_deg
from calibration.mouth_servos import JointRange
from calibration.simulated.elastic_robot import ElasticFace
from calibration.simulated.robot import SimulatedRobot
from lipsync.animpho.units import load_face_with_animphos
from lipsync.markers import MARKERS_47

MODEL = load_face_with_animphos()
REST_MM = MODEL.markers_mm(MODEL.rest[None])[0]


def drawn(seed, n_servos):
    draw, servos = draw_elastic_robot(REST_MM, seed, n_servos)
    return ElasticFace(draw), servos


def shortest(servos, seed):
    """No poses of speech: nothing is fitted on the way."""
    n_poses = usual_poses(len(servos.joints))
    return Procedure(MODEL, servos.joints, n_poses, seed=seed, positive=servos.positive)


@pytest.mark.parametrize("seed", [104, 116])
def test_weak_joints_are_looked_at_again_and_the_healthy_robot_is_accepted(seed, tmp_path):
    face, servos = drawn(seed, 10)
    robot, told = SimulatedRobot(face, noise_seed=seed), []
    procedure, keep = shortest(servos, seed), tmp_path / "poses.jsonl"

    capture = procedure.capture(
        MARKERS_47.names, Robot(robot.move, robot.measure), kept=KeptPoses(keep), report=told.append
    )

    assert len(told) == 1
    n_doubtful = sum(f"'{name}'" in told[0] for name in servos.names)
    assert n_doubtful > 0
    assert capture.n_planned == len(capture) == procedure.n_poses + 12 * n_doubtful
    check_capture(capture, MODEL, servos.positive)

    def measured_again():
        raise AssertionError("everything was kept")

    again = procedure.capture(
        MARKERS_47.names, Robot(robot.move, measured_again), kept=KeptPoses(keep)
    )
    assert np.array_equal(again.markers_mm, capture.markers_mm)


def test_by_files_too_a_joint_in_doubt_is_looked_at_again_once():
    face, servos = drawn(104, 10)
    robot, procedure = SimulatedRobot(face, noise_seed=104), shortest(servos, 104)
    plan = procedure.range_plan()
    seen = capture_poses(plan, MARKERS_47.names, robot.move, robot.measure)

    looks, (told,) = procedure.further_plan(seen, servos.positive, accept=False)

    unsure = [joint for joint, name in enumerate(servos.names) if f"'{name}'" in told]
    assert len(looks) == 12 * len(unsure) > 0
    moved = np.abs(looks.goals_deg) > 0.1
    assert (moved.sum(axis=1) == 1).all()
    assert set(np.flatnonzero(moved.any(axis=0))) == set(unsure)
    whole = joined(plan, looks)
    seen = capture_poses(whole, MARKERS_47.names, robot.move, robot.measure)
    assert unseen_alone(seen) == []


def test_a_dead_joint_is_named_after_the_second_look():
    face, servos = drawn(104, 10)
    dead = servos.names.index("cheek_l")
    robot = SimulatedRobot(face, noise_seed=1)

    def move(goal_deg):
        robot.move(np.where(np.arange(10) == dead, 0.0, goal_deg))
        return goal_deg

    told = []
    capture = shortest(servos, 104).capture(
        MARKERS_47.names, Robot(move, robot.measure), report=told.append
    )
    assert ["'cheek_l'" in line for line in told] == [True] * MOST_FRAMES
    with pytest.raises(CalibrationError, match="'cheek_l' moves no marker"):
        check_capture(capture, MODEL, servos.positive)


def two_servos(accept=False):
    face = LinearFace()
    return face, Procedure(SMALL, SERVOS.joints, 20, positive=SERVOS.positive, accept=accept)


def test_two_names_that_change_places_are_looked_at_again_and_told(tmp_path):
    face, procedure = two_servos()
    robot, looks, told = SimulatedRobot(face), [], []
    pair = [MARKERS_47.names.index(name) for name in ("outer_lip_61", "outer_lip_0")]

    def measure():
        looks.append(robot.measure())
        if len(looks) == 8:
            looks[-1][pair] = looks[-1][pair[::-1]]
        return looks[-1]

    keep = tmp_path / "poses.jsonl"
    capture = procedure.capture(
        MARKERS_47.names, Robot(robot.move, measure), kept=KeptPoses(keep), report=told.append
    )
    assert told == ["pose 8: the tracker exchanged 'outer_lip_61' with 'outer_lip_0': taken again"]
    assert len(looks) == len(capture) + 1
    check_capture(capture, SMALL, SERVOS.positive)
    again = procedure.capture(
        MARKERS_47.names, Robot(robot.move, robot.measure), kept=KeptPoses(keep)
    )
    assert np.array_equal(again.markers_mm, capture.markers_mm)


def test_names_that_three_looks_agree_to_be_exchanged_are_exchanged():
    face, procedure = two_servos()
    robot, told, goals = SimulatedRobot(face), [], []
    pair = [MARKERS_47.names.index(name) for name in ("outer_lip_61", "outer_lip_0")]
    swapped_deg = procedure.range_plan().goals_deg[9]

    def move(goal_deg):
        goals.append(goal_deg)
        return robot.move(goal_deg)

    def measure():
        seen_mm = robot.measure()
        if np.allclose(goals[-1], swapped_deg):
            seen_mm[pair] = seen_mm[pair[::-1]]
        return seen_mm

    capture = procedure.capture(MARKERS_47.names, Robot(move, measure), report=told.append)
    assert ["3 times: named anew" in line for line in told] == [True]
    check_capture(capture, SMALL, SERVOS.positive)


def test_lips_are_closed_no_farther_in_any_later_part_once_a_servo_is_strained():
    face, procedure = two_servos()
    robot, stood = SimulatedRobot(face), []
    on = Robot(
        robot.move,
        robot.measure,
        arrived=lambda row, _: stood.append(row),
        strained=lambda: "jaw" if stood[-1] >= 20 else None,
    )

    capture = procedure.capture(MARKERS_47.names, on)
    assert (capture.ladders > 0).sum() == 1
    assert len(stood) == len(capture) > 21


def test_closing_steps_that_are_planned_after_a_servo_was_strained_are_left_out_as_well():
    plan = plan_around(np.arange(16.0).reshape(8, 2), SERVOS.joints)
    stood, left_out = [], set()
    robot = Robot(
        lambda goal_deg: goal_deg,
        lambda: np.zeros((1, 3)),
        lambda row, _: stood.append(row),
        strained=lambda: "jaw" if stood[-1] == 1 else None,
    )

    for n in (4, 8):
        part = plan_rows(plan, range(n))
        take_poses(part, ("a",), robot, [], pressing=range(1, n), left_out=left_out)
    assert stood == [0, 1, 0]


def test_a_joint_that_is_stuck_is_named_at_once_and_when_it_is_free_the_same_file_goes_on(tmp_path):
    face, procedure = two_servos()
    robot, kept = SimulatedRobot(face), KeptPoses(tmp_path / "poses.jsonl")
    recorded = []
    stuck = Robot(
        lambda _: np.array([4.0, 0.0]), robot.measure, lambda *pose: recorded.append(pose)
    )

    for _ in range(2):
        with pytest.raises(
            CalibrationError, match=r"pose 1: jaw stopped at 4\.0 of 0\.0 deg; free that joint"
        ):
            procedure.capture(MARKERS_47.names, stuck, kept=kept)
    assert recorded == []
    capture = procedure.capture(MARKERS_47.names, Robot(robot.move, robot.measure), kept=kept)
    assert len(capture) == capture.n_planned


def test_a_pose_to_grade_by_is_taken_again_where_two_names_changed_places():
    face, procedure = two_servos()
    robot, n_looks = SimulatedRobot(face), []
    capture = procedure.capture(MARKERS_47.names, Robot(robot.move, robot.measure))
    fit = fit_measured(SMALL, capture, SERVOS)
    pair = [MARKERS_47.names.index(name) for name in ("outer_lip_61", "outer_lip_0")]

    def measure():
        seen_mm = robot.measure()
        n_looks.append(1)
        if len(n_looks) == 4:
            seen_mm[pair] = seen_mm[pair[::-1]]
        return seen_mm

    grade = take_grade(fit, SERVOS, MARKERS_47.names, Robot(robot.move, measure)).calibration.grade
    assert len(n_looks) == grade.n_poses + 1
    assert grade.lip_rms_mm < 1.0


def test_a_face_of_the_wrong_size_is_refused_at_its_first_pose():
    face, procedure = two_servos()
    robot, looks = SimulatedRobot(face), []

    def measure():
        looks.append(0.4 * robot.measure())
        return looks[-1]

    with pytest.raises(CalibrationError, match=r"0\.40 times as large"):
        procedure.capture(MARKERS_47.names, Robot(robot.move, measure))
    assert len(looks) == 1


def test_a_horn_that_slips_among_the_poses_of_speech_is_named():
    face, procedure = two_servos()
    robot, n_moves = SimulatedRobot(face), []

    def move(goal_deg):
        n_moves.append(1)
        robot.move(goal_deg + np.array([0.0, 15.0 * (len(n_moves) > 34)]))
        return goal_deg

    capture = procedure.capture(MARKERS_47.names, Robot(move, robot.measure))
    with pytest.raises(CalibrationError, match=r"'corners' slipped on its shaft"):
        check_capture(capture, SMALL, SERVOS.positive)


def test_the_lips_are_seen_as_far_apart_as_they_go():
    face, servos = drawn(109, 4)
    names = correspond(MARKERS_47.names)
    widest_deg = widest_pose_deg(RobotMouth(face.markers_mm, names, servos.limits_deg))
    robot = SimulatedRobot(face, noise_seed=109)
    procedure = replace(shortest(servos, 109), n_poses=30)

    capture = procedure.capture(MARKERS_47.names, Robot(robot.move, robot.measure))

    assert np.abs(capture.goals_deg - widest_deg).max(axis=1).min() < 1.0


class PowerError(Exception):
    """What a kill -9 is to a capture: nothing is said, nothing is tidied up."""


def test_a_capture_cut_short_on_its_way_and_again_while_it_is_graded_asks_for_no_pose_twice(
    tmp_path,
):
    face, procedure = two_servos()
    looks = []

    def graded(kept, fails_at=None):
        robot = SimulatedRobot(face)

        def measure():
            looks.append(1)
            if len(looks) == fails_at:
                raise PowerError
            # The same noise whenever a pose is seen, so that both ways need as many looks.
            pose = np.rint(np.abs(robot.output_deg) * 100).astype(int).tolist()
            noise = np.random.default_rng(pose).normal(0.0, 0.3, (47, 3))
            return robot.true_markers_mm() + noise

        capture = procedure.capture(MARKERS_47.names, Robot(robot.move, measure), kept=kept)
        fit = fit_measured(SMALL, capture, SERVOS)
        on = Robot(robot.move, measure)
        fit = take_grade(fit, SERVOS, MARKERS_47.names, on, kept, capture.n_planned)
        return fit.calibration.grade

    whole = graded(NOT_KEPT)
    n_looks = len(looks)
    looks.clear()
    kept = KeptPoses(tmp_path / "poses.jsonl")
    for fails_at in (10, n_looks - 5):
        with pytest.raises(PowerError):
            graded(kept, fails_at)
    resumed = graded(kept)

    assert len(looks) == n_looks + 2
    assert resumed == whole


def test_poses_to_grade_another_fit_by_are_not_taken_for_those_of_this_one(tmp_path):
    kept = KeptPoses(tmp_path / "poses.jsonl", first=20)
    earlier = plan_around(np.array([[3.0, 0.0], [0.0, 3.0]]), SERVOS.joints)
    later = plan_around(np.array([[4.0, 0.0], [0.0, 3.0]]), SERVOS.joints)
    for index in range(2):
        kept.add(CapturedPose(index, earlier.goals_deg[index], np.zeros((1, 3))), earlier, ("a",))

    assert kept.after(20, earlier).first == 20
    assert kept.after(20, later).first == 22
    assert kept.after(20, later).read(later, ("a",)) == []


def test_a_machine_takes_more_poses_for_more_joints_and_never_leaves_out_the_closing_steps():
    for n_servos in range(1, 20):
        for asked in (1, 30, 60):
            n_poses = machine_poses(asked, n_servos)
            joints = [JointRange(f"j{n}", -20.0, 20.0) for n in range(n_servos)]
            procedure = Procedure(SMALL, joints, n_poses)
            assert procedure.n_of_speech >= 2
            assert n_poses - procedure.n_of_speech >= usual_poses(n_servos)
    assert machine_poses(60, 10) == 60
    assert machine_poses(80, 10) == 80


def test_poses_of_servos_that_were_mounted_otherwise_are_refused_and_those_of_old_files_are_not(
    tmp_path,
):
    face, procedure = two_servos()
    robot, kept = SimulatedRobot(face), KeptPoses(tmp_path / "poses.jsonl", mounting="sign 1")
    on = Robot(robot.move, robot.measure)
    capture = procedure.capture(MARKERS_47.names, on, kept=kept)

    with pytest.raises(CalibrationError, match=r"line 1: not a pose .* mounted now"):
        procedure.capture(MARKERS_47.names, on, kept=replace(kept, mounting="sign -1"))
    kept.path.write_text(kept.path.read_text().replace('"mounting": "sign 1", ', ""))
    again = procedure.capture(MARKERS_47.names, on, kept=replace(kept, mounting="sign -1"))
    assert np.array_equal(again.markers_mm, capture.markers_mm)


@pytest.mark.parametrize("names", [("nose_tip",), ("outer_lip_0", "outer_lip_17"), ("lip",)])
def test_a_marker_that_is_missing_or_misspelt_is_told_before_the_robot_moves(names):
    with pytest.raises(CalibrationError, match="marker '"):
        two_servos()[1].capture(names, Robot(pytest.fail, pytest.fail))
