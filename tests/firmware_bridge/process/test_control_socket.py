"""The socket of a running face: who answers, who is left alone, who may ask."""

import json
import multiprocessing
import os
import socket
import stat
import threading
from contextlib import contextmanager
from pathlib import Path

import pytest
from places import short_folder

from firmware_bridge.process.commands import CommandQueue, Setting
from firmware_bridge.process.control_client import (
    ask,
    change_setting,
    face_at,
    running_faces,
    stop_and_wait,
    watch,
)
from firmware_bridge.process.control_socket import ControlSocket
from firmware_bridge.process.port_holders import holders_of_socket
from firmware_bridge.process.runtime_folder import ControlError, runtime_folder, socket_path
from firmware_bridge.stopping import StopLevel, StopRequest

PATIENCE_S = 60.0
SOME_USER = 65534


@pytest.fixture(autouse=True)
def own_folder(monkeypatch):
    """Faces of this test only: nothing of the machine's is found or touched."""
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    session = short_folder()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(session))
    return session


@contextmanager
def served(control):
    """A face's loop in a thread: polls until a stop comes, then reports the end."""
    heard, over = [], threading.Event()

    def loop():
        while not over.wait(0.001):
            request = control.poll()
            control.answer(lambda: {"n_ticks": 7})
            if request is not None:
                heard.append(request.level)
                if request.level is not StopLevel.FREEZE:
                    control.report_end({"confirmed": ["jaw"], "unconfirmed": {}})
                    return

    thread = threading.Thread(target=loop)
    thread.start()
    try:
        yield heard
    finally:
        over.set()
        thread.join()


def test_a_face_answers_how_it_is_and_who_it_is(tmp_path):
    path = tmp_path / "face.sock"
    with ControlSocket(path, {"name": "tom", "port": "/dev/x"}) as control, served(control):
        assert ask(path, "status", PATIENCE_S) == {"n_ticks": 7, "name": "tom", "port": "/dev/x"}
        assert "error" in ask(path, "dance", PATIENCE_S)


def test_a_socket_is_named_as_the_kernel_lists_it(tmp_path):
    folder = short_folder()
    (tmp_path / "link").symlink_to(folder)
    with ControlSocket(tmp_path / "link" / "tom.sock") as control:
        assert control.path == folder / "tom.sock"
        assert str(control.path) in Path("/proc/net/unix").read_text()


def test_who_watches_may_read_what_the_face_writes_and_write_nothing(tmp_path):
    path = tmp_path / "face.sock"
    written = os.memfd_create("of the face")
    os.write(written, b"before")
    face = ControlSocket(path, {"name": "tom"}, watched_fd=written)
    with face as control, served(control):
        handed = watch(path, PATIENCE_S)
    os.pwrite(written, b"later!", 0)

    assert os.pread(handed, 6, 0) == b"later!"
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.write(handed, b"mine")
    os.close(handed)
    os.close(written)


def test_a_face_that_cannot_be_watched_says_so(tmp_path):
    path = tmp_path / "face.sock"
    with (
        ControlSocket(path) as control,
        served(control),
        pytest.raises(ControlError, match="cannot be watched"),
    ):
        watch(path, PATIENCE_S)


@pytest.mark.parametrize("level", [StopLevel.SOFT, StopLevel.LIMP])
def test_who_asks_for_a_stop_hears_that_it_is_accepted_and_how_it_ended(tmp_path, level):
    path = tmp_path / "face.sock"
    with ControlSocket(path) as control, served(control) as heard:
        answer, report = stop_and_wait(path, level, PATIENCE_S, PATIENCE_S)

    assert heard == [level]
    assert answer == {"accepted": level.value}
    assert report == {"ended": True, "confirmed": ["jaw"], "unconfirmed": {}}


@pytest.mark.parametrize(
    ("name", "value", "answer"),
    [
        ("strength", 0.5, {"set": "strength", "value": 0.5, "name": "tom"}),
        ("strength", 2.0, {"error": "strength is 2; allowed: 0 to 1.5"}),
        ("x", 1.0, {"error": "'x': no such setting; there are: strength (0 to 1.5)"}),
        ("two words", 1.0, {"error": "'two words': no such setting"}),
        ("x" * 5000, 1.0, {"error": f"'{'x' * 40}': no such setting"}),
    ],
)
def test_who_sets_something_hears_what_became_of_it(tmp_path, name, value, answer):
    path = tmp_path / "face.sock"
    commands = CommandQueue({"strength": Setting(1.0, 0.0, 1.5)})
    with ControlSocket(path, {"name": "tom"}, commands) as control, served(control) as heard:
        assert change_setting(path, name, value) == answer
        for broken in ("set", "set strength", "set strength much"):
            assert "error" in ask(path, broken, PATIENCE_S)

    assert commands.take_changes() == ({"strength": 0.5} if "set" in answer else {})
    assert heard == []


def test_a_stop_that_somebody_else_wrote_into_the_queue_comes_out_as_well(tmp_path):
    commands = CommandQueue()
    with ControlSocket(tmp_path / "face.sock", commands=commands) as control:
        commands.stop(StopLevel.LIMP, "an agent")

        assert control.poll() == StopRequest(StopLevel.LIMP, "an agent")
        assert control.poll() is None


def test_what_waits_in_the_socket_outlives_the_process_that_served_it(tmp_path):
    """A bridge dies with a stop unheard, and another with one accepted; the third ends the face."""
    path = tmp_path / "face.sock"
    with ControlSocket(path) as supervisor:
        with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as waiting:
            waiting.connect(str(path))
            waiting.send(b"limp")
            first = ControlSocket(path, listener_fd=os.dup(supervisor.fileno()))
            first.__exit__()
            with ControlSocket(path, listener_fd=os.dup(supervisor.fileno())) as second:
                assert second.poll().level is StopLevel.LIMP
                second.answer(dict)
            assert json.loads(waiting.recv(1000)) == {"accepted": "limp"}
            assert waiting.recv(1000) == b""  # gone without a report
        assert path.exists()
        with served(supervisor) as heard:
            _, report = stop_and_wait(path, StopLevel.LIMP, PATIENCE_S, PATIENCE_S)

    assert heard == [StopLevel.LIMP]
    assert report is not None
    assert report["confirmed"] == ["jaw"]


def test_a_client_whose_face_dies_in_between_asks_the_next_one(tmp_path):
    path = tmp_path / "face.sock"
    with ControlSocket(path) as supervisor:
        answers = []
        client = threading.Thread(
            target=lambda: answers.append(
                stop_and_wait(path, StopLevel.SOFT, PATIENCE_S, PATIENCE_S)
            )
        )
        client.start()
        with ControlSocket(path, listener_fd=os.dup(supervisor.fileno())) as bridge:
            while bridge.poll() is None:
                pass
            bridge.answer(dict)
        with served(supervisor) as heard:
            client.join(PATIENCE_S)

    assert heard == [StopLevel.SOFT]
    assert answers[0][1]["confirmed"] == ["jaw"]


def test_a_second_face_leaves_the_socket_of_the_first_alone(tmp_path):
    path = tmp_path / "face.sock"
    with ControlSocket(path) as control, served(control):
        with pytest.raises(ControlError, match="another face uses it"):
            ControlSocket(path)

        assert ask(path, "status", PATIENCE_S) == {"n_ticks": 7}
    assert not path.exists()


def test_a_dead_socket_makes_room_and_a_file_does_not(tmp_path):
    path, file = tmp_path / "face.sock", tmp_path / "sound.wav"
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as dead:
        dead.bind(str(path))
    file.write_text("mine")

    with ControlSocket(path):
        pass
    with pytest.raises(ControlError, match="is not a socket"):
        ControlSocket(file)
    assert file.read_text() == "mine"


def test_the_end_removes_its_own_socket_only(tmp_path):
    """Somebody has put another one in its place."""
    path = tmp_path / "face.sock"
    with ControlSocket(path):
        path.unlink()
        other = ControlSocket(path)

    assert path.exists()
    other.__exit__()
    assert not path.exists()


def test_owner_and_group_may_connect_and_nobody_else(tmp_path):
    path = tmp_path / "face.sock"
    with ControlSocket(path):
        assert stat.S_IMODE(path.stat().st_mode) == 0o660


@pytest.mark.parametrize(
    "name", ["x" * 120 + ".sock", "no/such/folder/face.sock"], ids=["too long", "no folder"]
)
def test_an_impossible_place_is_one_line(tmp_path, name):
    with pytest.raises(ControlError) as raised:
        ControlSocket(tmp_path / name)

    assert str(tmp_path) in str(raised.value)
    assert "\n" not in str(raised.value)
    with pytest.raises(ControlError, match="is a face running"):
        face_at(tmp_path / name)


def test_clients_that_say_nothing_do_not_shut_others_out(tmp_path):
    path = tmp_path / "face.sock"
    with ControlSocket(path) as control, served(control):
        idle = [socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in range(60)]
        for each in idle:
            each.connect(str(path))

        assert ask(path, "status", PATIENCE_S) == {"n_ticks": 7}
        for each in idle:
            each.close()


def test_running_faces_are_found_by_name_and_dead_ones_are_cleared_away(own_folder):
    path = socket_path("my face/1")
    assert path.parent == own_folder / "lipservo"
    stale = path.with_name("old-123.sock")
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as dead:
        dead.bind(str(stale))
    with ControlSocket(path) as control, served(control):
        ours = [each for each in running_faces() if each.path.parent == path.parent]

    assert [(each.name, each.pid) for each in ours] == [("my_face_1", os.getpid())]
    assert not stale.exists()


def test_without_a_session_the_folder_is_ours_alone_or_refused(tmp_path, monkeypatch):
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    folder = runtime_folder()

    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    folder.chmod(0o777)
    with pytest.raises(ControlError, match="only you may write"):
        runtime_folder()
    folder.rmdir()
    folder.symlink_to(tmp_path)
    with pytest.raises(ControlError, match="only you may write"):
        runtime_folder()


def ask_as(user, path, answers):
    """In a process of its own: as a user, without the rights of root."""
    os.setgroups([])
    os.setgid(user)
    os.setuid(user)
    try:
        answers.put(stop_and_wait(path, StopLevel.LIMP, PATIENCE_S, PATIENCE_S)[1])
    except OSError as error:
        answers.put(type(error).__name__)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become somebody else")
@pytest.mark.parametrize(
    ("group", "expected"), [(SOME_USER, ["jaw"]), (0, None)], ids=["in the group", "a stranger"]
)
def test_the_group_of_a_service_may_stop_it_and_a_stranger_may_not(tmp_path, group, expected):
    """The answer needs no path of the asker's own: the service could not reach it."""
    folder = tmp_path / "run"
    folder.mkdir()
    for each in [folder, *folder.parents][:-1]:
        if each.stat().st_mode & 0o011 != 0o011:
            each.chmod(0o755)
    path = folder / "face.sock"
    with ControlSocket(path) as control:
        os.chown(path, 0, group)
        context = multiprocessing.get_context("fork")
        answers = context.Queue()
        client = context.Process(target=ask_as, args=(SOME_USER, path, answers))
        client.start()
        with served(control):
            answer = answers.get(timeout=PATIENCE_S)
            client.join()
            if expected is None:
                assert answer == "PermissionError"
            else:
                assert answer["confirmed"] == expected


def test_a_face_under_a_linked_folder_is_found_as_the_kernel_lists_it(monkeypatch, own_folder):
    (own_folder / "real").mkdir()
    (own_folder / "linked").symlink_to(own_folder / "real")
    monkeypatch.setenv("LIPSERVO_RUNTIME", str(own_folder / "linked" / "run"))
    with ControlSocket(socket_path("linda")):
        (face,) = [each for each in running_faces() if each.name == "linda"]

        assert holders_of_socket(face.path) == [os.getpid()]
