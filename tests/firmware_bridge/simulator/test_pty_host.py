"""The simulator behind a pseudo-terminal, driven by other people's programs, unmodified."""

import os
import struct
import subprocess
import sys

import pytest
import serial

from firmware_bridge.dynamixel.wire import codec
from firmware_bridge.dynamixel.wire.codec import FrameParser
from firmware_bridge.errors import PortError
from firmware_bridge.serial_servos.serial_transport import open_port
from lipservo.runtime.servos.sim_process import simulated_port

BAUD_RATE = 1_000_000


@pytest.fixture(scope="module")
def port():
    with simulated_port(["--servos", "5", "--baud-rate", str(BAUD_RATE), "--on-time"]) as port:
        yield port


@pytest.fixture(autouse=True)
def long_timeouts(monkeypatch):
    """The SDK waits for 34 ms; a computer that runs other tests meanwhile may need more."""
    monkeypatch.setattr("dynamixel_sdk.port_handler.LATENCY_TIMER", 250)


@pytest.fixture
def sdk(port):
    import dynamixel_sdk

    handler = dynamixel_sdk.PortHandler(port)
    assert handler.openPort()
    assert handler.setBaudRate(BAUD_RATE)
    yield handler, dynamixel_sdk.PacketHandler(2.0)
    handler.closePort()


def test_the_sdk_pings_reads_and_writes(sdk):
    handler, packets = sdk

    assert packets.ping(handler, 1) == (1200, 0, 0)
    assert packets.write1ByteTxRx(handler, 1, 64, 0) == (0, 0)
    assert packets.write4ByteTxRx(handler, 1, 116, 2100) == (0, 0)
    assert packets.read4ByteTxRx(handler, 1, 116) == (2100, 0, 0)
    assert packets.write4ByteTxRx(handler, 1, 116, 5000) == (0, 6)
    assert packets.write1ByteTxRx(handler, 1, 124, 1) == (0, 7)
    found, result = packets.broadcastPing(handler)
    assert result == 0
    assert found == {n: [1200, 52] for n in range(1, 6)}


@pytest.mark.parametrize("fast", [False, True])
def test_the_sdk_reads_and_writes_groups(sdk, fast):
    import dynamixel_sdk

    handler, packets = sdk
    write = dynamixel_sdk.GroupSyncWrite(handler, packets, 116, 4)
    read = dynamixel_sdk.GroupSyncRead(handler, packets, 116, 4)
    for servo_id in range(1, 6):
        write.addParam(servo_id, list(struct.pack("<i", 2000 + servo_id)))
        read.addParam(servo_id)

    assert write.txPacket() == 0
    assert (read.fastSyncRead() if fast else read.txRxPacket()) == 0
    assert [read.getData(n, 116, 4) for n in range(1, 6)] == [2001, 2002, 2003, 2004, 2005]


def test_the_sdk_reboots_and_resets_a_servo(sdk):
    handler, packets = sdk
    assert packets.write1ByteTxRx(handler, 5, 65, 1) == (0, 0)
    assert packets.reboot(handler, 5) == (0, 0)
    assert packets.ping(handler, 5)[1] != 0
    while packets.ping(handler, 5)[1] != 0:
        pass
    assert packets.read1ByteTxRx(handler, 5, 65) == (0, 0, 0)


def test_pyserial_gets_the_bytes_of_a_status_packet(port):
    with serial.Serial(port, BAUD_RATE, timeout=1.0) as client:
        client.write(codec.ping(3))
        (frame,) = FrameParser().feed(client.read(14))

    assert (frame.packet_id, frame.parameters) == (3, b"\0\xb0\x04\x34")


def test_at_the_wrong_baud_rate_nobody_answers(port):
    with serial.Serial(port, 115_200, timeout=0.05) as client:
        client.write(codec.ping(3))

        assert client.read(14) == b""


def test_a_port_has_one_owner(port):
    transport = open_port(port, BAUD_RATE)
    try:
        with pytest.raises(PortError, match="used by another program"):
            open_port(port, BAUD_RATE)
    finally:
        transport.close()


def test_a_port_without_permission_is_answered_with_the_command_that_helps(tmp_path):
    """As somebody who is not root: root may open everything."""
    path = tmp_path / "port"
    path.touch(0o000)
    script = (
        "import os, sys\n"
        "from firmware_bridge.errors import PortError\n"
        "from firmware_bridge.serial_servos.serial_transport import open_port\n"
        "try:\n"
        "    open_port(sys.argv[1], 1_000_000)\n"
        "except PortError as error:\n"
        "    print(error)\n"
    )
    if os.geteuid() == 0:
        script = script.replace("try:", "os.seteuid(65_534)\ntry:")
    done = subprocess.run(
        [sys.executable, "-c", script, str(path)], capture_output=True, text=True, check=True
    )

    assert done.stdout.startswith(f"{path}: no permission; run `sudo usermod -aG dialout $USER`")


@pytest.mark.parametrize(
    ("path", "said"),
    [("/dev/ttyUSB77", "no such port"), ("/dev/null", "is not a serial port")],
)
def test_a_port_that_is_none_is_explained(path, said):
    with pytest.raises(PortError, match=said):
        open_port(path, BAUD_RATE)
