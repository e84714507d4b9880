"""A jaw on a Feetech driven by real processes: what its servo was sent, after every end.

Judged by the simulator's own log of torque and goals, which no lipservo process writes.
"""

import contextlib
import json
import os
import signal
import time
from types import SimpleNamespace

import pytest
from places import ROOT
from running_daemon import PATIENCE_S, all_driven, child, own_folder, run, running, wait_for

from lipservo.runtime.servos.sim_process import simulated_port

# Real processes in real time.
pytestmark = pytest.mark.slow

CLIP = str(ROOT / "lipservo" / "clips" / "welcome.flac")
FACE = "face_jaw_feetech"


@pytest.fixture
def jaw(tmp_path, monkeypatch):
    """A servo behind a link, and its log."""
    own_folder(monkeypatch)
    log, link = tmp_path / "changes.jsonl", tmp_path / "port"
    arguments = ["--config", FACE, "--log", str(log), "--link", str(link)]
    with simulated_port(arguments) as port:
        yield SimpleNamespace(port=port, log=log, folder=tmp_path)


def changes(jaw):
    """(torque, goal) at each change."""
    return [json.loads(line)[2:4] for line in jaw.log.read_text().splitlines()]


def is_limp(jaw):
    return changes(jaw)[-1:] and changes(jaw)[-1][0] == 0


@contextlib.contextmanager
def driven(jaw, *arguments):
    with running(jaw.port, jaw.folder, "--config", FACE, "--wav", CLIP, *arguments) as daemon:
        wait_for(lambda: all_driven(daemon) and len(changes(jaw)) > 20)
        yield daemon


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_after_a_signal_the_servo_is_limp_and_has_confirmed_it(jaw, number):
    with driven(jaw) as daemon:
        daemon.send_signal(number)
        assert daemon.wait(PATIENCE_S) == 0
    said = daemon.said.read_text()

    assert is_limp(jaw)
    assert "confirmed by 1 servo" in said or "confirmed by all 1 servos" in said
    assert changes(jaw)[-2][1] == pytest.approx(2048, abs=3)  # eased to neutral before
    assert {torque for torque, _ in changes(jaw)} == {0, 1}


def test_a_bridge_that_is_shot_leaves_the_servo_limp_and_goes_on(jaw):
    with driven(jaw) as daemon:
        before = len(changes(jaw))
        os.kill(child(daemon, "bridge"), signal.SIGKILL)
        wait_for(lambda: 0 in [torque for torque, _ in changes(jaw)[before:]])
        wait_for(lambda: all_driven(daemon) and not is_limp(jaw))
    assert is_limp(jaw)


def test_a_speech_that_is_shot_lets_the_servo_hold_or_go_and_comes_back(jaw):
    with driven(jaw) as daemon:
        before = len(changes(jaw))
        os.kill(child(daemon, "speech"), signal.SIGKILL)
        wait_for(lambda: all_driven(daemon) and len(changes(jaw)) > before + 20)
    assert is_limp(jaw)


def test_a_supervisor_that_is_shot_leaves_the_servo_limp(jaw):
    with driven(jaw) as daemon:
        daemon.kill()
        wait_for(lambda: is_limp(jaw))


def test_when_all_are_shot_the_servo_holds_and_limp_without_a_face_ends_that(jaw):
    """There is no watchdog; the printed table says so."""
    with driven(jaw) as daemon:
        pids = [daemon.pid, child(daemon, "bridge"), child(daemon, "speech")]
        for pid in pids:
            os.kill(pid, signal.SIGSTOP)
        for pid in pids:
            os.kill(pid, signal.SIGKILL)
        daemon.wait(PATIENCE_S)
    assert not is_limp(jaw)

    done = run("limp", "--port", jaw.port)

    assert done.returncode == 0, done.stderr
    assert is_limp(jaw)


def test_a_face_that_hangs_is_ended_and_its_servo_confirms(jaw):
    with driven(jaw) as daemon:
        for pid in (daemon.pid, child(daemon, "bridge")):
            os.kill(pid, signal.SIGSTOP)
        done = run("stop", "--limp")
        assert done.returncode == 0, done.stdout + done.stderr
        assert is_limp(jaw)


def test_a_frozen_face_holds_where_it_stands(jaw):
    with driven(jaw) as daemon:
        assert run("stop", "--freeze").returncode == 0
        wait_for(lambda: time.sleep(0.3) or True)
        before = changes(jaw)
        time.sleep(0.3)
        assert changes(jaw) == before
        assert not is_limp(jaw)
    assert is_limp(jaw)
    assert daemon.returncode == 0


def test_a_plug_that_was_out_starts_where_the_servo_stands(tmp_path, monkeypatch):
    own_folder(monkeypatch)
    log, link, faults = tmp_path / "changes.jsonl", tmp_path / "port", tmp_path / "faults.yaml"
    faults.write_text("faults: [{kind: unplug, at_s: 8.0, lasts_s: 0.7}]")
    arguments = ["--config", FACE, "--log", str(log), "--link", str(link), "--faults", str(faults)]
    with simulated_port(arguments):
        jaw = SimpleNamespace(port=str(link), log=log, folder=tmp_path)
        with driven(jaw) as daemon:
            wait_for(lambda: "port of the servos is gone" in daemon.said.read_text())
            before = len(changes(jaw))
            wait_for(lambda: all_driven(daemon) and len(changes(jaw)) > before + 5)
        assert is_limp(jaw)
