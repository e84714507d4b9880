"""Orders of a person to single servos: what is refused, and what comes of the others."""

import math
from collections.abc import Sequence

from firmware_bridge.health import ServoState
from firmware_bridge.joints import Joint, named
from firmware_bridge.loop.jog import Jog
from firmware_bridge.loop.report import FaceState
from firmware_bridge.loop.servo_group import ServoGroup
from firmware_bridge.orders import (
    ArmJog,
    EndJog,
    JogTo,
    Order,
    ServoOrder,
    ServoSwitch,
    StartFace,
)

#: The face has torque, or will have it again by itself.
_LIVE = (FaceState.DRIVEN, FaceState.SILENT)


class SingleServos:
    """Notes the orders; the ticks carry them out, through gate, limiter and supervision."""

    def __init__(self, joints: Sequence[Joint], servos: ServoGroup, jog: Jog) -> None:
        self._joints = tuple(joints)
        self._index = {joint.name: n for n, joint in enumerate(joints)}
        self._servos = servos
        self._jog = jog

    def refusal(self, order: Order, state: FaceState, *, plugged: bool) -> str:
        """Why this order is refused now, in one line; empty: it is not."""
        if isinstance(order, (ServoOrder, JogTo)) and order.name not in self._index:
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
            case JogTo():
                return self._jog_refusal(state) or self._goal_refusal(order)
            case EndJog() | StartFace():
                return ""

    def note(self, order: Order, time_s: float) -> None:
        """Obey an order that is not refused; speaks to a servo only to restart it: PortError."""
        match order:
            case ServoOrder():
                self._switch(self._index[order.name], order.switch, time_s)
            case ArmJog():
                self._jog.arm(time_s)
            case JogTo():
                self._jog.move(self._index[order.name], order.position_deg, time_s)
            case EndJog():
                self._jog.end()

    def _switch(self, index: int, switch: ServoSwitch, time_s: float) -> None:
        if switch is ServoSwitch.OFF:
            self._jog.drop(index)
            self._servos.switch_off(index, time_s)
        elif switch is ServoSwitch.REBOOT:
            self._servos.reboot(index, time_s)
        elif self._servos.switch_on(index, time_s):
            self._jog.return_slowly(index)

    def _switch_refusal(self, index: int, switch: ServoSwitch, state: FaceState) -> str:
        joint, gate = self._joints[index], self._servos.gate
        if switch is ServoSwitch.OFF:
            if joint.critical:
                return f"{named(joint)} is critical: the face cannot go on without it; stop it"
            return ""
        if gate.forbidden or state in (FaceState.LETTING_GO, FaceState.ENDED):
            return f"the face is {gate.forbidden or state.value}: start it again"
        is_driven = self._servos.supervision.states[index] == ServoState.DRIVEN
        if switch is ServoSwitch.REBOOT and is_driven:
            return f"{named(joint)} is driven; switch it off first"
        return ""

    def _jog_refusal(self, state: FaceState) -> str:
        if state is FaceState.DRIVEN:
            return ""
        why = self._servos.gate.forbidden or state.value
        return f"the face is {why}: nothing can be jogged"

    def _goal_refusal(self, order: JogTo) -> str:
        index = self._index[order.name]
        joint = self._joints[index]
        if not self._jog.is_armed:
            return "jogging is not armed: say `jog arm` first"
        goal_deg = order.position_deg
        if not (math.isfinite(goal_deg) and joint.min_deg <= goal_deg <= joint.max_deg):
            allowed = f"{joint.min_deg:g} to {joint.max_deg:g} deg"
            return f"{joint.name} is {goal_deg:g} deg; allowed: {allowed}"
        if self._servos.supervision.states[index] != ServoState.DRIVEN:
            why = self._servos.supervision.reasons[index] or "is not driven yet"
            return f"{named(joint)} {why}"
        return ""
