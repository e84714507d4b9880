"""What sync and bulk instructions ask of each servo: their parameters, taken apart.

https://emanual.robotis.com/docs/en/dxl/protocol2/#sync-read and the three sections after it
"""

from typing import NamedTuple


class SpanWanted(NamedTuple):
    """`size` bytes from `address` on, of one servo."""

    servo_id: int
    address: int
    size: int


def sync_read(parameters: bytes) -> list[SpanWanted]:
    """The same span of each id; an id named twice is answered once, at its first place."""
    if len(parameters) < 5:
        return []
    address = parameters[0] | parameters[1] << 8
    size = parameters[2] | parameters[3] << 8
    return [SpanWanted(servo_id, address, size) for servo_id in dict.fromkeys(parameters[4:])]


def bulk_read(parameters: bytes) -> list[SpanWanted]:
    """A span of its own for each id; an id named twice is answered once, as it was named first."""
    wanted: dict[int, SpanWanted] = {}
    for at in range(0, len(parameters) - 4, 5):
        servo_id, low, high, size_low, size_high = parameters[at : at + 5]
        span = SpanWanted(servo_id, low | high << 8, size_low | size_high << 8)
        wanted.setdefault(servo_id, span)
    return list(wanted.values())


def sync_write(parameters: bytes) -> dict[int, bytes]:
    """Parameters of a plain write, by id. Of an id named twice the last block counts."""
    if len(parameters) < 5:
        return {}
    head = parameters[:2]
    size = parameters[2] | parameters[3] << 8
    return {
        parameters[at]: head + parameters[at + 1 : at + 1 + size]
        for at in range(4, len(parameters) - size, size + 1)
    }


def bulk_write(parameters: bytes) -> dict[int, bytes]:
    """Parameters of a plain write, by id. A block cut short is left out."""
    blocks: dict[int, bytes] = {}
    at = 0
    while at + 5 <= len(parameters):
        end = at + 5 + (parameters[at + 3] | parameters[at + 4] << 8)
        if end <= len(parameters):
            blocks[parameters[at]] = parameters[at + 1 : at + 3] + parameters[at + 5 : end]
        at = end
    return blocks
