"""The processes of one face at simulated servos, shot, hung, and stopped, each in turn."""

import contextlib
import json
import os
import signal

import numpy as np
import pytest
from running_daemon import (
    PATIENCE_S,
    alive,
    all_driven,
    child,
    log,
    own_folder,
    run,
    running,
    torque,
    wait_for,
)
from speech import CLIP_PATH
from typer.testing import CliRunner

from firmware_bridge.process.control_client import ask
from lipservo.cli import app
from lipservo.runtime.servos.sim_process import simulated_port
from lipservo.traces.trace_file import read_trace
from lipsync.errors import UserError

# Real processes in real time.
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def port():
    with simulated_port(["--config", "face_sim", "--on-time"]) as port:
        yield port


@pytest.fixture(scope="module")
def enduring(port, tmp_path_factory):
    """One daemon for all that it survives."""
    folder = tmp_path_factory.mktemp("enduring")
    with pytest.MonkeyPatch.context() as monkeypatch:
        own_folder(monkeypatch)
        with running(port, folder) as process:
            yield process


@pytest.fixture(scope="module")
def free_port():
    """Servos for daemons that end, one after another."""
    with simulated_port(["--config", "face_sim", "--on-time"]) as port:
        yield port


@pytest.fixture
def daemon(free_port, tmp_path, monkeypatch):
    """A daemon of its own."""
    own_folder(monkeypatch)
    with running(free_port, tmp_path) as process:
        process.port = free_port
        yield process


@pytest.mark.parametrize(
    ("number", "said"),
    [(signal.SIGKILL, "bridge died (signal 9)"), (signal.SIGSTOP, "bridge hangs")],
)
def test_a_bridge_that_is_shot_or_hangs_leaves_a_limp_face_and_is_replaced(enduring, number, said):
    first = child(enduring, "bridge")
    os.kill(first, number)
    wait_for(lambda: child(enduring, "bridge") != first)
    wait_for(lambda: all_driven(enduring))

    assert said in log(enduring)
    assert "torque off confirmed by all 10 servos" in log(enduring)
    assert not alive(first)


def test_a_servo_switched_off_by_a_person_stays_off_when_its_bridge_is_shot(enduring):
    def state(name):
        with contextlib.suppress(OSError):
            return ask(enduring.control, "status", PATIENCE_S)["servos"].get(name)

    off = run("servo", "jaw", "off")
    first = child(enduring, "bridge")
    os.kill(first, signal.SIGKILL)
    wait_for(lambda: child(enduring, "bridge") != first)
    wait_for(lambda: state("upper_lip_left") == "driven")
    wait_for(lambda: state("jaw") == "off")
    on = run("servo", "jaw", "on")

    assert (off.returncode, on.returncode) == (0, 0), (off, on)
    assert "servo jaw is off" in off.stdout
    assert "servo jaw is driven" in on.stdout
    wait_for(lambda: all_driven(enduring))


def test_a_speech_side_shot_dead_is_replaced_while_the_face_is_held(enduring):
    first, bridge = child(enduring, "speech"), child(enduring, "bridge")
    os.kill(first, signal.SIGKILL)
    wait_for(lambda: child(enduring, "speech") != first)

    assert child(enduring, "bridge") == bridge
    assert all_driven(enduring)


@pytest.mark.parametrize("same_socket", [False, True])
def test_a_second_face_is_refused_and_the_first_goes_on(enduring, port, same_socket):
    control = ["--control", str(enduring.control)] if same_socket else []
    done = run("daemon", "--port", port, *control)

    assert done.returncode == 1
    assert "used by another program" in done.stderr
    assert "confirmed" not in done.stderr  # of servos that another face drives
    assert "Traceback" not in done.stderr
    wait_for(lambda: all_driven(enduring))  # a busy computer may be late with an answer just now


def test_what_a_daemon_cannot_do_is_refused_before_a_servo_is_spoken_to():
    done = CliRunner().invoke(app, ["daemon", "--port", "/dev/none", "--wav", "no_such.wav"])

    assert isinstance(done.exception, UserError)
    assert "no_such.wav" in str(done.exception)


def test_a_daemon_at_servos_writes_the_trace_that_a_run_writes(free_port, tmp_path, monkeypatch):
    """What was shown is told by one process, what was sent by the other."""
    own_folder(monkeypatch)
    trace = tmp_path / "trace.jsonl"
    with running(free_port, tmp_path, "--wav", str(CLIP_PATH), "--trace", str(trace)) as process:
        wait_for(lambda: ask(process.control, "status", PATIENCE_S)["n_phonemes"])
        wait_for(lambda: _has_moved(tmp_path / "trace.jsonl.partial"))
        process.terminate()
        process.wait(PATIENCE_S)
    told = read_trace(trace)

    assert told.delay_s > 0.1
    assert len(told.servos) == 10
    assert {"SIL", "W"} & set(told.phonemes)
    assert np.ptp(told.sent_deg, axis=0).max() > 3.0
    assert np.ptp(told.coefficients[:, 0]) > 0.1


def _has_moved(partial):
    """A face that a busy computer starves is driven, and stays at neutral, for a while."""
    ticks = [json.loads(line) for line in partial.read_text().splitlines()[1:-1]]
    return len(ticks) > 100 and np.ptp([tick["sent_deg"] for tick in ticks], axis=0).max() > 3.0


def test_stop_ends_the_face_limp_and_says_who_confirmed_it(free_port, tmp_path, monkeypatch):
    """Nobody reads what the daemon says: its log is a full pipe, as after Ctrl-S."""
    own_folder(monkeypatch)
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writing, b"x" * 1000)
    os.set_blocking(writing, True)
    with running(free_port, tmp_path, "--json", errors=writing) as daemon:
        (face,) = json.loads(run("status", "--json").stdout)["faces"]
        assert (face["port"], face["pid"]) == (free_port, daemon.pid)
        done = run("stop", "--end", "--json")
        (stopped,) = json.loads(done.stdout)["faces"]
        assert daemon.wait(PATIENCE_S) == 0
        assert torque(free_port) == [0] * 10
    os.close(reading)
    os.close(writing)

    assert done.returncode == 0, done
    assert len(stopped["confirmed"]) == 10
    assert (stopped["unconfirmed"], stopped["problem"]) == ({}, "")
    assert len(json.loads(daemon.out.read_text())["confirmed"]) == 10


def test_a_stopped_face_waits_limp_through_a_replug_and_is_driven_again(daemon):
    """The way back: what was stopped on a page needs no terminal, and no second daemon."""
    done = run("stop", "--json")
    (stopped,) = json.loads(done.stdout)["faces"]
    assert (done.returncode, stopped["waits"]) == (0, True)
    assert torque(daemon.port) == [0] * 10
    speech = child(daemon, "speech")
    status = ask(daemon.control, "status", PATIENCE_S)
    assert (status["state"], status["stopped"], status["can_start"]) == ("stopped", "soft", True)
    assert "confirmed by 10 servos" in run("status").stdout

    back = run("start", "--json")

    assert back.returncode == 0, back
    assert all_driven(daemon)
    assert child(daemon, "speech") == speech
    assert run("start").returncode == 1  # it is driven already


def test_a_face_stopped_before_its_daemon_died_comes_back_limp(free_port, tmp_path, monkeypatch):
    """As systemd starts it again; a person's start drives it."""
    own_folder(monkeypatch)
    with running(free_port, tmp_path) as daemon:
        assert run("stop", "--limp").returncode == 0
        daemon.kill()
        daemon.wait(PATIENCE_S)
        (tmp_path / "notify.sock").unlink()
        run("status")  # clears the dead socket away
    with running(free_port, tmp_path) as daemon:
        assert ask(daemon.control, "status", PATIENCE_S)["state"] == "stopped"
        assert "not driven until `lipservo start`" in log(daemon)
        assert torque(free_port) == [0] * 10
        assert run("start").returncode == 0
        assert all_driven(daemon)


def test_a_supervisor_shot_dead_takes_both_children_with_it_and_torque_off(daemon):
    """Its socket is left behind, and cleared away by whoever comes next."""
    children = [child(daemon, "bridge"), child(daemon, "speech")]
    daemon.kill()
    daemon.wait(PATIENCE_S)
    wait_for(lambda: not any(alive(pid) for pid in children))

    assert torque(daemon.port) == [0] * 10
    assert json.loads(run("status", "--json").stdout) == {"faces": []}
    assert not daemon.control.exists()


def test_a_closed_terminal_brings_the_face_to_rest(daemon):
    """The children are in groups of their own: the terminal's signal is the supervisor's alone."""
    assert os.getpgid(child(daemon, "bridge")) != os.getpgid(daemon.pid)
    daemon.send_signal(signal.SIGHUP)

    assert daemon.wait(PATIENCE_S) == 0
    assert torque(daemon.port) == [0] * 10
    assert "ended; torque off confirmed by all 10 servos" in log(daemon)


@pytest.mark.parametrize("command", [["stop"], ["limp", "--port"]])
def test_a_face_that_hears_nothing_at_all_is_let_go_by_force(daemon, command):
    """Supervisor and bridge are both stopped, as by a debugger: only somebody else can help."""
    bridge = child(daemon, "bridge")
    for pid in (daemon.pid, bridge):
        os.kill(pid, signal.SIGSTOP)
    done = run(*command, *([daemon.port] if command[-1] == "--port" else []), "--json")

    assert done.returncode == 0, done
    assert len(json.loads(done.stdout)["faces"][-1]["confirmed"]) == 10
    assert torque(daemon.port) == [0] * 10
    assert daemon.wait(PATIENCE_S) != 0
    wait_for(lambda: not alive(bridge))


def test_systemd_hears_that_a_face_with_servos_in_memory_is_up_and_goes_on_stopped(
    tmp_path, monkeypatch
):
    """The unit restarts what never says READY, and what is silent for 20 s."""
    own_folder(monkeypatch)
    with running(None, tmp_path, "--config", "face_jaw", "--listen", "none") as daemon:
        assert daemon.systemd.recv(100) == b"WATCHDOG=1"
        assert run("stop", "--control", str(daemon.control)).returncode == 0
        assert ask(daemon.control, "status", PATIENCE_S)["state"] == "stopped"
        daemon.systemd.setblocking(False)
        with contextlib.suppress(BlockingIOError):  # said before the stop
            while daemon.systemd.recv(100):
                pass
        daemon.systemd.settimeout(PATIENCE_S)

        assert daemon.systemd.recv(100) == b"WATCHDOG=1"
