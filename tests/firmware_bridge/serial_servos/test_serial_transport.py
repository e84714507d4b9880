"""A serial port is ours alone while it is open, at any rate that the servos know."""

import array
import contextlib
import fcntl
import os
import subprocess
import sys
import tty

import pytest

from firmware_bridge.clock import MonotonicClock
from firmware_bridge.dynamixel.control_table import baud_rates
from firmware_bridge.dynamixel.wire.sdk_line import SdkTransport
from firmware_bridge.errors import PortError, ServoError
from firmware_bridge.serial_servos.serial_transport import SameAdapter, adapter_identity, open_port
from lipservo.settings.settings import parse_face

#: asm-generic/ioctls.h of Linux: is the terminal exclusive; all of its settings, rates as numbers.
TIOCGEXCL, TCGETS2 = 0x80045440, 0x802C542A
OPENERS = {"own": open_port, "sdk": SdkTransport}
#: Root may open what is exclusive, so the stranger is nobody.
STRANGER = """
import os, sys
if os.geteuid() == 0:
    os.setuid(65_534)
try:
    os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)
except OSError as error:
    print(os.strerror(error.errno))
else:
    print("opened")
"""


@pytest.fixture
def port():
    """A terminal whose other end nobody serves; anybody may open it."""
    master, slave = os.openpty()
    tty.setraw(slave)
    os.chmod(os.ttyname(slave), 0o666)
    yield os.ttyname(slave)
    for fd in (master, slave):
        with contextlib.suppress(OSError):
            os.close(fd)


def number(path, request, index, size):
    """One number of what the kernel answers to an ioctl."""
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
    try:
        answer = array.array("i", [0] * size)
        fcntl.ioctl(fd, request, answer)
        return answer[index]
    finally:
        os.close(fd)


def what_a_stranger_gets(port):
    command = [sys.executable, "-c", STRANGER, port]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


@pytest.mark.parametrize("opener", OPENERS)
def test_no_other_program_of_an_ordinary_user_can_open_a_port_in_use(port, opener):
    transport = OPENERS[opener](port, 1_000_000)
    assert what_a_stranger_gets(port) == "Device or resource busy"
    transport.baud_rate = 57_600
    assert what_a_stranger_gets(port) == "Device or resource busy"
    transport.close()
    transport.close()

    assert what_a_stranger_gets(port) == "opened"


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can look at a port in use")
@pytest.mark.parametrize("opener", OPENERS)
def test_the_kernel_knows_that_a_port_is_exclusive(port, opener):
    transport = OPENERS[opener](port, 1_000_000)
    assert number(port, TIOCGEXCL, 0, 1) == 1
    transport.close()

    assert number(port, TIOCGEXCL, 0, 1) == 0


@pytest.mark.parametrize("second", OPENERS)
@pytest.mark.parametrize("first", OPENERS)
def test_a_second_lipservo_is_told_that_the_port_is_used(port, first, second):
    transport = OPENERS[first](port, 1_000_000)
    with pytest.raises(PortError, match="used by another program"):
        OPENERS[second](port, 1_000_000)
    transport.close()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can look at a port in use")
@pytest.mark.parametrize("baud_rate", sorted(baud_rates().values()))
def test_every_rate_of_the_servos_can_be_set(port, baud_rate):
    transport = open_port(port, baud_rate)
    assert number(port, TCGETS2, 10, 16) == baud_rate
    transport.baud_rate = 1_000_000
    assert number(port, TCGETS2, 10, 16) == 1_000_000
    transport.baud_rate = baud_rate
    assert number(port, TCGETS2, 10, 16) == baud_rate
    transport.close()


@pytest.mark.parametrize("kind", ["file", "folder", "fifo"])
def test_what_is_no_serial_port_is_named_in_one_plain_line(tmp_path, kind):
    path = tmp_path / "port"
    {"file": path.touch, "folder": path.mkdir, "fifo": lambda: os.mkfifo(path)}[kind]()
    with pytest.raises(PortError) as error:
        open_port(str(path), 1_000_000)

    assert str(error.value) in (
        f"{path}: is not a serial port",
        f"{path}: cannot be opened: Is a directory",
    )


def usb_port(sysfs, name, socket, serial=None):
    """What Linux shows of a USB adapter."""
    adapter = sysfs / "devices" / "usb1" / socket
    port = adapter / f"{socket}:1.0" / name
    port.mkdir(parents=True)
    (adapter / "idVendor").write_text("1a86\n")
    if serial is not None:
        (adapter / "serial").write_text(f"{serial}\n")
    entry = sysfs / "class" / "tty" / name
    entry.mkdir(parents=True)
    (entry / "device").symlink_to(port)


def test_an_adapter_is_known_by_its_serial_number_or_without_one_by_its_socket(tmp_path):
    usb_port(tmp_path, "ttyUSB7", "1-1", "FT4THUXY")
    usb_port(tmp_path, "ttyUSB8", "1-2.3")
    found = [adapter_identity(f"/dev/ttyUSB{n}", tmp_path) for n in (7, 8, 9)]

    assert found == ["serial number FT4THUXY", "USB path 1-2.3", None]


@pytest.mark.parametrize(
    ("own", "other"),
    [("serial number FT4THUXY", "serial number FT999999"), ("USB path 1-1", "USB path 1-2")],
)
def test_another_adapter_at_the_old_port_is_not_opened(port, monkeypatch, own, other):
    """The adapters' numbers are of the wire; no test machine has two."""
    present = [own]
    module = "firmware_bridge.serial_servos.serial_transport.adapter_identity"
    monkeypatch.setattr(module, lambda _port: present[0])
    opener = SameAdapter(port, 57_600)
    opener().close()
    present[0] = other
    with pytest.raises(PortError, match=f"another adapter is there .{other}, not {own}"):
        opener()
    present[0] = own
    opener().close()


FACE = """\
name: f
rate_hz: 30
bus: {kind: dynamixel, port: PORT, backend: BACKEND}
servos:
  jaw: {id: 1, model: XL330-M288, positive: opens, min_deg: 0, max_deg: 9, max_speed_deg_s: 60}
"""


@pytest.mark.parametrize("backend", ["own", "dynamixel-sdk"])
def test_a_face_leaves_the_servos_of_an_adapter_alone_that_took_its_port(
    port, monkeypatch, backend
):
    present = ["serial number FT4THUXY"]
    module = "firmware_bridge.serial_servos.serial_transport.adapter_identity"
    monkeypatch.setattr(module, lambda _port: present[0])
    face = parse_face(FACE.replace("PORT", port).replace("BACKEND", backend), "f.yaml")
    bus = face.bus_kind.open(face.wiring, MonotonicClock())
    with pytest.raises(ServoError, match="does not answer"), bus:
        pass
    present[0] = "serial number FT999999"
    with pytest.raises(PortError, match="another adapter is there"), bus:
        pass
