"""Writing what must be true: a register counts as written when it was read back."""

from typing import Final

from firmware_bridge.dynamixel.wire.line import Line

_TRIES: Final = 3


def write_verified(line: Line, servo_id: int, address: int, data: bytes) -> bool:
    """Write `data` to one servo until a read shows it, three times at most; whether it did.

    An acknowledgement is not enough: it carries nothing, and may belong to an earlier packet.
    """
    for _ in range(_TRIES):
        line.write(servo_id, address, data)
        status = line.read(servo_id, address, len(data))
        if status is not None and status.data == data:
            return True
    return False
