"""The token that clients over TCP must send: creating, checking and reading its file.

One for all faces of a runtime folder, made at the first start and used as long as the file exists.
Clients on this computer find it by themselves (`lipservo_client.local_token`).
"""

import contextlib
import os
import secrets
import stat
import tempfile
from pathlib import Path
from typing import Final

from lipservo_client.local_token import LONGEST_TOKEN_BYTES, TOKEN_NAME

from firmware_bridge.process.runtime_folder import runtime_folder
from lipsync.errors import UserError

#: Owner and group of the runtime folder read it: those who may use the control sockets beside it.
_MODE: Final = 0o640
#: 256 bits.
_N_RANDOM_BYTES: Final = 32
_REMEDY: Final = "remove it, so that another is made, or give --token-file FILE"


def runtime_token_file() -> Path:
    """Return the token file of this process's runtime folder; create it if it is missing.

    Raises
    ------
    UserError
        Where the file is unsafe or not a token, or cannot be made.
    ControlError
        Where the runtime folder cannot be used.
    """
    path = runtime_folder() / TOKEN_NAME
    try:
        if not os.path.lexists(path):
            _make(path)
        _check(path)
    except OSError as error:
        raise UserError(f"{path}: cannot be used as a token: {error.strerror}") from error
    return path


def read_token(token_file: str | None) -> str | None:
    """Return the token that clients must send, the first line of `token_file`; None for None.

    Raises
    ------
    UserError
        Where the file cannot be read, or the line is empty.
    """
    if token_file is None:
        return None
    try:
        with Path(token_file).open(encoding="utf-8") as file:
            token = file.readline(LONGEST_TOKEN_BYTES).strip()
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{token_file}: cannot be read as a token: {error}") from error
    if not token:
        raise UserError(f"{token_file}: its first line is empty; write the token there")
    return token


def _make(path: Path) -> None:
    """Write a new random token to `path` atomically; a file already made meanwhile stays."""
    fd, new = tempfile.mkstemp(prefix=f".{TOKEN_NAME}-", dir=path.parent)
    try:
        with os.fdopen(fd, "w", encoding="ascii") as file:
            file.write(secrets.token_urlsafe(_N_RANDOM_BYTES) + "\n")
            # Where this user is not in the folder's group, only this user may read the file.
            with contextlib.suppress(PermissionError):
                os.fchown(fd, -1, path.parent.stat().st_gid)
                os.fchmod(fd, _MODE)
        with contextlib.suppress(FileExistsError):
            os.link(new, path)
    finally:
        os.unlink(new)


def _check(path: Path) -> None:
    """Raise UserError unless `path` is this user's own file, of mode 0640 at most, with a token."""
    found = path.lstat()
    if not stat.S_ISREG(found.st_mode):
        raise UserError(f"{path}: is not a regular file, so no token; {_REMEDY}")
    if found.st_uid != os.geteuid():
        raise UserError(f"{path}: belongs to user {found.st_uid}, not {os.geteuid()}; {_REMEDY}")
    if stat.S_IMODE(found.st_mode) & ~_MODE:
        mode = f"{stat.S_IMODE(found.st_mode):04o}"
        raise UserError(f"{path}: is open to other users (mode {mode}); {_REMEDY}")
    read_token(str(path))
