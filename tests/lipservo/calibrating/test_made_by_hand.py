"""Trims, hand poses and the touch pose when a face is calibrated again."""

import dataclasses
import shutil

import numpy as np
import pytest
from typer.testing import CliRunner

from calibration.calibration import ServoMemory, Touch
from calibration.files.calibration_file import load_calibration, save_calibration
from calibration.mouth_servos import JointRange, MouthServos
from calibration.run.compensation import trimmed
from lipservo.calibrating.hand_poses import with_kept_hand_parts
from lipservo.cli import app
from lipservo.settings.settings import calibration_file, load_shipped_face

SETTINGS = load_shipped_face("face_four")
SERVOS = MouthServos(
    tuple(JointRange(n, s.min_deg, s.max_deg) for n, s in SETTINGS.mouth_servos.items()),
    positive=tuple(s.positive for s in SETTINGS.mouth_servos.values()),
)


@pytest.fixture
def fresh():
    return load_calibration(calibration_file(SETTINGS))


@pytest.fixture
def output(tmp_path):
    return tmp_path / "four.calibration.yaml"


def test_trims_poses_and_touch_are_kept_and_told(fresh, output):
    old = dataclasses.replace(
        trimmed(fresh, "P", "jaw", -1.5),
        touch=Touch(np.array([0.5, 0.0, 0.0, 1.0]), 250.0),
        hand_poses={"widest": np.array([14.0, 0.0, 0.0, 0.0])},
    )
    save_calibration(old, output)
    again, lines = with_kept_hand_parts(fresh, SERVOS, output)
    assert again.trim["P"].tolist() == [-1.5, 0.0, 0.0, 0.0]
    assert again.touch.positions_deg.tolist() == [0.5, 0.0, 0.0, 1.0]
    assert again.hand_poses["widest"].tolist() == [14.0, 0.0, 0.0, 0.0]
    assert again.max_deg[0] == 14.0
    assert np.array_equal(again.weights, fresh.weights)
    assert "trims are kept: P" in lines
    assert "hand poses are kept: widest" in lines


def test_a_touch_pose_by_hand_goes_before_one_that_was_fitted(fresh, output):
    by_hand = np.array([1.0, 0.0, 0.0, 0.0])
    save_calibration(dataclasses.replace(fresh, hand_poses={"touched": by_hand}), output)
    fitted = dataclasses.replace(fresh, touch=Touch(np.full(4, 3.0), 294.0))
    again, _ = with_kept_hand_parts(fitted, SERVOS, output)
    assert again.touch.positions_deg.tolist() == by_hand.tolist()
    assert again.touch.current_cap_ma == 294.0


def test_servos_that_were_set_up_anew_lose_their_hand_poses(fresh, output):
    def with_offset(offset):
        memories = (ServoMemory(offset, 0, 0, 4095),) * 4
        return dataclasses.replace(
            fresh, origin=dataclasses.replace(fresh.origin, servo_memories=memories)
        )

    save_calibration(dataclasses.replace(with_offset(0), hand_poses={"closed": np.ones(4)}), output)
    again, lines = with_kept_hand_parts(with_offset(100), SERVOS, output)
    assert again.hand_poses == {}
    assert "set up anew" in lines[0]


def test_a_trim_farther_than_the_new_joint_turns_is_named(fresh, output):
    save_calibration(trimmed(fresh, "P", "jaw", 20.0), output)
    narrow = dataclasses.replace(fresh, max_deg=fresh.max_deg * 0.5)
    again, lines = with_kept_hand_parts(narrow, SERVOS, output)
    assert "P" not in again.trim
    assert "trims of P are not kept" in lines[0]


def test_a_damaged_file_is_no_reason_not_to_calibrate(fresh, output):
    save_calibration(trimmed(fresh, "P", "jaw", -1.0), output)
    output.write_text(output.read_text().replace("max_deg: 25.0", "max_deg: 24.0"))
    again, lines = with_kept_hand_parts(fresh, SERVOS, output)
    assert again is fresh
    assert "its checksum differs" in lines[0]


def test_nothing_is_said_where_there_was_nothing(fresh, output):
    assert with_kept_hand_parts(fresh, SERVOS, output) == (fresh, [])
    save_calibration(fresh, output)
    assert with_kept_hand_parts(fresh, SERVOS, output)[1] == []


def test_calibrating_again_on_the_command_line_keeps_a_trim(tmp_path):
    path = tmp_path / "jaw.calibration.yaml"
    shutil.copy(str(calibration_file(load_shipped_face("face_jaw"))), path)
    run = CliRunner().invoke
    assert run(app, ["calibrate", "trim", str(path), "P", "jaw", "-1"]).exit_code == 0
    done = run(app, ["calibrate", "fit", "--config", "face_jaw", "--no-lags", "-o", str(path)])
    assert done.exit_code == 0, done.output
    assert "trims are kept: P" in done.stderr
    assert load_calibration(path).trim["P"].tolist() == [-1.0]
