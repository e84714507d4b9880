"""Supervision of single servos, so that one in trouble does not stop the face.

DRIVEN ──silent, torque lost──▶ WAITING ──answers, enabled──▶ DRIVEN
   ├──hardware error, too hot──▶ COOLING ──▶ REBOOTING ──▶ WAITING
   └──does not follow──────────▶ COOLING ──▶ WAITING
                                    └──fourth time in ten minutes─▶ FAILED, limp for good
any ──a person──▶ SWITCHING_OFF ──torque is read off──▶ OFF ──a person──▶ WAITING; so from FAILED
"""

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
from firmware_bridge.loop.torque_gate import SWITCHED_OFF

#: A servo that has not answered for so long has no power or no cable: its goals are withheld.
SILENT_S: Final = 0.5
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


#: Those that a person switched off: torque has been read off, or not yet.
_SWITCHED_OFF: Final = (ServoState.SWITCHING_OFF, ServoState.OFF)
#: An array is compared with an int five times as quickly as with a member of an enumeration.
_DRIVEN: Final = int(ServoState.DRIVEN)
_SWITCHING_OFF: Final = int(ServoState.SWITCHING_OFF)


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
        self._all_on = bytes([Torque.ON]) * n
        self.n_reboots = np.zeros(n, dtype=np.int64)
        self._critical = np.array([joint.critical for joint in joints])
        self._any_critical = bool(self._critical.any())
        self._until_s = np.zeros(n)
        self._reboots: list[deque[float]] = [deque(maxlen=_REBOOTS) for _ in joints]
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
        self.states[index] = ServoState.WAITING if why_not else ServoState.DRIVEN
        self._until_s[index] = time_s + _RETRY_S
        self._behind[index] = False
        self._tracking.suspend_until(index, time_s + _CATCH_UP_S)
        self._set_reason(index, why_not)

    def mark_all_waiting(self, time_s: float, why: str = "") -> None:
        """Mark all as not driven, when the port is lost or all torque was switched off.

        why: the reason, for people. Servos that a person switched off have to confirm again; failed
        servos stay failed.
        """
        for index in np.flatnonzero(self.states != ServoState.FAILED).tolist():
            if self.states[index] in _SWITCHED_OFF:
                self.switch_off(index, time_s)  # what it confirmed before may not be so any more
            else:
                self._wait(index, time_s, why)

    def switch_off(self, index: int, time_s: float) -> None:
        """Mark a servo as switched off by a person: no goals, and `act` disables it first."""
        self.states[index] = ServoState.SWITCHING_OFF
        self._until_s[index] = time_s
        self._next = index
        self._set_reason(index, f"{SWITCHED_OFF}, has not confirmed yet")

    def switch_on(self, index: int, time_s: float) -> bool:
        """Let `act` enable a servo as if it had never failed; False: it was not off or failed."""
        if self.states[index] not in (*_SWITCHED_OFF, ServoState.FAILED):
            return False
        self._reboots[index].clear()
        self._wait(index, time_s, "")
        return True

    def reboot(self, index: int, time_s: float, port: TorquePort) -> None:
        """Restart a servo that is not driven, at a person's order.

        Afterwards a servo that was switched off is switched off again, one that failed stays limp,
        and any other is enabled again by `act`.
        """
        port.reboot(index)
        self.n_reboots[index] += 1
        if self.states[index] in _SWITCHED_OFF:
            self.switch_off(index, time_s)
        elif self.states[index] != ServoState.FAILED:
            self.states[index] = ServoState.REBOOTING
        self._until_s[index] = time_s + _REBOOT_S

    def keep_off(self, time_s: float, port: TorquePort) -> None:
        """Disable switched-off servos until they confirm, in ticks of a limp face (no `act`)."""
        for index in np.flatnonzero(self.states == _SWITCHING_OFF).tolist():
            if time_s >= self._until_s[index]:
                self._let_go(index, time_s, port)

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
        """Enable, disable, restart or give up the next servo in turn that needs it.

        Return its index if it was enabled just now; None: no servo was enabled.
        """
        if self._all_normal(health):
            return None
        n = len(self.states)
        for k in range(n):
            index = (self._next + k) % n
            acted, enabled = self._act_on(index, health, time_s, port)
            if acted:
                self._next = index + 1
                return index if enabled else None
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

    def _act_on(self, i: int, health: Health, time_s: float, port: TorquePort) -> tuple[bool, bool]:
        """Enable, disable, restart or give up servo `i` if due; return (anything done, enabled)."""
        state = self.states[i]
        if state == ServoState.DRIVEN:
            return self._check_driven(i, health, time_s, port), False
        if time_s < self._until_s[i]:
            return False, False
        if state == _SWITCHING_OFF or (state == ServoState.OFF and health.torque[i] == Torque.ON):
            self._let_go(i, time_s, port)
            return True, False
        if state == ServoState.OFF:
            return False, False
        if state in (ServoState.COOLING, ServoState.FAILED) and health.torque[i] == Torque.ON:
            # Its torque was switched off and it has not confirmed: again, until it does.
            self._until_s[i] = time_s + _RETRY_S
            port.disable(i)
            return True, False
        if state == ServoState.FAILED:
            return False, False
        if port.refusal(i):
            if health.hardware_errors[i]:  # told although nothing is done about it now
                self._set_reason(i, describe_errors(int(health.hardware_errors[i])))
            return False, False
        if state == ServoState.COOLING:
            return self._recover(i, health, time_s, port), False
        if state == ServoState.REBOOTING:
            self.states[i] = ServoState.WAITING
        if health.silent_s[i] >= SILENT_S:
            self._set_reason(i, self.reasons[i] or "does not answer; check its power and cable")
            return False, False
        if health.hardware_errors[i]:
            self._begin_cool_down(i, time_s)
            return True, False
        why_not = port.enable(i)
        self.note_attempt(i, why_not, time_s)
        return True, not why_not

    def _let_go(self, i: int, time_s: float, port: TorquePort) -> None:
        self.switch_off(i, time_s + _RETRY_S)
        if port.disable(i):
            self.states[i] = ServoState.OFF
            self._set_reason(i, SWITCHED_OFF)

    def _check_driven(self, i: int, health: Health, time_s: float, port: TorquePort) -> bool:
        if health.silent_s[i] >= SILENT_S:
            self._wait(i, time_s, "does not answer")
            return False
        if health.hardware_errors[i] or health.room_degc[i] <= 0.0:
            error = int(health.hardware_errors[i])
            self._disable(i, time_s, port, describe_errors(error) if error else "too hot")
            return True
        if self._behind[i]:
            self._disable(i, time_s, port, self._tracking.reason(i))
            self._count_failure(i, time_s, port)
            return True
        if health.watchdog_tripped[i]:
            self._wait(i, time_s, "stopped by its watchdog")
        elif health.torque[i] == Torque.OFF:
            self._wait(i, time_s, "has lost its torque")
        return False

    def _wait(self, i: int, time_s: float, why: str) -> None:
        self.states[i] = ServoState.WAITING
        self._until_s[i] = time_s
        self._set_reason(i, why)

    def _set_reason(self, i: int, why: str) -> None:
        if self.reasons[i] != why:
            self.reasons[i] = why
            self.n_changes += 1

    def _disable(self, i: int, time_s: float, port: TorquePort, why: str) -> None:
        port.disable(i)
        self._set_reason(i, why)
        self._begin_cool_down(i, time_s)

    def _begin_cool_down(self, i: int, time_s: float) -> None:
        self.states[i] = ServoState.COOLING
        self._until_s[i] = time_s + _COOL_DOWN_S

    def _count_failure(self, i: int, time_s: float, port: TorquePort) -> None:
        """Count a failure of servo `i`; at the fourth in ten minutes it fails, limp for good."""
        past = self._reboots[i]
        if len(past) == _REBOOTS and time_s - past[0] < _REBOOT_WINDOW_S:
            self.states[i] = ServoState.FAILED
            self._set_reason(i, f"{self.reasons[i]}, again and again: it stays limp")
            port.give_up(i, self.reasons[i])
            return
        past.append(time_s)

    def _recover(self, i: int, health: Health, time_s: float, port: TorquePort) -> bool:
        if health.room_degc[i] < _ROOM_TO_WORK_DEGC:
            return False
        if not health.hardware_errors[i]:
            self.states[i] = ServoState.WAITING
            return False
        if (
            health.hardware_errors[i] & HardwareError.INPUT_VOLTAGE
            and health.silent_s[i] > SILENT_S
        ):
            return False
        self._count_failure(i, time_s, port)
        if self.states[i] == ServoState.FAILED:
            return False
        self.n_reboots[i] += 1
        port.reboot(i)
        self.states[i] = ServoState.REBOOTING
        self._until_s[i] = time_s + _REBOOT_S
        return True
