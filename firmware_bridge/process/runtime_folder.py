"""Where running faces can be found: one socket a face, in a folder that only its owner fills.

A service has `$RUNTIME_DIRECTORY` from systemd, a person who is logged in `$XDG_RUNTIME_DIR`;
where there is neither, a folder below the one for temporary files. `$LIPSERVO_RUNTIME` is before
all of them and the only one that is searched: jobs that run in parallel each have their own.
"""

import os
import re
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Final

#: The folder that the shipped unit asks systemd for (`RuntimeDirectory=lipservo`).
SERVICE_FOLDER: Final = Path("/run/lipservo")
SOCKET_SUFFIX: Final = ".sock"
_NAME: Final = "lipservo"
_OWN_VARIABLE: Final = "LIPSERVO_RUNTIME"
_LONGEST_FACE_NAME: Final = 40


class ControlError(Exception):
    """A face cannot listen, or cannot be spoken to; one line: what, where, what to do."""


def runtime_folder() -> Path:
    """The folder for this process's sockets, made if need be.

    Raises ControlError when it cannot be made, or is not ours alone to write into.
    """
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
    if not _is_own(folder):
        raise ControlError(
            f"{folder}: is not a folder that only you may write into; choose a place with --control"
        )
    return folder


def name_in_path(face: str) -> str:
    """A face's name as it is written in the name of its socket."""
    return re.sub(r"[^\w.-]", "_", face, flags=re.ASCII)[:_LONGEST_FACE_NAME].lstrip(".") or "face"


def socket_path(face: str) -> Path:
    """Where this process listens as the face of that name. Raises ControlError."""
    return runtime_folder() / f"{name_in_path(face)}-{os.getpid()}{SOCKET_SUFFIX}"


def read_socket_name(path: Path) -> tuple[str, int] | None:
    """The face and the process that `socket_path` made a name of; None for any other name."""
    match = re.fullmatch(rf"([^.].*)-(\d+){re.escape(SOCKET_SUFFIX)}", path.name)
    return None if match is None else (match[1], int(match[2]))


def searched_folders() -> list[Path]:
    """The folders in which a running face may be found: the service's, ours, for root everybody's.

    What cannot be looked into is left out, and so is a folder of others that does not belong to the
    user whose number is in its name: what lies there may be anything.
    """
    if own := os.environ.get(_OWN_VARIABLE, ""):
        return [each for each in (Path(own),) if _may_look_into(each)]
    candidates = [Path(each) for each in os.environ.get("RUNTIME_DIRECTORY", "").split(":") if each]
    session = Path(f"/run/user/{os.geteuid()}") / _NAME
    candidates += [SERVICE_FOLDER, _own_folder(), session, _temporary_folder()]
    if os.geteuid() == 0:
        found = [(each, _user_in_name(each)) for each in _folders_of_others()]
        candidates += [each for each, uid in found if uid is not None and _belongs_to(each, uid)]
    return [each for each in dict.fromkeys(candidates) if _may_look_into(each)]


def _own_folder() -> Path:
    session = os.environ.get("XDG_RUNTIME_DIR", "")
    if session and _is_own(Path(session)):
        return Path(session) / _NAME
    return _temporary_folder()


def _temporary_folder() -> Path:
    return Path(tempfile.gettempdir()) / f"{_NAME}-{os.geteuid()}"


def _folders_of_others() -> Iterator[Path]:
    yield from Path("/run/user").glob(f"*/{_NAME}")
    yield from Path(tempfile.gettempdir()).glob(f"{_NAME}-*")


def _is_own(folder: Path) -> bool:
    return _belongs_to(folder, os.geteuid())


def _user_in_name(folder: Path) -> int | None:
    """1000 of /run/user/1000/lipservo and of /tmp/lipservo-1000; None: of no user."""
    number = folder.parent.name if folder.name == _NAME else folder.name.rpartition("-")[2]
    return int(number) if number.isascii() and number.isdigit() else None


def _belongs_to(folder: Path, uid: int) -> bool:
    """Whether it is a true folder of that user into which no other user can put anything."""
    try:
        found = folder.lstat()
    except OSError:
        return False
    others_may_write = found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return stat.S_ISDIR(found.st_mode) and found.st_uid == uid and not others_may_write


def _may_look_into(folder: Path) -> bool:
    try:
        is_folder = stat.S_ISDIR(folder.lstat().st_mode)
    except OSError:
        return False
    return is_folder and os.access(folder, os.R_OK | os.X_OK)
