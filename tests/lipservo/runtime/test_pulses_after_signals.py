"""Signals to each process of a jaw on hobby servos: pulses as the printed table says.

Judged by the simulator's own log, which no process of the face writes. What is killed or signalled
besides: `test_maestro_processes.py`, `test_pca9685_stops.py`, `test_pca9685_guard.py`.
"""

import json
import os
import signal
import time
from types import SimpleNamespace

import pytest
from running_daemon import PATIENCE_S, all_driven, child, own_folder, running, wait_for

from lipservo.runtime.servos.sim_process import simulated_port

# Real processes in real time.
pytestmark = pytest.mark.slow
FACES = ["face_jaw_maestro", "face_jaw_pca9685"]


@pytest.fixture(params=FACES)
def jaw(request, tmp_path, monkeypatch):
    own_folder(monkeypatch)
    log = tmp_path / "pulses.jsonl"
    with simulated_port(["--config", request.param, "--log", str(log), "--on-time"]) as port:
        yield SimpleNamespace(face=request.param, port=port, log=log, folder=tmp_path)


def has_pulses(jaw):
    """A Maestro's log has what changes, that of a board every pulse."""
    rows = jaw.log.read_text().splitlines()
    if jaw.face == "face_jaw_maestro":
        return bool(rows) and json.loads(rows[-1])[2] > 0.0
    time.sleep(0.3)
    return len(jaw.log.read_text().splitlines()) > len(rows)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_to_the_bridge_ends_the_pulses_and_the_face(jaw, number):
    with running(jaw.port, jaw.folder, "--config", jaw.face) as daemon:
        wait_for(lambda: all_driven(daemon) and has_pulses(jaw))
        os.kill(child(daemon, "bridge"), number)
        assert daemon.wait(PATIENCE_S) == 0
        time.sleep(0.1)
        assert not has_pulses(jaw)


def test_speech_that_ends_by_any_signal_is_replaced_while_pulses_go_on(jaw):
    with running(jaw.port, jaw.folder, "--config", jaw.face) as daemon:
        wait_for(lambda: all_driven(daemon) and has_pulses(jaw))
        for number in (signal.SIGKILL, signal.SIGTERM, signal.SIGHUP):
            speech = child(daemon, "speech")
            os.kill(speech, number)
            wait_for(lambda speech=speech: child(daemon, "speech") != speech)
            assert has_pulses(jaw)
    time.sleep(0.1)
    assert not has_pulses(jaw)
