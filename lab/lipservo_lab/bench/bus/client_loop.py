"""A servo loop as one writes it with dynamixel-sdk or rustypot, a process of its own.

Run as `python -m lipservo_lab.bench.bus.client_loop KIND PORT BAUD_RATE N RATE_HZ TARGETS COUNT`,
the last two inherited descriptors: a socket that goals come through, in degrees, as they come to
the bridge; and eight bytes of memory in which it counts its rounds. It ends when the socket closes.
"""

import gc
import mmap
import select
import socket
import struct
import sys
import time
from typing import Final

from lipservo_lab.bench.bus.servo_clients import (
    AnswerLost,
    HealthRead,
    RustypotClient,
    SdkClient,
    ServoClient,
)

#: Number and time of a record, before its angles.
_HEAD_BYTES: Final = 16
_LONGEST: Final = 4096
_COUNT: Final = struct.Struct("<Q")
_CENTER, _PULSES_PER_DEG = 2048, 4096 / 360


def make_client(kind: str, port: str, baud_rate: int, n_servos: int) -> ServoClient:
    """`sdk`, `sdk_all_fast`, `sdk_in_turn`, `rustypot_in_turn`; the SDK's also with `_waiting`."""
    name, _, health = kind.removesuffix("_waiting").partition("_")
    reads: HealthRead = "in_turn" if health == "in_turn" else "all_plain"
    if health == "all_fast" or (name == "rustypot" and not health):
        reads = "all_fast"
    if name == "rustypot":
        return RustypotClient(port, n_servos, reads, baud_rate=baud_rate)
    in_kernel = kind.endswith("_waiting")
    return SdkClient(port, n_servos, reads, baud_rate=baud_rate, in_kernel=in_kernel)


def run(client: ServoClient, n_servos: int, rate_hz: float, targets: int, count: int) -> int:
    """The newest goals out, and everything back, in every period; no gate, no stop, no status.

    Returns how often an answer was lost, once the socket of the targets is closed.
    """
    angles, ready = struct.Struct(f"<{n_servos}d"), select.poll()
    gc.collect()
    gc.freeze()
    with socket.socket(fileno=targets) as end, mmap.mmap(count, 0) as counted:
        ready.register(end, select.POLLIN)
        n, n_lost, due_s = 0, 0, time.monotonic()
        while True:
            left_s = due_s - time.monotonic()
            if left_s > 0.0:
                time.sleep(left_s)
            due_s = max(due_s + 1.0 / rate_hz, time.monotonic())
            while ready.poll(0):
                raw = end.recv(_LONGEST)
                if not raw:
                    return n_lost
                client.goals = [
                    _CENTER + round(deg * _PULSES_PER_DEG)
                    for deg in angles.unpack_from(raw, _HEAD_BYTES)
                ]
            try:
                client.work()
            except AnswerLost:
                n_lost += 1
            n += 1
            _COUNT.pack_into(counted, 0, n)


if __name__ == "__main__":
    kind, port, *numbers = sys.argv[1:]
    baud_rate, n_servos, targets, count = (int(numbers[n]) for n in (0, 1, 3, 4))
    client = make_client(kind, port, baud_rate, n_servos)
    run(client, n_servos, float(numbers[2]), targets, count)
