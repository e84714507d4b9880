"""The one gate to torque: whether a servo may hold; and torque off until each has confirmed."""

from collections.abc import Collection, Mapping, Sequence
from itertools import compress
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.bus import ServoBus, all_set
from firmware_bridge.capabilities import BusCapabilities
from firmware_bridge.joints import Joint
from firmware_bridge.known_torque import KnownTorque, Torque
from firmware_bridge.stopping import StopReport, let_go_report

#: Why a servo holds no torque that a person switched off.
SWITCHED_OFF: Final = "switched off by a person"
#: Why it cannot be known what a servo does.
PORT_GONE: Final = "cannot be reached: the port is gone"


class TorqueGate:
    """The only way to torque for a servo: three checks, in this order.

    Is it forbidden for the whole face: a dry run, or a stop by a person, which lasts until a person
    starts again? Was this servo switched off by a person, or given up? Does the servo itself, read
    now, agree with the YAML? (The last check is `ServoBus.obstacle`, which every bus repeats in
    `enable_torque`.) Start, the end of a silence, replug and restart all come through `enable`.
    """

    def __init__(
        self,
        bus: ServoBus,
        *,
        dry_run: bool = False,
        given_up: Mapping[int, str] | None = None,
        switched_off: Collection[int] = (),
    ) -> None:
        """Make an open gate. dry_run: no servo ever gets torque.

        given_up: reason by index, of servos that an earlier process of this face gave up.
        switched_off: indices of those that a person switched off there. Attribute closed_because:
        why no servo may hold; empty: the gate is open.
        """
        self._bus = bus
        self._given_up = dict(given_up or {})
        self._switched_off = set(switched_off)
        self.closed_because = ""
        self.dry_run = dry_run

    @property
    def torque(self) -> KnownTorque:
        """What is known of the servos' torque."""
        return self._bus.torque

    @property
    def given_up(self) -> Mapping[int, str]:
        """Servos that stay limp for good: reason by index."""
        return self._given_up

    @property
    def switched_off(self) -> Collection[int]:
        """The indices of the servos that a person switched off."""
        return self._switched_off

    @property
    def forbidden(self) -> str:
        """Why no servo may have torque; empty: nothing forbids it for the whole face."""
        return "dry run: servos are only read" if self.dry_run else self.closed_because

    def refusal(self, index: int) -> str:
        """Return why servo `index` must not have torque, by orders alone; empty: it may.

        The servo itself is not read.
        """
        if why := self.forbidden:
            return why
        return SWITCHED_OFF if index in self._switched_off else self._given_up.get(index, "")

    def obstacle(self, index: int) -> str:
        """Return why this servo would get no torque now; empty: it would.

        By orders, as from `refusal`, or by its own state, read now.
        """
        return self.refusal(index) or self._bus.obstacle(index)

    def enable(self, index: int) -> str:
        """Switch a servo's torque on at its position; return why not, "" if it confirmed."""
        return self.refusal(index) or self._bus.enable_torque(index)

    def keep(self, index: int) -> bool:
        """Hold a servo whose torque is on, even after a stop; return whether it confirmed.

        False, too, in a dry run, for a limp servo, and for one that a person switched off.
        """
        may_keep = not self.dry_run and index not in self._switched_off
        return may_keep and self._bus.keep_torque(index)

    @property
    def capabilities(self) -> BusCapabilities:
        """The capabilities of the servos."""
        return self._bus.capabilities

    def disable(self, index: int) -> bool:
        """Switch one servo's torque off; return whether it confirmed.

        True, too, for a servo that was sent the packet and cannot confirm.
        """
        return self._bus.disable_torque(index)

    def disable_all(self) -> None:
        """Switch the torque of all servos off; in a dry run write nothing."""
        if not self.dry_run:
            self._bus.disable_all()

    def reboot(self, index: int) -> None:
        """Restart one servo, which leaves its torque off; do nothing while `forbidden`."""
        if not self.forbidden:
            self._bus.reboot(index)

    def close(self, because: str) -> None:
        """Refuse all torque from now on, since a person stopped the face; `because`: the reason."""
        self.closed_because = because

    def open(self) -> None:
        """Allow torque again, since a person starts the face; not to servos off or given up."""
        self.closed_because = ""

    def switch_off(self, index: int) -> None:
        """Refuse one servo torque from now on, until a person switches it on again."""
        self._switched_off.add(index)

    def switch_on(self, index: int) -> None:
        """Allow torque again to a servo that was switched off or given up."""
        self._switched_off.discard(index)
        self._given_up.pop(index, None)

    def give_up(self, index: int, because: str) -> None:
        """Leave one servo limp for good. because: the reason."""
        self._given_up[index] = because


#: One servo that has not confirmed is asked again in every tick; a servo that is there confirms in
#: a fraction of this even where half of all packets are lost.
_LONGEST_S: Final = 2.0
_OFF: Final = int(Torque.OFF)


class TorqueOff:
    """The switching off of all servos' torque, repeated until every servo is known to be off.

    A bus forgets what it knew before it sends torque off, so that what is known afterwards was
    confirmed since. Methods that send packets may raise PortError.
    """

    def __init__(self, joints: Sequence[Joint], gate: TorqueGate) -> None:
        self._joints = tuple(joints)
        self._gate = gate
        self._since_s: float | None = None
        self._next = 0

    @property
    def off(self) -> NDArray[np.bool_]:
        """Which servos are known to be off.

        Returns
        -------
        NDArray[np.bool_]
            (n_servos,).
        """
        return np.asarray(self._gate.torque.states == _OFF)

    def begin(self) -> None:
        """Send torque off to all servos now."""
        self._since_s = None
        self._gate.disable_all()

    def go_on(self, time_s: float) -> None:
        """Send torque off to the next servo that is not known to be off; call it in every tick.

        time_s: monotonic; the time allowed for all servos counts from the first call after `begin`.
        """
        if self._since_s is None:
            self._since_s = time_s
        missing = np.flatnonzero(~self.off)
        if len(missing) and not self._gate.dry_run:
            self._next += 1
            self._gate.disable(int(missing[self._next % len(missing)]))

    def over(self, time_s: float) -> bool:
        """Return whether all servos are known to be off, or 2 s of trying are over at `time_s`."""
        if self._gate.dry_run or all_set(self.off):
            return True
        return self._since_s is not None and time_s - self._since_s > _LONGEST_S

    def report(self, *, at_rest: bool, plugged: bool) -> StopReport:
        """Return the report of the servos that are known to be off, and of those that are not.

        at_rest: whether the face had come to neutral before. plugged: whether the port is open.
        """
        names = [joint.name for joint in self._joints]
        off, dry_run = self.off, self._gate.dry_run
        why = "does not answer" if plugged else PORT_GONE
        can = {name: self._gate.capabilities.of(n) for n, name in enumerate(names)}
        let_go = {name: can[name] for name in compress(names, off)}
        left = {} if dry_run else dict.fromkeys(compress(names, ~off), why)
        confirms = any(each.confirmed_limp for each in can.values())
        return let_go_report(let_go, left, at_rest=at_rest, dry_run=dry_run, confirms=confirms)
