"""Every kind of fault of every kind of bus against the whole bridge, on a virtual clock.

`Trials` says for a kind of bus which faults it has, what must not happen, and which stage
(simulated servos with their observers) plays a case; the rest is here.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from itertools import product
from typing import Final, Protocol

import numpy as np

from firmware_bridge.bus import ServoBus, ServoState
from firmware_bridge.clock import Clock, ManualClock
from firmware_bridge.errors import BusError
from firmware_bridge.joints import Joint
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.life_cycle import LifeCycle, LifeCycleLinks
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.stopping import Order, StopLevel, StopReport, StopRequest

#: The fault begins and ends, s; then there is time to recover: reboots and cool-downs take seconds.
FAULT_FROM_S, FAULT_UNTIL_S, END_S = 2.0, 4.0, 12.0
INTENSITIES: Final = (0, 1, 2)
#: A stop comes in the middle of the fault.
STOP_S: Final = 3.0
STOPS: Final = (None, StopLevel.SOFT, StopLevel.LIMP, StopLevel.FREEZE)
MAX_SPEED_DEG_S: Final = 300.0
#: Kinds of bus, and the module and name of their trials.
_TRIALS: Final = {
    "dynamixel": "chain_trials:DYNAMIXEL",
    "feetech": "chain_trials:FEETECH",
    "maestro": "pulse_trials:MAESTRO",
    "pca9685": "pulse_trials:PCA9685",
}
CAMPAIGN_BUSES: Final = tuple(_TRIALS)


@dataclass(frozen=True, slots=True)
class Case:
    """One fault of one bus at one intensity, and a person's stop during the fault.

    intensity: 0 to 2. strict: servos are armed strictly. stop: None: no stop.
    """

    bus: str
    kind: str
    intensity: int
    n_servos: int
    rate_hz: float
    strict: bool = False
    stop: StopLevel | None = None

    def times_s(self) -> list[tuple[float, float]]:
        """Return when the fault happens and for how long, s.

        Intensity 0: once; 1: every half second; 2: always.
        """
        every_s, lasts_s = ((9.0, 0.3), (0.5, 0.2), (0.1, 0.1))[self.intensity]
        return [(at_s, lasts_s) for at_s in np.arange(FAULT_FROM_S, FAULT_UNTIL_S, every_s)]


class Stage(Protocol):
    """A face of simulated servos with a fault, and its observers outside the code under test."""

    @property
    def bus(self) -> ServoBus:
        """The bus that the bridge drives."""

    @property
    def clock(self) -> ManualClock:
        """The clock that moves the servos."""

    @property
    def joints(self) -> Sequence[Joint]:
        """The joints, in the order of the servos."""

    @property
    def auditor(self) -> "StopWitness":
        """The auditor that watches the wire."""

    def look(self, bridge: Bridge) -> None:
        """Check the robot after a tick."""

    def look_at_last(self) -> None:
        """Check the robot before servos are released, if no person has stopped the face."""

    def counts(self, report: StopReport | None) -> Mapping[str, int]:
        """Return how often each thing of `Trials.must_not`, and maybe more, has happened."""


@dataclass(frozen=True, slots=True)
class Trials:
    """What is tried on one kind of bus.

    kinds: of faults; sizes: numbers of servos; must_not: names of counts that must be 0; stage:
    makes the stage of a case.
    """

    kinds: Sequence[str]
    sizes: Sequence[int]
    rates_hz: Sequence[float]
    must_not: Sequence[str]
    stage: Callable[[Case], Stage]


@dataclass(frozen=True, slots=True)
class Outcome:
    """The outcome of one case.

    error: of the bridge, empty: none. counts: of each name in `Trials.must_not`. recovery_s: from
    the end of the fault until every servo follows again; None: never, which is correct where
    nothing can bring it back (another id, another baud rate, a third reboot), or because of a stop.
    """

    case: Case
    error: str
    counts: Mapping[str, int]
    recovery_s: float | None

    @property
    def survived(self) -> bool:
        """Whether there was no error, and nothing happened that must not."""
        return not self.error and not any(self.counts.values())

    def __str__(self) -> str:
        wrong = {"error": self.error, **self.counts}
        return f"{self.case}: " + ", ".join(f"{name} {n}" for name, n in wrong.items() if n)


@cache
def trials_of(bus: str) -> Trials:
    """Return the trials for a kind of bus. Raises KeyError where there are none."""
    module, _, name = _TRIALS[bus].partition(":")
    trials: Trials = getattr(import_module(f"lipservo_lab.campaigns.{module}"), name)
    return trials


def cases(bus: str, *, whole: bool = False) -> Iterator[Case]:
    """Yield cases of every kind, intensity, size and rate.

    Ways of arming and stops take turns. whole: each case with every way of arming and every stop,
    eight times as many.
    """
    variants, trials = list(product((False, True), STOPS)), trials_of(bus)
    grid = product(trials.kinds, INTENSITIES, trials.sizes, trials.rates_hz)
    for n, (kind, intensity, n_servos, rate_hz) in enumerate(grid):
        for strict, stop in variants if whole else (variants[n * 3 % len(variants)],):
            yield Case(bus, kind, intensity, n_servos, rate_hz, strict, stop)


def play(case: Case, end_s: float = END_S) -> Outcome:
    """Run one case up to `end_s`, virtual time, and return its outcome."""
    trials = trials_of(case.bus)
    stage = trials.stage(case)
    clock, channel = stage.clock, MemoryTargetChannel()
    settings = BridgeSettings(case.rate_hz, tolerant=not case.strict)
    bridge = Bridge(stage.bus, stage.joints, channel, settings)
    control = StopInTheFault(case.stop, clock, stage.auditor)
    error, recovered_s, report = "", math.nan, None
    try:
        with stage.bus, LifeCycle(bridge, clock, LifeCycleLinks(control=control)) as life:
            life.start()
            for time_s, late in life.ticks():
                if time_s > end_s:
                    break
                channel.publish(ServoTargets(time_s, wanted_deg(time_s, case.n_servos)))
                bridge.tick(time_s, late)
                stage.look(bridge)
                all_driven = all(s is ServoState.DRIVEN for s in bridge.servo_states)
                if not all_driven:
                    recovered_s = math.nan
                elif math.isnan(recovered_s):
                    recovered_s = time_s
            if not life.stopping:
                stage.look_at_last()
        report = life.report
    except (BusError, ArithmeticError, LookupError, ValueError, TypeError) as problem:
        error = f"{type(problem).__name__}: {problem}"
    no_recovery = case.stop is not None or math.isnan(recovered_s)
    recovery_s = None if no_recovery else max(0.0, recovered_s - FAULT_UNTIL_S)
    counts = stage.counts(report)
    return Outcome(case, error, {name: counts[name] for name in trials.must_not}, recovery_s)


class StopWitness(Protocol):
    """The part of an auditor that must know of stops."""

    def note_stop(self, time_s: float, level: StopLevel) -> None:
        """Note that a person stopped the face."""

    def let_go(self) -> None:
        """Note that a frozen face is released now."""


class StopInTheFault:
    """A person's stop during the fault; it takes the place of the bridge's control socket."""

    def __init__(self, level: StopLevel | None, clock: Clock, auditor: StopWitness) -> None:
        self._level, self._clock, self._auditor = level, clock, auditor
        self._is_frozen = False

    def poll(self) -> StopRequest | None:
        """Return the stop when it is due, a soft stop of a frozen face at the end, or None."""
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

    def answer(
        self,
        status: Callable[[], Mapping[str, object]],
        of_stop: Callable[[], Mapping[str, object]],
    ) -> None:
        """Drop an answer: no client waits for one."""

    def attend(self, refusal: Callable[[Order], str]) -> None:
        """Take no orders to single servos."""

    def take_orders(self) -> Sequence[Order]:
        """Return no orders."""
        return ()

    def report_end(self, report: Mapping[str, object]) -> None:
        """Drop the report: no client waits for it."""


def wanted_deg(time_s: float, n_servos: int) -> np.ndarray:
    """Return quick target angles, (n_servos,) deg, now and then beyond every limit."""
    phase = np.arange(n_servos) * 0.7
    return np.asarray(25.0 * np.sin(2.0 * np.pi * 1.3 * time_s + phase) + 20.0 * np.sin(time_s))
