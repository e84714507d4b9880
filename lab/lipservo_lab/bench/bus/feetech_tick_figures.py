"""Processor time of a tick of Feetech servos, beside a loop by hand with pyserial."""

import statistics
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Final

import serial

from firmware_bridge.bus import ServoBus
from firmware_bridge.bus_kinds import Wiring
from firmware_bridge.clock import MonotonicClock
from firmware_bridge.feetech.control_table import servo_models
from firmware_bridge.feetech.kind import FEETECH
from firmware_bridge.feetech.settings import FeetechServo, FeetechSettings
from firmware_bridge.joints import Joint
from lipservo.runtime.servos.sim_process import simulated_port
from lipservo_lab.bench.bus.pulse_tick_figures import (
    N_SERVOS,
    Call,
    bus_tick,
    calls_us,
    settled,
    timed,
    whole_tick,
)
from lipservo_lab.bench.bus.tick_cpu_figures import moving_deg

_RATE_HZ: Final = 50.0
_BAUD_RATE: Final = 1_000_000
_MODEL: Final = "STS3215"
_SYNC_READ, _SYNC_WRITE, _EVERYBODY = 0x82, 0x83, 0xFE
#: Until all have torque, and their full speed.
_SETTLES_TICKS: Final = 150
_TRIES: Final = 50


def feetech_tick_ratios() -> dict[str, float]:
    """Return median CPU time of a tick of 16 STS3215, over that of a loop written by hand.

    The loop by hand clamps each angle, makes it a position, and does one sync write and one sync
    read of all positions, whose answers it checks, as the maker's examples do.
    `cpu_goals_feetech_ratio`: our bus instead, which also reads load, voltage, temperature and
    errors. `cpu_tick_feetech_ratio`: all of `Bridge.tick`. Thread CPU time; the servos are
    simulated behind a pseudo-terminal, in processes of their own, with the time of their wire.
    """
    arguments = ["--kind", "feetech", "--servos", str(N_SERVOS), "--model", _MODEL]
    with ExitStack() as stack:
        ports = [stack.enter_context(simulated_port(arguments)) for _ in range(3)]
        calls = {
            "bus": stack.enter_context(_bus_tick(_wiring(ports[0]))),
            "by hand": stack.enter_context(_tick_by_hand(ports[1])),
            "whole": stack.enter_context(_whole_tick(_wiring(ports[2]))),
        }
        median_us = {name: statistics.median(each) for name, each in calls_us(calls).items()}
    return {
        "cpu_goals_feetech_ratio": median_us["bus"] / median_us["by hand"],
        "cpu_tick_feetech_ratio": median_us["whole"] / median_us["by hand"],
    }


def _wiring(port: str) -> Wiring:
    """Return the wiring of `N_SERVOS` equal Feetech servos, -40 to 40 degrees, at a serial port."""
    joints = [Joint(f"joint_{n}", n, -40.0, 40.0, 260.0) for n in range(1, N_SERVOS + 1)]
    servos = [
        FeetechServo(
            id=joint.servo_id,
            model=_MODEL,
            positive="opens",
            min_deg=joint.min_deg,
            max_deg=joint.max_deg,
            max_speed_deg_s=joint.max_speed_deg_s,
        )
        for joint in joints
    ]
    settings = FeetechSettings(port=port, baud_rate=_BAUD_RATE)
    return Wiring(settings, tuple(joints), tuple(servos), _RATE_HZ)


@contextmanager
def _bus_tick(wiring: Wiring) -> Iterator[Call]:
    """Yield the bus's part of a tick, once all servos have torque and full speed."""
    bus: ServoBus
    with FEETECH.open(wiring, MonotonicClock()) as bus:
        bus.read()
        # On a busy computer the simulator may answer too late.
        assert all(
            any(not bus.enable_torque(index) for _ in range(_TRIES)) for index in range(N_SERVOS)
        )
        yield settled(bus_tick(bus), _SETTLES_TICKS)


@contextmanager
def _whole_tick(wiring: Wiring) -> Iterator[Call]:
    """Yield a whole tick of a bridge, once all servos have torque and full speed."""
    clock = MonotonicClock()
    with FEETECH.open(wiring, clock) as bus:
        bridge, call = whole_tick(bus, wiring, clock)
        tick = settled(call, _SETTLES_TICKS)
        assert not bridge.troubles
        yield tick


@contextmanager
def _tick_by_hand(port_name: str) -> Iterator[Call]:
    """Yield one tick written directly with pyserial, the measure that our bus is compared with.

    Opens the port `name` and enables torque first. The call takes a tick's number and returns what
    `timed` measured.
    """
    dialect = servo_models()[_MODEL].dialect
    per_deg = dialect.positions_per_deg
    goal_address = dialect.registers["goal_position"].address
    position_address = dialect.registers["present_position"].address
    ids = range(1, N_SERVOS + 1)
    read_request = _packet(_SYNC_READ, [position_address, 2, *ids])
    torque = dialect.registers["torque_enable"].address
    with serial.Serial(port_name, _BAUD_RATE, timeout=0.05) as port:
        port.write(_packet(_SYNC_WRITE, [torque, 1, *(each for n in ids for each in (n, 1))]))

        def exchange(goals_deg: list[float]) -> list[int]:
            """Write goals (degrees) by one sync write, read all positions; return encoder steps.

            Goals are clipped to +-40 degrees; answers with a wrong header or checksum are dropped.
            """
            parameters = [goal_address, 2]
            for n, deg in zip(ids, goals_deg, strict=True):
                value = round(dialect.center + min(max(deg, -40.0), 40.0) * per_deg)
                parameters += [n, value & 0xFF, value >> 8]
            port.write(_packet(_SYNC_WRITE, parameters))
            port.write(read_request)
            answer = port.read(8 * N_SERVOS)
            positions = []
            for start in range(0, len(answer), 8):
                status = answer[start : start + 8]
                if status[:2] == b"\xff\xff" and ~sum(status[2:7]) & 0xFF == status[-1]:
                    positions.append(status[5] | status[6] << 8)
            return positions

        assert len(exchange([0.0] * N_SERVOS)) == N_SERVOS
        yield lambda n: timed(exchange, moving_deg(n / _RATE_HZ, N_SERVOS).tolist())


def _packet(instruction: int, parameters: list[int]) -> bytes:
    """Return a Feetech packet to all servos, with its checksum."""
    body = [_EVERYBODY, len(parameters) + 2, instruction, *parameters]
    return bytes([0xFF, 0xFF, *body, ~sum(body) & 0xFF])
