"""`lipservo calibrate unit`: a design's calibration on another unit, by eye and by a tracker."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from lipservo_lab.bench.calibration.elastic_draws import draw_elastic_robot
from lipservo_lab.bench.calibration.unit_figures import sister_of
from small_model import small_model
from typer.testing import CliRunner

from calibration.calibration import CalibrationError
from calibration.capture.capture import KeptPoses, Robot
from calibration.files.calibration_file import load_calibration
from calibration.fit.measured import fit_measured
from calibration.fit.procedure import Procedure
from calibration.simulated.elastic_robot import ElasticFace
from calibration.simulated.robot import SimulatedRobot
from lipservo.calibrating.unit_calibration import Design, capture_unit
from lipservo.cli import app
from lipservo.settings.settings import calibration_file, load_shipped_face
from lipsync.markers import MARKERS_47

MODEL = small_model()
N_POSES = 14


@pytest.fixture
def base(tmp_path):
    path = tmp_path / "design.calibration.yaml"
    shutil.copy(str(calibration_file(load_shipped_face("face_four"))), path)
    return path


def unit(*arguments, **options):
    return CliRunner().invoke(app, ["calibrate", "unit", *(str(a) for a in arguments)], **options)


def test_poses_that_a_person_leaves_as_they_are_make_the_designs_map(base, tmp_path):
    out = tmp_path / "mine.calibration.yaml"
    done = unit(base, "--config", "face_four", "-o", out, input="\n" * N_POSES)
    assert done.exit_code == 0, (done.output, done.exception)
    design, mine = load_calibration(base), load_calibration(out)
    assert mine.weights == pytest.approx(design.weights)
    assert mine.rest_deg == pytest.approx(design.rest_deg, abs=1e-6)
    assert (mine.origin.method, mine.origin.poses) == ("unit by eye", N_POSES)
    assert mine.face_checksum == load_shipped_face("face_four").checksum


def test_a_joint_that_a_person_turns_in_every_pose_is_turned_in_the_map(base, tmp_path):
    out = tmp_path / "mine.calibration.yaml"
    done = unit(base, "--config", "face_four", "-o", out, input="sD\n" + "D\n" * (N_POSES - 1))
    assert done.exit_code == 0, (done.output, done.exception)
    design, mine = load_calibration(base), load_calibration(out)
    turned_deg = mine.rest_deg - design.rest_deg
    assert turned_deg[1] == pytest.approx(5.0, abs=1.0)
    assert np.delete(turned_deg, 1) == pytest.approx(0.0, abs=1e-6)


def test_too_few_poses_are_refused_and_kept(base, tmp_path):
    out = tmp_path / "mine.calibration.yaml"
    done = unit(base, "--config", "face_four", "-o", out, input="\n\nq")
    assert done.exit_code == 1
    assert "3 other poses at least" in str(done.exception)
    assert not out.exists()
    done = unit(base, "--config", "face_four", "-o", out, input="\n" * (N_POSES - 2))
    assert done.exit_code == 0, (done.output, done.exception)


@pytest.mark.parametrize(
    ("config", "more", "said"),
    [
        ("face_jaw", (), "is of another design, whose joints are"),
        ("face_four", ("--tracker", "m.csv"), "the poses that .* was measured by are not there"),
    ],
)
def test_a_file_of_another_design_or_without_its_poses_is_refused(
    base, tmp_path, config, more, said
):
    out = tmp_path / "mine.calibration.yaml"
    done = unit(base, "--config", config, "-o", out, *more)
    assert done.exit_code == 1
    with pytest.raises(type(done.exception), match=said):
        raise done.exception
    assert not out.exists()


def test_a_damaged_file_of_the_designs_poses_is_refused(base, tmp_path):
    base.with_name(f"{base.name}.poses").write_text("servo_names: [jaw]\n")
    out = tmp_path / "mine.calibration.yaml"
    done = unit(base, "--config", "face_four", "-o", out, "--tracker", "m.csv")
    assert done.exit_code == 1
    assert "design.calibration.yaml.poses, line 1" in str(done.exception)


def test_the_designs_file_is_never_written_over(base):
    before = base.read_bytes()
    done = unit(base, "--config", "face_four", "-o", base, input="\n" * N_POSES)
    assert done.exit_code == 1
    assert base.read_bytes() == before


@pytest.fixture(scope="module")
def design():
    """Return a design of four servos, its robot and its servos."""
    draw, servos = draw_elastic_robot(MODEL.markers_mm(MODEL.rest[None])[0], 40_003, 4)
    robot = SimulatedRobot(ElasticFace(draw), noise_seed=1)
    procedure = Procedure(MODEL, servos.joints, 60, seed=1, positive=servos.positive)
    capture = procedure.capture(MARKERS_47.names, Robot(robot.move, robot.measure))
    return Design.learnt(fit_measured(MODEL, capture, servos).calibration, capture), draw, servos


def test_an_interrupted_capture_of_a_unit_goes_on_with_the_pose_that_was_next(design, tmp_path):
    known, draw, servos = design
    robot = SimulatedRobot(ElasticFace(sister_of(draw, 5)), noise_seed=2)
    kept, n_measured = KeptPoses(tmp_path / "kept"), []

    def measure():
        if len(n_measured) == 12:
            raise KeyboardInterrupt
        n_measured.append(1)
        return robot.measure()

    def capture(look):
        by = Robot(robot.move, look)
        return capture_unit(known, MODEL, servos, MARKERS_47.names, by, kept)

    with pytest.raises(KeyboardInterrupt):
        capture(measure)
    n_measured.clear()
    found = capture(measure)
    assert len(n_measured) == 3
    assert len(found) - len(known.capture) == 15
    assert found.ladders[-5:].tolist() == [known.capture.ladders.max() + 1] * 5
    again = capture(lambda: pytest.fail("nothing is left to be measured"))
    assert np.array_equal(again.markers_mm, found.markers_mm)


def test_a_jaw_a_tooth_off_is_named_before_lips_are_closed(design):
    known, draw, servos = design
    robot = SimulatedRobot(ElasticFace(sister_of(draw, 5, tooth_off=draw.jaw)), noise_seed=2)
    looks = []
    by = Robot(robot.move, lambda: looks.append(1) or robot.measure())
    with pytest.raises(CalibrationError, match=f"tooth of a horn: .*{servos.names[draw.jaw]} "):
        capture_unit(known, MODEL, servos, MARKERS_47.names, by)
    assert len(looks) == 10


def test_a_tracker_that_sees_what_the_design_lacks_is_refused(design):
    known, _, servos = design
    fewer = replace(known, capture=replace(known.capture, marker_names=("chin_199",)))
    by = Robot(lambda deg: deg, lambda: pytest.fail("measured"))
    with pytest.raises(CalibrationError, match=r"measured without the markers .*inner_lip_13"):
        capture_unit(fewer, MODEL, servos, MARKERS_47.names, by)


def test_a_tracker_with_fewer_markers_in_another_order_is_enough(design):
    known, draw, servos = design
    robot = SimulatedRobot(ElasticFace(sister_of(draw, 5)), noise_seed=2)
    rows = [row for row in range(46, -1, -1) if row not in range(12, 20)]  # no nose, half a jaw
    names = tuple(MARKERS_47.names[row] for row in rows)
    by = Robot(robot.move, lambda: robot.measure()[rows])
    found = capture_unit(known, MODEL, servos, names, by, sees_forward=False)
    assert found.marker_names == names
    # Poses of the design as the unit shows them, and the unit's own without depth.
    off_mm = found.markers_mm[0] - found.markers_mm[-15]
    assert np.sqrt(np.mean(off_mm[:, :2] ** 2)) < 1.0
    assert np.isnan(found.markers_mm[-15:, :, 2]).all()
