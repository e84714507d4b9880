"""The folders for the control sockets of running faces, one socket a face, and their socket files.

A service has `$RUNTIME_DIRECTORY` from systemd, a person who is logged in `$XDG_RUNTIME_DIR`; where
there is neither, a folder below the one for temporary files. `$LIPSERVO_RUNTIME` is before all of
them and the only one that is searched: jobs that run in parallel each have their own.
"""

import contextlib
import errno
import os
import re
import socket
import stat
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

#: The folder that the shipped unit asks systemd for (`RuntimeDirectory=lipservo`).
SERVICE_FOLDER: Final = Path("/run/lipservo")
SOCKET_SUFFIX: Final = ".sock"
_NAME: Final = "lipservo"
_OWN_VARIABLE: Final = "LIPSERVO_RUNTIME"
_LONGEST_FACE_NAME: Final = 40
#: Folders with the number of their user in the path: his session's, and below the temporary one.
_OF_A_USER: Final = re.compile(rf"/run/user/(\d+)/{_NAME}|.*/{_NAME}-(\d+)", re.ASCII)


#: Unix sockets that keep messages whole and name their peer, file locks and /proc. Without them
#: what needs no running face works: docs/decisions/release-and-site.md.
RUNS_FACES: Final = hasattr(socket, "SO_PEERCRED")
NEEDS_LINUX: Final = "servos and running faces need Linux; `lipservo doctor` says what works here"


class ControlError(Exception):
    """A face cannot listen, or cannot be reached; in one line: what, where, and the remedy."""


def runtime_folder() -> Path:
    """Return the folder for this process's sockets, and make it if needed.

    Raises ControlError when it cannot be made, or other users may write into it.
    """
    _check_system()
    given = os.environ.get("RUNTIME_DIRECTORY", "").split(":")[0]
    own = os.environ.get(_OWN_VARIABLE, "")
    if given and not own:
        return Path(given)
    folder = Path(own) if own else _own_folder()
    try:
        folder.mkdir(mode=0o700, exist_ok=True, parents=bool(own))
    except OSError as error:
        raise ControlError(
            f"{folder}: cannot be made: {error.strerror}; choose a place with --control"
        ) from error
    if not _belongs_to(folder, os.geteuid()):
        raise ControlError(
            f"{folder}: is no folder that only you may write into; choose another with --control"
        )
    return folder


def name_in_path(face: str) -> str:
    """Return a face's name as used in file names: safe characters only, at most 40 of them."""
    return re.sub(r"[^\w.-]", "_", face, flags=re.ASCII)[:_LONGEST_FACE_NAME].lstrip(".") or "face"


def socket_path(face: str) -> Path:
    """Return the path for this process's socket as the face named `face`. Raises ControlError."""
    return runtime_folder() / f"{name_in_path(face)}-{os.getpid()}{SOCKET_SUFFIX}"


def read_socket_name(path: Path) -> tuple[str, int] | None:
    """Return (face, process id) from a path made by `socket_path`; None for any other file name."""
    match = re.fullmatch(rf"([\w-][\w.-]*)-(\d+)\{SOCKET_SUFFIX}", path.name, re.ASCII)
    return None if match is None else (match[1], int(match[2]))


def searched_folders() -> list[Path]:
    """Return readable folders where faces may listen: the service's, ours, for root all users'.

    Left out are unreadable folders, and users' folders to which others may write or that belong to
    another user than the one whose number is in their path (without a number: than this process's),
    since their files cannot be trusted.
    """
    _check_system()
    if own := os.environ.get(_OWN_VARIABLE, ""):
        return [each for each in (Path(own),) if _may_look_into(each)]
    candidates = [Path(each) for each in os.environ.get("RUNTIME_DIRECTORY", "").split(":") if each]
    session = Path(f"/run/user/{os.geteuid()}") / _NAME
    of_users = [_own_folder(), session, _temporary_folder()]
    if os.geteuid() == 0:
        of_users += _folders_of_others()
    candidates += [SERVICE_FOLDER, *filter(_is_its_users, of_users)]
    return [each for each in dict.fromkeys(candidates) if _may_look_into(each)]


def _check_system() -> None:
    if not RUNS_FACES:
        raise ControlError(NEEDS_LINUX)


def _own_folder() -> Path:
    session = os.environ.get("XDG_RUNTIME_DIR", "")
    if session and _belongs_to(Path(session), os.geteuid()):
        return Path(session) / _NAME
    return _temporary_folder()


def _temporary_folder() -> Path:
    return Path(tempfile.gettempdir()) / f"{_NAME}-{os.geteuid()}"


def _folders_of_others() -> Iterator[Path]:
    yield from Path("/run/user").glob(f"*/{_NAME}")
    for folder in Path(tempfile.gettempdir()).glob(f"{_NAME}-*"):
        if _OF_A_USER.fullmatch(str(folder)):  # any other name is of a job that keeps apart
            yield folder


def _is_its_users(folder: Path) -> bool:
    """Return whether `folder` belongs to the user whose number is in its path.

    The number is 1000 in /run/user/1000/lipservo and in /tmp/lipservo-1000; a folder without one
    must belong to this process's user.
    """
    match = _OF_A_USER.fullmatch(str(folder))
    return _belongs_to(folder, int(match[1] or match[2]) if match else os.geteuid())


def _belongs_to(folder: Path, uid: int) -> bool:
    """Return whether `folder` is a real folder of user `uid`, in which no other user may write."""
    try:
        found = folder.lstat()
    except OSError:
        return False
    others_may_write = found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return stat.S_ISDIR(found.st_mode) and found.st_uid == uid and not others_may_write


def _may_look_into(folder: Path) -> bool:
    is_folder = os.path.isdir(folder) and not os.path.islink(folder)
    return is_folder and os.access(folder, os.R_OK | os.X_OK)


@contextlib.contextmanager
def held_folder(folder: Path, patience_s: float = 1.0) -> Iterator[None]:
    """Lock a folder inside the `with` block: no other process makes or removes a socket in it.

    Raises ControlError where the folder cannot be opened, or other processes lock it for longer
    than `patience_s`: others hold it for as long as a socket is made in it.
    """
    import fcntl

    give_up_s = time.monotonic() + patience_s
    try:
        fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except OSError as error:
        raise ControlError(f"{folder}: cannot be used: {error.strerror}") from error
    try:
        while True:
            try:
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() >= give_up_s:
                    raise ControlError(f"{folder}: another program uses it") from None
                time.sleep(0.01)
        yield
    finally:
        os.close(fd)


def knock(path: Path) -> int:
    """Return 0 if a process listens at the socket `path`, else the error number.

    Connects to the socket and disconnects at once.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as probe:
        probe.setblocking(False)
        try:
            refused = probe.connect_ex(str(path))
        except OSError:  # longer than a socket's address may be
            return errno.ENAMETOOLONG
    return 0 if refused == errno.EAGAIN else refused  # so many wait there already


def is_dead_socket(path: Path) -> bool:
    """Return whether `path` is a socket that no process listens on, and that we may remove."""
    try:
        found = path.lstat()
    except OSError:
        return False
    is_ours = os.geteuid() in (0, found.st_uid)
    return stat.S_ISSOCK(found.st_mode) and is_ours and knock(path) == errno.ECONNREFUSED


def make_room(path: Path) -> None:
    """Remove a dead socket of ours at `path`, if any. Raises ControlError for any other file."""
    if not os.path.lexists(path):
        return
    if not stat.S_ISSOCK(path.lstat().st_mode):
        raise ControlError(f"{path}: is not a socket; choose another --control")
    if not is_dead_socket(path):
        raise ControlError(f"{path}: another face uses it; choose another --control")
    path.unlink()


def inode_of(path: Path) -> tuple[int, int] | None:
    """Return device and inode of the file at a path, links not followed; None: there is no file."""
    try:
        found = path.lstat()
    except OSError:
        return None
    return found.st_dev, found.st_ino
