"""Every kind of fault against the whole bridge, on a virtual clock, with an auditor on the wire."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final, Protocol

import numpy as np

from firmware_bridge.bus import ServoState
from firmware_bridge.clock import Clock, ManualClock
from firmware_bridge.dynamixel.bus import DynamixelBus
from firmware_bridge.dynamixel.control_table import servo_models
from firmware_bridge.dynamixel.mounting import MountedServo
from firmware_bridge.errors import BusError
from firmware_bridge.joints import Joint
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.life_cycle import LifeCycle, LifeCycleLinks
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.simulator.chain import chain_for
from firmware_bridge.simulator.faults import KINDS, ON_INSTRUCTIONS, ON_REPLIES, Fault
from firmware_bridge.simulator.ports import MemoryTransport
from firmware_bridge.stopping import Order, StopLevel, StopRequest
from lipservo_lab.campaigns.auditor import Auditor

BAUD_RATE: Final = 1_000_000
#: Quiet, then trouble, then time to recover: reboots and cool-downs take seconds.
FAULT_FROM_S, FAULT_UNTIL_S, END_S = 2.0, 4.0, 12.0
INTENSITIES: Final = (0, 1, 2)
SIZES: Final = (5, 10, 20)
RATES_HZ: Final = (30.0, 100.0)
#: A stop comes in the middle of the fault.
STOP_S: Final = 3.0
STOPS: Final = (None, StopLevel.SOFT, StopLevel.LIMP, StopLevel.FREEZE)
_PROBABILITIES: Final = (0.01, 0.1, 0.5)
_MAX_SPEED_DEG_S: Final = 300.0


@dataclass(frozen=True, slots=True)
class Case:
    """One fault at one intensity on one face, armed strictly or not, and a person's stop in it."""

    kind: str
    intensity: int
    n_servos: int
    rate_hz: float
    strict: bool = False
    stop: StopLevel | None = None

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

    motion_too_fast, moved_outside, armed_wrongly, undone, moved_frozen: see `Auditor`.
    torque_left_on: servos that can be reached and hold at the end. recovery_s: from the end of the
    fault until every servo follows again; None: never, which is right where nothing can bring it
    back (another id, another baud rate, a third reboot), or stopped before.
    """

    case: Case
    error: str
    goals_outside_limits: int
    steps_above_clamp: int
    motion_too_fast: int
    moved_outside: int
    armed_wrongly: int
    undone: int
    moved_frozen: int
    contention: int
    torque_unknown: int
    torque_left_on: int
    recovery_s: float | None

    @property
    def survived(self) -> bool:
        """The process lives and nothing that must not happen happened."""
        bad = self.goals_outside_limits + self.steps_above_clamp + self.motion_too_fast
        bad += (
            self.moved_outside
            + self.armed_wrongly
            + self.undone
            + self.contention
            + self.moved_frozen
        )
        return not self.error and bad + self.torque_unknown + self.torque_left_on == 0


def cases(*, whole: bool = False) -> Iterator[Case]:
    """Every kind, intensity, size and rate, with arming and stop in turns.

    whole: every way of arming and every stop for each of them, eight times as many.
    """
    ways = list(product((False, True), STOPS))
    grid = product(KINDS, INTENSITIES, SIZES, RATES_HZ)
    for n, (kind, intensity, n_servos, rate_hz) in enumerate(grid):
        for strict, stop in ways if whole else (ways[n * 3 % len(ways)],):
            yield Case(kind, intensity, n_servos, rate_hz, strict, stop)


def face(n_servos: int) -> list[MountedServo]:
    """Servos as in `face_sim`, every other one mounted the other way round."""
    model = servo_models()["XL330-M288"]
    return [
        MountedServo(
            Joint(f"joint_{k}", k, -30.0, 40.0, _MAX_SPEED_DEG_S), model, 1 if k % 2 else -1
        )
        for k in range(1, n_servos + 1)
    ]


class StopWitness(Protocol):
    """An auditor, as far as it must know of stops."""

    def note_stop(self, time_s: float, level: StopLevel) -> None:
        """A person stopped the face then."""

    def let_go(self) -> None:
        """A frozen face is let go now."""


class StopInTheFault:
    """A person's stop in the middle of the fault: the control socket of a case."""

    def __init__(self, level: StopLevel | None, clock: Clock, auditor: StopWitness) -> None:
        self._level, self._clock, self._auditor = level, clock, auditor
        self._is_frozen = False

    def poll(self) -> StopRequest | None:
        """The stop, at its moment."""
        now_s = self._clock.now()
        if self._is_frozen and now_s >= END_S:
            self._is_frozen = False
            self._auditor.let_go()
            return StopRequest(StopLevel.SOFT)  # a frozen face ends only when a person says so
        if self._level is None or now_s < STOP_S:
            return None
        level, self._level = self._level, None
        self._is_frozen = level is StopLevel.FREEZE
        self._auditor.note_stop(now_s, level)
        return StopRequest(level)

    def answer(self, status: Callable[[], Mapping[str, object]]) -> None:
        """Nobody waits for one."""

    def attend(self, refusal: Callable[[Order], str]) -> None:
        """Nobody orders anything of single servos."""

    def take_orders(self) -> Sequence[Order]:
        """None."""
        return ()

    def report_end(self, report: Mapping[str, object]) -> None:
        """Nobody waits."""


def play(case: Case, seed: int = 1, end_s: float = END_S) -> Outcome:
    """Run one case to its end."""
    servos = face(case.n_servos)
    clock = ManualClock()
    chain = chain_for(servos, BAUD_RATE, faults=case.faults(), seed=seed)
    auditor = Auditor(servos, 1.0 / case.rate_hz)
    auditor.watch(chain)
    bus = DynamixelBus(
        servos,
        lambda: MemoryTransport(chain, clock, BAUD_RATE, tap=auditor.see),
        watchdog_s=max(0.1, 3.0 / case.rate_hz),
        strict=case.strict,
    )
    channel = MemoryTargetChannel()
    joints = [servo.joint for servo in servos]
    settings = BridgeSettings(case.rate_hz, tolerant=not case.strict)
    bridge = Bridge(bus, joints, channel, settings)
    control = StopInTheFault(case.stop, clock, auditor)
    error, recovered_s, unknown = "", math.nan, 0
    try:
        with bus, LifeCycle(bridge, clock, LifeCycleLinks(control=control)) as life:
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
            if chain.plugged and not life.stopping:
                believed = bus.look_after().torque_on
                for servo, belief in zip(chain.servos, believed, strict=True):
                    reachable = servo.deaf_until_s <= clock.now() and _reachable(servo, servos)
                    unknown += reachable and servo.torque_on != belief
    except (BusError, ArithmeticError, LookupError, ValueError, TypeError) as problem:
        error = f"{type(problem).__name__}: {problem}"
    stiff = sum(s.torque_on for s in chain.servos if _reachable(s, servos))
    never = case.stop is not None or math.isnan(recovered_s)
    return Outcome(
        case=case,
        error=error,
        goals_outside_limits=auditor.goals_outside,
        steps_above_clamp=auditor.steps_too_long,
        motion_too_fast=auditor.too_fast,
        moved_outside=auditor.moved_outside,
        armed_wrongly=auditor.armed_wrongly,
        undone=auditor.armed_late,
        moved_frozen=auditor.moved_frozen,
        contention=chain.counts.contention,
        torque_unknown=int(unknown),
        torque_left_on=int(stiff) if chain.plugged else 0,
        recovery_s=None if never else max(0.0, recovered_s - FAULT_UNTIL_S),
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
