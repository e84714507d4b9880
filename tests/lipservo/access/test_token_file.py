"""The token of a runtime folder: made once, and refused where others could have laid it."""

import os
import stat
import threading

import pytest
from places import laid, short_folder

from lipservo.access.token_file import read_token, runtime_token_file
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


@pytest.mark.parametrize(
    ("how", "why"),
    [
        ("link", "is not a regular file"),
        ("broken link", "is not a regular file"),
        ("folder", "is not a regular file"),
        ("fifo", "is not a regular file"),
        ("others read", r"is open to other users \(mode 0644\)"),
        ("group writes", r"is open to other users \(mode 0660\)"),
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
    with pytest.raises(UserError, match="belongs to user 65534, not 0"):
        runtime_token_file()


def test_a_stricter_mode_will_do(folder):
    laid(folder, "plain").chmod(0o400)
    assert read_token(str(runtime_token_file())) == "a secret"
