"""A daemon plays performances of its folder: by clients and by the command, and is cut off."""

import contextlib
import json
import os
import signal
import subprocess

import pytest
from lipservo_client.protocol import FaceError
from running_daemon import (
    LIPSERVO,
    PATIENCE_S,
    all_driven,
    child,
    own_folder,
    run,
    running,
    torque,
    wait_for,
)
from written_performance import written_performance

import lipservo
from firmware_bridge.process.control_client import ask
from lipservo.runtime.servos.sim_process import simulated_port


@contextlib.contextmanager
def daemon(folder):
    """A `lipservo daemon` in one process, with the simulated face; its address."""
    arguments = ["--listen", "127.0.0.1:0", "--sounds", folder]
    with (folder / "said.txt").open("w") as log:
        process = subprocess.Popen([*LIPSERVO, "daemon", *arguments], stdout=log, stderr=log)
        try:
            wait_for(lambda: process.poll() is not None or "ws://" in said(folder))
            yield process, "ws://" + said(folder).split("ws://")[1].split()[0]
        finally:
            process.terminate()
            process.wait(PATIENCE_S)


def said(folder):
    return (folder / "said.txt").read_text()


def refusal(face, file, code="refused"):
    with pytest.raises(FaceError) as raised:
        face.play(file)
    assert raised.value.code == code
    assert "\n" not in str(raised.value)
    return str(raised.value)


@pytest.mark.slow
def test_performances_are_played_by_name_refused_in_one_line_and_cut_off(tmp_path, monkeypatch):
    own_folder(monkeypatch)
    short = written_performance(tmp_path / "short.perf", 0.3)
    written_performance(tmp_path / "long.perf", 60.0)
    written_performance(tmp_path / "other.perf", 0.3, face_checksum="another")
    written_performance(tmp_path / "apart.perf", 0.3, included=False)
    (tmp_path / "apart.wav").unlink()
    (tmp_path / "cut.perf").write_bytes(short.read_bytes()[:-300])
    with daemon(tmp_path) as (process, url), lipservo.connect(url) as face:
        assert "rendered for face model another" in refusal(face, "other.perf")
        assert "its sound" in refusal(face, "apart.perf")
        assert "damaged" in refusal(face, "cut.perf")
        assert "cannot be read" in refusal(face, "none.perf")
        assert "outside the folder" in refusal(face, "../none.perf")
        assert face.status()["speaking"] is None

        short = face.play("short.perf", wait=True)
        assert (short["finished"], short["duration_s"]) == (True, 0.3)
        assert short["stream"].startswith("short.perf #")
        assert face.play("long.perf")["duration_s"] == 60.0  # waits for its turn
        wait_for(lambda: str(face.status()["speaking"]).startswith("long.perf"))
        with pytest.raises(FaceError) as busy, face.stream(playback="client"):
            pass
        assert busy.value.code == "busy"
        face.interrupt()
        wait_for(lambda: face.status()["speaking"] is None)

        done = run("lines", "perform", "short.perf", "--through", url, "--json")
        told = json.loads(done.stdout)
        assert told["stream"].startswith("short.perf")
        assert (told["finished"], told["duration_s"], done.returncode) == (True, 0.3, 0)
        face.play("long.perf")
        done = run("lines", "perform", "none.perf", "--through", url)
        assert done.returncode != 0
        assert len(done.stderr.splitlines()) == 1
        for _ in range(7):
            face.play("long.perf")
        full = "8 texts, sounds or performances already wait"
        assert full in refusal(face, "short.perf", "too_many_streams")
        # In the middle of one: to rest and limp, as ever.
        assert face.status()["speaking"].startswith("long.perf")
        face.stop(end=True)
        assert process.wait(PATIENCE_S) == 0
    assert "at rest and limp: confirmed by 10 servos" in said(tmp_path)


@pytest.mark.slow
def test_a_daemon_at_a_port_that_performs_ends_limp_whatever_happens(tmp_path, monkeypatch):
    """Its speech process is shot in the middle, a second start is refused, then it is ended."""
    own_folder(monkeypatch)
    line = written_performance(tmp_path / "long.perf", 60.0)
    asked = ["--config", "face_sim", "--listen", "127.0.0.1:0", "--sounds", tmp_path]
    with (
        simulated_port(["--config", "face_sim", "--on-time"]) as port,
        running(port, tmp_path, *asked) as process,
    ):
        wait_for(lambda: all_driven(process))
        perform_and_wait(process)
        first = child(process, "speech")
        os.kill(first, signal.SIGKILL)
        wait_for(lambda: child(process, "speech") != first)
        wait_for(lambda: all_driven(process))
        # What it said is not taken up; it performs again when it is asked.
        wait_for(lambda: status(process).get("speaking") is None)
        perform_and_wait(process)
        second = run("lines", "perform", line, "--config", "face_sim", "--port", port, "--mute")
        assert second.returncode != 0
        assert "Traceback" not in second.stderr
        assert status(process)["speaking"].startswith("long.perf")
        process.send_signal(signal.SIGHUP)
        assert process.wait(PATIENCE_S) == 0
        assert torque(port) == [0] * 10


def status(process):
    try:
        return ask(process.control, "status", PATIENCE_S)
    except OSError:
        return {"speaking": "unknown"}


def perform_and_wait(process):
    """Ask until the agent server is there, and until it is said."""

    def asked():
        try:
            with lipservo.connect(status(process).get("listens_on") or "") as face:
                return bool(face.play("long.perf"))
        except FaceError:
            return False

    wait_for(asked)
    wait_for(lambda: str(status(process).get("speaking")).startswith("long.perf"))
