"""Orders of a person to single servos, switching and jogging: refused, or carried out."""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from firmware_bridge.bus import Array, ServoState
from firmware_bridge.joints import Joint, named
from firmware_bridge.loop.face_table import FaceState
from firmware_bridge.loop.servo_group import ServoGroup
from firmware_bridge.stopping import (
    ArmJog,
    EndJog,
    JogPulse,
    JogTo,
    Order,
    ServoOrder,
    ServoSwitch,
    StartFace,
)

#: The fastest that a jogged joint goes, there and back. Ours: a hand can be taken away in time.
JOG_DEG_S: Final = 30.0
#: So long after the last jog command all joints go back: the person may have gone.
JOG_LASTS_S: Final = 3.0
#: Beyond a joint's limits, where it may meet a mechanical stop: longest step, and speed.
BEYOND_STEP_US: Final = 10.0
_BEYOND_DEG_S: Final = 5.0


_SAME_US: Final = 0.01
_SAME_DEG: Final = 1e-6


class Jog:
    """Jogging: moves single joints by a person's commands, in place of their targets.

    Its goals still pass limiter and rules. is_armed: whether jogging is allowed now. is_active:
    whether `guide` has to be called. Arrays are (n_joints,).
    """

    def __init__(self, joints: Sequence[Joint], period_s: float) -> None:
        """Set the longest step of each joint: its jogging speed times `period_s`, of a tick."""
        speeds_deg_s = np.array([joint.max_speed_deg_s for joint in joints])
        self._step_deg = np.minimum(speeds_deg_s, JOG_DEG_S) * period_s
        self._small_step_deg = np.minimum(speeds_deg_s, _BEYOND_DEG_S) * period_s
        self._min_deg = np.array([joint.min_deg for joint in joints])
        self._max_deg = np.array([joint.max_deg for joint in joints])
        # A hobby servo's ends are those of its pulses: its limits in degrees are rounded inwards.
        ends = [
            sorted((pulse.deg(pulse.min_us), pulse.deg(pulse.max_us)))
            if (pulse := joint.pulse)
            else (joint.min_deg, joint.max_deg)
            for joint in joints
        ]
        self._least_deg, self._most_deg = np.array(ends).reshape(-1, 2).T
        self._goals_deg = np.full(len(joints), np.nan)  # NaN: not jogged
        self._returns = np.zeros(len(joints), dtype=np.bool_)
        self._until_s = 0.0
        self.is_armed = self.is_active = False

    @property
    def jogged(self) -> list[int]:
        """The indices of the jogged joints, without those on their way back to their targets."""
        return [int(index) for index in np.flatnonzero(np.isfinite(self._goals_deg))]

    def arm(self, time_s: float) -> None:
        """Allow jogging until 3 s after `time_s`; joints that are jogged already go on."""
        self.is_armed = self.is_active = True
        self._until_s = time_s + JOG_LASTS_S

    def move(self, index: int, position_deg: float, time_s: float) -> None:
        """Jog one joint to a position in degrees until 3 s after `time_s`; only while armed."""
        self._goals_deg[index] = position_deg
        self._returns[index] = False
        self._until_s = time_s + JOG_LASTS_S

    def end(self) -> None:
        """End jogging: all jogged joints go back to their targets, at jogging speed."""
        self._returns |= np.isfinite(self._goals_deg)
        self._goals_deg[:] = np.nan
        self.is_armed = False
        self.is_active = bool(self._returns.any())

    def return_slowly(self, index: int) -> None:
        """Move one joint slowly from its present position to its target."""
        self._goals_deg[index] = np.nan
        self._returns[index] = self.is_active = True

    def drop(self, index: int) -> None:
        """End the jogging of one joint at once, without a slow return."""
        self._goals_deg[index] = np.nan
        self._returns[index] = False

    def clear(self) -> None:
        """End all jogging at once, with no return to targets: the face stops or goes limp."""
        if self.is_active:
            self._goals_deg[:] = np.nan
            self._returns[:] = False
            self.is_armed = self.is_active = False

    def guide(self, wanted_deg: Array, sent_deg: Array, scale: Array, time_s: float) -> Array:
        """Return the joints' next goals while a person jogs some; jogging ends 3 s after an order.

        To be called in every tick in which `is_active`.

        Parameters
        ----------
        wanted_deg : Array
            (n_joints,) degrees: targets.
        sent_deg : Array
            (n_joints,) degrees: goals sent last.
        scale : Array
            (n_joints,), 0 to 1 of the amplitude, to spare servos.
        time_s : float
            Monotonic seconds.

        Returns
        -------
        Array
            (n_joints,) degrees.
        """
        if self.is_armed and time_s >= self._until_s:
            self.end()
        # Jogged joints, and those on their way back, move by a small step; others follow targets.
        is_jogged = np.isfinite(self._goals_deg)
        aim_deg = np.where(is_jogged, self._goals_deg * scale, wanted_deg)
        way_deg = aim_deg - sent_deg
        # Goals of joints that are not jogged are NaN, which compares as not beyond the limits.
        beyond_deg = np.fmax(self._least_deg - self._goals_deg, self._goals_deg - self._most_deg)
        goes_beyond = beyond_deg > _SAME_DEG
        step_deg = np.where(goes_beyond, self._small_step_deg, self._step_deg)
        near_deg = sent_deg + np.clip(way_deg, -step_deg, step_deg)
        guided_deg = np.where(is_jogged | self._returns, near_deg, wanted_deg)
        # A return is over once what is left is less than a step.
        self._returns &= np.abs(way_deg) > self._step_deg
        self.is_active = self.is_armed or bool(self._returns.any())
        return guided_deg

    def reached(self, sent_deg: Array) -> tuple[Array, Array]:
        """Return the range of each joint for this tick, widened to where a person jogs it.

        A joint that is beyond its limits and no longer jogged gets a range that ends one step
        nearer to them, so that it comes back whatever its target.

        Parameters
        ----------
        sent_deg : Array
            (n_joints,) degrees: goals sent last.

        Returns
        -------
        tuple[Array, Array]
            (low, high), (n_joints,) degrees each.
        """
        back_deg = np.where(np.isfinite(self._goals_deg), 0.0, self._step_deg)
        low_deg = np.fmin(np.minimum(self._min_deg, sent_deg + back_deg), self._goals_deg)
        high_deg = np.fmax(np.maximum(self._max_deg, sent_deg - back_deg), self._goals_deg)
        return low_deg, high_deg


class SingleServos:
    """A person's orders to single servos; noted here, and carried out by the ticks."""

    def __init__(self, joints: Sequence[Joint], servos: ServoGroup, jog: Jog) -> None:
        self._joints = tuple(joints)
        self._index = {joint.name: n for n, joint in enumerate(joints)}
        self._servos = servos
        self._jog = jog

    def refusal(self, order: Order, state: FaceState, *, plugged: bool) -> str:
        """Return why an order is refused now, in one line; empty: it is accepted.

        state: of the face; plugged: whether the port is open.
        """
        if isinstance(order, (ServoOrder, JogTo, JogPulse)) and order.name not in self._index:
            return f"{order.name[:40]!r}: no such servo; there are: {', '.join(self._index)}"
        if self._servos.gate.dry_run:
            return self._servos.gate.forbidden
        if not plugged and isinstance(order, ServoOrder) and order.switch is ServoSwitch.REBOOT:
            return "the port of the servos is gone"
        match order:
            case ServoOrder():
                return self._switch_refusal(self._index[order.name], order.switch, state)
            case ArmJog():
                return self._jog_refusal(state)
            case JogTo() | JogPulse():
                return self._jog_refusal(state) or self._goal_refusal(order)
            case EndJog() | StartFace():
                return ""

    def note(self, order: Order, time_s: float) -> None:
        """Store an accepted order, which the next ticks of the control loop carry out.

        Only the restart of a servo is sent at once; raises PortError where that fails.
        """
        match order:
            case ServoOrder():
                self._switch(self._index[order.name], order.switch, time_s)
            case ArmJog():
                self._jog.arm(time_s)
            case JogTo():
                self._jog.move(self._index[order.name], order.position_deg, time_s)
            case JogPulse():
                index = self._index[order.name]
                pulse = self._joints[index].pulse
                assert pulse is not None  # refused before
                self._jog.move(index, pulse.deg(order.pulse_us), time_s)
            case EndJog():
                self._jog.end()

    def _switch(self, index: int, switch: ServoSwitch, time_s: float) -> None:
        """Switch a servo off, on or restart it; one that comes on goes to its target slowly."""
        if switch is ServoSwitch.OFF:
            self._jog.drop(index)
            self._servos.switch_off(index, time_s)
        elif switch is ServoSwitch.REBOOT:
            self._servos.reboot(index, time_s)
        elif self._servos.switch_on(index, time_s):
            self._jog.return_slowly(index)

    def _switch_refusal(self, index: int, switch: ServoSwitch, state: FaceState) -> str:
        """Return why a servo must not be switched off, on or restarted now; empty: it may."""
        joint, gate = self._joints[index], self._servos.gate
        if switch is ServoSwitch.OFF and joint.critical:
            return f"{named(joint)} is critical: the face cannot go on without it; stop it"
        if switch is not ServoSwitch.REBOOT:
            return ""  # switched on while the face is stopped: it is done at the start
        if gate.forbidden or state in (FaceState.LETTING_GO, FaceState.ENDED):
            return f"the face is {gate.forbidden or state.value}: start it again"
        if self._servos.supervision.states[index] == ServoState.DRIVEN:
            return f"{named(joint)} is driven; switch it off first"
        return ""

    def _jog_refusal(self, state: FaceState) -> str:
        if state is FaceState.DRIVEN:
            return ""
        return f"the face is {self._servos.gate.forbidden or state.value}: nothing can be jogged"

    def _goal_refusal(self, order: JogTo | JogPulse) -> str:
        """Return why a jog order is refused; empty: accepted.

        Refused are jogs that were not armed, goals out of range, and servos that are not driven.
        """
        if not self._jog.is_armed:
            return "jogging is not armed: say `jog arm` first"
        index, supervision = self._index[order.name], self._servos.supervision
        joint = self._joints[index]
        if isinstance(order, JogTo):
            refusal = _angle_refusal(joint, order.position_deg)
        else:
            sent_deg = float(self._servos.limiter.sent_deg[index])
            refusal = _pulse_refusal(joint, order.pulse_us, sent_deg)
        if refusal or supervision.states[index] == ServoState.DRIVEN:
            return refusal
        return f"{named(joint)} {supervision.reasons[index] or 'is not driven yet'}"


def _angle_refusal(joint: Joint, goal_deg: float) -> str:
    if math.isfinite(goal_deg) and joint.min_deg <= goal_deg <= joint.max_deg:
        return ""
    return f"{joint.name} is {goal_deg:g} deg; allowed: {joint.min_deg:g} to {joint.max_deg:g} deg"


def _pulse_refusal(joint: Joint, pulse_us: float, sent_deg: float) -> str:
    """Return why a joint must not be jogged to `pulse_us`; empty: it may.

    sent_deg: the goal sent last. Within min_us..max_us any pulse is allowed; beyond, up to
    `reach_us`, only one a small step farther than the present pulse.
    """
    pulse = joint.pulse
    if pulse is None:
        return f"{named(joint)} takes no pulses: jog it in degrees"
    low_us, high_us = pulse.reach_us
    if not (math.isfinite(pulse_us) and low_us <= pulse_us <= high_us):
        return f"{joint.name} is {pulse_us:g} us; never outside {low_us:g} to {high_us:g}"
    sent_us = pulse.us(sent_deg)
    nearest_us = min(sent_us, pulse.min_us) - BEYOND_STEP_US - _SAME_US
    farthest_us = max(sent_us, pulse.max_us) + BEYOND_STEP_US + _SAME_US
    if nearest_us <= pulse_us <= farthest_us:
        return ""
    return (
        f"{joint.name}: beyond its limits, {pulse.min_us:g} to {pulse.max_us:g} us, it "
        f"goes {BEYOND_STEP_US:g} us at a time; it is at {sent_us:.0f}"
    )
