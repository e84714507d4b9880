"""`servo` as a person types it, beside a face that plays in this process."""

import json
import threading
import time
from contextlib import contextmanager

import pytest
from places import short_folder
from typer.testing import CliRunner

from firmware_bridge.clock import MonotonicClock
from lipservo.cli import app
from lipservo.runtime.face_runtime import run_face
from lipservo.runtime.motion_options import MotionOptions
from lipservo.runtime.run_request import SILENCE, RunRequest
from lipservo.runtime.sound import open_sound
from lipsync.errors import UserError

PATIENCE_S = 60.0


@pytest.fixture(autouse=True)
def own_folder(monkeypatch):
    """Faces of this test only."""
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    session = short_folder()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(session))
    monkeypatch.setattr(
        "firmware_bridge.process.runtime_folder._folders_of_others", lambda: iter(())
    )


def invoke(*arguments):
    return CliRunner().invoke(app, list(arguments))


def status():
    (face,) = json.loads(invoke("status", "--json").stdout)["faces"]
    return face


@contextmanager
def playing(**options):
    """A face with simulated servos that hears silence in this process, until the block ends."""
    request = RunRequest("face_jaw", SILENCE, MotionOptions(), quiet=True, **options)

    def play():
        with open_sound(SILENCE) as source:
            run_face(request, source, MonotonicClock(), endless=True)

    thread = threading.Thread(target=play)
    thread.start()
    give_up_s = time.monotonic() + PATIENCE_S
    while not json.loads(invoke("status", "--json").stdout)["faces"]:
        assert time.monotonic() < give_up_s
        time.sleep(0.05)
    try:
        yield
    finally:
        invoke("stop", "--end")
        thread.join(PATIENCE_S)


def test_a_servo_is_switched_off_and_on_and_restarted_and_the_status_tells_it():
    with playing():
        early = invoke("servo", "jaw", "reboot")
        off = invoke("servo", "jaw", "off")
        (told,) = [status()]
        rebooted = invoke("servo", "jaw", "reboot", "--json")
        on = invoke("servo", "jaw", "on")
        after = status()
        unknown = invoke("servo", "nose", "off")

    assert early.exit_code == 1
    assert "is driven; switch it off first" in early.stderr
    assert (off.exit_code, on.exit_code, rebooted.exit_code) == (0, 0, 0)
    assert "servo jaw is off" in off.stdout
    assert told["servos"] == {"jaw": "off"}
    of_servos = [each for each in told["troubles"] if each.startswith("servo")]
    assert of_servos == ["servo 'jaw' (id 11) switched off by a person"]
    assert told["torque_on"] is False
    (answer,) = json.loads(rebooted.stdout)["faces"]
    assert (answer["servo"], answer["asked"], answer["state"]) == ("jaw", "reboot", "off")
    assert after["servos"] == {"jaw": "driven"}
    (health,) = after["health"]
    assert (health["name"], health["state"], health["n_reboots"]) == ("jaw", "driven", 1)
    assert health["current_ma"] == 0.0
    assert after["jogged"] == []
    assert "no such servo; there are: jaw" in unknown.stderr


def test_in_a_dry_run_it_is_refused():
    with playing(dry_run=True):
        done = invoke("servo", "jaw", "off")

    assert done.exit_code == 1
    assert "dry run: servos are only read" in done.stderr


def test_without_a_face_it_says_so():
    assert isinstance(invoke("servo", "jaw", "off").exception, UserError)
