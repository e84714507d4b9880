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
from firmware_bridge.loop.torque_gate import PORT_GONE, TorqueGate, TorqueOff

#: Amplitude shrinks over the last degrees below the servo's temperature limit, and with the mean
#: square of the load, which is what heats a winding: full up to half the stall torque (rms).
_DERATE_FROM_DEGC: Final = 10.0
_DUTY_S: Final = 60.0
_DUTY_FULL: Final = 0.25
_LEAST_SCALE: Final = 0.3
#: Heat is computed so often, to save time in the ticks between: a winding warms far more slowly. A
#: little less than the 50 ms meant, so that rounding makes no sixth tick of the fifth.
_HEAT_EVERY_S: Final = 0.049


class HeatDerating:
    """How far each joint's amplitude is reduced to spare its servo; arrays are (n_servos,)."""

    def __init__(self, has_load: Sequence[bool]) -> None:
        """Start at full amplitude. has_load: for each servo, whether it reports its load."""
        n_servos = len(has_load)
        self._has_load = np.array(has_load)
        self._duty = np.zeros(n_servos)
        self._duty_at_s: float | None = None
        self._scale = np.ones(n_servos)

    def scale(self, feedback: Feedback, health: Health) -> Array:
        """Return the share of its amplitude that each servo's temperature and load allow.

        Computed anew every 50 ms; between, the last result is returned.

        Parameters
        ----------
        feedback : Feedback
            Its time, seconds, and effort, (n_servos,) shares of the stall torque, are used.
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
            # The effort's mean square: a first-order low-pass with a time constant of 60 s.
            share = min(1.0, max(0.0, feedback.time_s - self._duty_at_s) / _DUTY_S)
            # NaN: its bus has not reported yet.
            effort = np.where(self._has_load, np.nan_to_num(feedback.effort), 0.0)
            self._duty += share * (effort * effort - self._duty)
        self._duty_at_s = feedback.time_s
        # Both fall from 1 to 0: with temperature over the last 10 degrees below the limit, with the
        # mean square from _DUTY_FULL to twice that; the smaller counts.
        warm = health.room_degc / _DERATE_FROM_DEGC
        worked = 2.0 - self._duty / _DUTY_FULL
        scale = np.minimum(warm, worked)
        np.maximum(scale, _LEAST_SCALE, out=scale)
        self._scale = np.minimum(scale, 1.0, out=scale)
        return self._scale


#: So often positions are read before a start until every servo has answered: one lost packet is no
#: reason to fail.
_READS = 5
#: So often a check of a servo, or switching its torque on, is tried before a start fails. It
#: takes some ten exchanges of packets; with a fifth of all packets lost in either direction one
#: attempt in seven succeeds.
_REQUESTED = 60
#: A shaft at top speed that is to stop gets a goal so far ahead of it, in time: it stops there
#: without turning back.
_BRAKES_S = 0.02
#: The state of a servo that is to be driven, and is not known to have torque yet.
STARTING_WORD: Final = "starting"
#: Why a servo waits while a port of the face is gone; its torque is known where its own is not.
_MEANWHILE: Final = {
    Torque.ON: "held: a port of the face is gone",
    Torque.OFF: "limp: a port of the face is gone",
    Torque.UNKNOWN: PORT_GONE,
}
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
        #: Whether a joint's range is wider than its limits now, as a person searches them.
        self.is_wide = False
        self._wide = np.zeros(len(self._joints), dtype=np.bool_)
        # Of a frozen face: servos that have not answered since, and those that may hold or not.
        self._to_stay = np.zeros(len(self._joints), dtype=np.bool_)
        self._to_keep: deque[int] = deque(maxlen=len(self._joints))
        self._health: Health | None = None
        #: The positions, loads and errors read in the last tick; None before the first.
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
        for index in self._not_off(range(len(self._joints))):
            self._bus.forgive(index)
        for index in self._not_off(list(self.gate.given_up)):
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
        if lets_go:
            with contextlib.suppress(PortError):
                self.torque_off.begin()

    def wait_for_port(self, time_s: float, *, lets_go: bool) -> None:
        """Run a tick without a port: switch off, on the buses whose port is open, what must be off.

        lets_go: that is every servo; otherwise those that a person switched off.
        """
        with contextlib.suppress(PortError):
            self.supervision.keep_off(time_s, self.gate)
            if lets_go:
                self.torque_off.go_on(time_s)
        for index in np.flatnonzero(self.supervision.states == ServoState.WAITING).tolist():
            why = _MEANWHILE[Torque(int(self.torque.states[index]))]
            self.supervision.note_attempt(index, why, time_s)

    def read(self) -> Readings:
        """Read and return all servos' positions; up to five times, until every servo answers.

        Servos that cannot report a position are not waited for. Raises PortError.
        """
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
        found = [
            (i, _stop_is_repeated(self.gate.obstacle, i, may_continue))
            for i in self._not_off(indices)
            if may_continue()
        ]
        self._refuse(found, may_continue)

    def enable(
        self, indices: Sequence[int], time_s: float, may_continue: Callable[[], bool]
    ) -> None:
        """Switch torque of servos `indices` on at their positions; all off on an error.

        Servos that a person switched off stay off. Raises ServoError naming the servos that refuse.
        may_continue: called before each servo and between tries; False, a stop: no further servo is
        armed.
        """
        found = []
        for index in self._not_off(indices):
            if not may_continue():
                return
            why_not = _stop_is_repeated(self.gate.enable, index, may_continue)
            self.supervision.note_attempt(index, why_not, time_s)
            found.append((index, why_not))
        self._note_ready()
        self._refuse(found, may_continue)

    def keep_holding(self, time_s: float) -> None:
        """Hold the servos of a frozen face that still have torque at their present positions.

        Torque that is off is not switched on. Servos that do not confirm are noted in `_to_keep`,
        and `stay_on` tries them again: just after a port is plugged in answers are lost, and a
        watchdog that tripped protects nothing until it is set again.
        """
        self._to_keep.clear()
        for index in self._not_off(range(len(self._joints))):
            why_not = "" if self.gate.keep(index) else "lost its torque; not again"
            self.supervision.note_attempt(index, why_not, time_s)
            if why_not:
                self._to_keep.append(index)
        # After `keep`, whose place of a servo counts even where this read misses it.
        here_deg = self._bus.read().start_deg(self._bus.capabilities)
        self.limiter.start_from(here_deg, time_s)

    def hold_position(self, time_s: float) -> None:
        """Set the goals sent last, for a freeze, to where each servo can stop.

        That is its last goal, but no farther from its position than it moves in braking. A servo
        that did not answer just now keeps its last goal until it answers (`stay_on`), since its
        position is unknown; one that never reports a position keeps the angle sent last.
        """
        self._to_keep.clear()
        heard, near_deg = self._stopping_places()
        here_deg = np.where(heard, near_deg, self.limiter.sent_deg)
        sent_deg = self._bus.feedback().sent_deg if self._any_blind else None
        if sent_deg is not None:
            here_deg = np.where(np.isfinite(sent_deg), sent_deg, here_deg)
        self.limiter.start_from(here_deg, time_s)
        self._to_stay = ~heard & self._has_place

    def stay_on(self, time_s: float) -> Limited:
        """Run a tick of a frozen face: send its goals again; return them.

        A servo that was silent at the freeze is stopped where it is once it answers. One servo of
        `_to_keep`, whose torque was not confirmed, is tried again; if limp, it stays limp.
        """
        # One that was silent and holds after all is looked after again.
        held = (self.supervision.states == ServoState.WAITING) & (self.torque.states == _ON)
        for index in self._not_off(np.flatnonzero(held).tolist()):
            if index not in self._to_keep:
                self._to_keep.append(index)
        if self._to_keep:
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
        """Switch off servos that wait for their turn to start, since a person stopped the face.

        Only on a bus without positions (hobby servos) do servos start in turn after torque on.
        """
        ready = self._bus.feedback().ready if self._any_blind else None
        if ready is not None:
            for index in np.flatnonzero(self.supervision.driven & ~ready).tolist():
                self.gate.disable(index)
                self.supervision.note_attempt(index, "was stopped before its turn", time_s)

    def _start_here(self, index: int) -> None:
        """Set the limiter's last goal of servo `index`, known to hold, to its position.

        For a servo that reports no position, to the angle that the bus sent last; if the bus does
        not report that either, the limiter's last goal stays.
        """
        feedback = self._bus.feedback()
        has_place = self._has_place[index]
        known_deg = feedback.positions_deg if has_place else feedback.sent_deg
        here_deg = math.nan if known_deg is None else float(known_deg[index])
        if has_place or math.isfinite(here_deg):
            self.limiter.start_one(index, here_deg)
        self._note_ready()

    def _note_ready(self) -> None:
        """Have the limiter hold back the goals of servos that wait for their turn to start.

        These are hobby servos, which start one after another at unknown positions.
        """
        if self._any_blind:
            self.limiter.hold_back(self._bus.feedback().ready)

    def _stopping_places(self) -> tuple[NDArray[np.bool_], Array]:
        """Return (servos that answered just now, where each can stop in degrees), (n_servos,) each.

        A servo stops at its last goal, but no farther from its position than it moves in braking.
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

        limited: the goals that passed the limiter; servos that are not driven get none (NaN).
        Stores `feedback` and the new `scale`. Raises PortError.
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
        # One servo a tick may be switched on, off or restarted; switched on, it starts where it is.
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
        self._bus.forgive(index)
        self.gate.switch_on(index)
        return self.supervision.switch_on(index, time_s)

    def reboot(self, index: int, time_s: float) -> None:
        """Restart one servo, which must not be driven, at a person's order."""
        self._bus.forgive(index)
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
                if record[name] != record[name]:  # NaN
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

    def _refuse(self, found: Sequence[tuple[int, str]], may_continue: Callable[[], bool]) -> None:
        """Raise ServoError for servos that refuse, all torque off; not where a stop has come."""
        lines = [f"{named(self._joints[i])} {why}" for i, why in found if why]
        if lines and may_continue():
            self.disable_all()
            raise ServoError("\n".join([*lines, "`lipservo doctor` examines every servo"]))


def _stop_is_repeated(
    ask: Callable[[int], str], index: int, may_continue: Callable[[], bool]
) -> str:
    """Call `ask(index)` up to 60 times until it returns ""; return "", or its last refusal.

    Repeated, since a lost packet is no reason for a start to fail. may_continue: called between;
    False ends it. The tries may take seconds, in which the supervisor waits for a heartbeat.
    """
    refusal = ""
    for _ in range(_REQUESTED):
        refusal = ask(index)
        if not refusal or not may_continue():
            break
    return refusal
