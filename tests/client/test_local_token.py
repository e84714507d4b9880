"""Tokens of this computer's faces, found by a client: ours alone, and for our programs alone."""

import os
import socket
import tempfile

import pytest
from lipservo_client import local_token
from lipservo_client.local_token import (
    connected_users,
    found_tokens,
    listening_users,
    runtime_folders,
)
from places import laid, short_folder

from firmware_bridge.process.runtime_folder import searched_folders
from lipservo.access.token_file import read_token, runtime_token_file


@pytest.fixture
def folder(monkeypatch):
    session = short_folder()
    monkeypatch.delenv("LIPSERVO_RUNTIME", raising=False)
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(session))
    # What others have left in the folder for temporary files is none of ours.
    monkeypatch.setattr(tempfile, "tempdir", str(short_folder()))
    return session / "lipservo"


@pytest.mark.parametrize("variable", [None, "LIPSERVO_RUNTIME", "RUNTIME_DIRECTORY"])
def test_a_client_looks_where_running_faces_are_searched(folder, variable, monkeypatch):
    folder.mkdir()
    if variable is not None:
        monkeypatch.setenv(variable, str(short_folder()))
    assert runtime_folders() == searched_folders()
    assert runtime_folders()


@pytest.mark.parametrize("session", ["", "/nowhere", "/tmp"])
def test_it_looks_there_without_a_session_of_its_own(folder, session, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", session)
    temporary = folder.parent / "temporary"
    for name in (f"lipservo-{os.geteuid()}", "lipservo-1234", "lipservo-x", "lipservo-"):
        (temporary / name).mkdir(parents=True)
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    assert runtime_folders() == searched_folders()
    assert temporary / f"lipservo-{os.geteuid()}" in runtime_folders()


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
    monkeypatch.setattr(local_token, "listening_users", lambda _port: {os.geteuid() + 1})
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
