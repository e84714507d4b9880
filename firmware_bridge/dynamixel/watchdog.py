"""The watchdog in every servo: it stops by itself when the bus has been silent for too long."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from firmware_bridge.dynamixel.control_table import register
from firmware_bridge.dynamixel.units import WATCHDOG_UNIT_S
from firmware_bridge.dynamixel.wire import codec
from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.dynamixel.wire.verified_write import write_verified

_ADDRESS: Final = register("bus_watchdog").address
_LONGEST: Final = 127


class Watchdogs:
    """Sets the watchdogs of all servos, and notices when our own silence may have tripped them."""

    def __init__(self, ids: Sequence[int], timeout_s: float) -> None:
        """timeout_s: how long servos go on without hearing anything; 0 = for ever."""
        self._ids = tuple(ids)
        self._setting = min(_LONGEST, int(np.ceil(timeout_s / WATCHDOG_UNIT_S - 1e-9)))
        self._trips_after_s = self._setting * WATCHDOG_UNIT_S if self._setting else float("inf")
        self._spoke_s = 0.0
        self._lapsed = False

    @property
    def setting(self) -> int:
        """What the register must hold while torque is on; 0 = no watchdog."""
        return self._setting

    def start(self, line: Line, servo_id: int) -> bool:
        """Clear one servo's watchdog and start it; whether its register now says so.

        A tripped one takes no goals before, and a lost write would leave nothing to stop a face
        whose computer has died.
        """
        cleared = write_verified(line, servo_id, _ADDRESS, b"\0")
        if not (cleared and self._setting):
            return cleared
        return write_verified(line, servo_id, _ADDRESS, bytes((self._setting,)))

    def spoke(self, now_s: float) -> None:
        """The servos hear us now; whether they heard us in time before is remembered."""
        if now_s - self._spoke_s >= self._trips_after_s:
            self._lapsed = True
        self._spoke_s = now_s

    def keep(self, line: Line) -> None:
        """Set servos going again that may have stopped by themselves; before every goal."""
        self.spoke(line.transport.clock.now())
        if self._lapsed:
            self._lapsed = False
            for value in (b"\0", bytes((self._setting,))):
                line.tell(codec.sync_write(_ADDRESS, 1, [(each, value) for each in self._ids]))
