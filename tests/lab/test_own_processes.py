"""What a bench starts ends with its block, and with a bench that is killed."""

import signal
import subprocess
import sys
import time

import pytest
from lipservo_lab.own_processes import started
from lipservo_lab.seen_processes import state_of

SLEEPS = [sys.executable, "-c", "import time; print('up', flush=True); time.sleep(600)"]
#: Sleeps on when it is asked to end.
STUBBORN = [
    sys.executable,
    "-c",
    "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN)\n"
    "print('up', flush=True); time.sleep(600)",
]
BENCH = (
    "import sys, time\n"
    "from lipservo_lab.own_processes import started\n"
    "with started([sys.executable, '-c', 'import time; time.sleep(600)']) as process:\n"
    "    print(process.pid, flush=True); time.sleep(600)\n"
)


@pytest.mark.parametrize("command", [SLEEPS, STUBBORN])
def test_a_process_is_gone_after_its_block(command, monkeypatch):
    monkeypatch.setattr("lipservo_lab.own_processes.end.__defaults__", (0.2,))
    with started(command, stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"up\n"

    assert process.returncode in (-signal.SIGTERM, -signal.SIGKILL)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_bench_that_is_ended_leaves_nothing_behind(number):
    with subprocess.Popen([sys.executable, "-c", BENCH], stdout=subprocess.PIPE) as bench:
        pid = int(bench.stdout.readline())
        bench.send_signal(number)

    give_up_s = time.monotonic() + 30.0
    while state_of(pid):
        assert time.monotonic() < give_up_s
        time.sleep(0.02)
