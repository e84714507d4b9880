"""When a process without a heartbeat counts as hung: what the kernel says of its threads."""

import os
import signal
import subprocess
import sys
import time

import pytest

from firmware_bridge.process.child import HeartbeatMonitor, HeartbeatTimeouts, RestartDelay
from firmware_bridge.process.processor_wait import ProcessorWait, thread_counts

ROUND_S = 0.05
NS = 1_000_000_000


class Process:
    """Its main thread as the kernel counts it, whatever it does from 100 s on; it never beats."""

    def __init__(self, timeouts):
        self.monitor = HeartbeatMonitor(timeouts)
        self.now_s, self.ran_ns, self.waited_ns, self.pending_ns = 100.0, NS, NS, 0
        self.n_read = 0
        self.monitor.begin(self.now_s)

    def counts(self):
        self.n_read += 1
        return {"7": (self.runnable, self.ran_ns, self.waited_ns)}

    def hung_after_s(self, does, most_s=1000.0, beat_s=100.0):
        """How long it was silent until it counted as hung; None: it did not. does: each round."""
        while self.now_s < 100.0 + most_s:
            self.now_s += ROUND_S
            does(self)
            if self.now_s >= self.monitor.look(self.now_s, beat_s, self.counts):
                return self.now_s - 100.0
        return None

    runnable = False


def sleeps(process):
    process.runnable = False


def spins(process):
    process.runnable = True
    process.ran_ns += int(ROUND_S * NS)


def waits(process):
    """In one go: the kernel counts the wait when it ends, which it does not."""
    process.runnable = True


def gets_a_tenth(process):
    """It runs for one round in ten; the nine before are then counted as waited."""
    process.runnable = True
    process.pending_ns += int(ROUND_S * NS)
    if process.pending_ns >= 10 * int(ROUND_S * NS):
        process.ran_ns += process.pending_ns // 10
        process.waited_ns += process.pending_ns - process.pending_ns // 10
        process.pending_ns = 0


BRIDGE = HeartbeatTimeouts(30.0, 1.0, patience=20.0)


@pytest.mark.parametrize(
    ("does", "hung_s"),
    [(sleeps, 1.0), (spins, 1.0), (waits, 20.0), (gets_a_tenth, 10.0)],
)
def test_a_silence_counts_without_what_was_waited_for_a_processor_up_to_a_bound(does, hung_s):
    """A process that sleeps, or is held by SIGSTOP, hangs as soon as ever."""
    assert Process(BRIDGE).hung_after_s(does) == pytest.approx(hung_s, rel=0.1, abs=0.06)


def test_before_its_first_heartbeat_it_has_the_longer_time_and_the_longer_bound():
    assert Process(BRIDGE).hung_after_s(sleeps, beat_s=None) == pytest.approx(30.0, abs=0.06)
    assert Process(BRIDGE).hung_after_s(waits, beat_s=None) == pytest.approx(600.0, abs=0.06)


def test_one_of_which_nothing_can_be_read_hangs_as_soon_as_ever():
    process = Process(BRIDGE)
    process.counts = dict

    assert process.hung_after_s(waits) == pytest.approx(1.0, abs=0.06)


def test_nothing_is_read_before_a_tenth_of_its_time_has_passed_and_a_heartbeat_ends_it():
    process = Process(BRIDGE)
    assert process.hung_after_s(waits, most_s=0.04) is None
    assert process.n_read == 0
    assert process.hung_after_s(waits, most_s=15.0) is None
    assert process.n_read > 0

    # It beats after fifteen seconds, and then sleeps: what it waited before is past.
    beat_s = process.now_s
    assert process.hung_after_s(sleeps, beat_s=beat_s) == pytest.approx(16.0, abs=0.1)


def test_a_wait_is_told_once_although_it_was_seen_before_the_kernel_counted_it():
    wait = ProcessorWait()
    told_s = [
        wait.waited_s(now_s, {"7": (runnable, ran, waited)})
        for now_s, runnable, ran, waited in [
            (10.0, False, 5, 1 * NS),
            (11.0, True, 5, 1 * NS),  # it may have slept until now
            (12.0, True, 5, 1 * NS),
            (13.0, True, 6, int(3.5 * NS)),
            (14.0, False, 7, int(3.5 * NS)),
        ]
    ]

    assert told_s == [0.0, 0.0, 1.0, 2.5, 2.5]


def test_the_thread_that_waited_longest_counts_and_those_that_come_and_go_do_not_harm():
    wait = ProcessorWait()
    wait.waited_s(0.0, {"7": (False, 1, 0)})
    wait.waited_s(1.0, {"7": (False, 1, 0), "8": (True, 1, 9 * NS)})

    both = {"7": (False, 2, NS // 4), "8": (False, 2, 10 * NS)}
    assert wait.waited_s(2.0, both) == pytest.approx(1.0)
    assert wait.waited_s(3.0, {"7": both["7"]}) == pytest.approx(0.25)


def python(code):
    return subprocess.Popen([sys.executable, "-c", code])


@pytest.fixture
def processes():
    started = []
    yield started
    for process in started:
        process.kill()
        process.wait()


def waited_of(pid, at_least_s, timeout_s):
    """How long it waited in so much time, or until it waited for `at_least_s`."""
    wait, until_s = ProcessorWait(), time.monotonic() + timeout_s
    while (now_s := time.monotonic()) < until_s:
        if (waited_s := wait.waited_s(now_s, thread_counts(pid))) >= at_least_s:
            break
        time.sleep(0.02)
    return waited_s


@pytest.mark.skipif(not hasattr(os, "SCHED_IDLE"), reason="Linux only")
def test_the_kernel_tells_of_a_process_that_gets_no_processor_but_not_of_one_that_is_held(
    processes,
):
    core = min(os.sched_getaffinity(0))
    pin = f"import os\nos.sched_setaffinity(0, {{{core}}})\n"
    idle = "os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))\n"
    processes += [python(pin + "while True: pass") for _ in range(2)]
    starved = python(pin + idle + "while True: pass")
    held = python("import time\ntime.sleep(600)")
    processes += [starved, held]
    held.send_signal(signal.SIGSTOP)
    while b"T" not in (state := _state(held.pid)):
        assert state
        time.sleep(0.01)

    assert waited_of(starved.pid, 0.5, 60.0) >= 0.5
    assert waited_of(held.pid, 0.01, 0.3) < 0.01


def _state(pid):
    with open(f"/proc/{pid}/stat", "rb") as file:
        return file.read().rpartition(b")")[2].split()[0]


def test_of_a_process_that_is_not_there_nothing_is_told():
    gone = python("pass")
    gone.wait()

    assert thread_counts(gone.pid) == {}


def test_a_process_that_hangs_again_and_again_is_started_ever_more_rarely_a_crashed_one_soon():
    hangs = RestartDelay()
    waits_s = [hangs.after(100.0, hung=True) for _ in range(11)]
    assert [round(each, 1) for each in waits_s] == [
        *(0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8, 25.6, 51.2),
        *(60.0, 60.0),
    ]
    assert hangs.after(601.0, hung=True) == 0.2
    for _ in range(9):
        hangs.after(100.0, hung=True)
    assert hangs.after(1.0) == 5.0
    assert hangs.after(11.0) == 0.2
