"""Tokens of the faces of this computer: their files, and the programs that may be sent a token.

A face keeps its token beside its control socket, in a folder that only its owner fills; the folders
are those of `firmware_bridge/process/runtime_folder.py`, which a client does not need. The kernel's
list of TCP sockets, readable by every user, contains the users whose programs listen on a port,
before a token is sent there, and those whose programs have connected.
"""

import ipaddress
import os
import re
import stat
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

TOKEN_NAME: Final = "token"
LONGEST_TOKEN_BYTES: Final = 4096
_SERVICE_FOLDER: Final = Path("/run/lipservo")
_FOLDER_NAME: Final = "lipservo"
#: Folders whose path has the number of their user: of a session, or below the temporary folder.
_OF_A_USER: Final = re.compile(rf"/run/user/(\d+)/{_FOLDER_NAME}|.*/{_FOLDER_NAME}-(\d+)", re.ASCII)
_TABLES: Final = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))
_LISTEN: Final = "0A"  # TCP_LISTEN of the kernel's include/net/tcp_states.h


def found_tokens(url: str) -> list[str]:
    """Return the tokens that a face at `url` may require; empty for another computer's face.

    They are read in the runtime folders where running faces are searched. A token is left out
    unless its file's owner has a program that listens on the port: so no other user's program is
    sent one.
    """
    try:
        split = urlsplit(url)
        host, port = split.hostname or "", split.port or 0
    except ValueError:
        return []
    if not is_loopback(host) or not hasattr(os, "geteuid"):
        return []
    users = listening_users(port) if are_listed() else {os.geteuid()}
    tokens = (_read_trusted_token(folder / TOKEN_NAME, users) for folder in runtime_folders())
    return list(dict.fromkeys(each for each in tokens if each is not None))


def runtime_folders() -> list[Path]:
    """Return the folders that may contain a running face: the service's and the user's; root: all.

    LIPSERVO_RUNTIME, if set, is the only one. Left out are folders that cannot be read, and users'
    folders to which others may write or that belong to another user than the one whose number is in
    their path (without a number: than this process's), since their contents cannot be trusted.
    """
    if only_folder := os.environ.get("LIPSERVO_RUNTIME", ""):
        return [each for each in (Path(only_folder),) if _is_readable_folder(each)]
    user = os.geteuid()
    temporary = Path(tempfile.gettempdir())
    candidates = [Path(each) for each in os.environ.get("RUNTIME_DIRECTORY", "").split(":") if each]
    own_temporary = temporary / f"{_FOLDER_NAME}-{user}"
    session = os.environ.get("XDG_RUNTIME_DIR", "")
    has_session = session and _belongs_to(Path(session), user)
    user_folders = [Path(session) / _FOLDER_NAME if has_session else own_temporary]
    user_folders += [Path(f"/run/user/{user}") / _FOLDER_NAME, own_temporary]
    if user == 0:
        user_folders += Path("/run/user").glob(f"*/{_FOLDER_NAME}")
        others = temporary.glob(f"{_FOLDER_NAME}-*")
        user_folders += [each for each in others if _OF_A_USER.fullmatch(str(each))]
    candidates += [_SERVICE_FOLDER, *filter(_is_trusted, user_folders)]
    return [each for each in dict.fromkeys(candidates) if _is_readable_folder(each)]


@dataclass(frozen=True, slots=True)
class TcpSocket:
    """One TCP socket: its port, its peer's port, its user's id, its inode, whether it listens."""

    port: int
    peer_port: int
    uid: int
    inode: str
    listens: bool


def tcp_sockets() -> Iterator[TcpSocket]:
    """Yield every TCP socket of this network namespace; none if the kernel does not list them."""
    for table in _TABLES:
        try:
            rows = table.read_text("ascii", "replace").splitlines()[1:]
        except OSError:
            continue
        for row in rows:
            fields = row.split()
            port, peer_port = (int(each.rpartition(":")[2], 16) for each in fields[1:3])
            yield TcpSocket(port, peer_port, int(fields[7]), fields[9], fields[3] == _LISTEN)


def are_listed() -> bool:
    """Return whether this system lists its TCP sockets, as Linux does in /proc/net."""
    return any(table.exists() for table in _TABLES)


def listening_users(port: int) -> set[int]:
    """Return the ids of the users whose programs listen on a port."""
    return {each.uid for each in tcp_sockets() if each.listens and each.port == port}


def connected_users(port: int, server_port: int) -> set[int]:
    """Return the ids of users with a socket from `port` to `server_port` of this computer."""
    return {
        each.uid
        for each in tcp_sockets()
        if each.port == port and each.peer_port == server_port and not each.listens
    }


def host_address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    """Return the IP address that `host` is; None for a name. IPv4-mapped IPv6 becomes IPv4."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return None
    mapped = address.ipv4_mapped if isinstance(address, ipaddress.IPv6Address) else None
    return mapped or address


def is_loopback(host: str) -> bool:
    """Return whether a host, by name or address, is this computer's loopback."""
    address = host_address(host)
    return host.lower() == "localhost" if address is None else address.is_loopback


def _read_trusted_token(path: Path, users: set[int]) -> str | None:
    """Return the token in a file that one of `users` owns; None for others, unreadable or empty."""
    try:
        fd = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return None
    try:
        file_status = os.fstat(fd)
        if not stat.S_ISREG(file_status.st_mode) or file_status.st_uid not in users:
            return None
        lines = os.read(fd, LONGEST_TOKEN_BYTES).decode("utf-8", "replace").splitlines()
    except OSError:
        return None
    finally:
        os.close(fd)
    return (lines[0].strip() or None) if lines else None


def _is_trusted(folder: Path) -> bool:
    """Return whether `folder` belongs to the user whose number is in its path, else to this one."""
    match = _OF_A_USER.fullmatch(str(folder))
    return _belongs_to(folder, int(match[1] or match[2]) if match else os.geteuid())


def _belongs_to(folder: Path, uid: int) -> bool:
    """Return whether `folder`, not a link, is user `uid`'s, and no other user can write to it."""
    try:
        status = folder.lstat()
    except OSError:
        return False
    others_may_write = status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return stat.S_ISDIR(status.st_mode) and status.st_uid == uid and not others_may_write


def _is_readable_folder(folder: Path) -> bool:
    is_folder = os.path.isdir(folder) and not os.path.islink(folder)
    return is_folder and os.access(folder, os.R_OK | os.X_OK)
