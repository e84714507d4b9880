"""The dashboard beside a face: started once the face listens, again when it dies, and ended."""

import os
import signal
import sys
import time

import pytest
from places import short_folder

from lipservo.dashboard import child
from lipservo.dashboard.child import bound_dashboard, dashboard_child


@pytest.fixture
def program(tmp_path, monkeypatch):
    """In place of Python with the dashboard: writes down how it was called, and lives on."""
    started = tmp_path / "started"
    script = tmp_path / "program"
    script.write_text(f'#!/bin/sh\necho "$$ $@" >> {started}\nexec sleep 60\n')
    script.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(script))
    monkeypatch.setattr(child, "_RESTART_S", 0.1)
    return started


def starts(started):
    return started.read_text().splitlines() if started.exists() else []


def is_alive(pid):
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def wait_for(condition):
    give_up_s = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < give_up_s, "nothing happened"
        time.sleep(0.02)


def test_it_comes_with_the_face_comes_again_and_goes_with_it(program, caplog):
    control = short_folder() / "tom.sock"
    with bound_dashboard("127.0.0.1:0", None) as listener:
        with dashboard_child(control, listener, "token.txt", open_page=True):
            time.sleep(0.5)
            assert starts(program) == []  # nobody listens yet
            control.touch()
            wait_for(lambda: len(starts(program)) == 1)
            pid, told = starts(program)[0].split(" ", 1)
            assert told.startswith(f"-P -m lipservo dashboard --control {control}")
            assert f"--listener {listener.fileno()}" in told
            assert "--token-file token.txt" in told
            assert told.endswith("--open")

            assert "--open-to-this-computer" not in told
            kill(pid)
            wait_for(lambda: len(starts(program)) == 2)
            assert "--open" not in starts(program)[1]
            assert len(caplog.messages) == 1
            last = starts(program)[1].split()[0]
            assert is_alive(last)
        wait_for(lambda: not is_alive(last))


def test_without_a_token_it_is_open_to_this_computer_because_its_face_is(program):
    control = short_folder() / "tom.sock"
    control.touch()
    with bound_dashboard("127.0.0.1:0", None) as listener, dashboard_child(control, listener):
        wait_for(lambda: len(starts(program)) == 1)
        assert "--open-to-this-computer" in starts(program)[0]
        assert "--token-file" not in starts(program)[0]


def test_one_that_cannot_be_started_disturbs_nobody(monkeypatch, caplog):
    monkeypatch.setattr(sys, "executable", "/no/such/program")
    control = short_folder() / "tom.sock"
    control.touch()
    with bound_dashboard("127.0.0.1:0", None) as listener, dashboard_child(control, listener):
        wait_for(lambda: caplog.messages)
    assert "cannot be started" in caplog.messages[0]


def kill(pid):

    os.kill(int(pid), signal.SIGKILL)
