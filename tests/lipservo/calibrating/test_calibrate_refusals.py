"""What `lipservo calibrate` refuses before anything moves."""

import re

import numpy as np
import pytest
from typer.testing import CliRunner

from calibration.capture.capture import PosePlan
from calibration.capture.marker_files import write_plan
from lipservo.cli import app


def calibrate(*arguments):
    return CliRunner().invoke(app, ["calibrate", *(str(a) for a in arguments)])


def test_a_port_without_anybody_who_sees_the_markers_moves_nothing(tmp_path):
    """Markers of a computed face would be a calibration of nothing."""
    out = tmp_path / "c.yaml"
    done = calibrate("measure", "--config", "face_jaw", "--port", "/dev/ttyUSB77", "-o", out)
    assert done.exit_code == 2
    assert "no source of markers given" in done.stderr
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ("measure", "--tracker", "typo.txt", "--sim", "pty"),
            "--tracker typo.txt must be a",
        ),
        (
            ("measure", "--port", "/dev/ttyUSB77", "--tracker", "markers.csv"),
            "/dev/ttyUSB77: no such port",
        ),
        (("measure", "--sim", "usb"), "--sim only accepts `pty`"),
    ],
)
def test_bad_wishes_are_one_clear_line_and_write_nothing(tmp_path, arguments, said):
    out = tmp_path / "c.yaml"
    done = calibrate(*arguments, "--config", "face_jaw", "-o", out)
    assert done.exit_code == 1
    assert said in str(done.exception)
    assert not out.exists()


@pytest.mark.parametrize(
    ("goals_deg", "message"),
    [
        (np.zeros(8), "jaw never moves in it, so nothing can be learnt of it"),
        (np.linspace(0.0, 60.0, 8), r"is outside -2\.\.25 deg; is it a plan of this face"),
    ],
)
def test_a_plan_that_teaches_nothing_or_is_of_another_face_is_refused(tmp_path, goals_deg, message):
    plan, markers = tmp_path / "plan.csv", tmp_path / "m.csv"
    goals, below = goals_deg[:, None], np.ones((8, 1))
    write_plan(PosePlan(("jaw",), goals, below, goals - 3.0), plan)
    rows = [f"{pose},chin_199,0,{pose},0" for pose in range(1, 9)]
    markers.write_text("\n".join(["pose,marker,x_mm,y_mm,z_mm", *rows]) + "\n")
    out = tmp_path / "jaw.calibration.yaml"
    done = CliRunner().invoke(
        app,
        ["calibrate", "fit", "--config", "face_jaw", "--plan", str(plan), "--markers",
         str(markers), "-o", str(out)],
    )  # fmt: skip
    assert done.exit_code == 1
    assert re.search(message, str(done.exception))
    assert not out.exists()
