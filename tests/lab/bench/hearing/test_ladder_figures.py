"""The figures of the ladder from ticks that are known, and what is left when the bench is ended."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from lipservo_lab.bench.hearing.ladder_figures import Load, Ticks, figures_of
from lipservo_lab.seen_processes import children_of, state_of
from places import short_folder

PATIENCE_S = 60.0
ALWAYS = np.ones(100, np.bool_)


def ticks(n=2_000, away=(), over=()):
    """Return n ticks at 100 Hz from monotonic 100 s, in which the network listens.

    away: (from, to) in s, when it does not; over: (from, to, seconds that targets are late).
    """
    time_s = 100.0 + np.arange(n) / 100.0
    is_network, over_s = np.ones(n, np.bool_), np.zeros(n)
    for begin_s, end_s in away:
        is_network[round(begin_s * 100) : round(end_s * 100)] = False
    for begin_s, end_s, seconds in over:
        over_s[round(begin_s * 100) : round(end_s * 100)] = seconds
    return Ticks(time_s, time_s - 100.0, is_network, over_s, np.zeros(n, np.int64))


LOADS = (Load(102.0, 103.0), Load(108.0, 113.0))


def test_a_network_that_stays_is_never_away():
    found = figures_of(ticks(), LOADS, ALWAYS)
    assert (found["network_share"], found["changes"], found["delay_over_p99_ms"]) == (1.0, 0, 0.0)


def test_the_share_of_speech_that_the_network_hears_is_of_all_ticks():
    found = figures_of(ticks(away=[(2.5, 4.0), (12.0, 16.0)]), LOADS, ALWAYS)
    assert found["network_share"] == pytest.approx(1.0 - 5.5 / 20.0)
    assert found["changes"] == 4


def test_only_speech_counts_and_the_delay_of_loads_alone():
    half = np.arange(100) < 50
    away = [(second + 0.5, second + 1.0) for second in range(20)]
    assert figures_of(ticks(away=away), LOADS, half)["network_share"] == 1.0
    over = [(0.0, 2.0, 9.0), (8.0, 9.0, 0.1)]
    assert figures_of(ticks(over=over), LOADS, ALWAYS)["delay_over_p99_ms"] == pytest.approx(100.0)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_ending_the_bench_ends_its_load_and_its_face(number):
    folder = short_folder()
    command = [sys.executable, "-m", "lipservo", "bench", "ladder", "--quiet", "--minutes", "1"]
    with subprocess.Popen(
        command, env={**os.environ, "TMPDIR": str(folder)}, stderr=subprocess.PIPE
    ) as bench:
        # Two busy programs for each core, and the face.
        until(lambda: len(children_of(bench.pid)) == 2 * (os.cpu_count() or 1) + 1)
        started = children_of(bench.pid)
        bench.send_signal(number)
        bench.wait(PATIENCE_S)
        said = bench.stderr.read().decode()
    until(lambda: not any(map(state_of, started)))
    if number == signal.SIGTERM:
        assert said.strip() == "lipservo: stopped before the end: no figures"
        assert list(folder.iterdir()) == []


def until(condition):
    give_up_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < give_up_s
        time.sleep(0.05)
