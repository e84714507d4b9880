"""Processes of one face, and what happens when one is shot: kill -9, each in turn."""

import os
import signal
import socket
import subprocess
import sys
import time

import pytest

from firmware_bridge.control_socket import ask
from firmware_bridge.dynamixel.line import Line
from firmware_bridge.dynamixel.serial_transport import open_port
from lipservo.sim_process import simulated_port

BAUD_RATE = 1_000_000
IDS = range(11, 21)
#: Far more than anything here takes, even on a busy machine.
PATIENCE_S = 120.0


@pytest.fixture
def port():
    with simulated_port(["--config", "face_sim", "--on-time"]) as port:
        yield port


@pytest.fixture
def daemon(port, tmp_path):
    """A running `lipservo daemon` at simulated servos, armed."""
    control = tmp_path / "control.sock"
    command = [sys.executable, "-m", "lipservo", "daemon", "--port", port]
    said = tmp_path / "said.txt"
    with (
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd,
        said.open("w") as errors,
    ):
        systemd.bind(str(tmp_path / "notify.sock"))
        systemd.settimeout(PATIENCE_S)
        with subprocess.Popen(
            [*command, "--control", str(control)],
            stderr=errors,
            env={**os.environ, "NOTIFY_SOCKET": str(tmp_path / "notify.sock")},
        ) as process:
            process.systemd = systemd
            process.control = control
            process.said = said
            try:
                wait_for(lambda: status(process).get("stale") == "fresh")
                yield process
            finally:
                process.terminate()
                try:
                    process.wait(PATIENCE_S)
                except subprocess.TimeoutExpired:
                    process.kill()


def wait_for(condition):
    give_up_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < give_up_s, "nothing happened"
        time.sleep(0.05)


def status(process):
    try:
        return ask(process.control, "status")
    except OSError:
        return {}


def log(process):
    return process.said.read_text()


def child(process, name):
    """The number of the newest process of that name, from the log."""
    lines = [line for line in log(process).splitlines() if line.startswith(f"{name} runs")]
    return int(lines[-1].split()[-1])


def torque(port):
    """torque_enable of every servo, read by a second program once the first is gone."""
    transport = open_port(port, BAUD_RATE)
    try:
        line = Line(transport)
        return [line.read(each, 64, 1).data[0] for each in IDS]
    finally:
        transport.close()


def alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_a_bridge_shot_dead_leaves_a_limp_face_and_is_replaced(daemon):
    shot = status(daemon)["pid"]
    os.kill(shot, signal.SIGKILL)
    wait_for(lambda: status(daemon).get("stale") == "fresh" and status(daemon)["pid"] != shot)

    assert "bridge died (signal 9)" in log(daemon)
    assert "torque off confirmed by all 10 servos" in log(daemon)
    assert status(daemon)["torque_on"]


def test_a_supervisor_shot_dead_takes_both_children_with_it_and_torque_off(daemon, port):
    children = [child(daemon, "bridge"), child(daemon, "speech")]
    daemon.kill()
    daemon.wait(PATIENCE_S)
    wait_for(lambda: not any(alive(pid) for pid in children))

    assert torque(port) == [0] * 10


def test_a_speech_side_shot_dead_is_replaced_while_the_face_is_held(daemon):
    before = status(daemon)
    os.kill(child(daemon, "speech"), signal.SIGKILL)
    wait_for(lambda: "speech died (signal 9)" in log(daemon))
    assert status(daemon)["pid"] == before["pid"]
    wait_for(lambda: status(daemon).get("stale") == "fresh" and "process" in log(daemon))

    assert status(daemon)["pid"] == before["pid"]


@pytest.mark.parametrize("level", [[], ["--limp"]])
def test_stop_ends_the_face_limp_and_the_program_well(daemon, port, level):
    command = [sys.executable, "-m", "lipservo", "stop", *level, "--control", str(daemon.control)]
    done = subprocess.run(command, timeout=PATIENCE_S, check=False, capture_output=True)

    assert done.returncode == 0
    assert daemon.wait(PATIENCE_S) == 0
    assert torque(port) == [0] * 10


def test_systemd_hears_that_the_face_is_ready_and_lives_and_its_sigterm_ends_it_limp(daemon, port):
    said = [daemon.systemd.recv(100) for _ in range(3)]
    daemon.terminate()
    daemon.wait(PATIENCE_S)

    assert said == [b"READY=1", b"WATCHDOG=1", b"WATCHDOG=1"]
    assert torque(port) == [0] * 10


def test_stop_without_a_running_face_says_so(tmp_path):
    command = [sys.executable, "-m", "lipservo", "stop", "--control", str(tmp_path / "none.sock")]
    done = subprocess.run(command, timeout=PATIENCE_S, check=False, capture_output=True, text=True)

    assert done.returncode == 1
    assert "is a face running?" in done.stderr
