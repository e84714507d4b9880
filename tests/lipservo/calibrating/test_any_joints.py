"""`lipservo calibrate` on faces whose joints have other names than face_sim's."""

import pytest
from typer.testing import CliRunner

from calibration.files.calibration_file import load_calibration
from lipservo.calibrating.calibration_setup import CalibrationSetup
from lipservo.calibrating.measured_calibration import calibrate_on_servos, computed_tracker
from lipservo.cli import app
from lipservo.runtime.servos.assembly import load_settings
from lipservo.runtime.servos.sim_process import simulated_port
from lipsync.animpho.units import load_face_with_animphos

SERVO = """\
  {name}: {{id: {n}, model: XL330-M288, positive: {word}, part: {part}, min_deg: {low}, \
max_deg: {high}, max_speed_deg_s: 400}}
"""
ONE = (("hinge", "opens", -3, 24),)
STRANGE = (("kiefer", "closes", -24, 3), ("m2", "lowers", -30, 30), ("drei", "turns", -30, 30))


@pytest.fixture(autouse=True)
def fewer_frames(monkeypatch):
    """What is claimed of errors is measured elsewhere."""
    monkeypatch.setattr("calibration.fit.measured.MAX_FITTED", 60)
    monkeypatch.setattr("calibration.fit.measured.MAX_HELD_OUT", 20)


def face_of(folder, joints, part="mouth"):
    lines = [
        SERVO.format(name=name, n=11 + n, word=word, part=part, low=low, high=high)
        for n, (name, word, low, high) in enumerate(joints)
    ]
    face = folder / "face.yaml"
    face.write_text("name: a face\nrate_hz: 30\nservos:\n" + "".join(lines))
    return face


def calibrate(*arguments, **options):
    return CliRunner().invoke(app, ["calibrate", *(str(a) for a in arguments)], **options)


def test_practise_makes_a_robot_of_what_the_yaml_says_and_tells_what_is_guessed(tmp_path):
    face, out = face_of(tmp_path, STRANGE), tmp_path / "c.yaml"
    done = calibrate(
        "practise", 3, "--config", face, "--poses", 30, "--no-lags", "--accept", "-o", out
    )
    assert done.exit_code == 0, (done.output, done.exception)
    assert "what the servos m2, drei move is a guess" in done.stderr
    calibration = load_calibration(out)
    assert calibration.servo_names == ("kiefer", "m2", "drei")
    assert calibration.grade is not None


@pytest.mark.parametrize("family", ["own", "elastic"])
def test_a_seed_that_is_none_is_named_with_what_is_allowed(tmp_path, family):
    done = calibrate("practise", "--family", family, "-o", tmp_path / "c.yaml", "--", "-1")
    assert done.exit_code == 2
    assert "'SEED'" in done.output
    assert "0" in done.output
    assert "--family elastic accepts" not in done.output


@pytest.mark.parametrize("joints", [ONE, STRANGE])
def test_a_person_can_pose_any_face(tmp_path, joints):
    face, out = face_of(tmp_path, joints), tmp_path / "c.yaml"
    done = calibrate("guided", "--config", face, "-o", out, input="\n" + "d\n" * 13)
    assert done.exit_code == 0, (done.output, done.exception)
    assert load_calibration(out).origin.method == "guided"


@pytest.mark.slow
def test_a_rehearsal_over_the_wire_takes_a_jaw_of_any_name_and_no_lips(tmp_path):
    """As `measure --sim pty`, but by servos that answer in time on a machine however busy."""
    face = face_of(tmp_path, ONE)
    settings, _ = load_settings(str(face))
    with simulated_port(["--config", str(face), "--on-time"]) as port:
        setup = CalibrationSetup(
            settings.at_port(port), load_face_with_animphos(None), n_poses=6, quiet=True,
            lags=False, speed_deg_s=400.0, accept=True,
        )  # fmt: skip
        calibration = calibrate_on_servos(setup, lambda _: computed_tracker(setup)).calibration
    assert calibration.servo_names == ("hinge",)
    assert len(calibration.origin.servo_memories) == 1


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("practise", 1, "--family", "own"), "servo 'kiefer' is not in the simulated face"),
        (("fit",), "`lipservo calibrate practise SEED` calibrates a simulated robot"),
    ],
)
def test_what_needs_other_names_says_so_in_a_line(tmp_path, arguments, said):
    face, out = face_of(tmp_path, STRANGE), tmp_path / "c.yaml"
    done = calibrate(*arguments, "--config", face, "-o", out)
    assert done.exit_code == 1
    assert said in str(done.exception)
    assert not out.exists()


@pytest.mark.parametrize("arguments", [("practise", 1), ("guided",)])
def test_a_face_without_a_mouth_has_nothing_to_calibrate(tmp_path, arguments):
    face, out = face_of(tmp_path, (("yaw", "left", -30, 30),), "neck"), tmp_path / "c.yaml"
    done = calibrate(*arguments, "--config", face, "-o", out)
    assert done.exit_code == 1
    assert "no servo of `part: mouth`" in str(done.exception)
