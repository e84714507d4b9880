"""`stop`, `status` and `limp` as a person types them: no face, one, two, and a port without any."""

import json
import os
import socket
import threading
from contextlib import ExitStack, contextmanager

import pytest
from places import short_folder
from typer.testing import CliRunner

from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.dynamixel.wire.serial_transport import open_port
from firmware_bridge.process.control_socket import ControlSocket
from firmware_bridge.process.runtime_folder import runtime_folder
from firmware_bridge.stopping import StopLevel
from lipservo.cli import app
from lipservo.face.sim_process import simulated_port
from lipsync.errors import UserError

RUNTIME = "firmware_bridge.process.runtime_folder"


@pytest.fixture(autouse=True)
def own_folder(monkeypatch):
    """Faces of this test only."""
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    session = short_folder()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(session))
    monkeypatch.setattr(f"{RUNTIME}.SERVICE_FOLDER", session / "none")
    monkeypatch.setattr(f"{RUNTIME}._folders_of_others", lambda: iter(()))
    return session


@contextmanager
def face(name, unconfirmed=None):
    """A face that listens and ends when told; no servos behind it."""
    over = threading.Event()
    path = runtime_folder() / f"{name}-{os.getpid()}.sock"
    heard = []

    def loop(control):
        while not over.wait(0.001):
            request = control.poll()
            control.answer(lambda: {"servos": {"jaw": "driven", "left": "cooling"}, "troubles": []})
            if request is not None:
                heard.append(request.level)
                if request.level is not StopLevel.FREEZE:
                    control.report_end(
                        {"confirmed": ["jaw"], "unconfirmed": dict(unconfirmed or {})}
                    )

    with ControlSocket.bind(path, {"name": name, "port": f"/dev/{name}"}) as control:
        thread = threading.Thread(target=loop, args=(control,))
        thread.start()
        try:
            yield heard
        finally:
            over.set()
            thread.join()


def invoke(*arguments):
    return CliRunner().invoke(app, list(arguments))


def faces(result):
    return json.loads(result.stdout)["faces"]


def test_without_a_face_stop_says_so_and_status_lists_none():
    done = invoke("stop")

    assert done.exit_code == 1
    assert isinstance(done.exception, UserError)
    assert "is a face running?" in str(done.exception)
    assert faces(invoke("status", "--json")) == []
    assert isinstance(invoke("limp").exception, UserError)


@pytest.mark.parametrize(
    ("options", "level"),
    [([], StopLevel.SOFT), (["--limp"], StopLevel.LIMP), (["--freeze"], StopLevel.FREEZE)],
)
def test_stop_without_a_name_stops_all_and_with_one_only_that(options, level):
    with ExitStack() as stack:
        tim, tom = stack.enter_context(face("tim")), stack.enter_context(face("tom"))
        listed = faces(invoke("status", "--json"))
        one = invoke("stop", *options, "--face", "tim", "--json")
        both = invoke("stop", *options)
        unknown = invoke("stop", "--face", "tam")

    assert [(each["name"], each["port"]) for each in listed] == [
        ("tim", "/dev/tim"),
        ("tom", "/dev/tom"),
    ]
    assert [each["name"] for each in faces(one)] == ["tim"]
    assert (one.exit_code, both.exit_code) == (0, 0)
    assert (tim, tom) == ([level, level], [level])
    assert "running: tim, tom" in str(unknown.exception)


def test_a_servo_that_did_not_confirm_is_named_and_the_exit_status_says_it():
    with face("tom", unconfirmed={"left": "did not answer"}):
        done = invoke("stop")

    assert done.exit_code == 1
    assert "NOT by left: did not answer" in done.stdout


def test_status_shows_servos_and_no_dead_faces(own_folder):
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as dead, face("tom"):
        dead.bind(str(own_folder / "lipservo" / "tim-1.sock"))
        dead.close()
        shown = invoke("status").stdout

    assert shown.startswith("tom ")
    assert "1 of 2 servos driven" in shown
    assert "tim" not in shown


@pytest.fixture(scope="module")
def port():
    arguments = ["--servos", "3", "--first-id", "5", "--baud-rate", "2000000", "--on-time"]
    with simulated_port(arguments) as port:
        yield port


def test_limp_lets_go_of_whatever_hangs_on_a_port_at_any_rate(port):
    """No face, no configuration: as after `kill -9` of somebody else's program."""
    transport = open_port(port, 2_000_000)
    line = Line(transport)
    for each in (5, 6, 7):
        line.write(each, 64, b"\1")
    transport.close()
    done = invoke("limp", "--port", port, "--json")
    transport = open_port(port, 2_000_000)
    line = Line(transport)
    torque = [line.read(each, 64, 1).data for each in (5, 6, 7)]
    transport.close()

    assert done.exit_code == 0, done.output
    assert faces(done)[0]["confirmed"] == ["id 5", "id 6", "id 7"]
    assert torque == [b"\0"] * 3


def test_limp_of_a_face_whose_servos_are_not_there_names_each_and_fails(port):
    done = invoke("limp", "--port", port, "--config", "face_jaw", "--json")

    assert done.exit_code == 1
    assert set(faces(done)[0]["unconfirmed"].values()) == {"did not answer"}


def test_limp_leaves_the_faces_at_other_ports_alone(port):
    with face("tom") as heard:
        invoke("limp", "--port", port)

    assert heard == []


def test_a_service_that_has_ended_leaves_a_port_that_somebody_holds_alone(port):
    transport = open_port(port, 2_000_000)
    line = Line(transport)
    line.write(5, 64, b"\1")
    done = invoke("limp", "--unless-held", "--port", os.path.relpath(port))
    held = line.read(5, 64, 1).data
    transport.close()

    assert done.exit_code == 0
    assert held == b"\1"


def test_limp_at_a_port_that_is_not_there_is_one_line():
    done = invoke("limp", "--port", "/dev/no_such_port")

    assert done.exit_code == 1
    assert "/dev/no_such_port: no such port" in done.stdout
