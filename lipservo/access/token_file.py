"""The token that clients over TCP must send: where it is kept, made, and found again.

One for all faces of a runtime folder, made at the first start and used as long as the file is
there. Clients of this computer find it by themselves.
"""

import contextlib
import os
import secrets
import stat
import tempfile
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from firmware_bridge.process.runtime_folder import runtime_folder, searched_folders
from lipservo.access.admission import is_loopback
from lipservo.access.kernel_sockets import are_listed, listening_users
from lipsync.errors import UserError

_NAME: Final = "token"
#: Owner and group of the runtime folder read it: those who may use the control sockets beside it.
_MODE: Final = 0o640
_LONGEST_BYTES: Final = 4096
#: 256 bits.
_N_RANDOM_BYTES: Final = 32
_REMEDY: Final = "remove it, so that another is made, or give --token-file FILE"


def runtime_token_file() -> Path:
    """Return the token file of this process's runtime folder; make it where there is none.

    Raises
    ------
    UserError
        Where something else lies there, or it cannot be made.
    ControlError
        Where the runtime folder cannot be used.

    """
    path = runtime_folder() / _NAME
    try:
        if not os.path.lexists(path):
            _make(path)
        _check(path)
    except OSError as error:
        raise UserError(f"{path}: cannot be used as a token: {error.strerror}") from error
    return path


def read_token(token_file: str | None) -> str | None:
    """Return the first line of a file, which clients must send; None without a file.

    Raises
    ------
    UserError
        Where it cannot be read, or the line is empty.

    """
    if token_file is None:
        return None
    try:
        with Path(token_file).open(encoding="utf-8") as file:
            token = file.readline(_LONGEST_BYTES).strip()
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{token_file}: cannot be read as a token: {error}") from error
    if not token:
        raise UserError(f"{token_file}: its first line is empty; write a token there")
    return token


def found_tokens(url: str) -> list[str]:
    """Return the tokens that a face at `url` may ask for; none for another computer's.

    They are read in the runtime folders where running faces are searched. A token is sent only to
    a program of the user who owns its file: another user's, that listens on the port, gets none.
    """
    try:
        split = urlsplit(url)
        host, port = split.hostname or "", split.port or 0
    except ValueError:
        return []
    if not is_loopback(host) or not hasattr(os, "geteuid"):
        return []
    users = listening_users(port) if are_listed() else {os.geteuid()}
    tokens = (_token_of(folder / _NAME, users) for folder in searched_folders())
    return list(dict.fromkeys(each for each in tokens if each is not None))


def _make(path: Path) -> None:
    """Whole or not at all; the file of another face that starts at the same time stays."""
    fd, new = tempfile.mkstemp(prefix=f".{_NAME}-", dir=path.parent)
    try:
        with os.fdopen(fd, "w", encoding="ascii") as file:
            file.write(secrets.token_urlsafe(_N_RANDOM_BYTES) + "\n")
            # Where we are not of the folder's group, only we read it.
            with contextlib.suppress(PermissionError):
                os.fchown(fd, -1, path.parent.stat().st_gid)
                os.fchmod(fd, _MODE)
        with contextlib.suppress(FileExistsError):
            os.link(new, path)
    finally:
        os.unlink(new)


def _check(path: Path) -> None:
    """Raises UserError for what another user may have laid there, or may read."""
    found = path.lstat()
    if not stat.S_ISREG(found.st_mode):
        raise UserError(f"{path}: is no plain file, and no token; {_REMEDY}")
    if found.st_uid != os.geteuid():
        raise UserError(f"{path}: belongs to user {found.st_uid}, not to {os.geteuid()}; {_REMEDY}")
    if stat.S_IMODE(found.st_mode) & ~_MODE:
        mode = f"{stat.S_IMODE(found.st_mode):04o}"
        raise UserError(f"{path}: mode {mode} is open to other users, not 0640; {_REMEDY}")
    read_token(str(path))


def _token_of(path: Path, users: set[int]) -> str | None:
    """The token in a file of one of these users; None: there is none that we may read."""
    try:
        fd = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        found = os.fstat(fd)
        if not stat.S_ISREG(found.st_mode) or found.st_uid not in users:
            return None
        lines = os.read(fd, _LONGEST_BYTES).decode("utf-8", "replace").splitlines()
    except OSError:
        return None
    finally:
        os.close(fd)
    return (lines[0].strip() or None) if lines else None
