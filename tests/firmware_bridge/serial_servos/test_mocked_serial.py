"""Servos behind whatever people put in the place of a serial port: docs/simulator.md."""

import contextlib
import socket
import subprocess
import sys
import threading
import time
from types import SimpleNamespace
from unittest import mock

import pytest
import serial
from serial.rfc2217 import PortManager
from servos.dynamixel_chain import mounted

from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.dynamixel.wire.sdk_line import SdkLine, SdkTransport
from firmware_bridge.errors import PortError, PortGone
from firmware_bridge.serial_servos.serial_transport import open_port
from firmware_bridge.simulator.chain import chain_for
from lipservo.runtime.servos.sim_process import simulated_port

BAUD = 1_000_000
TORQUE, GOAL = 64, 116


class FakeSerial:
    """In place of pyserial's class: servos in memory, no descriptor."""

    def __init__(self, port=None, baudrate=BAUD, **_):
        self.port, self.baudrate, self.is_open = port, baudrate, True
        self.chain = chain_for(mounted(3), BAUD)
        self.answers = b""

    @property
    def in_waiting(self):
        self.chain.advance(time.monotonic())
        self.answers += self.chain.deliver(time.monotonic())
        return len(self.answers)

    def read(self, size=1):
        size = min(size, self.in_waiting)
        data, self.answers = self.answers[:size], self.answers[size:]
        return data

    def write(self, data):
        self.chain.receive(bytes(data), time.monotonic(), BAUD)
        return len(data)

    def reset_input_buffer(self):
        self.answers = b""

    def flush(self):
        pass

    def close(self):
        self.is_open = False


def move_a_servo(line):
    """Find it, switch it on, send it somewhere, and read where it was sent."""
    assert line.ping(2, 1.0).servo_id == 2
    assert line.write(2, TORQUE, b"\x01", 1.0).error == 0
    assert line.write(2, GOAL, (2500).to_bytes(4, "little"), 1.0).error == 0
    assert line.read(2, GOAL, 4, 1.0).data == (2500).to_bytes(4, "little")


def test_a_class_put_in_place_of_pyserial_s_is_asked_for_bytes():
    with mock.patch("serial.Serial", FakeSerial):
        transport = open_port("/dev/ttyUSB0", BAUD)
    move_a_servo(Line(transport))
    transport.close()


def test_the_vendor_s_sdk_works_on_it_too(monkeypatch):
    monkeypatch.setattr("dynamixel_sdk.port_handler.LATENCY_TIMER", 250)
    with mock.patch("serial.Serial", FakeSerial):
        transport = SdkTransport("/dev/ttyUSB0", BAUD)
    move_a_servo(SdkLine(transport))
    transport.close()


def test_a_mock_that_answers_nothing_is_a_silent_servo():
    with mock.patch("serial.Serial"):
        line = Line(open_port("/dev/ttyUSB0", BAUD))
    assert line.ping(1) is None


def test_a_mock_that_raises_is_a_port_that_is_gone():
    with mock.patch("serial.Serial") as made:
        made.return_value.write.side_effect = OSError(5, "Input/output error")
        line = Line(open_port("/dev/ttyUSB0", BAUD))
        with pytest.raises(PortGone, match="/dev/ttyUSB0: gone"):
            line.ping(1)


@pytest.fixture
def server(request):
    """Servos behind a TCP socket, as behind a serial server; or behind pyserial's of RFC 2217."""
    scheme = getattr(request, "param", "socket")
    listener = socket.create_server(("127.0.0.1", 0))

    def serve():
        client, _ = listener.accept()
        client.settimeout(0.001)
        servos, heard, said = FakeSerial(), (lambda data: data), (lambda data: data)
        if scheme == "rfc2217":
            port = serial.serial_for_url("loop://", timeout=0)
            telnet = PortManager(port, SimpleNamespace(write=client.sendall))
            heard = lambda data: b"".join(telnet.filter(data))  # noqa: E731
            said = lambda data: b"".join(telnet.escape(data))  # noqa: E731
        data = b"-"
        with client, contextlib.suppress(ConnectionError):
            while data:
                with contextlib.suppress(TimeoutError):
                    data = client.recv(4096)
                    servos.write(heard(data))
                client.sendall(said(servos.read(servos.in_waiting)))

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    yield f"{scheme}://127.0.0.1:{listener.getsockname()[1]}"
    listener.close()
    thread.join(5.0)


@pytest.mark.filterwarnings("ignore:set(Daemon|Name)")  # pyserial's own
@pytest.mark.parametrize("server", ["socket", "rfc2217"], indirect=True)
def test_servos_behind_a_serial_server(server):
    transport = open_port(server, BAUD)
    move_a_servo(Line(transport))
    transport.close()


def test_what_a_serial_server_sends_at_once_is_read_at_once():
    """pyserial counts one byte, however many wait: of ten servos nine seemed silent."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        transport = open_port(f"socket://127.0.0.1:{listener.getsockname()[1]}", BAUD)
        client, _ = listener.accept()
        with client:
            client.sendall(bytes(1000))
            assert transport.read(transport.clock.now() + 5.0) == bytes(1000)
        transport.close()


def test_a_serial_server_that_takes_nothing_any_more_is_a_port_that_is_gone():
    """As one that lost its power: a write would wait for ever."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        transport = open_port(f"socket://127.0.0.1:{listener.getsockname()[1]}", BAUD)
        client, _ = listener.accept()
        began_s = time.monotonic()
        gone = pytest.raises(PortGone, match=r"gone \(Write timeout")
        with client, contextlib.closing(transport), gone:
            transport.write(bytes(100_000_000))

    assert time.monotonic() - began_s < 5.0


def test_a_serial_server_is_used_by_one_program_of_this_computer(server):
    """Until it closes the port or dies: here a process of its own, shot dead."""
    code = f"from {open_port.__module__} import open_port; t = open_port({server!r}, {BAUD})"
    other = subprocess.Popen(
        [sys.executable, "-c", f"{code}; print(1, flush=True); input()"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    with other:
        assert other.stdout.read(1) == b"1"
        with pytest.raises(PortError, match="used by another program of this computer"):
            open_port(server.replace("socket", "rfc2217"), BAUD)
        other.kill()
    for _ in range(2):  # a port that could not be opened, and one that was closed, are free again
        with pytest.raises(PortError, match="cannot be opened"):
            open_port("socket://127.0.0.1:1", BAUD)
        open_port(server, BAUD).close()


def test_a_loop_gives_back_what_is_written():
    transport = open_port("loop://", BAUD)
    transport.write(b"\xff\xff\xfd")
    assert transport.read(transport.clock.now() + 1.0) == b"\xff\xff\xfd"


def test_a_spy_tells_of_every_byte(capfd):
    with simulated_port(["--servos", "3", "--baud-rate", str(BAUD), "--on-time"]) as port:
        transport = open_port(f"spy://{port}", BAUD)
        assert Line(transport).ping(2, 1.0).servo_id == 2
        transport.close()
    told = capfd.readouterr().err
    assert " TX " in told
    assert " RX " in told


@pytest.mark.parametrize(
    ("url", "why"),
    [
        ("telepathy://x", "pyserial knows socket://"),
        ("socket://127.0.0.1:1", "cannot be opened"),
    ],
)
def test_a_url_that_leads_nowhere_is_refused_with_the_reason(url, why):
    with pytest.raises(PortError, match=why):
        open_port(url, BAUD)
