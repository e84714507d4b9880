"""Workers end with the process that they work for, whatever they are doing."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from places import short_folder

PATIENCE_S = 60.0
#: Two workers that burn a core, ignore signals, and have a process in a group of its own.
STUBBORN = """
import signal, subprocess
from lipservo_lab.worker_pool import worker_pool

def work(_):
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    subprocess.Popen(["sleep", "600"], process_group=0)
    while True:
        pass

with worker_pool(2) as pool:
    list(pool.map(work, range(2)))
"""
LIPSERVO = ["-m", "lipservo", "bench", "faults", "--quiet"]


def in_session(session):
    """The processes of a session that have not ended: whatever group or parent they have now."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            fields = stat.read_text().rpartition(")")[2].split()
            if int(fields[3]) == session and fields[0] != "Z":
                found.append(int(stat.parent.name))
    return found


def settle(until):
    give_up_s = time.monotonic() + PATIENCE_S
    while not until():
        assert time.monotonic() < give_up_s
        time.sleep(0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("program", "n_processes"),
    [(["-c", STUBBORN], 5), (LIPSERVO, 3), ([*LIPSERVO, "--stops", "--only", "stops"], 7)],
    ids=["stubborn", "faults", "stops"],
)
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_of_a_program_that_is_ended_no_process_is_left(program, n_processes, number):
    folder = str(short_folder())  # sockets in it: their paths have 107 bytes
    environment = {**os.environ, "TMPDIR": folder, "XDG_RUNTIME_DIR": folder}
    process = subprocess.Popen(
        [sys.executable, *program],
        start_new_session=True,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        settle(lambda: len(in_session(process.pid)) >= n_processes)
        process.send_signal(number)
        assert process.wait(PATIENCE_S) == -number
        settle(lambda: not in_session(process.pid))
    finally:
        for pid in in_session(process.pid):
            os.kill(pid, signal.SIGKILL)
        process.wait()
