"""`lipservo calibrate show` and `trim`: a calibration file that is there already."""

import json
from importlib import resources

import pytest
from typer.testing import CliRunner

from calibration.files.calibration_file import load_calibration
from lipservo.cli import app


def calibrate(*arguments):
    return CliRunner().invoke(app, ["calibrate", *(str(a) for a in arguments)])


@pytest.fixture
def path(tmp_path):
    shipped = resources.files("lipservo.config") / "face_four.calibration.yaml"
    file = tmp_path / "c.yaml"
    lines = shipped.read_text().splitlines(keepends=True)
    # Without its checksum, as after a change that is meant: the tests here change it.
    file.write_text("".join(line for line in lines if not line.startswith("checksum: ")))
    return file


def test_trims_are_set_shown_and_taken_back(path):
    assert calibrate("trim", path).stdout == "no trims\n"
    assert calibrate("trim", path, "B", "jaw", "-1.5").stdout == "P: jaw -1.5 deg\n"
    assert load_calibration(path).trim["P"].tolist() == [-1.5, 0.0, 0.0, 0.0]
    assert calibrate("trim", path, "AA", "lip_protrusion", "2").exit_code == 0
    assert calibrate("trim", path).stdout == "P: jaw -1.5 deg\nAA: lip_protrusion +2 deg\n"
    assert calibrate("trim", path, "P", "jaw", "0").stdout == "AA: lip_protrusion +2 deg\n"
    before = path.read_text()
    for wrong, said in (
        (("Q", "jaw", "1"), "no phoneme 'Q'; one of each viseme: SIL P"),
        (("P", "tail", "1"), "this calibration has no joint 'tail'; it has jaw,"),
        (("P", "jaw", "99"), "jaw turns 27 deg in all, not 99"),
        (("P", "jaw", "nan"), "jaw turns 27 deg in all, not nan"),
    ):
        done = calibrate("trim", path, *wrong)
        assert done.exit_code == 1
        assert said in str(done.exception)
    assert path.read_text() == before


def test_each_servo_is_shown_with_its_error_lag_and_backlash(path):
    said = json.loads(calibrate("show", path, "--json").stdout)
    calibration = load_calibration(path)
    assert list(said["servos"]) == list(calibration.servo_names)
    jaw = said["servos"]["jaw"]
    assert jaw["range_deg"] == [-2.0, 25.0]
    assert jaw["hold_out_rms_deg"] == calibration.errors.joint_rms_deg[0]
    assert jaw["lag_ms"] == pytest.approx(calibration.following.lag_s[0] * 1000, abs=1e-3)
    assert jaw["backlash_deg"] == calibration.following.backlash_deg[0]
    assert said["hold_out"]["lip_rms_mm"] == calibration.errors.lip_rms_mm
    shown = calibrate("show", path).stdout
    assert all(word in shown for word in ("jaw", "lag ms", "backlash", "method: simulated face"))


def test_the_rules_of_a_face_are_shown_with_its_calibration(path, tmp_path):
    face = tmp_path / "face.yaml"
    shipped = (resources.files("lipservo.config") / "face_four.yaml").read_text()
    face.write_text(
        shipped
        + "prevent:\n  - {joints: {jaw: 1.0, lip_protrusion: 0.5}, above: 30.0, because: lips}\n"
    )
    shown = calibrate("show", path, "--config", face).stdout
    assert "rule: 1 x jaw + 0.5 x lip_protrusion <= 30 deg (lips)" in shown
    said = json.loads(calibrate("show", path, "--config", face, "--json").stdout)
    assert said["rules"][0]["above"] == 30.0


def test_a_file_of_a_servo_without_lags_shows_that_nobody_knows_them(path):
    kept = [line for line in path.read_text().splitlines() if not unknown(line)]
    path.write_text("\n".join(kept) + "\n")
    said = json.loads(calibrate("show", path, "--json").stdout)
    assert {servo["lag_ms"] for servo in said["servos"].values()} == {None}
    assert calibrate("show", path).exit_code == 0


def unknown(line):
    keys = ("lag_s:", "backlash_deg:", "top_speed_deg_s:", "bandwidth_hz:")
    return line.strip().startswith(keys)


def test_what_is_within_reach_is_drawn_from_the_file_alone(path, tmp_path):
    pytest.importorskip("matplotlib", reason="pictures need matplotlib, the extra `plots`")
    refused = calibrate("show", path, "--plots", tmp_path / "plots")
    assert "needs a measured calibration" in str(refused.exception)
    with path.open("a") as file:
        file.write("coverage:\n  P: {reachable: 0.9, off_mm: 0.4}\n")
    assert calibrate("show", path, "--plots", tmp_path / "plots").exit_code == 0
    assert (tmp_path / "plots" / "coverage.png").read_bytes()[:4] == b"\x89PNG"
