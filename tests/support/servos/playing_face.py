"""A face with simulated servos that plays silence in this process, for commands beside it."""

import json
import threading
import time
from contextlib import contextmanager

from typer.testing import CliRunner

from firmware_bridge.clock import MonotonicClock
from lipservo.cli import app
from lipservo.runtime.face_runtime import run_face
from lipservo.runtime.motion_options import MotionOptions
from lipservo.runtime.run_request import SILENCE, RunRequest
from lipservo.runtime.sound import open_sound

PATIENCE_S = 60.0


def invoke(*arguments):
    return CliRunner().invoke(app, list(arguments))


def status():
    (face,) = json.loads(invoke("status", "--json").stdout)["faces"]
    return face


@contextmanager
def playing(config="face_jaw", **options):
    """A face that hears silence in this process, until the block ends."""
    request = RunRequest(config, SILENCE, MotionOptions(), quiet=True, **options)

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
