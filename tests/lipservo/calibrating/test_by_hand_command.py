"""`lipservo calibrate by-hand` as a process: what signals, refusals and scripts leave behind."""

import os
import shutil
import signal
import subprocess
import sys
import time

import pytest
from places import short_folder

from calibration.files.calibration_file import load_calibration
from lipservo.runtime.servos.sim_process import simulated_port
from lipservo.settings.settings import calibration_file, load_shipped_face


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "jaw.calibration.yaml"
    shutil.copy(str(calibration_file(load_shipped_face("face_jaw"))), path)
    return path


def begin(file, *options):
    return subprocess.Popen(
        [sys.executable, "-m", "lipservo", "calibrate", "by-hand", str(file), "--config",
         "face_jaw", *options],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "XDG_RUNTIME_DIR": str(short_folder())},
    )  # fmt: skip


@pytest.mark.slow
def test_poses_of_a_script_are_kept_in_the_file_and_torque_off_is_confirmed(file):
    with simulated_port(["--config", "face_jaw", "--on-time"]) as port:
        done = begin(file, "--port", port)
        out, err = done.communicate("     ", timeout=120)
    assert done.returncode == 0, err
    assert "hold the jaw with a hand" in err.lower()
    assert "torque off confirmed by all 1 servos; it stays off" in err
    assert set(load_calibration(file).hand_poses) == {"closed", "widest", "rounded", "touched"}
    assert file.with_name(file.name + ".previous").exists()
    assert "touched is the touch pose" in out


@pytest.mark.slow
def test_whoever_does_not_say_yes_finds_all_as_it_was(file):
    before = file.read_bytes()
    done = begin(file)
    _, err = done.communicate("n", timeout=120)
    assert done.returncode == 1
    assert "nothing was let go, and nothing kept" in err
    assert file.read_bytes() == before


@pytest.mark.slow
def test_torque_off_that_is_not_confirmed_is_told_by_the_exit_status(file):
    before = file.read_bytes()
    silent = (
        "from firmware_bridge.stopping import StopReport\n"
        "from lipservo.command_line import main\n"
        "from lipservo.runtime.servos.limp_servos import LimpServos\n"
        "LimpServos.let_go = lambda _: StopReport((), {'jaw': 'does not answer'})\n"
        "main()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", silent, "calibrate", "by-hand", str(file), "--config", "face_jaw"],
        input=" ", capture_output=True, text=True, timeout=120,
        env={**os.environ, "XDG_RUNTIME_DIR": str(short_folder())},
    )  # fmt: skip
    assert done.returncode == 3, done.stderr
    assert "not every servo confirmed torque off, so nothing was kept" in done.stderr
    assert "NOT by jaw: does not answer; keep your hands away" in done.stderr
    assert "stays off" not in done.stderr
    assert file.read_bytes() == before


@pytest.mark.parametrize(
    "number",
    [
        signal.SIGTERM,
        *(
            pytest.param(each, marks=pytest.mark.slow)
            for each in (signal.SIGINT, signal.SIGHUP, signal.SIGQUIT)
        ),
    ],
)
def test_a_signal_leaves_torque_off_confirmed_and_the_file_as_it_was(file, tmp_path, number):
    before, keep = file.read_bytes(), tmp_path / "poses.json"
    running = begin(file, "--keep", str(keep))
    running.stdin.write("  ")  # let go, and one pose
    running.stdin.flush()
    give_up_s = time.monotonic() + 120.0
    while not keep.exists():
        assert time.monotonic() < give_up_s
        assert running.poll() is None, running.stderr.read()
        time.sleep(0.01)
    running.send_signal(number)
    _, err = running.communicate(timeout=120)
    assert running.returncode == 128 + number
    assert "torque off confirmed by all 1 servos; it stays off" in err
    assert "1 poses are in" in err
    assert file.read_bytes() == before
