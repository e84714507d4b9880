"""The Pico's protocol against the simulated Maestro, byte for byte, and driven by the bridge."""

import ast
import importlib.util
from collections import deque

import numpy as np
import pytest
from hobby_bus import on_maestro
from hypothesis import given, settings
from hypothesis import strategies as st
from places import ROOT

from firmware_bridge.clock import ManualClock
from firmware_bridge.errors import PortError
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.maestro.controller import MaestroController
from firmware_bridge.maestro.kind import BAUD_RATE, MAESTRO
from firmware_bridge.maestro.protocol import N_CHANNELS, command, split
from firmware_bridge.maestro.release import MaestroRelease
from firmware_bridge.maestro.settings import MaestroSettings
from firmware_bridge.maestro.simulator import SimulatedMaestro
from firmware_bridge.pulse_bus import PulseBus
from firmware_bridge.simulator.ports import MemoryTransport
from lipservo.settings.settings import load_shipped_face

FIRMWARE = ROOT / "firmware" / "pico_maestro"
RANGE_US = 500, 2500
TIMEOUT_MS = 500
TIMEOUT_ERROR, PROTOCOL_ERROR = 1 << 5, 1 << 4

spec = importlib.util.spec_from_file_location("pico_protocol", FIRMWARE / "protocol.py")
pico = importlib.util.module_from_spec(spec)
spec.loader.exec_module(pico)

N = N_CHANNELS["pico"]


def new():
    return pico.Maestro(N, *RANGE_US, TIMEOUT_MS)


def tell(maestro, text):
    data = bytes.fromhex(text) if isinstance(text, str) else text
    return b"".join(maestro.receive(byte) for byte in data)


def pulses(maestro):
    return [maestro.pulse(n) for n in range(N)]


class Pair:
    """A Pico and a simulated Maestro that hear the same."""

    def __init__(self):
        # A little more, so that sums of its seconds do not decide.
        timeout_s = TIMEOUT_MS / 1e3 + 1e-6
        of = MaestroSettings(model="mini12", device=12, serial_timeout_s=timeout_s)
        self.simulated = SimulatedMaestro(of, range_us=RANGE_US)
        self.pico = new()
        self.now_ms = 0

    def tell(self, data):
        self.simulated.receive(data, self.now_ms / 1e3, 0)
        answer = tell(self.pico, data)
        assert answer == self.simulated.deliver(self.now_ms / 1e3 + 1.0)
        self.compare()

    def wait(self, ms):
        self.now_ms += ms
        self.simulated.advance(self.now_ms / 1e3)
        self.pico.advance(ms)
        self.compare()

    def compare(self):
        assert pulses(self.pico) == [round(each.position) for each in self.simulated.channels]
        assert self.pico.errors == self.simulated.errors


data_byte = st.integers(0, 127)
channel = st.integers(0, N + 1)
target = st.one_of(st.just(0), st.integers(0, 0x3FFF), st.integers(4 * 500, 4 * 2500))
#: In tenths of a quarter in a millisecond: whole quarters, so that no two ways to round differ.
speed = st.integers(0, 30).map(lambda n: 10 * n)


@st.composite
def good_command(draw):
    code = draw(st.sampled_from([0x84, 0x84, 0x87, 0x89, 0x90, 0x9F, 0x9F, 0xA1, 0xA2]))
    data = []
    if code == 0x9F:
        n = draw(st.integers(0, N))
        data = [n, draw(channel)]
        for each in draw(st.lists(target, min_size=n, max_size=n)):
            data += split(each)
    elif code == 0x84:
        data = [draw(channel), *split(draw(target))]
    elif code == 0x87:
        data = [draw(channel), *split(draw(speed))]
    elif code == 0x89:
        data = [draw(channel), 0, 0]
    elif code == 0x90:
        data = [draw(channel)]
    return command(code, data, device=draw(st.sampled_from([None, None, 12, 3])), crc=False)


@st.composite
def damaged(draw):
    """A command that ends too early, has a byte too many, or is no command."""
    whole = draw(good_command())
    how = draw(st.sampled_from(["cut", "more", "noise"]))
    if how == "cut":
        return whole[: draw(st.integers(0, len(whole)))]
    if how == "more":
        return whole + bytes(draw(st.lists(data_byte, max_size=3)))
    noise = draw(st.binary(max_size=12))
    # What the Pico knows and the simulator does not, or takes as read.
    return bytes(
        each for each in noise if each & 0x7F not in (0x93 & 0x7F, 0x89 & 0x7F, 0x87 & 0x7F)
    )


@given(st.lists(st.one_of(good_command(), damaged(), st.integers(0, 60)), max_size=40))
@settings(max_examples=200, deadline=None)
def test_the_same_bytes_have_the_same_answers_pulses_and_errors(story):
    pair = Pair()
    for each in story:
        if isinstance(each, int):
            pair.wait(10 * each)
            if pair.pico.errors:  # a simulated timeout comes once only until it is asked for
                pair.tell(b"\xa1")
        else:
            pair.tell(each)


@given(st.binary(max_size=600))
@settings(max_examples=300, deadline=None)
def test_no_bytes_raise_grow_or_leave_the_bounds(noise):
    maestro = new()
    buffer = maestro._message
    for byte in noise:
        assert len(maestro.receive(byte)) <= 2
        assert all(not each or 2000 <= each <= 10000 for each in pulses(maestro))
    assert maestro._message is buffer
    assert len(buffer) == pico.LONGEST
    tell(maestro, "a2 a1")
    assert pulses(maestro) == [0] * N


def test_the_longest_command_there_is_fits():
    maestro = new()
    tell(maestro, b"\xaa\x0c\x1f" + bytes((127, 0)) + bytes(254))
    assert tell(maestro, "a1") == bytes((PROTOCOL_ERROR, 0))


def test_no_pulse_is_sent_before_the_first_target_nor_after_an_error():
    maestro = new()
    assert pulses(maestro) == [0] * N
    assert tell(maestro, "84 00 70 2e 90 00") == b"\x70\x17"
    assert tell(maestro, "84 0c 70 2e a1") == bytes((PROTOCOL_ERROR, 0))
    assert pulses(maestro) == [0] * N
    assert tell(maestro, "a1") == b"\0\0"


def test_silence_stops_all_pulses_each_time_whether_or_not_errors_are_read():
    maestro = new()
    for _ in range(2):
        tell(maestro, "9f 02 00 70 2e 70 2e")
        maestro.advance(TIMEOUT_MS)
        assert pulses(maestro)[:2] == [6000, 6000]
        maestro.advance(1)
        assert pulses(maestro) == [0] * N
    assert tell(maestro, "a1") == bytes((TIMEOUT_ERROR, 0))
    assert tell(maestro, "a1") == b"\0\0"


@pytest.mark.parametrize("text", ["", "84 00 70", "aa 0c 04", "aa 03 04 00 70 2e", "9f 7f 00 70"])
def test_what_is_no_complete_command_for_it_keeps_no_pulse_alive(text):
    maestro = new()
    tell(maestro, "84 00 70 2e")
    for _ in range(51):
        maestro.advance(10)
        if not maestro.errors:
            tell(maestro, text)
    assert pulses(maestro) == [0] * N


def test_a_speed_bounds_each_step_and_no_time_is_no_step():
    maestro = new()
    tell(maestro, "84 00 70 2e 87 00 0a 00 84 00 00 3e")
    assert tell(maestro, "93") == b"\1"
    maestro.advance(0)
    assert maestro.pulse(0) == 6000
    maestro.advance(10)
    assert maestro.pulse(0) == 6010
    tell(maestro, "87 00 07 00")
    maestro.advance(1)
    assert maestro.pulse(0) == 6011
    tell(maestro, "87 00 00 00")
    maestro.advance(1)
    assert maestro.pulse(0) == 7936
    assert tell(maestro, "93") == b"\0"


def test_an_acceleration_is_no_promise():
    maestro = new()
    assert tell(maestro, "89 00 00 00 a1") == b"\0\0"
    assert tell(maestro, "89 00 01 00 a1") == bytes((PROTOCOL_ERROR, 0))


def test_the_firmware_is_short_and_its_protocol_imports_nothing():
    files = sorted(FIRMWARE.glob("*.py"))
    assert [each.name for each in files] == ["main.py", "protocol.py"]
    assert sum(len(each.read_text().splitlines()) for each in files) <= 200
    nodes = ast.walk(ast.parse((FIRMWARE / "protocol.py").read_text()))
    assert not [each for each in nodes if isinstance(each, ast.Import | ast.ImportFrom)]


class PicoDevice:
    """The Pico's protocol as a `SimulatedDevice`."""

    plugged = True

    def __init__(self):
        self.maestro, self._now_s, self._answers = new(), 0.0, deque()

    @property
    def next_delivery_s(self):
        return self._answers[0][0] if self._answers else float("inf")

    def advance(self, now_s):
        elapsed_ms = round((now_s - self._now_s) * 1e3)
        if elapsed_ms > 0:
            self._now_s += elapsed_ms / 1e3
            self.maestro.advance(elapsed_ms)

    def receive(self, data, now_s, _baud_rate):
        self.advance(now_s)
        answer = tell(self.maestro, bytes(data))
        if answer:
            self._answers.append((now_s + 0.001, answer))

    def deliver(self, now_s):
        answer = b""
        while self._answers and self._answers[0][0] <= now_s:
            answer += self._answers.popleft()[1]
        return answer


FACE = load_shipped_face("face_four")


@pytest.mark.parametrize("device", [None, 12])
def test_the_bridge_drives_it_and_its_pulses_end_when_the_bridge_is_gone(device):
    clock, board = ManualClock(), PicoDevice()
    wiring = on_maestro(FACE, model="pico", device=device)
    controller = MaestroController(wiring, lambda: MemoryTransport(board, clock, BAUD_RATE))
    can = MAESTRO.capabilities(wiring.settings)
    channel, n = MemoryTargetChannel(), len(wiring.joints)
    with PulseBus(wiring.servos, controller, clock, can, may_jump=True) as bus:
        bridge = Bridge(bus, wiring.joints, channel, BridgeSettings(50.0, tolerant=True))
        bridge.start()
        for _ in range(150):
            time_s = clock.now() + 0.02
            clock.sleep_until(time_s)
            channel.publish(ServoTargets(time_s, np.full(n, 5.0)))
            bridge.tick(time_s)
        assert bridge.troubles == ()
        assert bus.remarks() == []
        np.testing.assert_allclose(np.array(pulses(board.maestro)[:n]) / 4, 1550.0, atol=1.0)
        board.advance(clock.now() + 0.6)
        assert pulses(board.maestro) == [0] * N


def test_limp_without_a_face_finds_its_channels_and_stops_them():
    board, clock = PicoDevice(), ManualClock()
    for number in range(N):
        tell(board.maestro, bytes((0x84, number, 0x70, 0x2E)))
    transport = MemoryTransport(board, clock, BAUD_RATE)
    release = MaestroRelease(transport, "port", MaestroSettings(model="mini24"), knows=False)

    assert list(release.find([])) == list(range(N))
    assert pulses(board.maestro) == [0] * N


def test_a_crc_is_refused_in_words():
    board, clock = PicoDevice(), ManualClock()
    wiring = on_maestro(FACE, model="pico", crc=True)
    controller = MaestroController(wiring, lambda: MemoryTransport(board, clock, BAUD_RATE))
    with pytest.raises(PortError, match=r"set bus\.crc to false"):
        controller.open()


def test_a_face_that_names_it_has_a_watchdog_without_saying_so():
    settings = MaestroSettings(model="pico", port="/dev/x")
    assert settings.serial_timeout_s == TIMEOUT_MS / 1e3
    can = MAESTRO.capabilities(settings)
    assert can.watchdog
    alone = "pulses off; a digital servo may hold"
    assert can.stop_table()["computer dies, or the plug is pulled"] == alone
    assert not MAESTRO.capabilities(MaestroSettings(model="mini12")).watchdog
    assert MaestroSettings(model="pico", serial_timeout_s=0.2).serial_timeout_s == 0.2
