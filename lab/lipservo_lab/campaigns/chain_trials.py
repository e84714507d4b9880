"""Trials of serial servos: a simulated chain with faults, an auditor, and what the bus reports."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, get_args

import numpy as np

from firmware_bridge.bus import ServoBus
from firmware_bridge.clock import ManualClock
from firmware_bridge.dynamixel.bus import DynamixelBus
from firmware_bridge.dynamixel.control_table import servo_models as dynamixel_models
from firmware_bridge.feetech.bus import FeetechBus
from firmware_bridge.feetech.control_table import servo_models as feetech_models
from firmware_bridge.feetech.simulator import ChainFault
from firmware_bridge.feetech.simulator import chain_for as feetech_chain
from firmware_bridge.joints import Joint
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.serial_servos.mounting import MountedServo
from firmware_bridge.simulator.chain import chain_for as dynamixel_chain
from firmware_bridge.simulator.faults import KINDS, ON_INSTRUCTIONS, ON_REPLIES, Fault
from firmware_bridge.simulator.ports import MemoryTransport
from firmware_bridge.stopping import StopReport
from lipservo_lab.campaigns.auditor import Auditor, FeetechWire
from lipservo_lab.campaigns.fault_campaign import (
    FAULT_FROM_S,
    FAULT_UNTIL_S,
    MAX_SPEED_DEG_S,
    Case,
    Trials,
)

BAUD_RATE: Final = 1_000_000
_PROBABILITIES: Final = (0.01, 0.1, 0.5)
#: Feedback is compared with shafts only if it is so new, as servos move on; and may differ by so
#: much.
_JUST_NOW_S, _PLACE_DEG = 0.005, 3.0
_MUST_NOT: Final = (
    "goals_outside_limits",
    "steps_above_clamp",
    "motion_too_fast",
    "moved_outside",
    "moved_frozen",
    "armed_wrongly",
    "undone",
    "contention",
    "torque_unknown",
    "torque_left_on",
)


def face(n_servos: int, model: Any = None) -> list[MountedServo[Any]]:
    """Return a face of `n_servos` servos as in `face_sim`, every other one mounted mirrored."""
    model = model or dynamixel_models()["XL330-M288"]
    return [
        MountedServo(
            Joint(f"joint_{k}", k, -30.0, 40.0, MAX_SPEED_DEG_S), model, 1 if k % 2 else -1
        )
        for k in range(1, n_servos + 1)
    ]


@dataclass
class ChainStage:
    """A simulated chain of servos in a case; see `fault_campaign.Stage`.

    holds: returns whether a servo's torque is on. is_reachable: returns whether a bus can reach it
    at a time, as it still has its own id and rate. n_collisions: returns the collisions on the wire
    so far. n_unknown: torque that the bus reports wrongly. n_untrue: positions that it reports
    wrongly.
    """

    case: Case
    servos: Sequence[MountedServo[Any]]
    chain: Any
    bus: ServoBus
    clock: ManualClock
    auditor: Auditor
    holds: Callable[[Any], bool]
    is_reachable: Callable[[Any, float], bool]
    n_collisions: Callable[[], int]
    n_unknown: int = 0
    n_untrue: int = 0

    @property
    def joints(self) -> Sequence[Joint]:
        """The joints, in the order of the servos."""
        return [servo.joint for servo in self.servos]

    def look(self, bridge: Bridge) -> None:
        """Count positions in fresh feedback that differ from the simulated shafts."""
        feedback = bridge.feedback
        if feedback is None or self.clock.now() - feedback.time_s > _JUST_NOW_S:
            return
        shafts = self.chain.motors.position
        off_deg = np.abs(
            [
                (servo.pulse(deg) - shaft) / servo.model.pulses_per_deg
                for servo, deg, shaft in zip(
                    self.servos, np.nan_to_num(feedback.positions_deg), shafts, strict=True
                )
            ]
        )
        self.n_untrue += int((off_deg[feedback.age_s == 0.0] > _PLACE_DEG).sum())

    def look_at_last(self) -> None:
        """Count reachable servos whose torque is not as the bus reports it."""
        if self.chain.plugged:
            reported = self.bus.look_after().torque
            for servo, is_on in zip(self.chain.servos, reported, strict=True):
                reachable = self.is_reachable(servo, self.clock.now())
                self.n_unknown += reachable and self.holds(servo) != is_on

    def counts(self, report: StopReport | None) -> Mapping[str, int]:
        """Return counts of the auditor, of the wire, and of what servos do at the end.

        torque_left_on: reachable servos that still hold. claims: false positions, and servos that
        were confirmed as limp but hold. report: of the stop; None: there was none.
        """
        auditor, chain = self.auditor, self.chain
        n_holding = sum(self.holds(s) for s in chain.servos if self.is_reachable(s, float("inf")))
        confirmed = () if report is None else report.confirmed
        holding = {j.name for j, s in zip(self.joints, chain.servos, strict=True) if self.holds(s)}
        return {
            "goals_outside_limits": auditor.goals_outside,
            "steps_above_clamp": auditor.steps_too_long,
            "motion_too_fast": auditor.too_fast,
            "moved_outside": auditor.moved_outside,
            "moved_frozen": auditor.moved_frozen,
            "armed_wrongly": auditor.armed_wrongly,
            "undone": auditor.armed_late,
            "contention": self.n_collisions(),
            "torque_unknown": int(self.n_unknown),
            "torque_left_on": int(n_holding) if chain.plugged else 0,
            "claims": self.n_untrue + len(holding & set(confirmed)),
        }


def dynamixel_faults(case: Case) -> list[Fault]:
    """Return the faults of a case, by its intensity 0 to 2.

    Faults of packets hit 1, 10 or 50 % of them; faults of servos hit one servo once, one again and
    again, or all servos.
    """
    kind, intensity = case.kind, case.intensity
    amount = {
        "late_reply": (0.0005, 0.003, 0.010)[intensity],
        "error_reply": 1.0,
        "id_change": 200.0,
        "pushed": (5.0, 20.0, 60.0)[intensity],
        "encoder_fault": (0.0, 10.0, 90.0)[intensity],
        "load": (0.3, 0.6, 0.9)[intensity],
        "jam": 0.9,
        "limits_drift": 2100.0,
    }.get(kind, 0.0)
    if kind in ON_REPLIES | ON_INSTRUCTIONS:
        share = _PROBABILITIES[intensity]
        return [
            Fault(
                kind,
                probability=share,
                from_s=FAULT_FROM_S,
                until_s=FAULT_UNTIL_S,
                amount=amount,
            )
        ]
    servos = () if intensity == 2 or kind == "unplug" else (case.n_servos // 2,)
    every_s = 0.5 if intensity == 1 else 0.0
    lasts_s = 0.3 if intensity == 1 else FAULT_UNTIL_S - FAULT_FROM_S
    return [
        Fault(
            kind,
            servos=servos,
            at_s=() if every_s else (FAULT_FROM_S,),
            from_s=FAULT_FROM_S,
            until_s=FAULT_UNTIL_S,
            every_s=every_s,
            lasts_s=lasts_s,
            amount=amount,
        )
    ]


def _dynamixels(case: Case) -> ChainStage:
    """Return Dynamixels with a case's faults, on a virtual clock, watched by an auditor."""
    servos, clock = face(case.n_servos), ManualClock()
    chain = dynamixel_chain(servos, BAUD_RATE, faults=dynamixel_faults(case), seed=1)
    auditor = Auditor(servos, 1.0 / case.rate_hz)
    auditor.watch(chain)
    bus = DynamixelBus(
        servos,
        lambda: MemoryTransport(chain, clock, BAUD_RATE, tap=auditor.see),
        watchdog_s=max(0.1, 3.0 / case.rate_hz),
        strict=case.strict,
    )

    def is_reachable(servo: Any, now_s: float) -> bool:
        own_id = servos[servo.index].joint.servo_id
        receives = servo.deaf_until_s <= now_s and servo.deaf_until_s < float("inf")
        return bool(servo.servo_id == own_id and servo.baud_rate == BAUD_RATE and receives)

    return ChainStage(
        case,
        servos,
        chain,
        bus,
        clock,
        auditor,
        holds=lambda servo: servo.torque_on,
        is_reachable=is_reachable,
        n_collisions=lambda: chain.counts.contention,
    )


def _feetechs(case: Case) -> ChainStage:
    """Return a chain of STS3215 with a case's faults, as `_dynamixels` does.

    Their encoder steps are those of the simulated shafts.
    """
    servos, clock = face(case.n_servos, feetech_models()["STS3215"]), ManualClock()
    one = None if case.intensity == 2 or case.kind == "unplug" else case.n_servos // 2
    faults = [
        ChainFault.model_validate({"kind": case.kind, "at_s": at_s, "lasts_s": for_s, "servo": one})
        for at_s, for_s in case.times_s()
    ]
    chain = feetech_chain(servos, BAUD_RATE, faults=faults)
    auditor = Auditor(servos, 1.0 / case.rate_hz, FeetechWire())
    auditor.watch(chain)
    bus = FeetechBus(
        servos,
        lambda: MemoryTransport(chain, clock, BAUD_RATE, tap=auditor.see),
        strict=case.strict,
        period_s=1.0 / case.rate_hz,
    )
    return ChainStage(
        case,
        servos,
        chain,
        bus,
        clock,
        auditor,
        holds=lambda servo: servo["torque_enable"] == 1,
        is_reachable=lambda servo, now_s: servo.silent_until_s <= now_s,
        n_collisions=lambda: chain.n_spoken_over,
    )


DYNAMIXEL: Final = Trials(KINDS, (5, 10, 20), (30.0, 100.0), _MUST_NOT, _dynamixels)
FEETECH: Final = Trials(
    get_args(ChainFault.model_fields["kind"].annotation),
    (1, 5, 10),
    (30.0, 50.0),
    (*_MUST_NOT, "claims"),
    _feetechs,
)
