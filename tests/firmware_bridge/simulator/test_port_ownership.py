"""Who holds a simulated port, where its link leads, and what pulls its plug."""

import contextlib
import os
import signal
import struct
import subprocess
import sys
import threading
import time
from itertools import pairwise
from pathlib import Path

import pytest

from firmware_bridge.dynamixel.control_table import servo_models
from firmware_bridge.dynamixel.wire import codec
from firmware_bridge.dynamixel.wire.codec import FrameParser
from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.errors import PortError
from firmware_bridge.serial_servos.serial_transport import open_port
from firmware_bridge.simulator.chain import SimulatedChain
from firmware_bridge.simulator.ports import PtyHost
from lipservo.commands.build.sim_bus import sim_bus
from lipservo.runtime.servos.sim_process import simulated_port
from lipsync.errors import UserError

BAUD_RATE = 1_000_000
#: Another user than root, whom exclusive access never keeps out.
NOBODY = 65_534
OPEN_FOR_ONESELF = f"""
import fcntl, os, sys, termios, time
if os.geteuid() == 0:
    os.seteuid({NOBODY})
try:
    fd = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)
except OSError as error:
    print(error.strerror, flush=True)
    sys.exit()
fcntl.ioctl(fd, termios.TIOCEXCL)
print("mine", flush=True)
time.sleep(60)
"""


@contextlib.contextmanager
def served(link=None, n=2):
    """A chain and its host, which serves in a thread."""
    chain = SimulatedChain([servo_models()["XL330-M288"]] * n, range(1, n + 1), baud_rate=BAUD_RATE)
    host = PtyHost(chain, link)
    over = threading.Event()
    thread = threading.Thread(target=host.serve, args=(over.is_set,))
    thread.start()
    try:
        yield chain, host
    finally:
        over.set()
        thread.join()
        host.close()


def until(reached):
    for _ in range(500):
        if reached():
            return True
        time.sleep(0.01)
    return False


@contextlib.contextmanager
def exclusive_client(port):
    """A process that asks for the port for itself alone; what it said."""
    os.chmod(port, 0o666)
    command = [sys.executable, "-c", OPEN_FOR_ONESELF, port]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process, process.stdout.readline().strip()
        finally:
            process.kill()


def test_a_port_held_exclusively_is_free_once_its_client_was_killed():
    with served() as (_, host):
        with exclusive_client(host.port) as (holder, said):
            assert said == "mine"
            with exclusive_client(host.port) as (_, said):
                assert said == "Device or resource busy"
            # That one has closed nothing that counts: the port is still the first one's.
            with exclusive_client(host.port) as (_, said):
                assert said == "Device or resource busy"
            os.kill(holder.pid, signal.SIGKILL)
            holder.wait()

        def free():
            with exclusive_client(host.port) as (_, said):
                return said == "mine"

        assert until(free)


def test_a_second_client_that_leaves_does_not_open_the_port_to_others():
    """Root may always open; that it closes again must not end the exclusive access."""
    if os.geteuid():
        pytest.skip("needs root, who is not kept out")
    with served() as (_, host), exclusive_client(host.port):
        os.close(os.open(host.port, os.O_RDWR | os.O_NOCTTY))
        time.sleep(0.2)
        with exclusive_client(host.port) as (_, said):
            assert said == "Device or resource busy"


def test_the_plug_is_pulled_and_put_in_on_demand(tmp_path):
    link = tmp_path / "servos"
    with served(link) as (chain, host):
        first = open_port(str(link), BAUD_RATE)
        assert Line(first).ping(1) is not None
        chain.unplug()
        assert until(lambda: not os.path.lexists(link))
        with pytest.raises(PortError):
            Line(first).ping(1)
        first.close()
        chain.plug_in()
        assert until(link.is_char_device)
        assert until(lambda: os.readlink(link) == host.port)
        second = open_port(str(link), BAUD_RATE)
        try:
            assert any(Line(second).ping(1) for _ in range(5))
        finally:
            second.close()
    assert not os.path.lexists(link)


def test_a_wire_without_its_plug_forgets_what_was_under_way():
    chain = SimulatedChain([servo_models()["XL330-M288"]], [1], baud_rate=BAUD_RATE)
    chain.receive(codec.ping(1), 1.0, BAUD_RATE)
    chain.unplug()
    chain.plug_in()
    chain.advance(1.1)

    assert chain.deliver(2.0) == b""
    assert chain.plugged


def test_every_step_of_the_motion_can_be_watched():
    """A profile of 100 units never moves a shaft faster than it says."""
    chain = SimulatedChain([servo_models()["XL330-M288"]] * 2, [1, 2], baud_rate=BAUD_RATE)
    seen = []
    chain.motion = lambda time_s, positions: seen.append((time_s, positions.copy()))
    for servo in chain.servos:
        servo.write(struct.pack("<HI", 112, 100))
        servo.write(struct.pack("<HB", 64, 1))
    chain.servos[1].write(struct.pack("<Hi", 116, 2500))
    for step in range(1, 40):
        chain.advance(step * 0.033)

    speed = 100 * 0.229 * 4096 / 60
    spans_s = [b - a for (a, _), (b, _) in pairwise(seen)]
    steps = [b[1] - a[1] for (_, a), (_, b) in pairwise(seen)]
    assert len([step for step in steps if step]) > 50
    for span_s, step in zip(spans_s, steps, strict=True):
        assert span_s == pytest.approx(0.005) or not step  # rest is told of in one piece
    assert max(steps) / 0.005 == pytest.approx(speed, rel=0.01)
    assert seen[-1][1].tolist() == pytest.approx([2048, 2500], abs=0.5)
    chain.motion = None
    chain.advance(2.0)
    assert seen[-1][0] < 1.3


def test_dynamixel_sdk_reads_a_motion_that_looks_like_a_header(monkeypatch):
    """-1 mA and -3 units of velocity are FF FF FD, which is sent with one FD more."""
    import dynamixel_sdk

    monkeypatch.setattr("dynamixel_sdk.port_handler.LATENCY_TIMER", 250)
    with served(n=1) as (chain, host):
        (servo,) = chain.servos
        for address, layout, value in ((112, "I", 3), (64, "B", 1), (116, "i", 1000)):
            servo.write(struct.pack(f"<H{layout}", address, value))
        chain.motors.load[0] = 0.0005
        assert until(lambda: servo["present_current"] == -1 and servo["present_velocity"] == -3)
        handler = dynamixel_sdk.PortHandler(host.port)
        assert handler.openPort()
        assert handler.setBaudRate(BAUD_RATE)
        data, result, error = dynamixel_sdk.PacketHandler(2.0).readTxRx(handler, 1, 126, 10)
        parser = FrameParser()
        handler.writePort(codec.read(1, 126, 10))
        raw, frames = b"", []
        while not frames:
            arrived = bytes(handler.readPort(64))
            raw += arrived
            frames += parser.feed(arrived)
        handler.closePort()

    assert (result, error) == (0, 0)
    assert struct.unpack_from("<hi", bytes(data)) == (-1, -3)
    assert b"\xff\xff\xfd\xfd\xff\xff\xff" in raw
    assert struct.unpack_from("<hi", frames[0].parameters, 1) == (-1, -3)


@pytest.fixture
def others(tmp_path):
    """Things of a user's that stand where a link is wanted."""
    (tmp_path / "file").write_text("mine")
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "file")
    (tmp_path / "unplugged").symlink_to("/dev/ttyUSB77")
    (tmp_path / "fifo_link").symlink_to("/dev/pts")
    os.mkfifo(tmp_path / "fifo")
    return tmp_path


@pytest.mark.parametrize("name", ["file", "folder", "link", "unplugged", "fifo", "fifo_link"])
def test_a_link_never_replaces_what_it_did_not_make(others, name):
    before = sorted(os.listdir(others))

    with pytest.raises(UserError, match="link is there; give another path"):
        sim_bus(link=others / name)

    assert (others / "file").read_text() == "mine"
    assert sorted(os.listdir(others)) == before


@pytest.mark.parametrize(
    ("link", "said"),
    [
        ("{}/nowhere/servos", "this link cannot be made: No such file or directory"),
        ("{}/file/servos", "this link cannot be made: Not a directory"),
        ("/proc/servos", "this link cannot be made: "),
        ("{}/" + "x" * 300, "this link cannot be made: File name too long"),
        ("/", "is a folder, not the name of a link"),
        ("", "is a folder, not the name of a link"),
    ],
)
def test_an_impossible_place_for_a_link_is_one_line(others, link, said):
    with pytest.raises(UserError, match=said) as problem:
        sim_bus(link=Path(link.format(others)))

    assert "\n" not in str(problem.value)


def test_a_link_that_a_killed_simulator_left_behind_is_taken_over(tmp_path):
    link = tmp_path / "servos"
    link.symlink_to("/dev/pts/987654")
    with served(link) as (_, host):
        assert os.readlink(link) == host.port
    assert os.listdir(tmp_path) == []


def test_a_link_that_leads_to_another_simulator_is_left_alone(tmp_path):
    link = tmp_path / "servos"
    with served(link) as (_, host):
        with pytest.raises(UserError, match="link is there; give another path"):
            sim_bus(link=link)
        assert os.readlink(link) == host.port


def test_at_the_end_a_link_that_leads_elsewhere_by_now_stays(tmp_path):
    link = tmp_path / "servos"
    with served(link) as (chain, _):
        link.unlink()
        link.write_text("mine")
        chain.unplug()
        time.sleep(0.1)
        chain.plug_in()
        time.sleep(0.1)

    assert link.read_text() == "mine"


def test_the_simulator_of_a_run_outlives_ctrl_c_and_ends_with_its_user():
    script = (
        "import os, signal, sys\n"
        "from lipservo.runtime.servos.sim_process import simulated_port\n"
        "signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
        "with simulated_port(['--servos', '1']) as port:\n"
        "    os.killpg(0, signal.SIGINT)  # as the terminal does\n"
        "    print(port, flush=True)\n"
        "    sys.stdin.readline()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", script],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        process_group=0,
    ) as user:
        port = user.stdout.readline().strip()
        time.sleep(0.2)
        line = Line(open_port(port, 57_600))
        assert any(line.ping(1) for _ in range(5))
        line.transport.close()
        user.kill()
        user.wait()
        assert until(lambda: not os.path.exists(port))


def test_any_rate_is_understood_whether_it_has_a_name_or_not():
    """4.5 Mbaud has none in termios; pyserial sets it as a number."""
    import serial

    arguments = ["--servos", "1", "--model", "XM430-W210", "--baud-rate", "4500000"]
    with simulated_port(arguments) as port, serial.Serial(port, 4_500_000, timeout=2.0) as client:
        client.write(codec.ping(1))

        assert len(client.read(14)) == 14
