"""Faces in this process for commands beside them: one that plays silence, and one that answers."""

import json
import os
import threading
import time
from contextlib import contextmanager

from typer.testing import CliRunner

from firmware_bridge.clock import MonotonicClock
from firmware_bridge.process.commands import CommandQueue
from firmware_bridge.process.control_socket import ControlSocket
from firmware_bridge.process.runtime_folder import runtime_folder
from firmware_bridge.stopping import StopLevel
from lipservo.cli import app
from lipservo.runtime.face_runtime import run_face
from lipservo.runtime.run_request import SILENCE, RunRequest
from lipservo.runtime.sound import open_sound

PATIENCE_S = 60.0
HELD = {"holds": ["jaw"], "limp": ["left"], "unknown": []}
SERVOS = {
    "servos": {"jaw": "driven", "left": "cooling"},
    "torque": {"jaw": {"on": True, "age_s": 0.0}, "left": {"on": None, "age_s": 0.7}},
    "troubles": [],
}


def invoke(*arguments):
    return CliRunner().invoke(app, list(arguments))


def status():
    (face,) = json.loads(invoke("status", "--json").stdout)["faces"]
    return face


@contextmanager
def playing(config="face_jaw", **options):
    """A face that hears silence in this process, until the block ends; then, what came of it."""
    outcomes, request = [], RunRequest(config, SILENCE, quiet=True, **options)

    def play():
        with open_sound(SILENCE) as source:
            outcomes.append(run_face(request, source, MonotonicClock(), endless=True))

    thread = threading.Thread(target=play)
    thread.start()
    give_up_s = time.monotonic() + PATIENCE_S
    while not json.loads(invoke("status", "--json").stdout)["faces"]:
        assert time.monotonic() < give_up_s
        time.sleep(0.05)
    try:
        yield outcomes
    finally:
        invoke("stop", "--end")
        thread.join(PATIENCE_S)


@contextmanager
def listening(name, *, unconfirmed=None, status=SERVOS, held=HELD, settings=None):
    """A face that answers and ends when told, without servos; the levels of its stops."""
    over, heard = threading.Event(), []
    about = {"name": name, "port": f"/dev/{name}"}

    def loop(control):
        while not over.wait(0.001):
            request = control.poll()
            control.answer(lambda: status, lambda: held)
            if request is not None:
                heard.append(request.level)
                if request.level is not StopLevel.FREEZE:
                    report = {"confirmed": ["jaw"], "unconfirmed": dict(unconfirmed or {})}
                    control.report_end(report)

    path = runtime_folder() / f"{name}-{os.getpid()}.sock"
    with ControlSocket(path, about, CommandQueue(settings)) as control:
        control.attend(lambda _order: "")
        thread = threading.Thread(target=loop, args=(control,))
        thread.start()
        try:
            yield heard
        finally:
            over.set()
            thread.join()
