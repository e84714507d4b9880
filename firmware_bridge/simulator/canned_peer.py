"""Answers sync reads at once with prepared bytes, so that only the master's own work is measured.

Run as `python -m firmware_bridge.simulator.canned_peer N SIZE`; prints its port, ends when its
standard input closes. Questions of another size than SIZE, which a line asks after it has missed an
answer, are answered in their size, too.
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
    answers = _answers(n_servos, size)
    parser = FrameParser()
    while True:
        ready = select.select([master, sys.stdin], [], [])[0]
        if sys.stdin in ready:
            return
        for frame in parser.feed(os.read(master, 65_536)):
            if frame.instruction in answers:
                asked = frame.parameters[2] | frame.parameters[3] << 8
                said = answers if asked == size else _answers(n_servos, asked)
                os.write(master, said[frame.instruction])


def _answers(n_servos: int, size: int) -> dict[int, bytes]:
    """What each kind of sync read is answered with."""
    data = [(n, 0, bytes(range(n, n + size))) for n in range(1, n_servos + 1)]
    return {
        codec.Instruction.SYNC_READ: b"".join(codec.status(*each) for each in data),
        codec.Instruction.FAST_SYNC_READ: codec.fast_status(data),
    }


if __name__ == "__main__":
    serve(int(sys.argv[1]), int(sys.argv[2]))
