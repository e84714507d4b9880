"""Where log lines of the program go: to people, to programs, and never in the way of a stop."""

import fcntl
import json
import logging
import os
import subprocess
import sys

import numpy as np
import pytest
import soundfile
from running_daemon import PATIENCE_S, all_driven, own_folder, run, running, wait_for

from firmware_bridge.process import logs
from firmware_bridge.process.control_client import ask
from lipservo.runtime.servos.sim_process import simulated_port

LIPSERVO = [sys.executable, "-m", "lipservo"]


@pytest.fixture
def sound(tmp_path):
    path = tmp_path / "line.wav"
    soundfile.write(path, 0.1 * np.sin(np.arange(8_000) / 20.0), 16_000)
    return path


def messages(stderr):
    return [json.loads(line)["message"] for line in stderr.splitlines()]


@pytest.mark.slow
def test_a_run_says_in_json_what_it_says_to_people(sound):
    plain = run("run", "--wav", sound)
    as_json = run("--log-json", "run", "--wav", sound)

    assert (plain.returncode, as_json.returncode) == (0, 0), as_json.stderr
    said = messages(as_json.stderr)
    assert any(line.startswith("delay from sound to face") for line in said)
    assert "stopped; the face is at rest and limp: confirmed by 10 servos" in said
    assert set(" ".join(said).split()) <= set(plain.stderr.split())


def test_a_complaint_is_json_too():
    done = run("--log-json", "run", "--wav", "no_such.wav")
    (line,) = map(json.loads, done.stderr.splitlines())

    assert done.returncode == 1
    assert (line["level"], line["logger"]) == ("error", "lipservo.messages")
    assert "no_such.wav: no such file" in line["message"]


@pytest.mark.slow
def test_in_detail_it_says_more_and_who_says_it(sound):
    plain, detailed = run("run", "--wav", sound), run("-v", "run", "--wav", sound)

    assert "armed" not in plain.stderr
    assert "DEBUG firmware_bridge.loop.life_cycle: armed: {'holds': ['jaw', " in detailed.stderr
    assert "INFO firmware_bridge.loop.life_cycle: stopped; the face is" in detailed.stderr


@pytest.mark.parametrize("option", ["-v", "--verbose", "--log-json"])
@pytest.mark.parametrize("command", ["run", "status"])
def test_an_option_of_the_program_after_its_command_says_where_it_goes(command, option):
    done = run(command, option)

    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert f"{option}: goes before the command: `lipservo {option} {command}`" in line


def test_help_names_the_options_and_a_quiet_run_stays_quiet(sound):
    help_text = run("--help").stdout

    assert all(option in help_text for option in ("--verbose", "-v", "--log-json"))
    assert run("run", "--wav", sound, "--quiet").stderr == ""


def test_our_packages_are_silent_in_a_program_that_sets_up_no_logging():
    script = "import logging, {0}; logging.getLogger('{0}.x').error('not to be seen')"
    for package in ("firmware_bridge", "lipsync"):
        done = subprocess.run(
            [sys.executable, "-c", script.format(package)], capture_output=True, text=True
        )
        assert (done.returncode, done.stderr) == (0, "")


def test_other_peoples_loggers_keep_to_warnings_and_their_handlers_stay():
    root, foreign = logging.getLogger(), logging.NullHandler()
    root.addHandler(foreign)
    logs.set_up()
    logs.set_up()
    n_handlers = len(root.handlers)
    with logs.face_logs("tom"):
        assert logging.getLogger("lipsync.audio").isEnabledFor(logging.INFO)
        assert not logging.getLogger("uvicorn.error").isEnabledFor(logging.INFO)
        assert foreign in root.handlers
        assert len(root.handlers) == n_handlers
    assert not logging.getLogger("lipsync.audio").isEnabledFor(logging.INFO)
    with logs.face_logs("tom", quiet=True):
        assert not logging.getLogger("lipsync.audio").isEnabledFor(logging.WARNING)
        assert logging.getLogger("lipsync.audio").isEnabledFor(logging.ERROR)
    assert len(root.handlers) == n_handlers
    root.removeHandler(foreign)


def test_a_replay_says_nothing_of_the_life_of_its_servos_and_all_of_what_went_wrong(sound):
    whole = sound.read_bytes()
    sound.write_bytes(whole[: len(whole) * 3 // 4])
    done = run("replay", sound, "--quiet")

    assert done.returncode == 0
    (line,) = done.stderr.splitlines()
    assert "cut short: its header promises 0.50 s, the file holds 0.37 s" in line


@pytest.fixture
def full_pipe():
    """A pipe that has no room left, and that nobody reads."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, 4_096)
    try:
        while True:
            os.write(writing, b"x" * 512)
    except BlockingIOError:
        os.set_blocking(writing, True)
    yield writing
    os.close(writing)
    os.close(reading)


@pytest.mark.slow
def test_a_full_pipe_holds_up_no_tick_no_stop_and_no_heartbeat(tmp_path, monkeypatch, full_pipe):
    """Every process of the face logs, in detail; none of it can be written."""
    own_folder(monkeypatch)
    monkeypatch.setenv(logs.VERBOSE, "1")
    with (
        simulated_port(["--config", "face_sim", "--on-time"]) as port,
        running(port, tmp_path, errors=full_pipe) as face,
    ):
        wait_for(lambda: all_driven(face))
        first = ask(face.control, "status", PATIENCE_S)
        wait_for(
            lambda: ask(face.control, "status", PATIENCE_S)["n_ticks"] > first["n_ticks"] + 200
        )
        stopped, started = run("stop"), run("start")
        wait_for(lambda: all_driven(face))

        assert ask(face.control, "status", PATIENCE_S)["bridge_pid"] != 0
        assert "at rest and limp, confirmed by all 10 servos" in stopped.stdout
        assert started.returncode == 0, started.stderr
        face.terminate()
        assert face.wait(PATIENCE_S) == 0
