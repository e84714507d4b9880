"""The guard that lets servos go once all processes of their face are dead: real processes."""

import os
import signal
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest

from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.errors import PortError
from firmware_bridge.process.port_holders import with_children
from firmware_bridge.serial_servos.serial_transport import open_port
from lipservo.runtime.servos.sim_process import simulated_port

# Real processes in real time.
pytestmark = pytest.mark.slow
PATIENCE_S = 60.0
RATE, TORQUE_ENABLE = 1_000_000, 64
#: A supervisor, and a bridge that holds the port and switches torque on; neither ever lets go.
SUPERVISOR = """
import subprocess, sys
from firmware_bridge.bus_kinds import bus_kind
from firmware_bridge.process.port_guard import port_guard
port, bridge = sys.argv[1:]
settings = bus_kind("dynamixel").settings(kind="dynamixel", port=port, baud_rate=1_000_000)
with port_guard("tom", settings, {1: "jaw", 2: "lip"}) as alive:
    subprocess.Popen([sys.executable, "-c", bridge, port], pass_fds=[alive])
    sys.stdin.readline()
"""
BRIDGE = """
import sys, time
from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.serial_servos.serial_transport import open_port
line = Line(transport := open_port(sys.argv[1], 1_000_000))
for servo_id in (1, 2):
    line.write(servo_id, 64, bytes([1]))
print("drives", flush=True)
time.sleep(1000.0)
"""


class Face:
    """The processes of a face, by what the kernel knows of them."""

    def __init__(self, process, said):
        self.process, self._said = process, said
        children = [each for each in with_children([process.pid]) if each != process.pid]
        (self.guard,) = [each for each in children if b"lipservo-guard" in command(each)]
        (self.bridge,) = [each for each in children if each != self.guard]

    @property
    def said(self):
        return self._said.read_text()

    def kill_all(self):
        """All at once: none sees another end."""
        for number in (signal.SIGSTOP, signal.SIGKILL):
            os.kill(self.process.pid, number)
            os.kill(self.bridge, number)
        self.process.wait()


def command(pid):
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


def is_alive(pid):
    """Its command line would be empty for a moment while the guard takes the shell's place."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def wait_for(condition):
    give_up_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < give_up_s, "nothing happened"
        time.sleep(0.02)


@pytest.fixture
def port(tmp_path):
    arguments = ["--servos", "2", "--baud-rate", str(RATE), "--link", str(tmp_path / "port")]
    with simulated_port([*arguments, "--on-time"]):
        yield str(tmp_path / "port")


@pytest.fixture
def face(port, tmp_path):
    said = tmp_path / "said.txt"
    with said.open("w") as log:
        process = subprocess.Popen(
            [sys.executable, "-c", SUPERVISOR, port, BRIDGE],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=log,
        )
    with process:
        assert process.stdout.readline() == b"drives\n"
        face = Face(process, said)
        yield face
        for pid in (process.pid, face.bridge, face.guard):
            if is_alive(pid):
                os.kill(pid, signal.SIGKILL)


def opened(port):
    """The port, once whoever held it has died."""
    give_up_s = time.monotonic() + PATIENCE_S
    while True:
        try:
            return open_port(port, RATE)
        except PortError:
            assert time.monotonic() < give_up_s, "the port is not free"
            time.sleep(0.01)


def read_torque(line):
    """Of both servos; on a busy computer an answer may come too late, and is asked for again."""
    give_up_s = time.monotonic() + PATIENCE_S
    while None in (answers := [line.read(each, TORQUE_ENABLE, 1) for each in (1, 2)]):
        assert time.monotonic() < give_up_s, "no servo answers"
    return [answer.data[0] for answer in answers]


def torque(port):
    with closing(opened(port)) as transport:
        return read_torque(Line(transport))


def test_when_all_are_dead_torque_goes_off_confirmed_and_one_line_says_so(face, port):
    face.kill_all()
    wait_for(lambda: not is_alive(face.guard))

    assert torque(port) == [0, 0]
    (line,) = face.said.splitlines()
    assert "tom: its processes have died; its guard at" in line
    assert "torque off confirmed by all 2 servos" in line


@pytest.mark.parametrize("survivor", ["supervisor", "bridge"])
def test_while_one_process_lives_the_guard_waits(face, port, survivor):
    """As in every restart of a bridge by its supervisor."""
    dead = face.bridge if survivor == "supervisor" else face.process.pid
    os.kill(dead, signal.SIGKILL)
    time.sleep(1.0)
    assert b"/bin/sh" in command(face.guard), "it runs nothing"
    if survivor == "supervisor":
        assert torque(port) == [1, 1]
    os.kill(face.bridge if survivor == "bridge" else face.process.pid, signal.SIGKILL)
    wait_for(lambda: not is_alive(face.guard))

    assert torque(port) == [0, 0]


def test_a_port_that_another_face_has_taken_is_left_alone_without_a_word(face, port):
    os.kill(face.bridge, signal.SIGKILL)
    with closing(opened(port)) as transport:
        line = Line(transport)
        face.process.kill()
        wait_for(lambda: not is_alive(face.guard))
        held = read_torque(line)

    assert held == [1, 1]
    assert face.said == ""


def test_it_ends_with_a_face_that_ends_in_order_and_opens_no_port(face, port):
    os.kill(face.bridge, signal.SIGKILL)
    face.process.communicate(b"\n", timeout=PATIENCE_S)

    assert face.process.returncode == 0
    assert not is_alive(face.guard)
    assert torque(port) == [1, 1]  # as its bridge left it
    assert face.said == ""


def test_no_signal_of_a_terminal_or_of_systemd_ends_it(face, port):
    for number in (signal.SIGHUP, signal.SIGINT, signal.SIGQUIT, signal.SIGTERM):
        os.kill(face.guard, number)
    assert os.getsid(face.guard) == face.guard, "not in the session of the terminal"
    face.kill_all()
    wait_for(lambda: not is_alive(face.guard))

    assert torque(port) == [0, 0]


def test_it_waits_for_an_adapter_that_was_out_when_all_died(face, port):
    adapter = os.readlink(port)
    os.unlink(port)
    face.kill_all()
    time.sleep(1.0)
    assert is_alive(face.guard)
    os.symlink(adapter, port)
    wait_for(lambda: not is_alive(face.guard))

    assert torque(port) == [0, 0]
    assert "torque off confirmed by all 2 servos" in face.said


def test_a_waiting_guard_costs_next_to_nothing(face):
    fields = Path(f"/proc/{face.guard}/stat").read_text().rpartition(")")[2].split()
    status = Path(f"/proc/{face.guard}/status").read_text()
    (rss,) = [line for line in status.splitlines() if line.startswith("VmRSS")]

    assert int(rss.split()[1]) < 4096, "kB"
    assert [int(each) for each in fields[11:13]] == [0, 0], "processor time, in ticks"
    assert len(os.listdir(f"/proc/{face.guard}/fd")) <= 4
