"""Supervision of single servos, so that one in trouble does not stop the face: `SERVO_TABLE`."""

from collections import deque
from collections.abc import Collection, Mapping, Sequence
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.bus import (
    Array,
    Feedback,
    HardwareError,
    Health,
    ServoState,
    all_set,
    any_set,
    describe_errors,
)
from firmware_bridge.gate.tracking import TrackingMonitor, TrackingRule
from firmware_bridge.joints import Joint
from firmware_bridge.known_torque import Torque
from firmware_bridge.loop.servo_table import SERVO_TABLE, ServoAction, ServoEvent, ServoGuard
from firmware_bridge.loop.torque_gate import SWITCHED_OFF

#: A servo that has not answered for so long has no power or no cable: its goals are withheld.
SILENT_S: Final = 0.5
#: In so many ticks, too: a servo that misses one answer after a late tick is not silent.
_SILENT_TICKS: Final = 3
#: After a hardware error the cause needs time to go. Ours.
_COOL_DOWN_S: Final = 1.0
#: So far below its limit a servo must be before it works again, degrees.
_ROOM_TO_WORK_DEGC: Final = 5.0
#: A restart takes half a second in the simulator; the manual does not say.
_REBOOT_S: Final = 1.0
_RETRY_S: Final = 0.5
#: A servo that fails once more within ten minutes is broken.
_REBOOTS: Final = 3
_REBOOT_WINDOW_S: Final = 600.0
#: A servo just enabled is slow for a second, then has to catch up.
_CATCH_UP_S: Final = 2.0


#: An array is compared with an int five times as quickly as with a member of an enumeration.
_DRIVEN: Final = int(ServoState.DRIVEN)
_SWITCHING_OFF: Final = int(ServoState.SWITCHING_OFF)
_TORQUE_OFF, _TORQUE_ON = int(Torque.OFF), int(Torque.ON)
#: When a servo in this state is next looked at, after it came there, seconds.
_REST_S: Final = {
    ServoState.COOLING: _COOL_DOWN_S,
    ServoState.REBOOTING: _REBOOT_S,
}
#: States in which torque that is read on is switched off again.
_MUST_BE_OFF: Final = (ServoState.COOLING, ServoState.FAILED, ServoState.OFF)
#: Why a servo is not driven that a person switched off.
_OFF_WORDS: Final = {
    ServoState.SWITCHING_OFF: f"{SWITCHED_OFF}, has not confirmed yet",
    ServoState.OFF: SWITCHED_OFF,
}
#: Events that take a tick, since packets are sent; a tick has time for one.
_SENDS: Final = (
    ServoEvent.ERROR,
    ServoEvent.HOT,
    ServoEvent.BEHIND,
    ServoEvent.STILL_ON,
    ServoEvent.STILL_FAULTY,
    ServoEvent.READY,
    ServoEvent.DUE,
)


class TorquePort(Protocol):
    """The switch of single servos' torque that supervision uses: a part of `TorqueGate`."""

    def refusal(self, index: int) -> str:
        """Return why this servo must not have torque; empty: it may."""

    def enable(self, index: int) -> str:
        """Switch a servo's torque on at its position; return why not, "" if it holds."""

    def disable(self, index: int) -> bool:
        """Switch torque off; return whether the servo confirmed it."""

    def reboot(self, index: int) -> None:
        """Restart one servo, which leaves its torque off."""

    def give_up(self, index: int, because: str) -> None:
        """Leave a servo limp for good. because: the reason, for people."""


class ServoSupervision:
    """The supervision of a face's servos: which are driven, switched off, restarted or given up.

    A tick decides about one servo, the next in turn that needs it; arrays are (n_servos,). reasons:
    why each servo is not driven, in words; empty while it is, or before it was tried. n_changes:
    how often a reason has changed, so that a loop need not compare texts.
    """

    def __init__(
        self,
        joints: Sequence[Joint],
        tracking: TrackingRule | None = None,
        given_up: Mapping[int, str] | None = None,
        switched_off: Collection[int] = (),
    ) -> None:
        """Mark every servo as waiting for torque, except those in `given_up` and `switched_off`.

        given_up: reason by index, of servos that stay limp from the beginning. switched_off:
        indices of those that a person switched off.
        """
        n = len(joints)
        self._tracking = TrackingMonitor(joints, tracking or TrackingRule())
        self._behind = np.zeros(n, dtype=np.bool_)
        self.reasons = [""] * n
        self.n_changes = 0
        self.states = np.full(n, ServoState.WAITING, dtype=np.int8)
        self._all_driven = bytes([_DRIVEN]) * n
        self._all_on = bytes([_TORQUE_ON]) * n
        self.n_reboots = np.zeros(n, dtype=np.int64)
        self._critical = np.array([joint.critical for joint in joints])
        self._any_critical = bool(self._critical.any())
        self._until_s = np.zeros(n)
        self._n_silent = np.zeros(n, dtype=np.int64)  # ticks in a row
        self._hot = np.zeros(n, dtype=np.bool_)  # until they have cooled down
        self._failures: list[deque[float]] = [deque(maxlen=_REBOOTS) for _ in joints]
        self._next = 0
        for index, why in (given_up or {}).items():
            self.states[index] = ServoState.FAILED
            self._set_reason(index, why)
        for index in switched_off:
            self.switch_off(index, 0.0)

    @property
    def driven(self) -> NDArray[np.bool_]:
        """Mask of the servos that get goals.

        Returns
        -------
        NDArray[np.bool_]
            (n_servos,): True for driven servos.
        """
        return np.asarray(self.states == _DRIVEN)

    @property
    def all_driven(self) -> bool:
        """Whether every servo gets goals."""
        return self.states.tobytes() == self._all_driven

    @property
    def any_driven(self) -> bool:
        """Whether any servo gets goals."""
        return _DRIVEN in self.states.tobytes()

    @property
    def lost_critical(self) -> int | None:
        """The index of a critical servo that stays limp for good; None: there is no such servo."""
        if not self._any_critical:
            return None
        lost = np.flatnonzero(self._critical & (self.states == ServoState.FAILED))
        return int(lost[0]) if len(lost) else None

    @property
    def settled(self) -> bool:
        """Whether every servo is driven, or there is a reason why it is not."""
        return all(self.reasons[i] for i in np.flatnonzero(self.states != ServoState.DRIVEN))

    def note_attempt(self, index: int, why_not: str, time_s: float) -> None:
        """Store the result of enabling a servo: driven if `why_not` is empty, else waiting."""
        event = ServoEvent.REFUSED if why_not else ServoEvent.ENABLED
        self._fire(index, event, time_s, why_not)
        self._until_s[index] = time_s + _RETRY_S
        self._behind[index] = False
        self._tracking.suspend_until(index, time_s + _CATCH_UP_S)

    def mark_all_waiting(self, time_s: float, why: str = "") -> None:
        """Mark every servo as waiting, not driven: the port is lost, or all torque is switched off.

        why: the reason, for people. Servos that a person switched off must once more confirm that
        their torque is off; failed servos stay failed.
        """
        for index in range(len(self.states)):
            self._fire(index, ServoEvent.ALL_OFF, time_s, why)

    def switch_off(self, index: int, time_s: float) -> None:
        """Mark a servo as switched off by a person: no goals, and `act` disables it first."""
        self._fire(index, ServoEvent.SWITCH_OFF, time_s)
        self._next = index

    def switch_on(self, index: int, time_s: float) -> bool:
        """Let `act` enable a servo as if it had never failed; False: it was not off or failed."""
        return self._fire(index, ServoEvent.SWITCH_ON, time_s)

    def reboot(self, index: int, time_s: float, port: TorquePort) -> None:
        """Restart a servo that is not driven, at a person's order.

        Afterwards a servo that was switched off is switched off again, one that failed stays limp,
        and any other is enabled again by `act`.
        """
        self._fire(index, ServoEvent.REBOOT, time_s, self.reasons[index], port)
        self._until_s[index] = time_s + _REBOOT_S

    def keep_off(self, time_s: float, port: TorquePort) -> None:
        """Disable switched-off servos until they confirm, in ticks of a limp face (no `act`)."""
        for index in np.flatnonzero(self.states == _SWITCHING_OFF).tolist():
            if time_s >= self._until_s[index]:
                self._fire(index, ServoEvent.DUE, time_s, port=port)

    def check_tracking(self, sent_deg: Array, feedback: Feedback) -> None:
        """Compare the goals sent last with the servos' positions; `act` uses the result.

        Parameters
        ----------
        sent_deg : Array
            (n_joints,) degrees: goals sent last.
        feedback : Feedback
            Positions in degrees, with their age.
        """
        self._behind = self._tracking.behind(sent_deg, feedback)

    def act(self, health: Health, time_s: float, port: TorquePort) -> int | None:
        """Enable, disable, restart or give up the next servo in turn that needs it, once a tick.

        health: the last readings of all servos. port: switches their torque. Return the index of a
        servo that was enabled just now; None: no servo was.
        """
        if self._all_normal(health):
            self._n_silent.fill(0)
            return None
        # Silent is who has not answered for half a second and in three ticks: after a late tick a
        # single lost answer lasts half a second.
        self._n_silent = np.where(health.silent_s >= SILENT_S, self._n_silent + 1, 0)
        # Begin with the servo after the one that packets were sent to last, or with one that a
        # person has just switched off.
        for k in range(len(self.states)):
            index = (self._next + k) % len(self.states)
            event, why = self._seen(index, health, time_s, port)
            if event is None:
                if why:
                    self._set_reason(index, why)
                continue
            self._fire(index, event, time_s, why, port)
            if event in _SENDS:
                self._next = index + 1
                is_driven = self.states[index] == _DRIVEN
                return index if event is ServoEvent.READY and is_driven else None
        return None

    def _all_normal(self, health: Health) -> bool:
        """Return whether every servo is driven, answers and has no error.

        Then `act` has nothing to do.
        """
        return (
            self.all_driven
            and health.torque.tobytes() == self._all_on
            and not any_set(self._behind)
            and not any_set(health.hardware_errors)
            and not any_set(health.watchdog_tripped)
            and all_set(health.silent_s < SILENT_S)
            and all_set(health.room_degc > 0.0)
        )

    def _seen(
        self, i: int, health: Health, time_s: float, port: TorquePort
    ) -> tuple[ServoEvent | None, str]:
        """Return (event, reason): the event of `SERVO_TABLE` that servo `i`'s readings cause.

        reason: why the servo is not driven, in words to show; "": the reason shown stays. The event
        is None where nothing is to be done now.
        """
        state, torque = self.states[i], health.torque[i]
        is_silent, errors = self._n_silent[i] >= _SILENT_TICKS, int(health.hardware_errors[i])
        if state == _DRIVEN:
            return self._seen_driven(i, health)
        if time_s < self._until_s[i]:
            return None, ""
        if state == _SWITCHING_OFF:
            return ServoEvent.DUE, ""
        if torque == _TORQUE_ON and state in _MUST_BE_OFF:
            return ServoEvent.STILL_ON, self.reasons[i]
        if state in (ServoState.OFF, ServoState.FAILED):
            return None, ""
        if port.refusal(i):  # no torque is allowed: only show an error
            return None, describe_errors(errors) if errors else ""
        if state == ServoState.COOLING:
            if health.room_degc[i] < _ROOM_TO_WORK_DEGC:
                return None, ""
            if not errors:
                return ServoEvent.COOLED, self.reasons[i]
            is_unpowered = errors & HardwareError.INPUT_VOLTAGE and is_silent
            return None if is_unpowered else ServoEvent.STILL_FAULTY, self.reasons[i]
        if is_silent:
            why = self.reasons[i] or "does not answer; check its power and cable"
            return ServoEvent.SILENT, why
        if errors:
            return ServoEvent.ERROR, describe_errors(errors)
        # Also one that left COOLING otherwise: all were switched off, or it was restarted.
        self._hot[i] &= health.room_degc[i] < _ROOM_TO_WORK_DEGC
        return (None, "too hot") if self._hot[i] else (ServoEvent.READY, self.reasons[i])

    def _seen_driven(self, i: int, health: Health) -> tuple[ServoEvent | None, str]:
        """Return (event, reason) that readings of driven servo `i` cause; (None, ""): it is well.

        The worst comes first: of several faults one is returned.
        """
        errors = int(health.hardware_errors[i])
        if self._n_silent[i] >= _SILENT_TICKS:
            return ServoEvent.SILENT, "does not answer"
        if errors:
            return ServoEvent.ERROR, describe_errors(errors)
        if health.room_degc[i] <= 0.0:
            return ServoEvent.HOT, "too hot"
        if self._behind[i]:
            return ServoEvent.BEHIND, self._tracking.reason(i)
        if health.watchdog_tripped[i]:
            return ServoEvent.TRIPPED, "stopped by its watchdog"
        if health.torque[i] == _TORQUE_OFF:
            return ServoEvent.TORQUE_LOST, "has lost its torque"
        return None, ""

    def _fire(
        self,
        i: int,
        event: ServoEvent,
        time_s: float,
        why: str = "",
        port: TorquePort | None = None,
    ) -> bool:
        """Set the state of servo `i` by its row of `SERVO_TABLE`, and carry out the row's actions.

        Return False, having done nothing, if the table has no row for state and event. time_s: now.
        why: the reason in words why the servo is not driven. port: required where an action sends
        packets.
        """

        def holds(_guard: ServoGuard) -> bool:
            """Return whether the servo has failed three times within the last ten minutes."""
            past = self._failures[i]
            return len(past) == _REBOOTS and time_s - past[0] < _REBOOT_WINDOW_S

        row = SERVO_TABLE.find(ServoState(int(self.states[i])), event, holds)
        if row is None:
            return False
        self._hot[i] |= event is ServoEvent.HOT
        if row.then is not None:
            self.states[i] = row.then
            self._until_s[i] = time_s + _REST_S.get(row.then, 0.0)
            self._set_reason(i, _OFF_WORDS.get(row.then, why))
        for action in row.do:
            self._do(action, i, time_s, port)
        return True

    def _do(self, action: ServoAction, i: int, time_s: float, port: TorquePort | None) -> None:
        """Carry out one action of `SERVO_TABLE` for servo `i` at `time_s`.

        Raises ValueError if port is None, unless the action only counts or forgets failures.
        """
        match action:
            case ServoAction.COUNT:
                self._failures[i].append(time_s)
            case ServoAction.FORGET_FAILURES:
                self._failures[i].clear()
            case _ if port is None:
                raise ValueError(f"{action}: needs a port")
            case ServoAction.DISABLE:
                self._until_s[i] = max(self._until_s[i], time_s + _RETRY_S)
                if port.disable(i):
                    self._fire(i, ServoEvent.CONFIRMED, time_s)
            case ServoAction.ENABLE:
                self.note_attempt(i, port.enable(i), time_s)
            case ServoAction.REBOOT:
                self.n_reboots[i] += 1
                port.reboot(i)
            case ServoAction.GIVE_UP:
                self._set_reason(i, f"{self.reasons[i]}, again and again: given up until a start")
                port.give_up(i, self.reasons[i])

    def _set_reason(self, i: int, why: str) -> None:
        if self.reasons[i] != why:
            self.reasons[i] = why
            self.n_changes += 1
