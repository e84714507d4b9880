"""`calibrate fit --check-plan` and `calibrate grade` as they are typed: two visits to a robot."""

import csv
import json

import numpy as np
import pytest
from lipservo_lab.learning.motion.trained_model import load_trained_model
from typer.testing import CliRunner

from calibration.files.calibration_file import load_calibration
from calibration.simulated.robot import SimulatedRobot, draw_robot
from lipservo.cli import app
from lipsync.markers import MARKERS_47

MODEL = load_trained_model()
REST_MM = MODEL.markers_mm(MODEL.rest[None])[0]
LIPS = ("outer_lip_61", "outer_lip_291", "inner_lip_13", "inner_lip_14", "outer_lip_17")
NOSE = tuple(name for name in MARKERS_47.names if name.startswith("nose"))


def calibrate(*arguments):
    return CliRunner().invoke(app, ["calibrate", *(str(a) for a in arguments)])


@pytest.fixture(scope="module", autouse=True)
def fewer_frames():
    """What is claimed of errors is measured elsewhere."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("calibration.fit.measured.MAX_FITTED", 60)
        patch.setattr("calibration.fit.measured.MAX_HELD_OUT", 40)
        yield


def write_markers(plan, path, share=1.0, moved_mm=(0.0, 0.0, 0.0), poses=100):
    """What a tracker saw of a jaw; share: of an angle that its horn passes on."""
    robot = SimulatedRobot(draw_robot(REST_MM, ["jaw"], 100))
    with plan.open() as source, path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["pose", "marker", "x_mm", "y_mm", "z_mm"])
        for row in list(csv.DictReader(source))[:poses]:
            goal, side = (np.array([float(row[f"jaw_{key}"])]) for key in ("deg", "from"))
            robot.move(share * goal - 3.0 * side)
            robot.move(share * goal)
            seen_mm = robot.measure() + moved_mm
            for name in (*LIPS, *NOSE):
                place_mm = seen_mm[MARKERS_47.names.index(name)].round(3)
                writer.writerow([row["pose"], name, *place_mm])
    return path


@pytest.fixture(scope="module")
def first_visit(tmp_path_factory):
    folder = tmp_path_factory.mktemp("first")
    plan, out, check = folder / "plan.csv", folder / "jaw.yaml", folder / "check.csv"
    assert calibrate("plan", plan, "--config", "face_jaw", "--poses", 15).exit_code == 0
    markers = write_markers(plan, folder / "markers.csv")
    done = calibrate(
        "fit", "--config", "face_jaw", "--plan", plan, "--markers", markers, "-o", out,
        "--check-plan", check,
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    assert "estimated, not measured" in done.stdout
    assert f"{check}: 10 poses to grade it by" in done.stdout
    return out, check


@pytest.fixture
def visit(first_visit, tmp_path):
    """The calibration, to be changed; the check plan; and what grades it."""
    out, check = tmp_path / "jaw.yaml", first_visit[1]
    out.write_bytes(first_visit[0].read_bytes())

    def grade(markers, *options):
        how = ("--config", "face_jaw", "--plan", check, "--markers", markers)
        return calibrate("grade", out, *how, *options)

    return out, check, grade


def test_the_check_plan_is_a_plan_within_the_limits(visit):
    _, check, _ = visit
    with check.open() as file:
        rows = list(csv.DictReader(file))
    assert [row["pose"] for row in rows] == [str(i + 1) for i in range(10)]
    assert all(-2.0 <= float(row["jaw_deg"]) <= 25.0 for row in rows)
    assert sum(float(row["share"]) for row in rows) == pytest.approx(1.0, abs=1e-3)
    assert sum(float(row["human_gap_mm"]) <= 1.0 for row in rows) == 3


def test_what_was_measured_is_the_grade_in_the_file_and_is_shown(visit, tmp_path):
    out, check, grade = visit
    before = load_calibration(out)
    assert before.grade is None
    done = grade(write_markers(check, tmp_path / "seen.csv"))
    assert done.exit_code == 0, done.output
    assert "measured at 10 poses of speech that were never fitted" in done.stdout
    after = load_calibration(out)  # whole, and its checksum fits
    assert after.grade.n_poses == 10
    assert after.grade.lip_rms_mm < 1.2
    assert after.grade.gap_slope > 0.8
    assert np.array_equal(after.weights, before.weights)
    assert out.with_name("jaw.yaml.previous").exists()
    shown = json.loads(calibrate("show", out, "--json").stdout)
    assert shown["grade"]["lip_rms_mm"] == after.grade.lip_rms_mm
    assert shown["learnt_lips"]["left_out_rms_mm"] > 0.0
    assert shown["learnt_lips"]["stop"] in (True, False)
    assert 0.0 <= shown["hold_out"]["clipped_share"] <= 1.0
    classes = shown["coverage"].values()
    assert sum(reach["n_measured"] for reach in classes) == 10
    assert all((reach["measured_mm"] is None) == (reach["n_measured"] == 0) for reach in classes)
    text = calibrate("show", out).stdout
    assert "measured at 10 poses" in text
    assert all(word in text for word in ("measured", "small kept", "at limit", "P B M"))
    assert "contact:" in text


def test_a_robot_that_makes_a_third_of_its_openings_is_not_graded_without_accept(visit, tmp_path):
    out, check, grade = visit
    before = out.read_bytes()
    slack = write_markers(check, tmp_path / "slack.csv", share=0.3)
    done = grade(slack)
    assert done.exit_code == 1
    assert f"{out} stays as it is:" in str(done.exception)
    assert "--accept" in str(done.exception)
    assert out.read_bytes() == before
    assert grade(slack, "--accept").exit_code == 0
    assert load_calibration(out).grade.gap_slope < 0.5


def test_a_tripod_that_stands_elsewhere_on_the_second_visit_changes_nothing(visit, tmp_path):
    _, check, grade = visit
    moved = write_markers(check, tmp_path / "moved.csv", moved_mm=(40.0, -12.0, 5.0))
    done = grade(moved, "--json")
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert said["grade"]["lip_rms_mm"] < 1.2
    assert said["warnings"][-1].startswith("the tracker was moved since the fit")


def test_what_is_no_check_of_this_calibration_is_one_clear_line(visit, tmp_path):
    out, check, grade = visit
    before = out.read_bytes()
    seen = write_markers(check, tmp_path / "seen.csv")
    fitted = tmp_path / "plan.csv"
    calibrate("plan", fitted, "--config", "face_jaw", "--poses", 15)
    other = tmp_path / "other.csv"
    lines = check.read_text().splitlines()
    checksum = lines[1].split(",")[lines[0].split(",").index("map")]
    other.write_text(check.read_text().replace(checksum, "0123456789abcdef"))
    few = write_markers(check, tmp_path / "few.csv", poses=4)
    foreign = tmp_path / "foreign.csv"
    foreign.write_text(seen.read_text().replace("outer_lip_17", "tail"))
    how = ("--config", "face_jaw", "--markers", seen)
    for done, said in (
        (calibrate("grade", out, *how, "--plan", fitted), "has no values to grade by"),
        (calibrate("grade", out, *how, "--plan", other), "was written for another calibration"),
        (grade(few), "4 of 10 poses to grade by were captured"),
        (grade(foreign), "marker 'tail' was not captured for the fit"),
        (grade(tmp_path / "none.csv"), "none.csv: cannot be read"),
        (
            calibrate("grade", out, "--plan", check, "--markers", seen, "--config", "face_four"),
            "is not of face",
        ),
    ):
        assert done.exit_code == 1, done.output
        assert said in str(done.exception)
    assert out.read_bytes() == before


def test_poses_to_grade_by_need_markers_and_never_replace_them(tmp_path):
    out = tmp_path / "c.yaml"
    done = calibrate("fit", "--config", "face_jaw", "-o", out, "--check-plan", tmp_path / "c.csv")
    assert done.exit_code == 2
    assert "nothing is measured" in done.stderr
    plan = tmp_path / "plan.csv"
    calibrate("plan", plan, "--config", "face_jaw", "--poses", 15)
    how = ("fit", "--config", "face_jaw", "--plan", plan, "--markers", plan, "-o", out)
    done = calibrate(*how, "--check-plan", out)
    assert done.exit_code == 2
    assert "same file" in done.stderr
    assert not out.exists()
    done = calibrate(
        "fit", "--config", "face_jaw", "--plan", plan, "--markers", plan, "-o", out,
        "--check-plan", plan,
    )  # fmt: skip
    assert done.exit_code == 1
    assert not out.exists()
