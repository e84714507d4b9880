"""A jaw at a simulated PCA9685 whose OE pin has a guard: whatever dies, its pulses end.

Judged by the simulator's own log: a pulse is one at the servo, of registers and OE together.
"""

import os
import signal
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from places import ROOT
from running_daemon import all_driven, child, log, own_folder, run, running, wait_for

from firmware_bridge.pca9685.controller import NO_GUARD
from lipservo.runtime.servos.sim_process import simulated_port

# Real processes in real time.
pytestmark = pytest.mark.slow
WORDS = "computer dies, or the plug is pulled: pulses off; a digital servo may hold"


@pytest.fixture
def board(tmp_path, monkeypatch):
    own_folder(monkeypatch)
    shipped = (ROOT / "config/face_jaw_pca9685.yaml").read_text()
    pin, face = tmp_path / "oe", tmp_path / "face.yaml"
    keys = f"kind: pca9685\n  oe_gpio: 17\n  gpio_chip: {pin}"
    face.write_text(shipped.replace("kind: pca9685", keys))
    calibration = "face_jaw.calibration.yaml"
    (tmp_path / calibration).write_text((ROOT / "config" / calibration).read_text())
    path, link = tmp_path / "pulses.jsonl", tmp_path / "port"
    arguments = ["--config", str(face), "--log", str(path), "--link", str(link), "--on-time"]
    with simulated_port(arguments):
        yield SimpleNamespace(face=str(face), port=str(link), log=path, folder=tmp_path)


@pytest.fixture
def daemon(board):
    with running(board.port, board.folder, "--config", board.face) as process:
        wait_for(lambda: all_driven(process) and has_pulses(board, 0.2))
        yield process


def has_pulses(board, seconds=0.3):
    n_before = len(board.log.read_text().splitlines())
    time.sleep(seconds)
    return len(board.log.read_text().splitlines()) > n_before


def guard_of(daemon):
    """Of the bridge that runs; by the arguments of its children."""
    bridge = child(daemon, "bridge")
    for pid in Path(f"/proc/{bridge}/task/{bridge}/children").read_text().split():
        if b"oe_guard" in Path(f"/proc/{pid}/cmdline").read_bytes():
            return int(pid)
    raise AssertionError("no guard")


def pids(daemon):
    return [daemon.pid, child(daemon, "bridge"), child(daemon, "speech")]


def kill_all(daemon):
    for pid in pids(daemon):
        os.kill(pid, signal.SIGSTOP)
    for pid in pids(daemon):
        os.kill(pid, signal.SIGKILL)
    daemon.wait(20.0)


def test_after_all_are_killed_pulses_end_and_a_start_brings_them_back(daemon, board):
    assert WORDS in log(daemon)
    assert NO_GUARD not in log(daemon)
    kill_all(daemon)
    wait_for(lambda: not has_pulses(board))
    daemon.control.unlink()  # of a face that is no more
    (folder := board.folder / "again").mkdir()
    with running(board.port, folder, "--config", board.face) as again:
        wait_for(lambda: all_driven(again) and has_pulses(board, 0.2))
    assert not has_pulses(board)


def test_when_all_hang_pulses_end(daemon, board):
    stopped = pids(daemon)
    for pid in stopped:
        os.kill(pid, signal.SIGSTOP)
    wait_for(lambda: not has_pulses(board))
    for pid in stopped:
        os.kill(pid, signal.SIGCONT)
    wait_for(lambda: has_pulses(board))


def test_a_bridge_that_is_killed_is_replaced_and_its_guard_too(daemon, board):
    first = guard_of(daemon)
    os.kill(child(daemon, "bridge"), signal.SIGKILL)
    wait_for(lambda: not Path(f"/proc/{first}").exists())
    wait_for(lambda: all_driven(daemon) and has_pulses(board, 0.2))


def test_a_guard_that_is_killed_ends_the_pulses_is_said_and_replaced(daemon, board):
    bridge = child(daemon, "bridge")
    os.kill(guard_of(daemon), signal.SIGKILL)
    wait_for(lambda: "the process that guards the pin has died" in log(daemon))
    wait_for(lambda: child(daemon, "bridge") != bridge)
    wait_for(lambda: all_driven(daemon) and has_pulses(board, 0.2))


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_to_every_process_eases_to_rest_and_ends_the_guard(daemon, board, number):
    """As systemd sends it: the guard goes on until the bridge is at rest."""
    guard = guard_of(daemon)
    for pid in (guard, *pids(daemon)):
        os.kill(pid, number)
    assert daemon.wait(20.0) == 0
    wait_for(lambda: not Path(f"/proc/{guard}").exists())

    assert not has_pulses(board)


def test_the_doctor_knows_the_pin(board):
    done = run("doctor", "--config", board.face, "--port", board.port)

    assert "is free for the guard of the OE pin" in done.stdout, done
    assert NO_GUARD not in done.stdout
