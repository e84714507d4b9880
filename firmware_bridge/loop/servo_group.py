"""All servos of a face behind gate, limiter and supervision: goals out, feedback in."""

import contextlib
import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.bus import (
    STATE_WORDS,
    Array,
    Feedback,
    Health,
    Readings,
    ServoBus,
    ServoHealth,
    ServoState,
    any_set,
)
from firmware_bridge.errors import PortError, ServoError
from firmware_bridge.gate.limits import Limited, Limiter
from firmware_bridge.joints import Joint, named
from firmware_bridge.known_torque import KnownTorque, Torque
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.servo_supervision import ServoSupervision
from firmware_bridge.loop.torque_gate import LET_GO_WITH_IT, PORT_GONE, TorqueGate, TorqueOff

#: Amplitude shrinks over the last degrees below the servo's limit, and with the load's square,
#: which is what heats a winding: full up to half the stall torque (root mean square).
_DERATE_FROM_DEGC: Final = 10.0
_DUTY_S: Final = 60.0
_DUTY_FULL: Final = 0.25
_LEAST_SCALE: Final = 0.3
#: Heat is looked at so often: a winding knows nothing faster, and every tick would pay for it. A
#: little less than the 50 ms meant, so that rounding makes no sixth tick of the fifth.
_HEAT_EVERY_S: Final = 0.049


class HeatDerating:
    """How far each joint's amplitude is reduced to spare its servo; arrays are (n_servos,)."""

    def __init__(self, has_load: Sequence[bool]) -> None:
        """Start at full amplitude. has_load: for each servo, whether it reports its load."""
        n_servos = len(has_load)
        self._has_load = None if all(has_load) else np.array(has_load)
        self._duty = np.zeros(n_servos)
        self._duty_at_s: float | None = None
        self._scale = np.ones(n_servos)

    def scale(self, feedback: Feedback, health: Health) -> Array:
        """Return the share of its motion that each servo's heat and load allow, new every 50 ms.

        Parameters
        ----------
        feedback : Feedback
            Its time, seconds, and effort, (n_servos,) shares of the stall torque.
        health : Health
            `room_degc`, (n_servos,) degC below each servo's limit.

        Returns
        -------
        Array
            (n_servos,), 0.3 to 1.
        """
        if self._duty_at_s is not None:
            if 0.0 <= feedback.time_s - self._duty_at_s < _HEAT_EVERY_S:
                return self._scale
            share = min(1.0, max(0.0, feedback.time_s - self._duty_at_s) / _DUTY_S)
            effort = feedback.effort
            if self._has_load is not None:
                effort = np.where(self._has_load, effort, 0.0)
            self._duty += share * (effort * effort - self._duty)
        self._duty_at_s = feedback.time_s
        warm = health.room_degc / _DERATE_FROM_DEGC
        worked = 2.0 - self._duty / _DUTY_FULL
        scale = np.minimum(warm, worked)
        np.maximum(scale, _LEAST_SCALE, out=scale)
        self._scale = np.minimum(scale, 1.0, out=scale)
        return self._scale


#: So often everybody is asked where they stand before a start; a lost answer is no reason to fail.
_READS = 5
#: So often a servo may refuse to hold before a start fails. Arming takes some ten exchanges, and at
#: a fifth of all packets lost in either direction one attempt in seven gets through them all.
_REQUESTED = 60
#: A shaft at top speed is so far behind its goal, in time, and stops there without turning back.
_BRAKES_S = 0.02
#: Of a servo that is to be driven, and is not known to have torque yet.
STARTING_WORD: Final = "starting"
_DRIVEN: Final = int(ServoState.DRIVEN)
_ON: Final = int(Torque.ON)
_HEALTH = tuple(each.name for each in fields(ServoHealth))


class ServoGroup:
    """The servos of a `Bridge`: limiter, torque gate and supervision in front of the bus.

    Every method that sends packets may raise PortError.
    """

    def __init__(self, bus: ServoBus, joints: Sequence[Joint], settings: BridgeSettings) -> None:
        """Make limiter, gate and supervision of these joints; send nothing."""
        self._bus = bus
        self._joints = tuple(joints)
        can = [bus.capabilities.of(index) for index in range(len(self._joints))]
        self._has_place = np.array([each.place for each in can], dtype=np.bool_)
        self._any_has_place = bool(self._has_place.any())
        self._any_blind = not bool(self._has_place.all())
        self.limiter = Limiter(self._joints, settings.period_s, settings.prevent)
        given_up, off = settings.given_up, settings.switched_off
        self.gate = TorqueGate(bus, dry_run=settings.dry_run, given_up=given_up, switched_off=off)
        self.supervision = ServoSupervision(self._joints, settings.tracking, given_up, off)
        is_known = any(each.load or each.heat for each in can)
        self._heat = HeatDerating([each.load for each in can]) if is_known else None
        self.torque_off = TorqueOff(self._joints, self.gate)
        self._brakes_deg = _BRAKES_S * np.array([joint.max_speed_deg_s for joint in joints])
        #: By how much each joint's amplitude shrinks to spare its servo, (n_joints,).
        self.scale = np.ones(len(self._joints))
        #: Whether a person has led a joint beyond its limits, to find them.
        self.is_wide = False
        self._wide = np.zeros(len(self._joints), dtype=np.bool_)
        self._to_stay = np.zeros(len(self._joints), dtype=np.bool_)  # frozen, not heard since
        self._to_keep: deque[int] = deque(maxlen=len(self._joints))  # frozen, may hold or not
        self._health: Health | None = None
        #: What the last question of a tick was answered; None before the first.
        self.feedback: Feedback | None = None

    @property
    def torque(self) -> KnownTorque:
        """What is known of the servos' torque."""
        return self.gate.torque

    @property
    def troubles(self) -> tuple[str, ...]:
        """A line for each servo that is not driven, with the reason."""
        reasons = zip(self._joints, self.supervision.reasons, strict=True)
        return tuple(f"{named(joint)} {why}" for joint, why in reasons if why)

    def words(self) -> list[str]:
        """Return each servo's `ServoState` in words; `starting`: driven, but not known to hold."""
        pairs = zip(self.supervision.states.tolist(), self.torque.states.tolist(), strict=True)
        return [
            STARTING_WORD if state == _DRIVEN and torque != _ON else STATE_WORDS[state]
            for state, torque in pairs
        ]

    def try_all_again(self, time_s: float) -> None:
        """Allow torque again to servos that were given up, since a person starts the face."""
        for index in list(self.gate.given_up):
            self.switch_on(index, time_s)

    def reopen(self) -> None:
        """Open the port again. Raises PortError."""
        self._bus.reopen()

    def disable_all(self, time_s: float = 0.0, why: str = "") -> None:
        """Switch all servos off, to wait for torque again. why: the reason in `troubles`."""
        self.torque_off.begin()
        self._note_ready()
        self.supervision.mark_all_waiting(time_s, why)

    def lose_port(self, time_s: float, *, lets_go: bool) -> None:
        """Mark all servos as waiting for a lost port.

        lets_go: also switch torque off, on those buses of the face whose port remains.
        """
        self.supervision.mark_all_waiting(time_s, PORT_GONE)
        if not lets_go:
            return
        with contextlib.suppress(PortError):
            self.torque_off.begin()
            for index in np.flatnonzero(self.torque_off.off).tolist():
                if self.supervision.states[index] == ServoState.WAITING:
                    self.supervision.note_attempt(index, LET_GO_WITH_IT, time_s)

    def read(self) -> Readings:
        """Read and return all servos' positions; up to four times more while one is missing."""
        readings = self._bus.read()
        for _ in range(_READS - 1):
            if np.isfinite(readings.positions_deg[self._has_place]).all():
                break
            readings = self._bus.read()
        return readings

    def check(self, indices: Sequence[int], may_continue: Callable[[], bool]) -> None:
        """Raise ServoError naming those of `indices` that could not hold now, with the reasons.

        Servos that a person switched off are not checked; may_continue: False ends the checks.
        """
        indices_on = self._not_off(indices)
        self._refuse(
            [(i, _stop_is_repeated(self.gate.obstacle, i)) for i in indices_on if may_continue()]
        )

    def enable(
        self, indices: Sequence[int], time_s: float, may_continue: Callable[[], bool]
    ) -> None:
        """Switch torque of servos `indices` on at their positions; all off on an error.

        Servos that a person switched off stay off. Raises ServoError naming the servos that refuse.
        may_continue: called before each servo; False, a stop: no further servo is armed.
        """
        found = []
        for index in self._not_off(indices):
            if not may_continue():
                return
            why_not = _stop_is_repeated(self.gate.enable, index)
            self.supervision.note_attempt(index, why_not, time_s)
            found.append((index, why_not))
        self._note_ready()
        self._refuse(found)

    def keep_holding(self, time_s: float) -> None:
        """Hold the servos of a frozen face that still have torque at their positions.

        A servo that does not confirm is ordered again by `stay_on`: just after a replug answers are
        lost, and its watchdog, which tripped meanwhile, protects nothing until it was set again.
        """
        self._to_keep.clear()
        here_deg = self._bus.read().start_deg(self._bus.capabilities)
        self.limiter.start_from(here_deg, time_s)
        for index in self._not_off(range(len(self._joints))):
            why_not = "" if self.gate.keep(index) else "lost its torque; not again"
            self.supervision.note_attempt(index, why_not, time_s)
            if why_not:
                self._to_keep.append(index)

    def hold_position(self, time_s: float) -> None:
        """Set the goals to the servos' present positions, or as near as they can stop.

        A moving shaft is behind its goal: it may go on to the goal, but no farther than it moves
        while it brakes. A servo that did not answer just now keeps its goal until it answers
        (`stay_on`), since its position is unknown.
        """
        heard, near_deg = self._stopping_places()
        here_deg = np.where(heard, near_deg, self.limiter.sent_deg)
        sent_deg = self._bus.feedback().sent_deg if self._any_blind else None
        if sent_deg is not None:
            here_deg = np.where(np.isfinite(sent_deg), sent_deg, here_deg)
        self.limiter.start_from(here_deg, time_s)
        self._to_stay = ~heard & self._has_place

    def stay_on(self, time_s: float) -> Limited:
        """Send a frozen face's goals again; stop servos that were silent once they answer.

        A servo that just came back is slow, and may be far from its goal. Return the goals sent.
        """
        if self._to_keep:  # one a tick; one that is limp stays so, and what ails it is still told
            index = self._to_keep.popleft()
            if self.gate.keep(index):
                self.supervision.note_attempt(index, "", time_s)
                self._start_here(index)
            else:
                self._to_keep.append(index)
        if self._to_stay.any():
            heard, near_deg = self._stopping_places()
            for index in np.flatnonzero(self._to_stay & heard).tolist():
                self.limiter.start_one(index, float(near_deg[index]))
            self._to_stay &= ~heard
        limited = self.limiter.unchanged()
        self.send(limited, time_s)
        return limited

    def drop_waiting(self, time_s: float) -> None:
        """Switch off servos whose bus has not yet started them, since a person stopped the face.

        Only a bus that knows no positions starts its servos one after another, after torque on.
        """
        ready = self._bus.feedback().ready if self._any_blind else None
        if ready is not None:
            for index in np.flatnonzero(self.supervision.driven & ~ready).tolist():
                self.gate.disable(index)
                self.supervision.note_attempt(index, "was stopped before its turn", time_s)

    def _start_here(self, index: int) -> None:
        """Set the limiter's last goal of servo `index`, which holds, to its position.

        Where that is unknown, to the goal the bus sent last; if the bus reports neither, the
        limiter's last goal is kept.
        """
        feedback = self._bus.feedback()
        has_place = self._has_place[index]
        known_deg = feedback.positions_deg if has_place else feedback.sent_deg
        here_deg = math.nan if known_deg is None else float(known_deg[index])
        if has_place or math.isfinite(here_deg):
            self.limiter.start_one(index, here_deg)
        self._note_ready()

    def _note_ready(self) -> None:
        """Hold back the goals of servos without known position that the bus has not started."""
        if self._any_blind:
            self.limiter.hold_back(self._bus.feedback().ready)

    def _stopping_places(self) -> tuple[NDArray[np.bool_], Array]:
        """Return which servos answered just now, and where each can stop, degrees; (n_servos,).

        That is the last goal, but no farther from the position than the servo moves in braking.
        """
        feedback = self._bus.feedback()
        sent_deg, places_deg = self.limiter.sent_deg, feedback.positions_deg
        near_deg = np.clip(sent_deg, places_deg - self._brakes_deg, places_deg + self._brakes_deg)
        return (feedback.age_s == 0.0) & np.isfinite(places_deg), near_deg

    def widen(self, low_deg: Array, high_deg: Array) -> None:
        """Set the range of each joint from now on, in the limiter and, beyond limits, in the bus.

        Parameters
        ----------
        low_deg,high_deg : Array
            (n_joints,) degrees.
        """
        wide = self.limiter.widen(low_deg, high_deg)
        if wide.tobytes() != self._wide.tobytes():
            self._wide, self.is_wide = wide, any_set(wide)
            self._bus.widen(wide)

    def send(self, limited: Limited, time_s: float) -> None:
        """Run a tick of a face with torque: send goals, read all, supervise the next servo in turn.

        limited: the goals that passed the limiter; servos that are not driven get none.
        """
        goals_deg = limited.positions_deg
        limp = None if self.supervision.all_driven else ~self.supervision.driven
        if limp is None:
            self._bus.write_positions(goals_deg)
        elif not limp.all():
            self._bus.write_positions(np.where(limp, np.nan, goals_deg))
        self.feedback = feedback = self._bus.feedback()
        self._health = health = self._bus.look_after()
        if self._heat is not None:
            self.scale = self._heat.scale(feedback, health)
        if self._any_has_place:
            self.supervision.check_tracking(goals_deg, feedback)
        if self._any_blind:
            self.limiter.hold_back(feedback.ready)
        if limp is not None:
            self.limiter.follow(limp, feedback.positions_deg)
        enabled = self.supervision.act(health, time_s, self.gate)
        if enabled is not None:
            self._start_here(enabled)

    def rest(self, time_s: float) -> None:
        """Run a tick of a limp face: read all, and switch off servos that have not confirmed."""
        self.feedback = self._bus.feedback()
        self._health = self._bus.look_after()
        self.supervision.keep_off(time_s, self.gate)

    def switch_off(self, index: int, time_s: float) -> None:
        """Mark one servo as switched off by a person; the next tick switches its torque off."""
        self.gate.switch_off(index)
        self.supervision.switch_off(index, time_s)

    def switch_on(self, index: int, time_s: float) -> bool:
        """Permit one servo torque again, at a person's order; a later tick switches it on.

        Returns False if the servo was neither switched off nor given up. time_s: now.
        """
        self.gate.switch_on(index)
        return self.supervision.switch_on(index, time_s)

    def reboot(self, index: int, time_s: float) -> None:
        """Restart one servo, which must not be driven, at a person's order."""
        self.supervision.reboot(index, time_s, self.gate)

    def remarks(self) -> Sequence[str]:
        """Return what is unusual about the bus, in sentences for a log."""
        return self._bus.remarks()

    def health(self) -> tuple[ServoHealth, ...]:
        """Return the last reading of every servo's condition; too slow for every tick."""
        return tuple(ServoHealth(*row) for row in zip(*self._health_columns(), strict=True))

    def health_records(self) -> list[dict[str, object]]:
        """Return the servos' `ServoHealth` as dicts for JSON; None for a value never read."""
        records = [dict(zip(_HEALTH, row)) for row in zip(*self._health_columns())]  # noqa: B905 - strict costs as much again
        for record in records:
            for name in ("temperature_degc", "load", "voltage_v"):
                if record[name] != record[name]:
                    record[name] = None
        return records

    def _health_columns(self) -> tuple[list[Any], ...]:
        """Return the columns of `ServoHealth`, in the order of its fields, one value a servo.

        () before the first reading: there are no servos to report.
        """
        known = self._health
        if known is None:
            return ()
        return (
            [joint.name for joint in self._joints],
            [joint.servo_id for joint in self._joints],
            self.words(),
            known.temperature_degc.tolist(),
            known.effort.tolist(),
            known.voltage_v.tolist(),
            [ma if math.isfinite(ma) else None for ma in known.current_ma.tolist()],
            known.hardware_errors.tolist(),
            self.supervision.n_reboots.tolist(),
            known.n_unanswered.tolist(),
            self.torque.as_json(),
        )

    def _not_off(self, indices: Sequence[int]) -> list[int]:
        return [index for index in indices if index not in self.gate.switched_off]

    def _refuse(self, found: Sequence[tuple[int, str]]) -> None:
        lines = [f"{named(self._joints[i])} {why}" for i, why in found if why]
        if lines:
            self.disable_all()
            raise ServoError("\n".join([*lines, "`lipservo doctor` examines every servo"]))


def _stop_is_repeated(ask: Callable[[int], str], index: int) -> str:
    """Call `ask(index)` up to 60 times until it returns ""; return "", or its last refusal.

    Repeated since lost packets are no reason to fail.
    """
    refusal = ""
    for _ in range(_REQUESTED):
        refusal = ask(index)
        if not refusal:
            break
    return refusal
