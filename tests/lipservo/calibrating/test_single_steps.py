"""`lipservo calibrate pose` and `lags`: servos moved for one step of a calibration."""

import dataclasses
from importlib import resources

import numpy as np
import pytest
import yaml
from dynamixel_chain import MemoryFace
from typer.testing import CliRunner

from calibration.capture.marker_files import read_plan, write_plan
from calibration.closure import Closure
from calibration.files.calibration_file import load_calibration, save_calibration
from calibration.files.calibration_text import calibration_text
from calibration.run.compensation import trimmed
from firmware_bridge.clock import ManualClock
from firmware_bridge.dynamixel.mounting import mounted_servos
from firmware_bridge.errors import ServoError
from firmware_bridge.simulator.faults import Fault
from lipservo.calibrating import measured_calibration
from lipservo.cli import app
from lipservo.runtime.servos.assembly import bus_for
from lipservo.runtime.servos.held_face import HeldFace
from lipservo.runtime.servos.sim_process import simulated_port
from lipservo.settings.settings import load_shipped_face

SHIPPED = resources.files("lipservo.config") / "face_jaw.calibration.yaml"


def calibrate(*arguments, **options):
    return CliRunner().invoke(app, ["calibrate", *(str(a) for a in arguments)], **options)


@pytest.fixture
def plan(tmp_path):
    path = tmp_path / "plan.csv"
    assert calibrate("plan", path, "--config", "face_jaw", "--poses", "8").exit_code == 0
    return path


def test_servos_stand_in_each_pose_reached_from_the_side_it_names(plan, monkeypatch):
    led_deg = []
    move = HeldFace.move

    def noted(face, goal_deg):
        led_deg.append(goal_deg.tolist())
        return move(face, goal_deg)

    monkeypatch.setattr(HeldFace, "move", noted)
    with simulated_port(["--config", "face_jaw", "--on-time"]) as port:
        done = calibrate(
            "pose", plan, 4, 7, "--config", "face_jaw", "--port", port, "--speed", "400",
            input="\n\n",
        )  # fmt: skip
    assert done.exit_code == 0, done.output
    told = [line for line in done.stdout.splitlines() if line.startswith("pose")]
    assert [line.split(":")[0] for line in told] == ["pose 4", "pose 7"]
    goals_deg = read_plan(plan, ("jaw",)).goals_deg[[3, 6], 0]
    for line, goal_deg in zip(told, goals_deg, strict=True):
        stands, asked = (float(word) for word in line.split()[3:6:2])
        assert asked == pytest.approx(goal_deg, abs=0.05)
        assert stands == pytest.approx(goal_deg, abs=0.5)
    from_below = read_plan(plan, ("jaw",)).from_below[[3, 6], 0]
    starts_deg = np.clip(goals_deg - 3.0 * from_below, -2.0, 25.0)
    expected = [step for pair in zip(starts_deg, goals_deg, strict=True) for step in pair]
    assert np.array(led_deg)[:, 0] == pytest.approx(expected, abs=0.01)


def test_a_plan_of_another_face_moves_nothing(plan):
    written = read_plan(plan, ("jaw",))
    written.goals_deg[2] = 60.0
    write_plan(written, plan)
    done = calibrate("pose", plan, "--config", "face_jaw")
    assert done.exit_code == 1
    assert "pose 3: jaw at 60 deg is outside -2..25 deg; is it a plan of this" in str(
        done.exception
    )


def test_lags_are_found_anew_and_nothing_else_of_the_file_changes(tmp_path):
    path = tmp_path / "jaw.calibration.yaml"
    lines = SHIPPED.read_text().splitlines(keepends=True)
    meant = [line for line in lines if not line.startswith("checksum: ")]
    late = ["    lag_s: 0.1990\n" if line.startswith("    lag_s") else line for line in meant]
    path.write_text("".join(late))
    done = calibrate("lags", path, "--config", "face_jaw")
    assert done.exit_code == 0, done.output
    assert "ms late" in done.stdout
    found, before = (
        load_calibration(path),
        load_calibration(path.with_name(path.name + ".previous")),
    )
    assert before.following.lag_s.tolist() == [0.199]
    # Servos simulated to the byte in memory: 8 ms, the same whatever computer runs them.
    assert found.following.lag_s[0] == pytest.approx(0.008, abs=0.002)
    as_before = dataclasses.replace(found, following=before.following)
    assert calibration_text(as_before) == calibration_text(before)


def test_lags_of_a_mouth_with_encoders_are_measured_beside_hobby_eyes(tmp_path, monkeypatch):
    jaw = load_shipped_face("face_jaw").servos["jaw"].model_dump(exclude_unset=True)
    eye = {"part": "other", "positive": "turns", "min_deg": -20, "max_deg": 20, "us_per_deg": 10}
    eye |= {"bus": "eyes", "channel": 0, "max_speed_deg_s": 300}
    buses = {"mouth": {"kind": "simulated"}, "eyes": {"kind": "maestro", "model": "micro6"}}
    face = {"name": "eyed", "rate_hz": 50, "buses": buses}
    face["servos"] = {"jaw": jaw | {"bus": "mouth"}, "eye": eye}
    config, path = tmp_path / "eyed.yaml", tmp_path / "jaw.calibration.yaml"
    config.write_text(yaml.safe_dump(face))
    path.write_bytes(SHIPPED.read_bytes())

    def in_virtual_time(setup):
        clock = ManualClock()
        return HeldFace(setup.settings, clock, bus=bus_for(setup.settings, clock))

    monkeypatch.setattr(measured_calibration, "held_servos", in_virtual_time)
    done = calibrate("lags", path, "--config", config)
    assert done.exit_code == 0, done.output + repr(done.exception)
    assert load_calibration(path).following.lag_s.shape == (1,)


def closing_jaw(path):
    """Lips that meet where the jaw stands at 2 degrees."""
    shipped = load_calibration(SHIPPED)
    n = len(shipped.rest)
    closure = Closure(
        speaker_mm=np.zeros((3, n)),
        speaker_rest_mm=np.zeros(3),
        opens_mm=np.zeros((1, n)),
        at_deg=np.array([2.0]),
        gaps_mm=np.zeros(1),
        slopes=np.array([[0.5]]),
        bends=np.zeros((1, 1)),
        turns_deg=np.array([[2.0]]),
        press_mm=0.7,
    )
    save_calibration(dataclasses.replace(shipped, closure=closure), path)
    return path


def test_trims_that_are_set_while_the_lips_are_closed_by_eye_are_kept(tmp_path, monkeypatch):
    path = closing_jaw(tmp_path / "jaw.calibration.yaml")
    keys = []

    def press():
        if not keys:  # another page or terminal
            save_calibration(trimmed(load_calibration(path), "P", "jaw", -1.5), path)
        keys.append("\r" if len(keys) % 8 == 7 else " ")
        return keys[-1]

    monkeypatch.setattr("lipservo.terminal.keys.read_key", press)
    by_eye = ("--sim", "pty", "--by-eye", "--speed", "400", "--config", "face_jaw")
    done = calibrate("touch", path, *by_eye)
    assert done.exit_code == 0, done.output
    found = load_calibration(path)
    assert found.trim["P"].tolist() == [-1.5]
    assert found.closure.gaps_mm[0] != 0.0


@pytest.mark.parametrize("how", [["--by-eye"], []])
def test_lips_that_a_hot_servo_closes_change_no_calibration(how, tmp_path, monkeypatch):
    path, settings = closing_jaw(tmp_path / "jaw.calibration.yaml"), load_shipped_face("face_jaw")
    before = path.read_bytes()
    hot = Fault("overheat", at_s=(1.0,), lasts_s=600.0, amount=69.0)
    face = MemoryFace(servos=mounted_servos(settings.wiring), faults=(hot,))
    robot = HeldFace(settings, face.clock, bus=face.bus)
    monkeypatch.setattr("lipservo.calibrating.touching.held_servos", lambda _: robot)
    monkeypatch.setattr("lipservo.terminal.keys.read_key", lambda: " ")
    done = calibrate("touch", path, *how, "--config", "face_jaw")
    assert isinstance(done.exception, ServoError), done.output
    assert path.read_bytes() == before
