"""Torque off for everybody, until each servo has said so itself."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from firmware_bridge.joints import Joint
from firmware_bridge.loop.torque_gate import TorqueGate
from firmware_bridge.stopping import StopReport

#: One servo that has not confirmed is asked again in every tick; a servo that is there confirms in
#: a fraction of this even where half of all packets are lost.
_LONGEST_S: Final = 2.0


class TorqueOff:
    """Who has confirmed that it is limp. Methods that speak to the servos may raise PortError."""

    def __init__(self, joints: Sequence[Joint], gate: TorqueGate) -> None:
        self._joints = tuple(joints)
        self._gate = gate
        self._confirmed = np.zeros(len(joints), dtype=np.bool_)
        self._since_s: float | None = None
        self._next = 0

    def forget(self) -> None:
        """Nothing is known any more: the port is gone, or torque may have come on."""
        self._confirmed[:] = False
        self._since_s = None

    def begin(self) -> None:
        """Switch everybody off now."""
        self.forget()
        self._confirmed = self._gate.disable_all()

    def go_on(self, time_s: float) -> None:
        """Ask one of those that have not confirmed; call it in every tick."""
        if self._since_s is None:
            self._since_s = time_s
        if self._confirmed.all() or self._gate.dry_run:
            return
        missing = np.flatnonzero(~self._confirmed)
        index = int(missing[self._next % len(missing)])
        self._next += 1
        self._confirmed[index] = self._gate.disable(index)

    def over(self, time_s: float) -> bool:
        """Whether all have confirmed, or those that are left do not answer."""
        if self._confirmed.all() or self._gate.dry_run:
            return True
        return self._since_s is not None and time_s - self._since_s > _LONGEST_S

    def report(self, *, at_rest: bool, plugged: bool) -> StopReport:
        """What is known now."""
        names = [joint.name for joint in self._joints]
        why = "does not answer" if plugged else "cannot be reached: the port is gone"
        confirmed = self._confirmed.tolist()
        return StopReport(
            confirmed=tuple(n for n, limp in zip(names, confirmed, strict=True) if limp),
            unconfirmed={
                n: why
                for n, limp in zip(names, confirmed, strict=True)
                if not limp and not self._gate.dry_run
            },
            at_rest=at_rest,
            dry_run=self._gate.dry_run,
        )
