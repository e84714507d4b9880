"""Lips on a Maestro and a neck of Dynamixels driven by real processes: what both wires say.

Judged by the simulator's own log of pulses, and by the torque registers that another program reads.
"""

import contextlib
import json
import os
import signal
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from places import ROOT
from running_daemon import (
    PATIENCE_S,
    alive,
    all_driven,
    child,
    own_folder,
    run,
    running,
    torque,
    wait_for,
)

from firmware_bridge.process.control_client import ask
from firmware_bridge.process.port_holders import with_children
from lipservo.runtime.servos.sim_process import simulated_port

# Real processes in real time.
pytestmark = pytest.mark.slow

CLIP = str(ROOT / "lipservo" / "clips" / "welcome.flac")
FACE = "face_head_mixed"
NECK_IDS = (21, 22, 23)
WORDS = "pulses off; a digital servo may hold"


@contextlib.contextmanager
def two_ports(folder):
    """Both simulators, each behind a link; `plug(name)` plugs one in anew, once `plugs` let it go.

    plugs: what is closed to pull one, by the name of its bus.
    """
    log, names = folder / "pulses.jsonl", ("lips", "neck")
    with contextlib.ExitStack() as stack:
        plugs = {name: stack.enter_context(contextlib.ExitStack()) for name in names}

        def plug(name):
            arguments = ["--config", FACE, "--bus", name, "--link", str(folder / name)]
            if name == "lips":
                arguments += ["--log", str(log)]
            plugs[name].enter_context(simulated_port(arguments))

        ports = {name: str(folder / name) for name in names}
        for name in names:
            plug(name)
        text = ",".join(f"{name}={port}" for name, port in ports.items())
        yield SimpleNamespace(**ports, text=text, log=log, folder=folder, plug=plug, plugs=plugs)


@pytest.fixture
def head(tmp_path, monkeypatch):
    own_folder(monkeypatch)
    with two_ports(tmp_path) as head:
        yield head


def lips_are_off(head):
    sent = {}
    for line in head.log.read_text().splitlines():
        _, channel, pulse_us, *_ = json.loads(line)
        sent[channel] = pulse_us
    return bool(sent) and not any(sent.values())


def neck_torque(head):
    return torque(head.neck, NECK_IDS)


def is_let_go(head):
    return lips_are_off(head) and neck_torque(head) == [0, 0, 0]


def status(daemon):
    return ask(daemon.control, "status", PATIENCE_S)


@contextlib.contextmanager
def driven(head, *arguments):
    with running(head.text, head.folder, "--config", FACE, "--wav", CLIP, *arguments) as daemon:
        wait_for(lambda: all_driven(daemon) and not lips_are_off(head))
        yield daemon


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_after_a_signal_both_buses_are_let_go(head, number):
    with driven(head) as daemon:
        assert status(daemon)["port"] == head.text
        daemon.send_signal(number)
        assert daemon.wait(PATIENCE_S) == 0
    said = daemon.said.read_text()

    assert is_let_go(head)
    assert f"10 servos let go, not confirmed: {WORDS}; torque off confirmed by 3 servos" in said
    assert f"lips: stop --limp: {WORDS}, which no servo confirms" in said


def test_a_bridge_that_is_shot_has_both_buses_let_go_and_comes_back(head):
    with driven(head) as daemon:
        os.kill(child(daemon, "bridge"), signal.SIGKILL)
        wait_for(lambda: lips_are_off(head))
        wait_for(lambda: all_driven(daemon) and not lips_are_off(head))
        assert "torque off confirmed by 3 servos" in daemon.said.read_text()
    assert is_let_go(head)


def test_a_supervisor_that_is_shot_leaves_both_buses_let_go(head):
    with driven(head) as daemon:
        bridge = child(daemon, "bridge")
        daemon.kill()
        wait_for(lambda: not alive(bridge))
    assert is_let_go(head)


def shoot_all(daemon, *others):
    pids = [daemon.pid, child(daemon, "bridge"), child(daemon, "speech"), *others]
    for number in (signal.SIGSTOP, signal.SIGKILL):
        for pid in pids:
            os.kill(pid, number)
    daemon.wait(PATIENCE_S)


def guards_of(daemon):
    """One at each port."""
    children = [pid for pid in with_children([daemon.pid]) if pid != daemon.pid]
    return [
        pid for pid in children if b"lipservo-guard" in Path(f"/proc/{pid}/cmdline").read_bytes()
    ]


def test_when_all_are_shot_their_guards_let_both_buses_go(head):
    with driven(head) as daemon:
        guards = guards_of(daemon)
        shoot_all(daemon)
        wait_for(lambda: not any(alive(pid) for pid in guards))
        assert "torque off confirmed by all 3 servos" in daemon.said.read_text()
    assert is_let_go(head)


def test_when_even_the_guards_are_shot_limp_ends_it_at_both_ports(head):
    with driven(head) as daemon:
        shoot_all(daemon, *guards_of(daemon))
    assert not lips_are_off(head)
    assert neck_torque(head) == [1, 1, 1]

    done = run("limp", "--port", f"neck={head.neck}", "--port", f"lips={head.lips}")

    assert done.returncode == 0, done.stdout + done.stderr
    assert WORDS in done.stdout
    assert "confirmed by 3 servos" in done.stdout
    assert is_let_go(head)


def test_a_stopped_face_says_of_each_servo_what_its_bus_can_know(head):
    with driven(head) as daemon:
        done = run("stop", "--limp")
        assert done.returncode == 0, done.stdout + done.stderr
        report = status(daemon)["stop_report"]
        assert sorted(report["confirmed"]) == ["neck_pitch", "neck_roll", "neck_yaw"]
        assert len(report["released"]) == 10
        assert f"{WORDS}; limp, confirmed by 3 servos" in run("status").stdout
        assert is_stopped_on_the_wire(head)
        assert run("start").returncode == 0
        wait_for(lambda: all_driven(daemon))
    assert is_let_go(head)


def is_stopped_on_the_wire(head):
    time.sleep(0.2)
    return lips_are_off(head)


@pytest.mark.parametrize("lost", ["lips", "neck"])
def test_a_plug_that_is_pulled_lets_go_of_the_other_bus_and_all_come_back(head, lost):
    with driven(head) as daemon:
        head.plugs[lost].close()
        wait_for(lambda: "port of the servos is gone" in daemon.said.read_text())
        if lost == "neck":
            wait_for(lambda: lips_are_off(head))
        head.plug(lost)
        wait_for(lambda: "the port is back" in daemon.said.read_text())
        wait_for(lambda: all_driven(daemon) and not lips_are_off(head))
        assert f"bus {lost}: " in daemon.said.read_text()


@pytest.mark.parametrize("hung", ["neck", "lips"])
def test_a_stop_while_one_controller_hangs_lets_the_other_go(tmp_path, monkeypatch, hung):
    """What hangs is the far end of a wire; the neck is missed at once, a Maestro never answers."""
    own_folder(monkeypatch)
    with two_ports(tmp_path) as head, driven(head) as daemon:
        pids = holders_of_link(getattr(head, hung))
        assert pids
        try:
            for pid in pids:
                os.kill(pid, signal.SIGSTOP)
            done = run("stop", "--limp")
            if hung == "neck":
                assert done.returncode == 1
                assert "neck_yaw" in done.stdout + " ".join(status(daemon)["troubles"])
                assert lips_are_off(head)
            else:
                # Nothing is said of servos whose Maestro says nothing.
                assert done.returncode == 1
                assert "no Maestro answers" in done.stdout or "NOT by jaw" in done.stdout
                health = {each["name"]: each["torque_on"] for each in status(daemon)["health"]}
                assert not any(on for name, on in health.items() if name.startswith("neck"))
        finally:
            for pid in pids:
                os.kill(pid, signal.SIGCONT)
        wait_for(lambda: (status(daemon).get("stop_report") or {}).get("complete"))
        daemon.send_signal(signal.SIGTERM)
        daemon.wait(PATIENCE_S)
        assert is_let_go(head)


def holders_of_link(link):
    """The simulators that were started with a link."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            with contextlib.suppress(OSError):
                words = (entry / "cmdline").read_bytes().decode().split("\0")
                if "sim-bus" in words and link in words:
                    found.append(int(entry.name))
    return found


def test_one_port_for_a_face_with_two_is_refused_with_what_to_say(head):
    done = run("run", "--config", FACE, "--port", head.neck)

    assert done.returncode == 1
    assert "has several buses; write each as --port lips=PORT --port neck=PORT" in done.stderr


def test_the_doctor_examines_each_bus(head):
    done = run("doctor", "--config", FACE, "--port", f"lips={head.lips}", "--port",
               f"neck={head.neck}")  # fmt: skip

    assert "lips: a Maestro answers at" in done.stdout
    assert "neck: " in done.stdout
