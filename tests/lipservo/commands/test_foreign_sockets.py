"""What a person is shown of a socket that somebody else has made, whatever it answers."""

import contextlib
import json
import socket
import threading

import pytest
from typer.testing import CliRunner

from firmware_bridge.process.control_client import ask, face_at
from firmware_bridge.process.runtime_folder import ControlError, runtime_folder
from lipservo.cli import app

PATIENCE_S = 60.0
#: The title of a terminal, a cleared screen, and text from right to left.
ESCAPES = "\x1b]0;owned\x07\x9b2J\r\n\u202egnirts"


pytestmark = pytest.mark.usefixtures("own_folder")


@contextlib.contextmanager
def foreign(raw, name="tim-1.sock"):
    """A socket that answers every message with these bytes, and again; its path."""
    path = runtime_folder() / name
    over = threading.Event()

    def answer():
        while not over.is_set():
            try:
                client, _ = listening.accept()
            except TimeoutError:
                continue
            with client, contextlib.suppress(ConnectionError):
                client.settimeout(PATIENCE_S)
                while client.recv(1 << 16):
                    client.send(raw)
                    client.send(raw)

    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listening:
        listening.bind(str(path))
        listening.listen()
        listening.settimeout(0.05)
        thread = threading.Thread(target=answer)
        thread.start()
        try:
            yield path
        finally:
            over.set()
            thread.join()


@pytest.mark.parametrize(
    "words",
    [("status",), ("start",), ("stop",), ("set", "strength", "1"), ("servo", "jaw", "off")],
)
def test_what_a_socket_answers_is_shown_without_control_characters(words):
    listed, named = [ESCAPES], {ESCAPES: ESCAPES}
    said = {"state": ESCAPES, "port": ESCAPES, "troubles": listed, "error": ESCAPES}
    said |= {"confirmed": listed, "unconfirmed": named, "servos": named, ESCAPES: named}
    with foreign(json.dumps(said).encode()):
        done = CliRunner().invoke(app, list(words))

    shown = done.stdout + done.stderr
    assert "gnirts" in shown
    assert all(line.isprintable() for line in shown.split("\n"))


NO_ANSWERS = [b"[1]", b"no JSON", b"\xff", b"[" * 100_000, b'{"a":' * 20_000, b"1" * 9999]


@pytest.mark.parametrize("raw", NO_ANSWERS, ids=range(len(NO_ANSWERS)))
def test_what_is_no_answer_of_a_face_is_said_to_be_none(raw):
    with (
        foreign(raw) as path,
        pytest.raises(OSError, match="the program that answers there is not a face"),
    ):
        ask(path, "status", PATIENCE_S)
    with foreign(raw, "tom-1.sock"):
        done = CliRunner().invoke(app, ["set", "strength", "1"])

    assert done.exit_code == 1
    assert "tom: the program that answers there is not a face" in done.stderr


@pytest.mark.parametrize("name", ["\x1b[31m-1.sock", "tim\n-1.sock", "tím-1.sock", ".tim-1.sock"])
def test_a_socket_by_a_name_that_no_face_gives_it_is_no_face(name):
    with foreign(b"{}", name):
        done = CliRunner().invoke(app, ["status", "--json"])

    assert json.loads(done.stdout) == {"faces": []}


def test_the_name_of_a_socket_that_a_person_names_is_shown_as_a_terminal_may_show_it():
    with foreign(b"{}", "\x1b[31mred.sock") as path:
        assert face_at(path).name == "?[31mred"
    with pytest.raises(ControlError, match=r"/\?\[31mred\.sock: no face answers there"):
        face_at(path)
