"""A jaw on a Maestro driven by real processes: what the wire to its servo says after every end.

Judged by the simulator's own log of pulses, which no lipservo process writes.
"""

import contextlib
import json
import os
import signal
import subprocess
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from places import ROOT
from running_daemon import (
    LIPSERVO,
    PATIENCE_S,
    all_driven,
    child,
    own_folder,
    run,
    running,
    wait_for,
)

from lipservo.runtime.servos.sim_process import simulated_port

# Real processes in real time.
pytestmark = pytest.mark.slow

CLIP = str(ROOT / "lipservo" / "clips" / "welcome.flac")
FACE = "face_jaw_maestro"
WORDS = "pulses off; a digital servo may hold"


@pytest.fixture
def jaw(tmp_path, monkeypatch):
    """A Maestro behind a link, and its log."""
    own_folder(monkeypatch)
    log, link = tmp_path / "pulses.jsonl", tmp_path / "port"
    arguments = ["--config", FACE, "--log", str(log), "--link", str(link)]
    with simulated_port(arguments) as port:
        yield SimpleNamespace(port=port, log=log, folder=tmp_path)


def pulses(jaw):
    return [json.loads(line)[2] for line in jaw.log.read_text().splitlines()]


def is_off(jaw):
    sent = pulses(jaw)
    return bool(sent) and sent[-1] == 0.0


@contextlib.contextmanager
def driven(jaw, *arguments):
    with running(jaw.port, jaw.folder, "--config", FACE, "--wav", CLIP, *arguments) as daemon:
        wait_for(lambda: all_driven(daemon) and len(pulses(jaw)) > 20)
        yield daemon


def test_a_second_program_at_one_maestro_is_refused_and_the_first_goes_on(jaw):
    with driven(jaw):
        for command in (("run", "--wav", CLIP), ("jog", "jaw", "2"), ("calibrate", "neutral")):
            done = run(*command, "--config", FACE, "--port", jaw.port)
            assert done.returncode == 1
            assert "another program" in done.stderr, done.stderr
            assert "Traceback" not in done.stderr
        n_before = len(pulses(jaw))
        wait_for(lambda: len(pulses(jaw)) > n_before)
        assert not is_off(jaw)
    assert is_off(jaw)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_after_a_signal_no_pulses_are_sent(jaw, number):
    with driven(jaw) as daemon:
        daemon.send_signal(number)
        assert daemon.wait(PATIENCE_S) == 0
    said = daemon.said.read_text()

    assert is_off(jaw)
    assert f"stop --limp: {WORDS}, which no servo confirms" in said
    assert "limp: confirmed" not in said
    assert pulses(jaw)[-2] == pytest.approx(1500.0, abs=3.0)  # eased to neutral before


def test_a_bridge_that_is_shot_leaves_no_pulses_and_goes_on(jaw):
    with driven(jaw) as daemon:
        before = len(pulses(jaw))
        os.kill(child(daemon, "bridge"), signal.SIGKILL)
        wait_for(lambda: 0.0 in pulses(jaw)[before:])
        wait_for(lambda: all_driven(daemon) and not is_off(jaw))
    assert is_off(jaw)


def test_a_supervisor_that_is_shot_leaves_no_pulses(jaw):
    with driven(jaw) as daemon:
        daemon.kill()
        wait_for(lambda: is_off(jaw))


def test_when_all_are_shot_pulses_go_on_and_limp_without_a_face_ends_them(jaw):
    with driven(jaw) as daemon:
        pids = [daemon.pid, child(daemon, "bridge"), child(daemon, "speech")]
        for pid in pids:
            os.kill(pid, signal.SIGSTOP)
        for pid in pids:
            os.kill(pid, signal.SIGKILL)
        daemon.wait(PATIENCE_S)
    assert not is_off(jaw)

    done = run("limp", "--port", jaw.port)

    assert done.returncode == 0, done.stderr
    assert WORDS in done.stdout + done.stderr
    assert is_off(jaw)


def test_a_face_that_hangs_is_ended_and_nothing_of_another_kind_is_written(jaw):
    with driven(jaw) as daemon:
        for pid in (daemon.pid, child(daemon, "bridge")):
            os.kill(pid, signal.SIGSTOP)
        done = run("stop", "--limp")
        assert done.returncode == 0, done.stdout + done.stderr
        assert WORDS in done.stdout + done.stderr
        assert is_off(jaw)


def test_a_frozen_face_holds_its_last_goal(jaw):
    with driven(jaw) as daemon:
        assert run("stop", "--freeze").returncode == 0
        before = pulses(jaw)
        time.sleep(0.3)
        assert pulses(jaw) == before
        assert not is_off(jaw)
    assert is_off(jaw)
    assert daemon.returncode == 0


def test_a_plug_that_was_out_starts_where_it_was(tmp_path, monkeypatch):
    own_folder(monkeypatch)
    log, link, faults = tmp_path / "pulses.jsonl", tmp_path / "port", tmp_path / "faults.yaml"
    faults.write_text("faults: [{kind: unplug, at_s: 8.0, lasts_s: 0.7}]")
    arguments = ["--config", FACE, "--log", str(log), "--link", str(link), "--faults", str(faults)]
    with simulated_port(arguments):
        jaw = SimpleNamespace(port=str(link), log=log, folder=tmp_path)
        with driven(jaw) as daemon:
            wait_for(lambda: "port of the servos is gone" in daemon.said.read_text())
            wait_for(lambda: all_driven(daemon) and not is_off(jaw))
        assert is_off(jaw)


def test_run_on_a_terminal_ends_without_pulses(jaw):
    with subprocess.Popen(
        [*LIPSERVO, "run", "--config", FACE, "--port", jaw.port, "--wav", CLIP],
        stderr=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
    ) as process:
        wait_for(lambda: len(pulses(jaw)) > 20 if Path(jaw.log).exists() else False)
        process.terminate()
        assert process.wait(PATIENCE_S) == 128 + signal.SIGTERM
    assert is_off(jaw)
