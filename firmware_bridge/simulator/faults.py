"""Faults on the simulated wire and in simulated servos, by seeded chance or at given times."""

import heapq
import math
import random
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.simulator.motors import (
    CENTER_PULSE,
    ENCODER_ERROR,
    PULSES_PER_DEG,
    SHOCK_ERROR,
    Motors,
)
from firmware_bridge.simulator.servo import SimulatedServo

_LAST: Final = 2 * CENTER_PULSE - 1


@dataclass(frozen=True, slots=True)
class Bounds:
    """What a number in a script may be: from `low` to `high`.

    meaning: of `amount`, for one kind of fault. whole: no fractions. needed: whether a script must
    give it.
    """

    low: float
    high: float
    meaning: str = ""
    whole: bool = False
    needed: bool = False


@dataclass(frozen=True, slots=True)
class _Kind:
    """A kind of fault. lasts: it is over after `lasts_s`; others are a matter of a moment."""

    amount: Bounds | None = None
    lasts: bool = False


_SHARE: Final = "load as a share of the stall torque"
_REPLY_KINDS: Final = {
    **dict.fromkeys(("drop_reply", "corrupt_reply", "truncate_reply", "duplicate_reply"), _Kind()),
    **dict.fromkeys(("wrong_id", "echo"), _Kind()),
    "late_reply": _Kind(Bounds(0.0, 10.0, "seconds late", needed=True)),
    "error_reply": _Kind(Bounds(1, 255, "error byte of the reply, else 1", whole=True)),
    "babble": _Kind(Bounds(1, 1000, "bytes of noise, else 8", whole=True)),
}
_SERVO_KINDS: Final = {
    **dict.fromkeys(("reboot", "shock", "torque_lost", "baud_reset", "watchdog_trip"), _Kind()),
    **dict.fromkeys(("silence", "brown_out", "answers_stop", "unplug"), _Kind(lasts=True)),
    "overload": _Kind(Bounds(0.0, 1.0, f"{_SHARE}, else 0.9"), lasts=True),
    "overheat": _Kind(Bounds(0.0, 200.0, "degC, else 5 above the limit"), lasts=True),
    "undervoltage": _Kind(Bounds(0.0, 60.0, "volt, else 0.6 of nominal"), lasts=True),
    "overvoltage": _Kind(Bounds(0.0, 60.0, "volt, else 1.5 of nominal"), lasts=True),
    "encoder_fault": _Kind(Bounds(-360.0, 360.0, "degrees that the reading jumps")),
    "jam": _Kind(Bounds(0.0, 1.0, _SHARE), lasts=True),
    "load": _Kind(Bounds(0.0, 1.0, _SHARE, needed=True), lasts=True),
    "id_change": _Kind(Bounds(0, 252, "the new id", whole=True, needed=True)),
    "return_delay_drift": _Kind(Bounds(1, 254, "register value, else 250", whole=True)),
    "limits_drift": _Kind(Bounds(1, _LAST, f"max_position_limit, else {_LAST}", whole=True)),
    "pushed": _Kind(Bounds(-360.0, 360.0, "degrees", needed=True)),
}
#: What happens to a status packet on its way, by chance.
ON_REPLIES: Final = frozenset(_REPLY_KINDS)
#: What happens to an instruction packet on its way, by chance.
ON_INSTRUCTIONS: Final = frozenset({"drop_instruction", "corrupt_instruction"})
#: What happens to a servo, or to all, at a moment; `lasts_s` later it is over.
ON_SERVOS: Final = frozenset(_SERVO_KINDS)
KINDS: Final = tuple(sorted(ON_REPLIES | ON_INSTRUCTIONS | ON_SERVOS))
LASTING: Final = frozenset(name for name, kind in _SERVO_KINDS.items() if kind.lasts)
#: Kinds that are not here have no amount.
AMOUNTS: Final = {
    name: kind.amount
    for name, kind in (_REPLY_KINDS | _SERVO_KINDS).items()
    if kind.amount is not None
}


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault of a simulated chain. servos: indices in the chain; empty: all.

    Of a kind that hits packets: it happens with `probability` between from_s and until_s.
    Of a kind that hits servos: it happens at each of at_s and every `every_s` (0: never), for
    lasts_s.
    amount: as `AMOUNTS` lists it for the kind: seconds late, degrees pushed, load share, ...
    """

    kind: str
    servos: tuple[int, ...] = ()
    probability: float = 1.0
    from_s: float = 0.0
    until_s: float = math.inf
    at_s: tuple[float, ...] = ()
    every_s: float = 0.0
    lasts_s: float = 0.0
    amount: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"fault {self.kind!r} is not known; use one of {', '.join(KINDS)}")
        if not 0.0 <= self.probability <= 1.0:
            raise ValueError(f"fault {self.kind}: probability {self.probability} is outside 0..1")

    def hits(self, index: int, now_s: float, rng: random.Random) -> bool:
        """Return whether the fault hits a packet of servo `index` at `now_s`, by chance (`rng`)."""
        return (
            (not self.servos or index in self.servos)
            and self.from_s <= now_s < self.until_s
            and rng.random() < self.probability
        )


class FaultInjector:
    """Injects the faults of a script into the servos of a chain, in order of time."""

    def __init__(
        self, servos: Sequence[SimulatedServo], motors: Motors, faults: Sequence[Fault]
    ) -> None:
        """Schedule those of `faults` that hit servos; `Wire` injects those that hit packets."""
        self._servos = servos
        self._motors = motors
        #: A heap of (time in s, number that orders equal times, number of earlier occurrences or -1
        #: if the fault does not repeat, whether it begins or ends then, fault).
        self._coming: list[tuple[float, int, int, bool, Fault]] = []
        self._n = 0
        for fault in faults:
            if fault.kind in ON_SERVOS:
                for when_s in fault.at_s:
                    self._expect(when_s, -1, fault, begins=True)
                self._expect_again(fault, 0)
        self.unplugged = False
        limits = ("min_voltage_limit", "max_voltage_limit", "temperature_limit")
        low, high, hot = (np.array([s[name] for s in servos], float) for name in limits)
        self._low_v, self._high_v, self._hottest = low / 10.0, high / 10.0, hot

    def advance(self, now_s: float) -> None:
        """Begin and end all faults that are due by `now_s`, each with the motors at its time.

        When a fault begins, its end and its next occurrence are scheduled, if it has them.
        """
        while self._coming and self._coming[0][0] <= now_s:
            when_s, _, n_before, begins, fault = heapq.heappop(self._coming)
            self._motors.advance(when_s)
            for servo in self._servos:
                if fault.servos and servo.index not in fault.servos:
                    continue
                if begins:
                    self._begin(servo, fault, when_s)
                else:
                    self._end(servo, fault)
            if begins and fault.lasts_s:
                self._expect(when_s + fault.lasts_s, -1, fault, begins=False)
            if begins and n_before >= 0:
                self._expect_again(fault, n_before + 1)

    def _expect(self, when_s: float, n_before: int, fault: Fault, *, begins: bool) -> None:
        self._n += 1
        heapq.heappush(self._coming, (when_s, self._n, n_before, begins, fault))

    def _expect_again(self, fault: Fault, n_before: int) -> None:
        """Schedule the next occurrence of a repeated fault, after `n_before` earlier ones."""
        when_s = fault.from_s + (n_before + 1) * fault.every_s
        if fault.every_s > 0.0 and when_s <= fault.until_s:
            self._expect(when_s, n_before, fault, begins=True)

    def hardware_errors(self) -> NDArray[np.int64]:
        """Return the hardware error bits that each servo sets now, by load, voltage and heat.

        Returns
        -------
        NDArray[np.int64]
            (n_servos,).
        """
        return self._motors.hardware_errors(self._low_v, self._high_v, self._hottest)

    def _begin(self, servo: SimulatedServo, fault: Fault, now_s: float) -> None:
        """Begin a fault of one servo at `now_s`; an `amount` of 0 means the kind's default, if any.

        The end of a fault that lasts is scheduled by `advance`; with lasts_s 0 it lasts for ever,
        but a brown-out half a second.
        """
        motors, i, kind = self._motors, servo.index, fault.kind
        if kind == "silence":
            servo.ignore_until(now_s + fault.lasts_s if fault.lasts_s else math.inf)
        elif kind == "reboot":
            servo.reboot(now_s)
        elif kind == "brown_out":
            servo.reboot(now_s)
            servo.ignore_until(now_s + max(0.5, fault.lasts_s))
        elif kind == "overload":
            motors.load[i] = fault.amount or 0.9
        elif kind in ("jam", "load"):
            motors.jammed[i] = kind == "jam"
            motors.load[i] = fault.amount
        elif kind == "overheat":
            motors.temperature[i] = fault.amount or self._hottest[i] + 5.0
        elif kind in ("undervoltage", "overvoltage"):
            nominal_v = servo.model.nominal_voltage_v
            motors.supply_v[i] = fault.amount or nominal_v * (0.6 if kind[0] == "u" else 1.5)
        elif kind == "shock":
            servo.latch(SHOCK_ERROR)
        elif kind == "encoder_fault":
            servo.latch(ENCODER_ERROR)
            motors.position[i] += fault.amount * PULSES_PER_DEG
        else:
            self._change_registers(servo, fault)

    def _change_registers(self, servo: SimulatedServo, fault: Fault) -> None:
        """Begin a fault that changes registers or torque, turns the shaft, or unplugs the chain."""
        motors, i, kind = self._motors, servo.index, fault.kind
        if kind == "torque_lost":
            servo.lose_torque()
        elif kind == "id_change":
            servo["id"] = int(fault.amount)
        elif kind == "baud_reset":
            servo["baud_rate"] = 1  # code of the factory's rate
        elif kind == "return_delay_drift":
            servo["return_delay_time"] = int(fault.amount) or 250
        elif kind == "limits_drift":
            servo["max_position_limit"] = int(fault.amount) or _LAST
        elif kind == "answers_stop":
            servo["status_return_level"] = 0
        elif kind == "watchdog_trip":
            servo.trip_watchdog()
        elif kind == "pushed":
            motors.position[i] += fault.amount * PULSES_PER_DEG
        elif kind == "unplug":
            self.unplugged = True

    def _end(self, servo: SimulatedServo, fault: Fault) -> None:
        """End a fault of one servo: load, supply, heat, answers or port are as usual again."""
        motors, i, kind = self._motors, servo.index, fault.kind
        if kind in ("overload", "jam", "load"):
            motors.load[i] = 0.0
            motors.jammed[i] = False
        elif kind in ("undervoltage", "overvoltage"):
            motors.supply_v[i] = servo.model.nominal_voltage_v
        elif kind == "overheat":
            motors.temperature[i] = 30.0
        elif kind == "answers_stop":
            servo["status_return_level"] = 2
        elif kind == "unplug":
            self.unplugged = False
