"""A computer that leaves some processes a tenth of a processor, and what it says of them."""

import contextlib
import os
import subprocess
from pathlib import Path
from typing import Final

from lipservo_lab.bench.stops.robot_at_port import RobotAtPort
from lipsync.errors import UserError

#: It works for 30 ms to .9 s before all others, also before bridges, then sleeps a ninth of that.
_HOG: Final = """
import os, random, sys, time
os.sched_setaffinity(0, {int(sys.argv[1])})
os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(90))
chance = random.Random(0)
while True:
    busy_s = 0.03 * 30.0 ** chance.random()
    until_s = time.monotonic() + busy_s
    while time.monotonic() < until_s:
        pass
    time.sleep(busy_s / 9.0)
"""
_TICKS_S: Final = os.sysconf("SC_CLK_TCK")


def split_processors() -> tuple[int, set[int]]:
    """The processor that will be busy, and the others. Raises UserError where there is only one."""
    *others, busy = sorted(os.sched_getaffinity(0))
    if not others:
        raise UserError("--starved: needs a second processor, for the simulated servos")
    return busy, set(others)


def keep_busy(robot: RobotAtPort, processor: int) -> subprocess.Popen[bytes]:
    """Start what takes nine tenths of a processor; it ends with the robot."""
    return robot.start_python("-c", _HOG, str(processor))


def check_running(hog: subprocess.Popen[bytes], robot: RobotAtPort) -> None:
    """Raise UserError where it was not permitted to run before all others."""
    if hog.poll() is not None:
        why = "--starved: needs permission to run before all others (root, or RLIMIT_RTPRIO of 90)"
        raise UserError(f"{why}: {robot.last_output}")


def put_on(pid: int, processors: set[int]) -> None:
    """Let all threads of a process, and those that it will start, run on these processors."""
    with contextlib.suppress(OSError):
        for thread in os.listdir(f"/proc/{pid}/task"):
            os.sched_setaffinity(int(thread), processors)


def processor_s(pid: int) -> float:
    """How long a process has run so far; 0 where it has ended."""
    fields = _stat(pid)
    return (int(fields[11]) + int(fields[12])) / _TICKS_S if fields else 0.0


def state_of(pid: int) -> str:
    """One letter: R, S, T and so on; empty where it has ended."""
    fields = _stat(pid)
    return "" if not fields or fields[0] in "ZX" else fields[0]


def _stat(pid: int) -> list[str]:
    """The fields from the state on."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text(errors="replace").rpartition(")")[2].split()
    return []
