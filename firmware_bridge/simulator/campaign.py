"""Every kind of fault against the whole bridge, on a virtual clock, with an auditor on the wire."""

import math
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from firmware_bridge.bridge import Bridge
from firmware_bridge.bus import BusError
from firmware_bridge.care import ServoState
from firmware_bridge.channel import MemoryTargetChannel
from firmware_bridge.clock import ManualClock
from firmware_bridge.dynamixel.bus import DynamixelBus
from firmware_bridge.dynamixel.codec import BROADCAST_ID, Instruction
from firmware_bridge.dynamixel.control_table import register, servo_models
from firmware_bridge.dynamixel.frames import FrameParser
from firmware_bridge.dynamixel.mounting import PULSES_PER_TURN, MountedServo
from firmware_bridge.joints import Joint
from firmware_bridge.life_cycle import LifeCycle
from firmware_bridge.simulator.face import chain_for
from firmware_bridge.simulator.faults import KINDS, ON_INSTRUCTIONS, ON_REPLIES, Fault
from firmware_bridge.simulator.memory_transport import MemoryTransport
from firmware_bridge.targets import ServoTargets

BAUD_RATE: Final = 1_000_000
#: Quiet, then trouble, then time to recover: reboots and cool-downs take seconds.
FAULT_FROM_S, FAULT_UNTIL_S, END_S = 2.0, 4.0, 12.0
INTENSITIES: Final = (0, 1, 2)
SIZES: Final = (5, 10, 20)
RATES_HZ: Final = (30.0, 100.0)
_PROBABILITIES: Final = (0.01, 0.1, 0.5)
_MAX_SPEED_DEG_S: Final = 300.0
_GOAL: Final = struct.pack("<H", register("goal_position").address)


@dataclass(frozen=True, slots=True)
class Case:
    """One fault at one intensity on one face."""

    kind: str
    intensity: int
    n_servos: int
    rate_hz: float

    def faults(self) -> list[Fault]:
        """Packets: 1, 10, 50 % of them. Servos: one once, one again and again, all at once."""
        kind, hard = self.kind, self.intensity
        amount = {
            "late_reply": (0.0005, 0.003, 0.010)[hard],
            "error_reply": 1.0,
            "id_change": 200.0,
            "pushed": (5.0, 20.0, 60.0)[hard],
            "encoder_fault": (0.0, 10.0, 90.0)[hard],
            "load": (0.3, 0.6, 0.9)[hard],
            "jam": 0.9,
            "limits_drift": 2100.0,
        }.get(kind, 0.0)
        if kind in ON_REPLIES | ON_INSTRUCTIONS:
            share = _PROBABILITIES[hard]
            return [
                Fault(
                    kind,
                    probability=share,
                    from_s=FAULT_FROM_S,
                    until_s=FAULT_UNTIL_S,
                    amount=amount,
                )
            ]
        servos = () if hard == 2 or kind == "unplug" else (self.n_servos // 2,)
        often = 0.5 if hard == 1 else 0.0
        lasts_s = 0.3 if hard == 1 else FAULT_UNTIL_S - FAULT_FROM_S
        return [
            Fault(
                kind,
                servos=servos,
                at_s=() if often else (FAULT_FROM_S,),
                from_s=FAULT_FROM_S,
                until_s=FAULT_UNTIL_S,
                every_s=often,
                lasts_s=lasts_s,
                amount=amount,
            )
        ]


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of one case.

    recovery_s: from the end of the fault until every servo follows again; None: never, which is
    right where nothing can bring it back (another id, another baud rate, a third reboot).
    """

    case: Case
    error: str
    goals_outside_limits: int
    steps_above_clamp: int
    contention: int
    torque_unknown: int
    recovery_s: float | None

    @property
    def survived(self) -> bool:
        """The process lives and nothing that must not happen happened."""
        bad = self.goals_outside_limits + self.steps_above_clamp + self.contention
        return not self.error and bad + self.torque_unknown == 0


def cases() -> Iterator[Case]:
    """Every kind, intensity, size and rate."""
    for kind in KINDS:
        for intensity in INTENSITIES:
            for n_servos in SIZES:
                for rate_hz in RATES_HZ:
                    yield Case(kind, intensity, n_servos, rate_hz)


class Auditor:
    """Reads what is written to the wire and knows only the limits; trusts nobody."""

    def __init__(self, servos: Sequence[MountedServo], period_s: float) -> None:
        self._ranges = {servo.joint.servo_id: servo.pulse_range() for servo in servos}
        speed = {s.joint.servo_id: s.joint.max_speed_deg_s * PULSES_PER_TURN / 360 for s in servos}
        self._speed = speed
        self._longest_s = 2.0 * period_s
        self._last: dict[int, tuple[float, int]] = {}
        self._parser = FrameParser()
        self.outside = self.too_far = self.goals = 0

    def see(self, time_s: float, data: bytes) -> None:
        """Look at one write."""
        if _GOAL not in data and not self._parser.pending:
            return  # the address is in no packet of it
        for frame in self._parser.feed(data):
            parameters = frame.parameters
            if parameters[:2] != _GOAL:
                continue
            if frame.instruction == Instruction.WRITE and frame.packet_id != BROADCAST_ID:
                # Waking: the goal is the place where the servo stands.
                goal = int.from_bytes(parameters[2:6], "little", signed=True)
                self._last[frame.packet_id] = (time_s, goal)
            elif frame.instruction == Instruction.SYNC_WRITE:
                for servo_id, goal in struct.iter_unpack("<Bi", parameters[4:]):
                    self._check(servo_id, goal, time_s)

    def _check(self, servo_id: int, goal: int, time_s: float) -> None:
        self.goals += 1
        low, high = self._ranges[servo_id]
        before_s, before = self._last.get(servo_id, (time_s, goal))
        self._last[servo_id] = (time_s, goal)
        # A pulse of rounding each; a joint found outside is led back in.
        if not min(low, before) - 1 <= goal <= max(high, before) + 1:
            self.outside += 1
        reach = self._speed[servo_id] * min(max(time_s - before_s, 0.0), self._longest_s)
        # The write comes a few packets after the tick it belongs to, a little more or less.
        if abs(goal - before) > reach + self._speed[servo_id] * 0.5 * self._longest_s + 2:
            self.too_far += 1


def face(n_servos: int) -> list[MountedServo]:
    """Servos as in `face_sim`, every other one mounted the other way round."""
    model = servo_models()["XL330-M288"]
    return [
        MountedServo(
            Joint(f"joint_{k}", k, -30.0, 40.0, _MAX_SPEED_DEG_S), model, 1 if k % 2 else -1
        )
        for k in range(1, n_servos + 1)
    ]


def play(case: Case, seed: int = 1, end_s: float = END_S) -> Outcome:
    """Run one case to its end."""
    servos = face(case.n_servos)
    clock = ManualClock()
    chain = chain_for(servos, BAUD_RATE, faults=case.faults(), seed=seed)
    auditor = Auditor(servos, 1.0 / case.rate_hz)
    bus = DynamixelBus(
        servos,
        lambda: MemoryTransport(chain, clock, BAUD_RATE, tap=auditor.see),
        watchdog_s=max(0.1, 3.0 / case.rate_hz),
        strict=False,
    )
    channel = MemoryTargetChannel()
    joints = [servo.joint for servo in servos]
    bridge = Bridge(bus, joints, channel, rate_hz=case.rate_hz, tolerant=True)
    error, recovered_s = "", math.nan
    try:
        with bus, LifeCycle(bridge, clock, rate_hz=case.rate_hz) as life:
            life.start()
            for time_s, late in life.ticks():
                if time_s > end_s:
                    break
                channel.publish(ServoTargets(time_s, wanted_deg(time_s, case.n_servos)))
                bridge.tick(time_s, late)
                fine = all(s is ServoState.DRIVEN for s in bridge.status.servo_states)
                if not fine:
                    recovered_s = math.nan
                elif math.isnan(recovered_s):
                    recovered_s = time_s
            believed = bus.look_after().torque_on if chain.plugged else None
            unknown = 0
            if believed is not None:
                for servo, belief in zip(chain.servos, believed, strict=True):
                    reachable = servo.deaf_until_s <= clock.now() and _reachable(servo, servos)
                    unknown += reachable and servo.torque_on != belief
    except (BusError, ArithmeticError, LookupError, ValueError, TypeError) as problem:
        error, unknown = f"{type(problem).__name__}: {problem}", 0
    stiff = sum(s.torque_on for s in chain.servos if _reachable(s, servos))
    return Outcome(
        case,
        error,
        auditor.outside,
        auditor.too_far,
        chain.counts.contention,
        int(unknown + (stiff if chain.plugged else 0)),
        None if math.isnan(recovered_s) else max(0.0, recovered_s - FAULT_UNTIL_S),
    )


def _reachable(servo: object, servos: Sequence[MountedServo]) -> bool:
    """Whether a servo still has its own id and rate: nobody can know of one that has not."""
    from firmware_bridge.simulator.servo import SimulatedServo

    assert isinstance(servo, SimulatedServo)
    at_home = servo.servo_id == servos[servo.index].joint.servo_id
    return at_home and servo.baud_rate == BAUD_RATE and not math.isinf(servo.deaf_until_s)


def wanted_deg(time_s: float, n_servos: int) -> np.ndarray:
    """Quick, and now and then beyond every limit."""
    phase = np.arange(n_servos) * 0.7
    return np.asarray(25.0 * np.sin(2.0 * np.pi * 1.3 * time_s + phase) + 20.0 * np.sin(time_s))
