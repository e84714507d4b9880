"""Processor time of a tick of hobby servos, beside a loop by hand with pyserial or smbus2."""

import os
import statistics
import threading
import time
import tty
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import Any, Final

import numpy as np
import serial
import smbus2

from firmware_bridge.bus import ServoBus
from firmware_bridge.bus_kinds import Wiring
from firmware_bridge.clock import Clock, ManualClock
from firmware_bridge.joints import Joint
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.maestro.controller import MaestroController
from firmware_bridge.maestro.kind import BAUD_RATE, MAESTRO
from firmware_bridge.maestro.protocol import GET_ERRORS, GET_POSITION, N_DATA, SET_TARGETS
from firmware_bridge.maestro.settings import MaestroSettings
from firmware_bridge.pca9685.i2c import READ, DeviceTransfers, I2cChip
from firmware_bridge.pca9685.kind import PCA9685, controller_of
from firmware_bridge.pca9685.registers import FULL, IDENTITY, Mode1, Register
from firmware_bridge.pca9685.settings import Pca9685Settings
from firmware_bridge.pulse_bus import PulseBus, PulseController
from firmware_bridge.pulse_servos import PulseServo
from firmware_bridge.serial_servos.serial_transport import open_port
from lipservo_lab.bench.bus.tick_cpu_figures import moving_deg

N_SERVOS: Final = 16
_RATE_HZ: Final = 50.0
_ADDRESS: Final = 0x40
#: Ends the canned Maestro; no command of the protocol.
_END_BYTE: Final = 0xFF
_WARM_UP_BLOCKS, _BLOCKS, _CALLS = 15, 120, 10
#: Until the last servo has come on and has caught up.
_SETTLES_TICKS: Final = 400

#: Runs tick n of a motion; returns its thread CPU time, ns.
Call = Callable[[int], int]


def pulse_tick_ratios() -> dict[str, float]:
    """Return median CPU time of a tick of 16 hobby servos, over that of a loop written by hand.

    The loop by hand clamps each angle, makes it a pulse, and sends all pulses in one message, as
    the makers' examples do. `cpu_pulses_*`: our bus instead, which also switches servos on one by
    one, keeps their pulses, and asks the controller five times a second what it sends.
    `cpu_tick_*`: all of `Bridge.tick`, with targets, limits and supervision, which a loop by hand
    lacks. Thread CPU time, in interleaved blocks of ten calls. The Maestro's includes the system
    call to its port (a pseudo-terminal); those of I2C are left out on both sides.
    """
    with ExitStack() as stack:
        calls: dict[str, Call] = {}
        for name, board, by_hand in (
            ("maestro", _maestro(stack), _maestro_by_hand(stack)),
            ("pca9685", _pca9685(), _pca9685_by_hand()),
        ):
            calls[name] = stack.enter_context(_bus_tick(*board))
            calls[f"{name} by hand"] = _loop_by_hand(by_hand)
        for name, board in (("maestro", _maestro(stack)), ("pca9685", _pca9685())):
            calls[f"{name} whole"] = stack.enter_context(_whole_tick(*board))
        spent_us = calls_us(calls)
    median_us = {name: statistics.median(each) for name, each in spent_us.items()}
    figures: dict[str, float] = {}
    for name in ("maestro", "pca9685"):
        by_hand_us = median_us[f"{name} by hand"]
        figures |= {
            f"cpu_pulses_{name}_ratio": median_us[name] / by_hand_us,
            f"cpu_tick_{name}_ratio": median_us[f"{name} whole"] / by_hand_us,
        }
    return figures


def calls_us(calls: Mapping[str, Call]) -> dict[str, list[float]]:
    """Run all ticks in interleaved blocks; return the CPU time of each call, us, by name.

    The first `_WARM_UP_BLOCKS` do not count.
    """
    spent_us: dict[str, list[float]] = {name: [] for name in calls}
    for block in range(_WARM_UP_BLOCKS + _BLOCKS):
        for name, call in calls.items():
            for n in range(block * _CALLS, (block + 1) * _CALLS):
                spent_ns = call(n)
                if block >= _WARM_UP_BLOCKS:
                    spent_us[name].append(spent_ns * 1e-3)
    return spent_us


def timed(work: Callable[[Any], object], argument: object) -> int:
    """Call `work(argument)`; return its thread CPU time, ns."""
    begun_ns = time.thread_time_ns()
    work(argument)
    return time.thread_time_ns() - begun_ns


def _wiring(settings: object) -> Wiring:
    """Return the wiring of `N_SERVOS` equal hobby servos, -40 to 40 degrees, at one board."""
    joints = [
        Joint(f"joint_{n}", n, -40.0, 40.0, 300.0, address_key="channel") for n in range(N_SERVOS)
    ]
    servos = [
        PulseServo(
            channel=joint.servo_id,
            positive="opens",
            min_deg=joint.min_deg,
            max_deg=joint.max_deg,
            max_speed_deg_s=joint.max_speed_deg_s,
            us_per_deg=10.0,
        )
        for joint in joints
    ]
    return Wiring(settings, tuple(joints), tuple(servos), _RATE_HZ)


Controlled = tuple[Wiring, PulseController, ManualClock, Any]


def _maestro(stack: ExitStack) -> Controlled:
    wiring = _wiring(MaestroSettings(model="mini18"))
    port = stack.enter_context(_canned_maestro())
    controller = MaestroController(wiring, lambda: open_port(port, BAUD_RATE))
    return wiring, controller, ManualClock(), MAESTRO


def _pca9685() -> Controlled:
    wiring, clock = _wiring(Pca9685Settings()), ManualClock()
    transfers = DeviceTransfers(CannedI2c(), smbus2.i2c_msg)
    controller = controller_of(wiring, lambda: I2cChip(transfers, _ADDRESS, "canned"), clock)
    return wiring, controller, clock, PCA9685


@contextmanager
def _bus_tick(
    wiring: Wiring, controller: PulseController, clock: ManualClock, kind: Any
) -> Iterator[Call]:
    """Yield the bus's part of a tick, once all servos have pulses and have caught up."""
    can = kind.capabilities(wiring.settings)
    with PulseBus(wiring.servos, controller, clock, can, may_jump=True) as bus:
        for index in range(N_SERVOS):
            bus.enable_torque(index)
        tick = settled(_advancing_clock(bus_tick(bus), clock), _SETTLES_TICKS)
        assert bus.torque.as_json() == [True] * N_SERVOS
        yield tick


@contextmanager
def _whole_tick(
    wiring: Wiring, controller: PulseController, clock: ManualClock, kind: Any
) -> Iterator[Call]:
    """Yield a whole tick of a bridge, once all servos have pulses and have caught up."""
    can = kind.capabilities(wiring.settings)
    with PulseBus(wiring.servos, controller, clock, can, may_jump=True) as bus:
        bridge, call = whole_tick(bus, wiring, clock)
        tick = settled(_advancing_clock(call, clock), _SETTLES_TICKS)
        assert bridge.settled
        assert not bridge.troubles
        yield tick


def _advancing_clock(tick: Call, clock: ManualClock) -> Call:
    def tick_later(n: int) -> int:
        clock.advance(1.0 / _RATE_HZ)
        return tick(n)

    return tick_later


def bus_tick(bus: ServoBus) -> Call:
    """Return the bus's part of a tick: write goals, read feedback, look after the servos.

    The motion's angles are computed outside the measured time.
    """

    def work(goals_deg: np.ndarray) -> None:
        bus.write_positions(goals_deg)
        bus.feedback()
        bus.look_after()

    return lambda n: timed(work, moving_deg(n / _RATE_HZ, N_SERVOS))


def whole_tick(bus: ServoBus, wiring: Wiring, clock: Clock) -> tuple[Bridge, Call]:
    """Return a started bridge, and a call that publishes a target and measures one whole tick."""
    channel = MemoryTargetChannel()
    bridge = Bridge(bus, wiring.joints, channel, BridgeSettings(wiring.rate_hz))
    bridge.start()

    def tick(n: int) -> int:
        time_s = clock.now()
        channel.publish(ServoTargets(time_s, moving_deg(n / _RATE_HZ, N_SERVOS)))
        return timed(bridge.tick, time_s)

    return bridge, tick


def settled(tick: Call, n_ticks: int) -> Call:
    """Run `n_ticks` ticks without counting them; return the tick itself."""
    for n in range(n_ticks):
        tick(n)
    return tick


def _loop_by_hand(send: Callable[[list[float]], None]) -> Call:
    """Return a tick by hand: angles to pulses within each servo's range, given to `send` (us)."""
    servos = _wiring(None).servos

    def work(goals_deg: list[float]) -> None:
        pulses_us = []
        for servo, deg in zip(servos, goals_deg, strict=True):
            pulse_us = servo.neutral_us + servo.us_per_deg * deg
            pulses_us.append(min(max(pulse_us, servo.min_us), servo.max_us))
        send(pulses_us)

    return lambda n: timed(work, moving_deg(n / _RATE_HZ, N_SERVOS).tolist())


def _maestro_by_hand(stack: ExitStack) -> Callable[[list[float]], None]:
    """Return a function that sends pulses, us, to a fake Maestro by plain pyserial: the baseline.

    It writes Pololu's Set Multiple Targets command.
    """
    port = stack.enter_context(serial.Serial(stack.enter_context(_canned_maestro()), BAUD_RATE))

    def send(pulses_us: list[float]) -> None:
        message = bytearray([SET_TARGETS, N_SERVOS, 0])
        for pulse_us in pulses_us:
            target = round(pulse_us * 4)
            message.append(target & 0x7F)
            message.append(target >> 7)
        port.write(message)

    return send


def _pca9685_by_hand() -> Callable[[list[float]], None]:
    """Return a function that sends pulses, us, to a fake PCA9685 by plain smbus2: the baseline.

    All channels are written by auto-increment; each pulse begins at a time of its own.
    """
    bus, count_us = CannedI2c(), Pca9685Settings().timing.count_us

    def send(pulses_us: list[float]) -> None:
        data = [Register.LED0_ON_L.value]
        for channel, pulse_us in enumerate(pulses_us):
            on = channel * 256
            off = (on + round(pulse_us / count_us)) % 4096
            data += [on & 0xFF, on >> 8, off & 0xFF, off >> 8]
        bus.i2c_rdwr(smbus2.i2c_msg.write(_ADDRESS, data))

    return send


class CannedI2c(smbus2.SMBus):
    """A fake I2C adapter with one PCA9685, whose registers keep what is written.

    No system call is made.
    """

    def __init__(self) -> None:
        super().__init__()
        self.registers, self._pointer = bytearray(256), 0
        self.registers[Register.SUBADR1 : Register.ALLCALLADR + 1] = IDENTITY
        self.registers[Register.PRE_SCALE] = 0x1E

    def i2c_rdwr(self, *messages: Any) -> None:
        """Write registers by write messages, and fill read messages from the registers.

        The messages are prepared as smbus2 does for the kernel, so that this work is measured too.
        """
        smbus2.smbus2.i2c_rdwr_ioctl_data.create(*messages)
        for each in messages:
            if each.flags & READ:
                values = self.registers[self._pointer : self._pointer + each.len]
                for n, value in enumerate(values):
                    each.buf[n] = value
                continue
            data = bytes(each)
            self._pointer = data[0]
            end = self._pointer + len(data) - 1
            if self._pointer == Register.MODE1 and len(data) > 1:
                self.registers[0] = data[1] & ~Mode1.RESTART
            elif self._pointer == Register.ALL_LED_OFF_H:
                for channel in range(16):
                    self.registers[Register.LED0_ON_L + 4 * channel + 3] |= FULL
            else:
                self.registers[self._pointer : end] = data[1:]


@contextmanager
def _canned_maestro() -> Iterator[str]:
    """Yield the port of a fake Maestro, which answers in a thread until the block ends."""
    master, slave = os.openpty()
    tty.setraw(slave)
    goals = bytearray(2 * N_SERVOS)

    def answer_commands() -> None:
        """Answer commands at the pseudo-terminal until `_END_BYTE` arrives; runs in a thread.

        Goals are stored, and returned when positions are read; error flags are always zero.
        """
        received = b""
        while data := os.read(master, 4096):
            received += data
            while received and received[0] != _END_BYTE:
                command = received[0]
                n_data = 2 + len(goals) if command == SET_TARGETS else N_DATA[command]
                if len(received) <= n_data:
                    break
                if command == SET_TARGETS:
                    goals[:] = received[3 : 3 + len(goals)]
                elif command == GET_POSITION:
                    low, high = goals[2 * received[1] : 2 * received[1] + 2]
                    os.write(master, (low | high << 7).to_bytes(2, "little"))
                elif command == GET_ERRORS:
                    os.write(master, bytes(2))
                received = received[1 + n_data :]
            if received[:1] == bytes([_END_BYTE]):
                return

    thread = threading.Thread(target=answer_commands, daemon=True)
    thread.start()
    try:
        yield os.ttyname(slave)
    finally:
        os.write(slave, bytes([_END_BYTE]))
        thread.join(1.0)
        os.close(slave)
        os.close(master)
