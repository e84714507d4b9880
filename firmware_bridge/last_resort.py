"""When nobody looks after the servos any more: open the port and let every joint go limp."""

import time
from collections.abc import Callable, Sequence
from typing import Final

from firmware_bridge.bus import BusError
from firmware_bridge.dynamixel import codec
from firmware_bridge.dynamixel.control_table import register
from firmware_bridge.dynamixel.line import Line
from firmware_bridge.dynamixel.transport import Transport

_TORQUE, _WATCHDOG = register("torque_enable").address, register("bus_watchdog").address
_REPEATS: Final = 3
_RETRY_S: Final = 0.05


def make_limp(
    open_transport: Callable[[], Transport], ids: Sequence[int], *, within_s: float = 5.0
) -> list[int]:
    """Torque off by three sync writes, checked one by one; the ids that were not seen limp.

    The port may still be held by a process that is dying, so opening is tried again for `within_s`.
    Raises PortError when it never opens. A tripped watchdog is cleared first.
    """
    give_up_s = time.monotonic() + within_s
    while True:
        try:
            transport = open_transport()
            break
        except BusError:
            if time.monotonic() > give_up_s:
                raise
            time.sleep(_RETRY_S)
    try:
        line = Line(transport)
        line.tell(codec.sync_write(_WATCHDOG, 1, [(each, b"\0") for each in ids]))
        for _ in range(_REPEATS):
            line.tell(codec.sync_write(_TORQUE, 1, [(each, b"\0") for each in ids]))
        return [each for each in ids if not _is_limp(line, each)]
    finally:
        transport.close()


def _is_limp(line: Line, servo_id: int) -> bool:
    for _ in range(_REPEATS):
        status = line.read(servo_id, _TORQUE, 1)
        if status is not None and status.data == b"\0":
            return True
        line.write(servo_id, _TORQUE, b"\0")
    return False
