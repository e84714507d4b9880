"""What is logged of a face while it is ticked: port, speech, servos, remarks, health."""

import logging
from collections.abc import Callable
from typing import Final, Protocol

from firmware_bridge.bus import ServoHealth
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.face_table import FaceState
from firmware_bridge.process.lifeline import Failed

_LOG: Final = logging.getLogger(__name__)
#: Troubles are logged so long after the first change: less than a servo rests before it is tried
#: again, so that its first fault is named, and long enough for a single lost answer to be over.
_TROUBLE_LASTS_S: Final = 0.5
_HEALTH_EVERY_S: Final = 10.0
_REMARKS_EVERY_S: Final = 1.0


class FailureReader(Protocol):
    """The receiver of failures: `Lifeline`."""

    def tell(self, message: Failed) -> None:
        """Report that a servo was given up, and why."""


class ChangeLog:
    """Compares a bridge with what was logged of it last; texts are made only when it changed."""

    def __init__(
        self,
        bridge: Bridge,
        now_s: float,
        lifeline: FailureReader | None,
        on_health: Callable[[tuple[ServoHealth, ...]], None] | None,
    ) -> None:
        """Begin with what `bridge` is now, at monotonic `now_s`.

        lifeline: gets the servos that are given up. on_health: called with all servos' condition
        every 10 s.
        """
        self._bridge = bridge
        self._lifeline = lifeline
        self._on_health = on_health
        self._plugged, self._state = True, FaceState.STOPPED
        self._keeps_up = True
        self._given_up = set(bridge.given_up)
        self._n_changes = bridge.n_trouble_changes
        self._trouble_since_s = float("inf")
        self._troubles: tuple[str, ...] = ()
        self._health_due_s = now_s + _HEALTH_EVERY_S
        self._remarks_due_s = now_s + _REMARKS_EVERY_S
        self._n_remarks = 0

    def look(self, time_s: float) -> None:
        """Log what has changed since the last call: port, state, lateness, troubles, remarks.

        Servos newly given up are reported to the supervisor. Every 10 s all servos' health is
        passed on. To be called in every tick, at its monotonic time `time_s`.
        """
        bridge = self._bridge
        if bridge.plugged is not self._plugged:
            self._plugged = bridge.plugged
            if bridge.plugged:
                _LOG.info("the port is back")
            else:
                _LOG.warning("the port of the servos is gone")
        if bridge.state is not self._state:
            self._log_state(bridge.state)
        if bridge.counts.keeps_up is not self._keeps_up:
            self._keeps_up = bridge.counts.keeps_up
            if self._keeps_up:
                _LOG.info("servo loop and speech are in time again")
            else:
                _LOG.warning("%s", "; ".join(bridge.counts.delays()))
        if bridge.given_up.keys() != self._given_up:
            for index in bridge.given_up.keys() - self._given_up:
                if self._lifeline is not None:
                    self._lifeline.tell(Failed(index, bridge.given_up[index]))
            self._given_up = set(bridge.given_up)
        if bridge.n_trouble_changes != self._n_changes:
            self._n_changes = bridge.n_trouble_changes
            self._trouble_since_s = min(self._trouble_since_s, time_s)
        if time_s - self._trouble_since_s >= _TROUBLE_LASTS_S and bridge.plugged:
            self._log_troubles()
        if self._on_health is not None and time_s >= self._health_due_s:
            self._health_due_s = time_s + _HEALTH_EVERY_S
            self._on_health(bridge.servo_health())
        if time_s >= self._remarks_due_s:
            self._remarks_due_s = time_s + _REMARKS_EVERY_S
            for remark in bridge.remarks()[self._n_remarks :]:
                self._n_remarks += 1
                _LOG.warning("%s", remark)

    def _log_state(self, state: FaceState) -> None:
        """Log that motion from speech stops or comes again, and store the new state."""
        if state is FaceState.SILENT:
            _LOG.warning(
                "no motion comes from speech (the computer is too busy, or it hangs): "
                "torque is switched off until it comes"
            )
        elif state is FaceState.DRIVEN and self._state is FaceState.SILENT:
            _LOG.info("motion comes again")
        self._state = state

    def _log_troubles(self) -> None:
        """Log the present troubles; or that there are none any more, if all torque is known on."""
        self._trouble_since_s = float("inf")
        had, self._troubles = self._troubles, self._bridge.troubles
        if self._troubles:
            _LOG.warning("%s", "; ".join(self._troubles))
        elif had and self._bridge.torque.all_on:
            _LOG.info("every servo holds again")
