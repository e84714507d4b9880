"""Plans and markers in files, and the commands that use them."""

import csv
import json

import numpy as np
import pytest
from lipservo_lab.bench.calibration.every_robot import read_seeds
from lipservo_lab.learning.motion.trained_model import load_trained_model
from small_model import small_model
from typer.testing import CliRunner

from calibration.calibration import CalibrationError
from calibration.capture.capture import plan_poses
from calibration.capture.marker_files import read_capture, read_readings, write_plan
from calibration.files.calibration_file import load_calibration
from calibration.mouth_servos import JointRange
from calibration.simulated.robot import SimulatedRobot, draw_robot
from lipservo.cli import app
from lipsync.markers import MARKERS_47

SERVOS = ("jaw", "lip_protrusion")
JOINTS = [JointRange("jaw", -2.0, 25.0), JointRange("lip_protrusion", -25.0, 40.0)]


@pytest.fixture
def plan_path(tmp_path):
    path = tmp_path / "plan.csv"
    write_plan(plan_poses(JOINTS, 12), path)
    return path


def write_markers(path, readings):
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["pose", "marker", "x_mm", "y_mm", "z_mm"])
        writer.writerows(readings)
    return path


def test_a_plan_and_its_markers_come_back_as_they_were(plan_path, tmp_path):
    plan = plan_poses(JOINTS, 12)
    places = np.random.default_rng(0).normal(size=(12, 2, 3)).round(3)
    names = ("inner_lip_13", "inner_lip_14")
    readings = [
        (pose + 1, name, *places[pose, i]) for pose in range(12) for i, name in enumerate(names)
    ]
    capture = read_capture(plan_path, write_markers(tmp_path / "m.csv", readings), SERVOS)
    assert capture.marker_names == names
    assert np.allclose(capture.markers_mm, places)
    assert np.allclose(capture.goals_deg, plan.goals_deg, atol=0.005)
    assert np.array_equal(capture.from_below, plan.from_below)
    keys = ("pose", "marker", "x_mm", "y_mm", "z_mm")
    as_json = tmp_path / "m.json"
    as_json.write_text(json.dumps([dict(zip(keys, r, strict=True)) for r in readings]))
    assert np.allclose(read_capture(plan_path, as_json, SERVOS).markers_mm, places)


def test_of_several_readings_the_median_counts_and_empty_ones_are_lost(plan_path, tmp_path):
    """One wild reading among three counts for nothing."""
    readings = [(1, "a", 1, 2, 3), (1, "a", 9999, 4, 5), (1, "a", 3, -9999, 4)]
    readings += [(1, "b", "", "", ""), (3, "b", 0, 0, 9)]
    capture = read_capture(plan_path, write_markers(tmp_path / "m.csv", readings), SERVOS)
    assert capture.markers_mm[0, 0].tolist() == [3.0, 2.0, 4.0]
    assert np.isnan(capture.markers_mm[0, 1]).all()
    assert len(capture) == 2
    assert capture.markers_mm[1, 1, 2] == 9.0


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("m.csv", "pose,marker,x_mm,y_mm\n", r"m\.csv: column 'z_mm' is missing"),
        ("m.csv", "pose,marker,x_mm,y_mm,z_mm\n1,a,1,far,3\n", r"line 2: 'far' is not a number"),
        ("m.csv", "pose,marker,x_mm,y_mm,z_mm\n1.5,a,1,2,3\n", "pose '1.5' is not a whole"),
        ("m.csv", "pose,marker,x_mm,y_mm,z_mm\n99,a,1,2,3\n", r"pose 99 is not in .*plan\.csv"),
        ("m.csv", "pose,marker,x_mm,y_mm,z_mm\n1,a,inf,2,3\n", "'inf' is not a number"),
        ("m.csv", "pose,marker,x_mm,y_mm,z_mm\n", r"m\.csv: has no readings"),
        ("m.csv", "pose,marker,x_mm,y_mm,z_mm\n1,a,1,5,2,3\n", "line 2: has more values than"),
        ("m.csv", f"pose,marker,x_mm,y_mm,z_mm\n1,{'a' * 200_000},1,2,3\n", "readable as CSV"),
        ("m.json", "{", "not readable as JSON"),
        ("m.json", "{}", "must be a list of readings"),
        ("m.json", '[{"pose": 1}]', "reading 1: 'marker' is missing"),
    ],
)
def test_what_is_wrong_with_a_marker_file_is_one_line_with_its_place(
    plan_path, tmp_path, name, text, message
):
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(CalibrationError, match=message) as caught:
        read_capture(plan_path, path, SERVOS)
    assert "\n" not in str(caught.value)


def test_a_plan_of_another_face_is_refused(plan_path, tmp_path):
    markers = write_markers(tmp_path / "m.csv", [(1, "a", 1, 2, 3)])
    with pytest.raises(CalibrationError, match="column 'corner_left_up_deg' is missing"):
        read_capture(plan_path, markers, ("jaw", "corner_left_up"))


def command(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def test_plan_then_markers_then_calibration_by_files_alone(tmp_path):
    """A jaw measured by hand: five points of the lips and the chin, in a spreadsheet."""
    plan_path, out = tmp_path / "plan.csv", tmp_path / "jaw.calibration.yaml"
    done = command("calibrate", "plan", plan_path, "--config", "face_jaw", "--poses", "15")
    assert done.exit_code == 0
    model = load_trained_model()
    robot = SimulatedRobot(draw_robot(model.markers_mm(model.rest[None])[0], ["jaw"], 100))
    names = ("outer_lip_61", "outer_lip_291", "inner_lip_13", "inner_lip_14", "outer_lip_17")
    readings = []
    with plan_path.open() as file:
        for row in csv.DictReader(file):
            goal, side = float(row["jaw_deg"]), float(row["jaw_from"])
            robot.move(np.array([goal - 3.0 * side]))
            robot.move(np.array([goal]))
            seen = dict(zip(MARKERS_47.names, robot.measure(), strict=True))
            readings += [(row["pose"], name, *seen[name].round(2)) for name in names]
    markers = write_markers(tmp_path / "m.csv", readings)
    done = command(
        "calibrate", "fit", "--config", "face_jaw", "--plan", plan_path, "--markers", markers,
        "-o", out, "--json",
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["gap_correlation"] > 0.95
    calibration = load_calibration(out)
    assert calibration.origin.method == "measured"
    wide = model.animphos.samples[model.animphos.of_phoneme("AA"), 2]
    assert np.median([calibration.positions_deg(c)[0] for c in wide]) > 4.0


@pytest.mark.slow
def test_practice_on_a_simulated_robot_tells_errors_play_and_lags(tmp_path):
    out, keep = tmp_path / "c.yaml", tmp_path / "poses.jsonl"
    done = command(
        "calibrate", "practise", "100", "--config", "face_four", "--poses", "30",
        "--keep", keep, "-o", out,
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    assert "mm from the shapes of speech" in done.stdout
    assert "ms late" in done.stdout
    # Lips are closed in steps afterwards, and the first poses taken again.
    assert 30 < len(keep.read_text().splitlines()) < 90
    assert load_calibration(out).following.lag_s.min() > 0.02


def test_markers_without_a_plan_and_no_output_are_refused(tmp_path):
    assert command("calibrate", "fit", "--markers", tmp_path / "m.csv", "-o", "x").exit_code != 0
    assert command("calibrate").exit_code != 0


@pytest.mark.parametrize("text", ["", "a-b", "3-1", "1-2-3", "-4"])
def test_seeds_that_are_no_range_are_refused(text):
    with pytest.raises(CalibrationError, match="--seeds"):
        read_seeds(text)


def test_seeds_are_one_number_or_a_range():
    assert read_seeds("7") == [7]
    assert read_seeds("3-5") == [3, 4, 5]


def test_small_models_are_enough_for_a_plan_and_the_simulated_robot():
    model = small_model()
    robot = SimulatedRobot(draw_robot(model.markers_mm(model.rest[None])[0], SERVOS, 3))
    assert robot.measure().shape == (47, 3)


@pytest.mark.parametrize("value", ["1e300", "-250000", "9e9"])
def test_a_number_that_is_no_place_is_refused_with_its_line(tmp_path, value):
    path = tmp_path / "m.csv"
    path.write_text(f"pose,marker,x_mm,y_mm,z_mm\n1,a,1,2,3\n1,b,1,{value},3\n")
    with pytest.raises(CalibrationError, match=r"line 3: y_mm is .*give it in millimetres"):
        read_readings(path)


def test_poses_without_markers_are_counted_and_named(tmp_path):
    plan, markers = tmp_path / "plan.csv", tmp_path / "m.csv"
    write_plan(plan_poses([JointRange("jaw", -2.0, 25.0)], 12), plan)
    markers.write_text("pose,marker,x_mm,y_mm,z_mm\n1,a,1,2,3\n2,a,1,2,3\n")
    capture = read_capture(plan, markers, ("jaw",))
    assert len(capture) == 2
    assert capture.stalled == (
        "no markers for 10 of 12 poses, which are left out: 3, 4, 5, 6, 7, 8, 9, 10, ...",
    )
