"""Answers sync reads at once with prepared bytes, so that only the master's own work is measured.

Run as `python -m firmware_bridge.simulator.canned_peer N SIZE`; prints its port, ends when its
standard input closes.
"""

import os
import select
import sys
import tty

from firmware_bridge.dynamixel import codec
from firmware_bridge.dynamixel.frames import FrameParser


def serve(n_servos: int, size: int) -> None:
    """Answer for servos 1..n_servos, `size` bytes each."""
    master, slave = os.openpty()
    tty.setraw(slave)
    sys.stdout.write(f"{os.ttyname(slave)}\n")
    sys.stdout.flush()
    data = [(n, 0, bytes(range(n, n + size))) for n in range(1, n_servos + 1)]
    answers = {
        codec.Instruction.SYNC_READ: b"".join(codec.status(*each) for each in data),
        codec.Instruction.FAST_SYNC_READ: codec.fast_status(data),
    }
    parser = FrameParser()
    while True:
        ready = select.select([master, sys.stdin], [], [])[0]
        if sys.stdin in ready:
            return
        for frame in parser.feed(os.read(master, 65_536)):
            answer = answers.get(codec.Instruction(frame.instruction))
            if answer is not None:
                os.write(master, answer)


if __name__ == "__main__":
    serve(int(sys.argv[1]), int(sys.argv[2]))
