"""The figures of the ladder from ticks that are known, and what is left when the bench is ended."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from lipservo_lab.bench.hearing.ladder_figures import Load, Ticks, crowd_figures, figures_of
from places import short_folder

PATIENCE_S = 60.0
DELAY_S = 0.2
ALWAYS = np.ones(100, np.bool_)


def ticks(n=2_000, away=(), over=(), jumps=()):
    """20 s at 100 Hz from monotonic 100 s. away: (from, to) in s; over: the same, and seconds;
    jumps: (when, mm)."""
    time_s = 100.0 + np.arange(n) / 100.0
    is_network, over_s, gap_mm = np.ones(n, np.bool_), np.zeros(n), np.zeros(n)
    for begin_s, end_s in away:
        is_network[round(begin_s * 100) : round(end_s * 100)] = False
    for begin_s, end_s, seconds in over:
        over_s[round(begin_s * 100) : round(end_s * 100)] = seconds
    for at_s, mm in jumps:
        gap_mm[round(at_s * 100) :] += mm
    heard_s = time_s - 100.0
    late = np.zeros(n, np.int64)
    return Ticks(time_s, heard_s, heard_s - DELAY_S, is_network, over_s, gap_mm, late)


LOADS = (Load(102.0, 103.0, 1.0), Load(108.0, 113.0, 5.0))


def test_a_network_that_stays_is_never_away():
    found = figures_of(ticks(), LOADS, ALWAYS)
    assert (found["network_share"], found["changes"], found["left_by_loads"]) == (1.0, 0, 0)
    assert (found["back_median_s"], found["back_worst_s"]) == (0.0, 0.0)
    assert (found["delay_over_p99_ms"], found["widest_step_mm"]) == (0.0, 0.0)


def test_back_counts_from_the_end_of_the_load_and_short_loads_are_told_apart():
    found = figures_of(ticks(away=[(2.5, 4.0), (12.0, 16.0)]), LOADS, ALWAYS)
    assert found["network_share"] == pytest.approx(1.0 - 5.5 / 20.0)
    assert found["back_median_s"] == pytest.approx((0.99 + 2.99) / 2)
    assert found["back_worst_s"] == pytest.approx(2.99)
    assert (found["left_by_loads"], found["left_by_loads_up_to_2_s"], found["changes"]) == (2, 1, 4)


def test_only_speech_counts_and_the_delay_of_loads_alone():
    half = np.arange(100) < 50
    away = [(second + 0.5, second + 1.0) for second in range(20)]
    assert figures_of(ticks(away=away), LOADS, half)["network_share"] == 1.0
    over = [(0.0, 2.0, 9.0), (8.0, 9.0, 0.1)]
    assert figures_of(ticks(over=over), LOADS, ALWAYS)["delay_over_p99_ms"] == pytest.approx(100.0)


def test_the_step_of_the_mouth_is_looked_for_where_recognisers_meet():
    """At the moment of the change, and where what was heard then is shown."""
    jumps = [(6.0, 9.0), (12.0, 2.0), (12.15, 3.0)]
    found = figures_of(ticks(away=[(12.0, 18.0)], jumps=jumps), LOADS, ALWAYS)
    assert found["widest_step_mm"] == pytest.approx(3.0)
    assert found["widest_step_in_speech_mm"] == pytest.approx(9.0)


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
    until(lambda: not any(is_alive(pid) for pid in started))
    if number == signal.SIGTERM:
        assert said.strip() == "lipservo: stopped before the end: no figures"
        assert list(folder.iterdir()) == []


@pytest.mark.campaign
def test_after_ten_faces_on_few_cores_those_that_go_on_have_the_network_again():
    """It was lost for the life of each process."""
    found = crowd_figures(10, 30.0, short_folder(), lambda: False)

    assert found["kept_back"] == found["kept"]


def children_of(pid):
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            after_name = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(after_name[1]) == pid:
            found.append(int(stat.parent.name))
    return found


def is_alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def until(condition):
    give_up_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < give_up_s
        time.sleep(0.05)
