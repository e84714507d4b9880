"""What the adapter between computer and servos does to answers."""

import statistics
from collections.abc import Sequence
from typing import Final

from firmware_bridge.dynamixel.wire import codec
from firmware_bridge.dynamixel.wire.line import Line, SpanRead

_PINGS: Final = 7
_TRIES: Final = 3


def measured_latency_s(line: Line, servo_id: int) -> float | None:
    """How much later than on the wire answers of this servo arrive, the median of a few pings.

    Return delay and computer included. None when it does not answer.
    """
    clock = line.transport.clock
    wire_s = (len(codec.ping(servo_id)) + codec.EMPTY_STATUS_SIZE + 3) * line.byte_s
    took_s = []
    for _ in range(_PINGS):
        start_s = clock.now()
        if line.ping(servo_id) is not None:
            took_s.append(clock.now() - start_s - wire_s)
    return max(0.0, statistics.median(took_s)) if took_s else None


def without_fast_read(line: Line, ids: Sequence[int]) -> list[int]:
    """Which of these servos, all of which answer, are silent when asked by Fast Sync Read."""
    spans = [SpanRead((each,), 0, 2, fast=True) for each in ids]
    return [span.ids[0] for span in spans if not any(line.sync_read(span) for _ in range(_TRIES))]
