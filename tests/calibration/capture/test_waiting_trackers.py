"""Trackers that wait for a file, a folder or a person; captures in two parts."""

import dataclasses
import json

import numpy as np
import pytest
from small_model import small_model

from calibration.calibration import (
    Calibration,
    CalibrationError,
    CouplingRule,
    Origin,
    ServoMemory,
    Touch,
    check_servo_memories,
)
from calibration.capture.capture import KeptPoses, Robot, ladders_of
from calibration.capture.repeated_poses import poses_to_repeat
from calibration.capture.trackers import PATIENCE_S, FileTracker
from calibration.files.calibration_file import parse_calibration
from calibration.files.calibration_text import calibration_text
from calibration.fit.learnt_face import fit_calibration
from calibration.fit.procedure import Procedure
from calibration.mouth_servos import JointRange
from calibration.simulated.robot import SimulatedRobot, draw_robot
from lipsync.markers import MARKERS_47

HEADER = "pose,marker,x_mm,y_mm,z_mm\n"
MODEL = small_model()
SERVOS = ("jaw", "lip_protrusion")
JOINTS = [JointRange("jaw", -2.0, 25.0), JointRange("lip_protrusion", -25.0, 40.0)]


class Wire:
    """Time that passes in `wait`, and what somebody writes meanwhile: (after_s, text to add)."""

    def __init__(self, path, *writes):
        self.path, self.writes, self.now_s, self.said = path, list(writes), 0.0, []

    def wait(self, seconds):
        self.now_s += seconds
        while self.writes and self.writes[0][0] <= self.now_s:
            with self.path.open("a") as file:
                file.write(self.writes.pop(0)[1])


def test_a_file_is_read_while_another_program_is_still_writing_it(tmp_path):
    path = tmp_path / "m.csv"
    wire = Wire(
        path,
        (0.5, HEADER + "0,a,1,2,3\n0,b,1,2,3\n"),
        (2.0, "1,a,4,5,6\n1,b,7,"),  # cut in the middle of a number
        (2.3, "8,9\n"),
        (4.0, "2,b,1,1,1\n"),  # a is lost
    )
    tracker = FileTracker(path, SERVOS, wire.wait, wire.said.append)
    told = tmp_path / "m.csv.pose.json"
    assert tracker.marker_names == ("a", "b")
    tracker.arrived(0, np.array([3.0, -4.0]))
    assert json.loads(told.read_text()) == {
        "pose": 1, "servos_deg": {"jaw": 3.0, "lip_protrusion": -4.0}
    }  # fmt: skip
    assert tracker.measure().tolist() == [[4.0, 5.0, 6.0], [7.0, 8.0, 9.0]]
    tracker.arrived(1, np.zeros(2))
    seen = tracker.measure()
    assert np.isnan(seen[0]).all()
    assert seen[1].tolist() == [1.0, 1.0, 1.0]
    assert wire.said[-1] == f"pose 2 stands: record it in {path}"
    tracker.arrived(0, np.zeros(2))  # it stands again, and shows what was recorded
    assert tracker.measure().tolist() == [[4.0, 5.0, 6.0], [7.0, 8.0, 9.0]]
    tracker.close()
    assert not told.exists()


def test_a_tracker_that_stalls_is_waited_for_no_longer_than_a_person_needs(tmp_path):
    path = tmp_path / "m.csv"
    path.write_text(HEADER + "0,a,1,2,3\n")
    wire = Wire(path)
    tracker = FileTracker(path, SERVOS, wire.wait, wire.said.append)
    tracker.arrived(0, np.zeros(2))
    with pytest.raises(CalibrationError, match=r"no pose 1 was recorded in 300 s; is the"):
        tracker.measure()
    assert wire.now_s == pytest.approx(PATIENCE_S, abs=1.0)


def test_a_pose_recorded_just_before_a_capture_was_killed_is_read_and_not_asked_for_again(tmp_path):
    path = tmp_path / "m.csv"
    path.write_text(HEADER + "0,a,1,2,3\n1,a,4,5,6\n2,a,7,8,9\n")
    wire = Wire(path)
    kept = {0: {"a": np.array([4.0, 5.0, 6.0])}}
    tracker = FileTracker(path, SERVOS, wire.wait, wire.said.append, kept=kept)
    tracker.arrived(1, np.zeros(2))
    assert tracker.measure().tolist() == [[7.0, 8.0, 9.0]]
    assert wire.said == [f"pose 2 is in {path} already, and is read from there"]
    assert not (tmp_path / "m.csv.pose.json").exists()


@pytest.mark.parametrize(
    ("rows", "kept_mm", "said"),
    [
        (
            "1,a,4,5,6\n2,a,7,8,9\n3,a,7,8,9\n",
            None,
            "it already has pose 1, so it is of another capture",
        ),
        (
            "1,a,4,5,6\n",
            4.2,
            "its pose 1 differs from the captured one, so it is of another capture",
        ),
    ],
)
def test_a_file_of_another_capture_is_refused_before_it_is_used(tmp_path, rows, kept_mm, said):
    path = tmp_path / "m.csv"
    path.write_text(HEADER + "0,a,1,2,3\n" + rows)
    kept = {} if kept_mm is None else {0: {"a": np.array([kept_mm, 5.0, 6.0])}}

    with pytest.raises(CalibrationError, match=said):
        FileTracker(path, SERVOS, Wire(path).wait, print, kept=kept).arrived(0, np.zeros(2))


def test_a_file_that_is_wrong_is_named_and_not_waited_for(tmp_path):
    path = tmp_path / "m.csv"
    path.write_text("pose,marker,x,y,z\n")
    with pytest.raises(CalibrationError, match="column 'x_mm' is missing"):
        FileTracker(path, SERVOS, Wire(path).wait, print)


def robot():
    rest_mm = MODEL.markers_mm(MODEL.rest[None])[0]
    return SimulatedRobot(draw_robot(rest_mm, SERVOS, 104))


def test_the_second_part_of_a_capture_is_where_speech_will_be_and_keeps_the_rules(tmp_path):
    """And one that was cut short in the second part goes on there, with the same poses."""
    rule = CouplingRule(np.array([1.0, 1.0]), 30.0)
    procedure = Procedure(MODEL, JOINTS, 20, (rule,), seed=3)
    assert procedure.n_of_speech == 5
    keep = KeptPoses(tmp_path / "poses.jsonl")
    first = robot()
    looks = iter(range(17))

    def measure_until_the_power_goes():
        next(looks)
        return first.measure()

    with pytest.raises(StopIteration):
        procedure.capture(
            MARKERS_47.names, Robot(first.move, measure_until_the_power_goes), kept=keep
        )
    before = [json.loads(line)["goals_deg"] for line in keep.path.read_text().splitlines()]
    assert len(before) == 17
    second = robot()
    capture = procedure.capture(MARKERS_47.names, Robot(second.move, second.measure), kept=keep)
    again = len(poses_to_repeat(procedure.range_plan()))
    assert (ladders_of(capture) == 0).sum() == 20 + again
    assert np.allclose(capture.goals_deg[:17], before, atol=1e-3)
    assert (capture.goals_deg @ rule.weights <= 30.0 + 1e-9).all()
    speech = capture.goals_deg[15:20]
    assert np.ptp(speech, axis=0)[1] < np.ptp(capture.goals_deg[:15], axis=0)[1]


MEMORY = ServoMemory(0, 0, 1968, 2389)


def with_memories(*memories) -> Calibration:
    fitted = fit_calibration(MODEL, JOINTS, "f" * 16)
    origin = Origin("measured", "2026-11-21", 20, (), memories)
    touch = Touch(np.zeros(2), 294.0)
    return dataclasses.replace(fitted, origin=origin, touch=touch)


def test_what_servos_keep_is_in_the_file_and_compared_by_name():
    calibration = with_memories(MEMORY, ServoMemory(-5, 1, 0, 4095))
    read = parse_calibration(calibration_text(calibration), "c.yaml")
    assert read.origin.servo_memories == calibration.origin.servo_memories
    check_servo_memories(read, read.origin.servo_memories)
    check_servo_memories(read, (None, read.origin.servo_memories[1]))
    for other, said in (
        (ServoMemory(7, 0, 1968, 2389), "'jaw' has homing offset 7 and was calibrated with 0"),
        (ServoMemory(0, 1, 1968, 2389), "'jaw' has drive mode 1 and was"),
        (ServoMemory(0, 0, 1000, 2389), "'jaw' has min position limit 1000 and was"),
    ):
        with pytest.raises(CalibrationError, match=f"{said}.*run `lipservo setup-servos`, or cal"):
            check_servo_memories(read, (other, read.origin.servo_memories[1]))
    without = with_memories()
    check_servo_memories(without, (MEMORY, MEMORY))
    check_servo_memories(without, ())  # hobby servos store nothing
    check_servo_memories(read, ())


def test_a_capture_that_ends_before_its_first_pose_leaves_no_pose_file(tmp_path):
    """A stop by a person strikes while the robot waits in neutral for a tracker."""

    def stopped(_seconds: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        FileTracker(tmp_path / "m.csv", SERVOS, stopped, [].append)
    assert list(tmp_path.iterdir()) == []
