"""When the computer itself stood still: what was measured meanwhile says nothing of a program.

On a shared host a core stops for milliseconds although nothing of ours runs on it. A process on
each core sleeps ten milliseconds at a time, before all else that the computer does where permitted,
and reports when it overslept. Run as `python -m lipservo_lab.bench.bus.host_witness CORE FD`.
"""

import os
import struct
import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from firmware_bridge.process.operating_system import die_with_parent, run_on_time

#: Once a tick of 100 Hz: more often it would cool the caches of what is measured.
_PERIOD_S: Final = 0.01
#: A sleep ends within some tenths of a millisecond where a core runs.
_STALL_S: Final = 0.002
#: After a wait of so long each witness has had its turn, or its core stands still now.
_SETTLES_S: Final = 0.03
#: Monotonic begin and end.
_STALL: Final = struct.Struct("<dd")
_MOST_STALLS: Final = 100_000
_CHUNK: Final = _STALL.size * 256


class HostWitness:
    """Knows when any core stalled, from the reports of one process on each. Use `watching`."""

    def __init__(self, fd: int) -> None:
        os.set_blocking(fd, False)
        self._fd = fd
        self._stalls: deque[tuple[float, float]] = deque(maxlen=_MOST_STALLS)

    @classmethod
    @contextmanager
    def watching(cls) -> "Iterator[HostWitness]":
        """Run a process on each core that notices when the core stalls, until the block ends."""
        reader, writer = os.pipe()
        command = [sys.executable, "-P", "-m", "lipservo_lab.bench.bus.host_witness"]
        watchers = [
            subprocess.Popen([*command, str(core), str(writer)], pass_fds=[writer])
            for core in sorted(os.sched_getaffinity(0))
        ]
        os.close(writer)
        try:
            for _ in watchers:  # a report each says that it watches
                os.read(reader, _STALL.size)
            yield cls(reader)
        finally:
            for each in watchers:
                each.kill()
                each.wait()
            os.close(reader)

    def settle(self) -> None:
        """Read the stalls reported until now; blocks for `_SETTLES_S`.

        To be called now and then, for the pipe holds 4,000 reports. Raises RuntimeError if the
        watching processes have ended.
        """
        time.sleep(_SETTLES_S)
        while True:
            try:
                data = os.read(self._fd, _CHUNK)
            except BlockingIOError:
                return
            if not data:
                raise RuntimeError("a witness of the computer's stalls has ended")
            self._stalls.extend(_STALL.iter_unpack(data))

    def saw_stall(self, begin_s: float, end_s: float) -> bool:
        """Return whether a core stalled between two monotonic times, as far as `settle` read."""
        return any(begin < end_s and end > begin_s for begin, end in self._stalls)


def watch(core: int, fd: int) -> None:
    """Write each stall of one core to a pipe (begin and end, monotonic seconds), for ever.

    The first report is an empty one, of the moment from which on stalls are seen.
    """
    die_with_parent()
    os.sched_setaffinity(0, {core})
    run_on_time()
    now_s = time.monotonic()
    os.write(fd, _STALL.pack(now_s, now_s))
    while True:
        due_s = time.monotonic() + _PERIOD_S
        time.sleep(_PERIOD_S)
        now_s = time.monotonic()
        if now_s - due_s > _STALL_S:
            os.write(fd, _STALL.pack(due_s, now_s))


if __name__ == "__main__":
    watch(int(sys.argv[1]), int(sys.argv[2]))
