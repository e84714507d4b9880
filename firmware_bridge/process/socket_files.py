"""Socket files: who may make one, whether somebody listens there, and room for a new one."""

import contextlib
import errno
import fcntl
import os
import socket
import stat
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from firmware_bridge.process.runtime_folder import ControlError

#: A folder is held by others for as long as a socket is made in it.
_FOLDER_PATIENCE_S: Final = 1.0


@contextlib.contextmanager
def held_folder(folder: Path, patience_s: float = _FOLDER_PATIENCE_S) -> Iterator[None]:
    """No other process makes or removes a socket in the folder meanwhile.

    Raises ControlError where it cannot be opened, or others hold it for longer than `patience_s`.
    """
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
                    raise ControlError(f"{folder}: is held by another program") from None
                time.sleep(0.01)
        yield
    finally:
        os.close(fd)


def knock(path: Path) -> int:
    """Connect and hang up again: 0 when somebody listens, else the number of the error."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as probe:
        probe.setblocking(False)
        try:
            refused = probe.connect_ex(str(path))
        except OSError:  # longer than a socket's address may be
            return errno.ENAMETOOLONG
    return 0 if refused == errno.EAGAIN else refused  # so many wait there already


def is_dead_socket(path: Path) -> bool:
    """Whether a socket lies there that nobody listens on any more, and it is ours to remove."""
    try:
        found = path.lstat()
    except OSError:
        return False
    is_ours = os.geteuid() in (0, found.st_uid)
    return stat.S_ISSOCK(found.st_mode) and is_ours and knock(path) == errno.ECONNREFUSED


def make_room(path: Path) -> None:
    """Remove a dead socket of ours. Raises ControlError where anything else lies."""
    if not os.path.lexists(path):
        return
    if not stat.S_ISSOCK(path.lstat().st_mode):
        raise ControlError(f"{path}: is no socket and stays as it is; choose another --control")
    if not is_dead_socket(path):
        raise ControlError(f"{path}: a face listens there already; stop it, or choose another")
    path.unlink()


def inode_of(path: Path) -> tuple[int, int] | None:
    """Which file lies there; None: none."""
    try:
        found = path.lstat()
    except OSError:
        return None
    return found.st_dev, found.st_ino
