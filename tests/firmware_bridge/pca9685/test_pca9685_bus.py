"""Hobby servos at a PCA9685: what goes over I2C, judged by the log of the simulated chip."""

import ctypes
import errno
import os
import re
from types import SimpleNamespace

import numpy as np
import pytest
from hobby_bus import on_pca9685

from firmware_bridge.bus_kinds import Severity
from firmware_bridge.clock import ManualClock
from firmware_bridge.errors import PortError, PortGone
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.life_cycle import LifeCycle
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.pca9685 import i2c
from firmware_bridge.pca9685.controller import NO_GUARD, Pca9685, check_identity
from firmware_bridge.pca9685.i2c import READ, I2cChip, open_chip
from firmware_bridge.pca9685.kind import PCA9685, BoardRelease
from firmware_bridge.pca9685.oe_guard import HOLD_S, OeGuard
from firmware_bridge.pca9685.registers import Mode1, Register
from firmware_bridge.pca9685.simulator import MemoryTransfers, SimulatedPca9685, chip_for
from firmware_bridge.pulse_bus import PulseBus
from firmware_bridge.stopping import StopLevel
from lipservo.settings.settings import load_shipped_face, parse_face
from lipservo.settings.strict_yaml import SettingsError

RATE_HZ = 50.0


class Tapped(MemoryTransfers):
    """Keeps every transfer."""

    def __init__(self, chip, clock):
        super().__init__(chip, clock)
        self.seen = []

    def transfer(self, messages):
        self.seen.append([(a, f, d if isinstance(d, int) else bytes(d)) for a, f, d in messages])
        return super().transfer(messages)


@pytest.fixture
def board():
    """Four servos, nobody has sent them a pulse; frequency 50 Hz."""
    return board_of(face_at(50.0))


def face_at(frequency_hz):
    return parse_face(on_pca9685(load_shipped_face("face_four"), frequency_hz=frequency_hz), "f")


def board_of(face, chip=None, clock=None, guard=None):
    wiring, clock = face.wiring, clock or ManualClock()
    chip = chip or chip_for(wiring)
    tap = Tapped(chip, clock)
    opener = lambda: I2cChip(tap, 0x40, "simulated")  # noqa: E731
    controller = Pca9685(
        opener, wiring.settings.timing, [each.channel for each in wiring.servos], clock, guard
    )
    bus = PulseBus(
        wiring.servos, controller, clock, PCA9685.capabilities(wiring.settings), may_jump=True
    )
    channel = MemoryTargetChannel()
    bridge = Bridge(bus, wiring.joints, channel, BridgeSettings(RATE_HZ))
    return SimpleNamespace(
        face=face, clock=clock, chip=chip, tap=tap, bus=bus, bridge=bridge, channel=channel,
        opener=opener,
    )  # fmt: skip


class Pin(OeGuard):
    """Has no process: its heartbeats go to an OE pin in memory."""

    def __init__(self, clock):
        super().__init__("chip", 17, clock)
        self.low_until_s, self.heard, self._echoes = 0.0, [], []

    def start(self):
        if self._link is None:
            self._link = self
            self.beat(passes=False)

    def send(self, heartbeat, _flags):
        self.low_until_s = self._clock.now() + HOLD_S if heartbeat == b"1" else 0.0
        self.heard.append(heartbeat)
        self._echoes.append(heartbeat)

    def recv(self, _size):
        if not self._echoes:
            raise BlockingIOError
        return self._echoes.pop()

    def close(self):
        self._link = None

    def is_high(self):
        return self._clock.now() >= self.low_until_s


@pytest.fixture
def guarded():
    """The same board with a guard at its OE pin."""
    face, clock = face_at(50.0), ManualClock()
    pin = Pin(clock)
    chip = chip_for(face.wiring, oe_is_high=pin.is_high)
    return SimpleNamespace(**vars(board_of(face, chip, clock, pin)), pin=pin)


def stand_still(board, seconds):
    """The process is stopped, and the board goes on."""
    for _ in range(int(seconds * RATE_HZ)):
        board.clock.advance(1.0 / RATE_HZ)
        board.chip.advance(board.clock.now())


def drive(board, seconds, goal_deg=(6.0, -3.0, 3.0, -2.0)):
    for _ in range(int(seconds * RATE_HZ)):
        time_s = board.clock.now() + 1.0 / RATE_HZ
        board.clock.sleep_until(time_s)
        board.channel.publish(ServoTargets(time_s, np.array(goal_deg)))
        board.bridge.tick(time_s)


def widths_us(board, since_s):
    """Of every channel, all lengths since a time."""
    found = {}
    for pulse in board.chip.log():
        if pulse.start_s >= since_s:
            found.setdefault(pulse.channel, []).append(pulse.width_us)
    return found


def test_opening_and_reading_write_nothing(board):
    with board.bus:
        board.bus.read()
        board.bus.look_after()
    written = [m for messages in board.tap.seen for m in messages if not m[1] and len(m[2]) > 1]

    assert not written


def test_servos_come_on_one_after_another_and_reach_their_goals(board):
    with board.bus:
        board.bridge.start()
        drive(board, 3.0)
        first_s = {}
        for pulse in board.chip.log():
            first_s.setdefault(pulse.channel, pulse.start_s)
        places_deg = board.chip.places_deg(board.clock.now())

        assert list(first_s) == [0, 1, 2, 3]
        assert (np.diff(list(first_s.values())) > 0.2).all()
        np.testing.assert_allclose(list(places_deg.values()), [6.0, -3.0, 3.0, -2.0], atol=0.3)
        assert not board.chip.to_others


def test_a_tick_is_one_transfer_and_no_pulse_is_outside_the_limits(board):
    with board.bus:
        board.bridge.start()
        drive(board, 3.0)
        board.tap.seen.clear()
        drive(board, 1.0, (20.0, -5.0, 5.0, 5.0))
        ticks = [m for m in board.tap.seen if len(m[0][2]) == 1 + 4 * 4]

        assert len(ticks) == 50
        # The pulses, and whether the chip is still set up: bcm2835 wants a read to be the last.
        assert all(m[1:] == [(0x40, 0, b"\x00"), (0x40, READ, 1)] for m in ticks)
    for servo in board.face.servos.values():
        widths = widths_us(board, 0.0)[servo.channel]
        assert servo.min_us - 3.0 <= min(widths)
        assert max(widths) <= servo.max_us + 3.0


def test_pulses_begin_a_sixteenth_of_the_cycle_apart(board):
    with board.bus:
        board.bridge.start()
        drive(board, 3.0)
        last = {pulse.channel: pulse.start_s for pulse in board.chip.log()}

    period_s = board.face.bus.timing.period_us * 1e-6
    for channel in (1, 2, 3):
        apart = (last[channel] - last[0]) % period_s
        assert apart == pytest.approx(channel * period_s / 16, abs=1e-6)


def test_the_all_call_address_is_not_answered_any_more(board):
    with board.bus:
        board.bridge.start()
        drive(board, 0.1)

        assert board.chip.transfer([(0x70, 0, b"\x01\x00")], board.clock.now())[0]


def test_a_stop_switches_all_off_in_one_byte_and_claims_nothing(board):
    with board.bus, LifeCycle(board.bridge, board.clock) as life:
        life.start()
        drive(board, 3.0)
        board.tap.seen.clear()
        life.stop(StopLevel.LIMP)
        stopped_s, first = board.clock.now(), board.tap.seen[0]
        for time_s, late in life.ticks():
            board.bridge.tick(time_s, late)
    board.clock.advance(1.0)
    board.chip.advance(board.clock.now())

    assert first == [(0x40, 0, b"\xfd\x10")]
    assert not widths_us(board, stopped_s + 0.025)
    assert not any(pulse.is_cut for pulse in board.chip.log())
    assert life.report.released == board.bridge.names
    assert "limp" not in life.report.text()


@pytest.mark.parametrize("after_s", [0.6, 3.0], ids=["while they come on", "driven"])
def test_after_a_broken_supply_servos_come_back_one_after_another(board, after_s):
    with board.bus:
        board.bridge.start()
        drive(board, after_s)
        board.chip.brown_out()
        broken_s = board.clock.now()
        drive(board, 5.0)
        first_s = {}
        for pulse in board.chip.log():
            if pulse.start_s > broken_s:
                first_s.setdefault(pulse.channel, pulse.start_s)

        assert sorted(first_s) == [0, 1, 2, 3]
        assert (np.diff(sorted(first_s.values())) > 0.08).all()
        assert board.bridge.troubles == ()
        places_deg = board.chip.places_deg(board.clock.now())
        np.testing.assert_allclose(list(places_deg.values()), [6.0, -3.0, 3.0, -2.0], atol=0.3)


def test_a_chip_that_another_program_set_up_meanwhile_is_driven_on(board):
    """Its pulses go on until it is set up anew, which ends them all."""
    with board.bus:
        board.bridge.start()
        drive(board, 3.0)
        board.chip.registers[Register.MODE1] = Mode1.ALL_CALL
        drive(board, 5.0, (3.0, -1.0, 1.0, -1.0))
        places_deg = board.chip.places_deg(board.clock.now())

        np.testing.assert_allclose(list(places_deg.values()), [3.0, -1.0, 1.0, -1.0], atol=0.3)


def test_a_supply_that_breaks_down_while_the_chip_is_set_up_makes_no_wrong_pulse(board):
    """With the prescaler of power-up a pulse of 1500 us would be one of 375."""
    transfer, n_seen = board.tap.transfer, 0

    def breaks(messages):
        nonlocal n_seen
        n_seen += any(message[2] == b"\xfe\x79" for message in messages)  # the prescaler
        if n_seen == 1 and messages[0][2] == b"\x01\x04":
            board.chip.brown_out()
            n_seen = 2
        return transfer(messages)

    board.tap.transfer = breaks
    with board.bus:
        board.bridge.start()
        drive(board, 4.0)

        assert n_seen > 2
        assert board.bridge.troubles == ()
    for widths in widths_us(board, 0.0).values():
        assert min(widths) > 1000.0


def test_one_spoilt_message_is_sent_again_and_more_are_a_lost_port(board):
    with board.bus:
        board.bridge.start()
        drive(board, 3.0)
        board.chip.nacks = 1
        drive(board, 0.5)
        assert board.bridge.counts.n_unplugged == 0
        board.chip.nacks = 4
        drive(board, 3.0)

        assert board.bridge.counts.n_unplugged == 1
        assert board.bridge.troubles == ()


def test_a_truncated_message_leaves_no_pulse_outside_the_limits(board):
    with board.bus:
        board.bridge.start()
        drive(board, 3.0)
        since_s = board.clock.now()
        for cut_after in range(2, 17):
            board.chip.cut_after = cut_after
            drive(board, 0.1, (20.0, -5.0, 5.0, 5.0) if cut_after % 2 else (0.0, 0.0, 0.0, 0.0))

    for channel, widths in widths_us(board, since_s).items():
        servo = next(each for each in board.face.servos.values() if each.channel == channel)
        assert servo.min_us - 3.0 <= min(widths)
        assert max(widths) <= servo.max_us + 3.0


def test_pulses_of_before_go_on_and_say_where_the_servos_stand(board):
    """A bridge that was killed leaves the chip as it is; the next one takes over."""
    with board.bus:
        board.bridge.start()
        drive(board, 3.0)
        again = board_of(board.face, board.chip, board.clock)
        with again.bus:
            goals_deg = again.bus.read().goals_deg
            again.tap.seen.clear()
            again.bus.enable_torque(0)
            written = [m for messages in again.tap.seen for m in messages if not m[1]]

    np.testing.assert_allclose(goals_deg, [6.0, -3.0, 3.0, -2.0], atol=0.3)
    assert not any(m[2].startswith(b"\x00") and len(m[2]) > 1 for m in written), "set up already"


def test_pulses_of_before_at_another_frequency_are_read_as_the_chip_makes_them(board):
    with board.bus:
        board.bridge.start()
        drive(board, 3.0)
        with board_of(face_at(60.0), board.chip, board.clock).bus as again:
            goals_deg = again.read().goals_deg

    np.testing.assert_allclose(goals_deg, [6.0, -3.0, 3.0, -2.0], atol=0.3)


def test_pulses_of_a_chip_that_another_program_set_up_are_not_said_to_be_off(board):
    with board.bus:
        board.bridge.start()
        drive(board, 3.0)
        board.chip.transfer([(0x40, 0, b"\x00\x21")], board.clock.now())  # as by Adafruit
        with board_of(board.face, board.chip, board.clock).bus as again:
            assert again.torque.as_json() == [True] * 4
        board.chip.transfer([(0x40, 0, b"\x00\x31")], board.clock.now())  # asleep
        with board_of(board.face, board.chip, board.clock).bus as again:
            assert again.torque.as_json() == [False] * 4


def test_a_frozen_face_whose_guard_blocked_its_pulses_while_the_wire_was_out_gets_none_back(
    guarded,
):
    with guarded.bus:
        guarded.bridge.start()
        drive(guarded, 3.0)
        guarded.bridge.stop(StopLevel.FREEZE)
        drive(guarded, 0.5)
        guarded.chip.nacks = 1_000_000
        drive(guarded, 3.0)
        guarded.chip.nacks, back_s = 0, guarded.clock.now()
        drive(guarded, 1.0)

        assert guarded.bridge.plugged
        assert not widths_us(guarded, back_s)
        assert guarded.bridge.torque_by_name()["holds"] == []


def test_pulses_that_a_guard_ended_with_its_bridge_do_not_go_on_by_the_next_one(guarded):
    guarded.bus.__enter__()
    guarded.bridge.start()
    drive(guarded, 3.0)
    stand_still(guarded, 1.0)
    killed_s, pin = guarded.clock.now(), guarded.pin
    pin.close()
    again = board_of(guarded.face, guarded.chip, guarded.clock, pin)
    with again.bus:
        again.bridge.start_frozen()
        drive(again, 1.0)

        assert not widths_us(again, killed_s)
        assert again.bridge.torque_by_name()["holds"] == []
        np.testing.assert_allclose(again.bus.read().goals_deg, [6.0, -3.0, 3.0, -2.0], atol=0.3)
    assert pin.heard[-1] == b"2", "the registers are on: the pin stays held"


def test_after_a_stop_of_the_process_within_a_transfer_servos_come_on_one_after_another(guarded):
    transfer = guarded.tap.transfer

    def slow(messages):
        found = transfer(messages)
        guarded.tap.transfer = transfer
        stand_still(guarded, 2.0)
        return found

    with guarded.bus:
        guarded.bridge.start()
        drive(guarded, 3.0)
        guarded.tap.transfer = slow
        drive(guarded, 1.0 / RATE_HZ)
        late_s, first_s = guarded.clock.now(), {}
        drive(guarded, 1.5)
        for pulse in guarded.chip.log():
            if pulse.start_s > late_s:
                first_s.setdefault(pulse.channel, pulse.start_s)

        assert list(first_s) == [0, 1, 2, 3]
        assert (np.diff(list(first_s.values())) > 0.2).all()


@pytest.mark.parametrize("is_out", [False, True])
def test_the_guard_holds_the_pin_after_an_end_where_the_registers_may_be_on(guarded, is_out):
    with guarded.bus:
        guarded.bridge.start()
        drive(guarded, 3.0)
        guarded.chip.nacks = 1_000_000 * is_out
    assert guarded.pin.heard[-1] == (b"2" if is_out else b"0")


def test_another_chip_at_the_address_is_refused_unharmed():
    class Other:
        def transfer(self, messages):
            assert all(flags & READ or len(data) == 1 for _, flags, data in messages)
            return b"\x39"

        def close(self):
            pass

    chip = I2cChip(Other(), 0x40, "/dev/i2c-1, address 0x40")
    with pytest.raises(PortError, match="no PCA9685 answers there") as error:
        BoardRelease(chip)
    assert "INA219" in str(error.value)


def test_a_stuck_bus_is_named():
    class Stuck:
        def transfer(self, _messages):
            raise OSError(errno.ETIMEDOUT, "timed out")

    with pytest.raises(PortGone, match="the bus is stuck; a chip holds SDA or SCL low"):
        I2cChip(Stuck(), 0x40, "x").write([b"\x00\x20"])


def test_a_board_is_let_go_without_a_bridge(board):
    with board.bus:
        board.bridge.start()
        drive(board, 3.0)
        port = BoardRelease(board.opener())
        port.tell_all([0, 1])
        board.clock.advance(0.05)
        off_s = board.clock.now()
        board.clock.advance(1.0)
        board.chip.advance(board.clock.now())

        assert not widths_us(board, off_s)
        assert not port.confirms


def test_one_address_is_ours_alone_and_others_stay_free(tmp_path):
    path = tmp_path / "i2c-1"
    path.touch()
    with open(path, "r+b") as one, open(path, "r+b") as two, open(path, "r+b") as three:
        i2c._claim(one.fileno(), 0x40, alone=False)
        i2c._claim(two.fileno(), 0x41, alone=False)
        with pytest.raises(OSError, match="unavailable"):
            i2c._claim(three.fileno(), 0x40, alone=False)


def test_what_is_missing_is_said_with_its_remedy(tmp_path, monkeypatch):
    pytest.importorskip("smbus2")
    with pytest.raises(PortError, match=r"no such I2C bus; switch it on \(Raspberry Pi"):
        open_chip(str(tmp_path / "i2c-1"), 0x40)
    (tmp_path / "i2c-2").touch()
    with pytest.raises(PortError, match="is no I2C bus"):
        open_chip(str(tmp_path / "i2c-2"), 0x40)

    def forbidden(*_):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr("smbus2.SMBus", forbidden)
    with pytest.raises(PortError, match="usermod -aG i2c"):
        open_chip("/dev/i2c-1", 0x40)
    monkeypatch.setitem(__import__("sys").modules, "smbus2", None)
    with pytest.raises(PortError, match=r"pip install 'lipservo\[pca9685\]'"):
        open_chip("/dev/i2c-1", 0x40)


@pytest.mark.parametrize(
    ("right", "wrong", "error"),
    [
        ("kind: pca9685", "kind: pca9685\n  address: 0x70", "PCA9685 address 0x70 is not"),
        ("kind: pca9685", "kind: pca9685\n  oe_gpio: -1", "-1 is outside 0..1023"),
        ("frequency_hz: 200.0", "frequency_hz: 400.0", "400 is outside 50..330"),
        ("channel: 3", "channel: 16", "channel 16 is outside 0..15"),
        ("channel: 3", "channel: 2", "both have channel 2; every servo needs its own"),
        ("us_per_deg: 10.0", "us_per_deg: 60.0", "outside min_us..max_us (1000..2000 us)"),
    ],
)
def test_what_no_board_can_do_is_refused_in_words(right, wrong, error):
    text = on_pca9685(load_shipped_face("face_four"))
    with pytest.raises(SettingsError, match=re.escape(error)):
        parse_face(text.replace(right, wrong), "face.yaml")


def test_the_file_of_the_bus_follows_from_its_number():
    text = on_pca9685(load_shipped_face("face_four"), i2c_bus=3)
    face = parse_face(text, "face.yaml")

    assert face.servo_port == "/dev/i2c-3"
    assert parse_face(on_pca9685(load_shipped_face("face_four")), "face.yaml").servo_port is None
    assert face.model_validate(face.model_dump()) == face


def test_too_many_bytes_for_the_bus_are_told_before(board):
    assert PCA9685.slowness(board.face.wiring, 50.0) is None
    assert "100 kHz" in PCA9685.slowness(board.face.wiring, 400.0)


def test_doctor_reads_and_says_what_cannot_be_known(board, monkeypatch):
    monkeypatch.setattr("firmware_bridge.pca9685.kind.opener_of", lambda _: board.opener)
    before = bytes(board.chip.registers)
    findings = list(PCA9685.examine(board.face.wiring))
    text = "\n".join(f.what for f in findings)

    assert bytes(board.chip.registers) == before
    assert max(f.severity for f in findings) is Severity.WARNING
    for words in ("a PCA9685", "asleep", "channel 0, no pulses", NO_GUARD, "clock_hz is that of"):
        assert words in text
    assert NO_GUARD in board.bus.remarks()


def test_doctor_tells_the_pulses_that_the_chip_makes_and_none_while_it_sleeps(board, monkeypatch):
    monkeypatch.setattr("firmware_bridge.pca9685.kind.opener_of", lambda _: board.opener)

    def told_us():
        found = [each.what for each in PCA9685.examine(face_at(60.0).wiring)]
        return re.findall(r"channel \d, (\d+ us|no pulses);", "\n".join(found))

    with board.bus:
        board.bridge.start()
        drive(board, 3.0)
        made_us = [float(each.removesuffix(" us")) for each in told_us()]
        assert made_us == pytest.approx([1560.0, 1470.0, 1530.0, 1480.0], abs=3.0)
        board.chip.transfer([(0x40, 0, b"\x00\x30")], board.clock.now())
        assert told_us() == ["no pulses"] * 4


def test_smbus2_is_handed_the_messages_that_the_chip_takes(tmp_path, monkeypatch):
    """All of smbus2 but the ioctl itself."""
    pytest.importorskip("smbus2")
    chip, path = SimulatedPca9685(), tmp_path / "i2c-1"
    path.touch()

    class Bus:
        funcs = 1

        def __init__(self, name):
            self.fd = os.open(name, os.O_RDWR)

        def i2c_rdwr(self, *made):
            messages = [(m.addr, m.flags, m.len if m.flags & READ else bytes(m)) for m in made]
            number, found = chip.transfer(messages, 0.0)
            if number:
                raise OSError(number, os.strerror(number))
            for each in made:
                if each.flags & READ:
                    ctypes.memmove(each.buf, found, each.len)

        def close(self):
            os.close(self.fd)

    asked = []
    monkeypatch.setattr("smbus2.SMBus", Bus)
    monkeypatch.setattr(i2c.fcntl, "ioctl", lambda *arguments: asked.append(arguments[1:]))
    opened = open_chip(str(path), 0x40)
    try:
        check_identity(opened)
        opened.write([bytes([0x00, 0x20])])
        assert opened.read(0x00) == b"\x20"
        with pytest.raises(PortError, match="used by another program; `lipservo status`"):
            open_chip(str(path), 0x40)
        open_chip(str(path), 0x41).close()
        chip.nacks = 2
        with pytest.raises(PortGone, match="no chip acknowledges; check power, SDA and SCL"):
            opened.read(0x00)
    finally:
        opened.close()
    assert set(asked) == {(0x0702, 5)}
    Bus.funcs = 0
    with pytest.raises(PortError, match="only speaks SMBus"):
        open_chip(str(path), 0x40)
