"""The peer of the benchmarks: it costs little, and what it says could be said by servos."""

import contextlib
import struct
import subprocess
import sys
import time

import numpy as np
import pytest
from lipservo_lab.campaigns.chain_trials import face

from firmware_bridge.dynamixel.bus import DynamixelBus
from firmware_bridge.dynamixel.wire.codec import SpanRead
from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.serial_servos.serial_transport import open_port

BAUD_RATE = 1_000_000
IDS = (1, 2, 3)


@pytest.fixture(scope="module")
def port():
    command = [sys.executable, "-m", "lipservo_lab.bench.bus.canned_peer", str(len(IDS)), "10"]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        yield process.stdout.readline().strip()
        process.stdin.close()
        assert process.wait(10) == 0


@pytest.fixture
def line(port):
    with contextlib.closing(open_port(port, BAUD_RATE)) as transport:
        yield Line(transport)


def asked(ask, n_answers=1):
    """Call `ask` until its answer is whole, at most 30 s: a busy computer may be late; return it.

    n_answers: number of parts of a whole answer.
    """
    give_up_s = time.monotonic() + 30.0
    while time.monotonic() < give_up_s:
        found = ask()
        if found is not None and (n_answers == 1 or len(found) == n_answers):
            return found
    raise AssertionError("no whole answer")


@pytest.mark.parametrize("fast", [False, True])
def test_places_change_within_a_few_degrees_and_currents_have_both_signs(line, fast):
    span = SpanRead(IDS, 126, 10, fast=fast)
    currents, places = [], []
    for _ in range(64):
        for status in asked(lambda: line.sync_read(span), len(IDS)):
            current, _, place = struct.unpack("<hii", status.data)
            currents.append(current)
            places.append(place)

    assert min(currents) < 0 < max(currents)
    assert len(set(places)) > 20
    assert np.abs(np.array(places) - 2048).max() < 60


def test_any_span_of_any_servo_is_answered(line):
    assert asked(lambda: line.ping(2)).data == struct.pack("<HB", 1200, 52)
    assert asked(lambda: line.read(3, 144, 3)).data[:2] in (b"\x32\0", b"\x31\0")
    assert len(asked(lambda: line.read(1, 64, 35)).data) == 35
    goals = asked(lambda: line.sync_read(SpanRead(IDS, 116, 20, fast=False)), len(IDS))
    assert [status.servo_id for status in goals] == list(IDS)
    assert line.read(77, 64, 1) is None


def test_a_bus_arms_these_servos_and_drives_them(port):
    servos = face(len(IDS))
    with DynamixelBus(servos, lambda: open_port(port, BAUD_RATE), strict=False) as bus:
        assert all(any(not bus.enable_torque(n) for _ in range(5)) for n in range(len(IDS)))
        places = set()
        for tick in range(20):
            bus.write_positions(np.full(len(IDS), tick / 10))
            places.add(tuple(bus.feedback().positions_deg))
            health = bus.look_after()
        assert len(places) > 5
        assert (health.torque == 1).all()
        assert not health.watchdog_tripped.any()
        assert (health.voltage_v > 4.5).any()
