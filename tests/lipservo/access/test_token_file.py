"""The token of a runtime folder: made once, refused where others could have laid it, and found."""

import os
import socket
import stat
import threading

import pytest
from places import short_folder

from lipservo.access import token_file
from lipservo.access.kernel_sockets import connected_users, listening_users
from lipservo.access.token_file import found_tokens, read_token, runtime_token_file
from lipsync.errors import UserError


@pytest.fixture
def folder(monkeypatch):
    session = short_folder()
    monkeypatch.delenv("LIPSERVO_RUNTIME", raising=False)
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(session))
    return session / "lipservo"


def test_it_is_made_once_for_owner_and_group_and_used_again(folder):
    path = runtime_token_file()
    first = read_token(str(path))

    assert path == folder / "token"
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    assert path.stat().st_gid == folder.stat().st_gid
    assert len(first) >= 40
    assert read_token(str(runtime_token_file())) == first
    assert [each.name for each in folder.iterdir()] == ["token"]

    path.unlink()
    assert read_token(str(runtime_token_file())) != first


def test_faces_that_start_at_the_same_time_have_one_token(folder):
    """`_make` of both runs to its end before either looks."""
    folder.mkdir()
    go_on, tokens = threading.Barrier(8), []

    def start():
        go_on.wait()
        tokens.append(read_token(str(runtime_token_file())))

    threads = [threading.Thread(target=start) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()

    assert len(tokens) == 8
    assert len(set(tokens)) == 1
    assert [each.name for each in folder.iterdir()] == ["token"]


def laid(folder, how):
    """Something in the token's place."""
    folder.mkdir()
    path = folder / "token"
    if how == "link":
        (folder / "mine").write_text("a secret\n")
        path.symlink_to(folder / "mine")
    elif how == "broken link":
        path.symlink_to(folder / "nothing")
    elif how == "folder":
        path.mkdir()
    elif how == "fifo":
        os.mkfifo(path, 0o600)
    else:
        path.write_text("" if how == "empty" else "a secret\n")
        path.chmod({"others read": 0o644, "group writes": 0o660}.get(how, 0o640))
    return path


@pytest.mark.parametrize(
    ("how", "why"),
    [
        ("link", "is no plain file"),
        ("broken link", "is no plain file"),
        ("folder", "is no plain file"),
        ("fifo", "is no plain file"),
        ("others read", "mode 0644 is open to other users"),
        ("group writes", "mode 0660 is open to other users"),
        ("empty", "its first line is empty"),
    ],
)
def test_what_another_user_may_have_laid_there_is_refused_in_one_line(folder, how, why):
    path = laid(folder, how)
    with pytest.raises(UserError, match=why) as raised:
        runtime_token_file()
    assert str(raised.value).startswith(f"{path}: ")
    assert len(str(raised.value).splitlines()) == 1


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root to give a file away")
def test_a_file_of_another_user_is_refused(folder):
    os.chown(laid(folder, "plain"), 65534, -1)
    with pytest.raises(UserError, match="belongs to user 65534, not to 0"):
        runtime_token_file()


def test_a_stricter_mode_will_do(folder):
    laid(folder, "plain").chmod(0o400)
    assert read_token(str(runtime_token_file())) == "a secret"


@pytest.fixture
def listening():
    with socket.create_server(("127.0.0.1", 0)) as made:
        yield made.getsockname()[1]


def test_it_is_found_for_a_face_of_this_user_on_this_computer(folder, listening):
    token = read_token(str(runtime_token_file()))

    for host in ("127.0.0.1", "localhost"):
        assert found_tokens(f"ws://{host}:{listening}") == [token]
        assert found_tokens(f"ws://{host}:{listening}/stream") == [token]
    assert listening_users(listening) == {os.geteuid()}
    assert folder.exists()


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("url", ["ws://192.0.2.7:8765", "ws://robot.local:8765", "ws://[", ""])
def test_no_token_leaves_for_another_computer(url):
    runtime_token_file()
    assert found_tokens(url) == []


@pytest.mark.usefixtures("folder")
def test_no_token_is_sent_where_nothing_listens_or_another_users_program(listening, monkeypatch):
    runtime_token_file()
    with socket.create_server(("127.0.0.1", 0)) as gone:
        port = gone.getsockname()[1]
    assert found_tokens(f"ws://127.0.0.1:{port}") == []
    monkeypatch.setattr(token_file, "listening_users", lambda _port: {os.geteuid() + 1})
    assert found_tokens(f"ws://127.0.0.1:{listening}") == []


@pytest.mark.parametrize("how", ["link", "broken link", "folder", "fifo", "empty"])
def test_what_is_no_token_is_not_found(folder, listening, how):
    laid(folder, how)
    assert found_tokens(f"ws://127.0.0.1:{listening}") == []


def test_the_kernel_knows_whose_program_has_connected(listening):
    with socket.create_connection(("127.0.0.1", listening)) as client:
        port = client.getsockname()[1]
        assert connected_users(port, listening) == {os.geteuid()}
        assert connected_users(port, listening + 1) == set()
