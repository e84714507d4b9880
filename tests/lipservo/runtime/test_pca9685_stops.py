"""A jaw at a simulated PCA9685 whose processes end: pulses as docs/hardware.md says.

Judged by the simulator's own log of pulses, which outlives every process of the face.
"""

import json
import os
import signal
import time
from itertools import pairwise

import pytest
from running_daemon import all_driven, child, log, own_folder, run, running, wait_for

from firmware_bridge.pca9685.controller import NO_GUARD
from lipservo.runtime.servos.sim_process import simulated_port

# Real processes in real time.
pytestmark = pytest.mark.slow
FACE = "face_jaw_pca9685"


@pytest.fixture
def board(tmp_path):
    """Port, and what tells how many pulses there were."""
    path = tmp_path / "pulses.jsonl"
    with simulated_port(["--config", FACE, "--log", str(path), "--on-time"]) as port:
        yield port, path


@pytest.fixture
def daemon(board, tmp_path, monkeypatch):
    own_folder(monkeypatch)
    with running(board[0], tmp_path, "--config", FACE) as process:
        wait_for(lambda: all_driven(process))
        yield process


def has_pulses(path, seconds=0.5):
    """Whether there are any for so long."""
    n_before = len(path.read_text().splitlines())
    time.sleep(seconds)
    return len(path.read_text().splitlines()) > n_before


def check_lengths(path):
    """Of all pulses: within min_us..max_us of the face."""
    rows = [json.loads(row) for row in path.read_text().splitlines()]
    assert {channel for _, channel, _ in rows} == {0}
    assert all(1365.0 <= width_us <= 1695.0 for _, _, width_us in rows)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_the_pulses_and_nothing_untrue_is_said(daemon, board, number):
    assert has_pulses(board[1])
    wait_for(lambda: NO_GUARD in log(daemon))
    os.kill(daemon.pid, number)
    assert daemon.wait(20.0) == 0
    time.sleep(0.1)

    assert not has_pulses(board[1])
    check_lengths(board[1])
    assert "pulses off; a digital servo may hold" in log(daemon)
    assert "confirmed by" not in log(daemon)


def test_a_bridge_that_is_killed_has_its_pulses_ended_and_is_replaced(daemon, board):
    first = child(daemon, "bridge")
    os.kill(first, signal.SIGKILL)
    wait_for(lambda: child(daemon, "bridge") != first)
    wait_for(lambda: all_driven(daemon))

    assert has_pulses(board[1])
    rows = [json.loads(row) for row in board[1].read_text().splitlines()]
    gaps_s = [after[0] - before[0] for before, after in pairwise(rows)]
    assert max(gaps_s) > 0.1, "the supervisor switched them off in between"
    check_lengths(board[1])


def test_a_supervisor_that_is_killed_takes_the_pulses_with_it(daemon, board):
    bridge = child(daemon, "bridge")
    os.kill(daemon.pid, signal.SIGKILL)
    wait_for(lambda: not os.path.exists(f"/proc/{bridge}"))
    time.sleep(0.1)

    assert not has_pulses(board[1])


def test_an_i2c_bus_that_disappears_is_a_lost_port_and_its_servo_comes_back(tmp_path, monkeypatch):
    """Meanwhile the chip goes on, as printed."""
    own_folder(monkeypatch)
    path, link, faults = tmp_path / "pulses.jsonl", tmp_path / "i2c", tmp_path / "faults.yaml"
    faults.write_text("faults: [{kind: unplug, at_s: 8.0, lasts_s: 1.5}]")
    arguments = ["--config", FACE, "--log", str(path), "--link", str(link), "--faults", str(faults)]
    with (
        simulated_port([*arguments, "--on-time"]),
        running(str(link), tmp_path, "--config", FACE) as daemon,
    ):
        wait_for(lambda: "port of the servos is gone" in log(daemon))
        assert has_pulses(path, 0.2)
        wait_for(lambda: all_driven(daemon))
        assert has_pulses(path)
        check_lengths(path)
        daemon.terminate()
        assert daemon.wait(20.0) == 0
        time.sleep(0.1)
        assert not has_pulses(path)


def test_after_all_are_killed_pulses_go_on_until_limp(daemon, board):
    port, path = board
    for pid in (daemon.pid, child(daemon, "bridge"), child(daemon, "speech")):
        os.kill(pid, signal.SIGSTOP)
    for pid in (daemon.pid, child(daemon, "bridge"), child(daemon, "speech")):
        os.kill(pid, signal.SIGKILL)
    daemon.wait(20.0)
    assert has_pulses(path), "nothing stops them"
    done = run("limp", "--port", port)
    time.sleep(0.1)

    assert done.returncode == 0, done
    assert "pulses off" in done.stdout
    assert not has_pulses(path)
    check_lengths(path)
