"""The address at which voice agents find a face."""

import contextlib
import errno
import os
import socket
from pathlib import Path
from typing import Final

from lipservo.access.admission import is_loopback
from lipservo.access.kernel_sockets import tcp_sockets
from lipsync.errors import UserError, shown

_BACKLOG: Final = 16
_HIGHEST_PORT: Final = 65_535
_PROC: Final = Path("/proc")


def bind_listener(spec: str, token: str | None) -> socket.socket:
    """Listen at `HOST:PORT`; an IPv6 address stands in brackets. Port 0: any that is free.

    Raises UserError: no such address, one beyond loopback without a token, one that is taken.
    """
    host, port = _host_and_port(spec)
    if not is_loopback(host) and not token:
        beyond = "can be reached from other computers and needs a token"
        raise UserError(f"{spec}: {beyond}; give one, or listen at 127.0.0.1:{port}")
    listener = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        address = socket.getaddrinfo(host, port, listener.family, socket.SOCK_STREAM)[0][4]
        listener.bind(address)
        listener.listen(_BACKLOG)
    except OSError as error:
        listener.close()
        if error.errno == errno.EADDRINUSE:
            holder = _holder_of(port)
            raise UserError(f"{spec}: is taken{holder}; stop that, or choose another") from error
        raise UserError(f"{spec}: cannot listen there: {error.strerror or error}") from error
    return listener


def url_of(listener: socket.socket) -> str:
    """Where clients connect, as `ws://127.0.0.1:8765`."""
    host, port = listener.getsockname()[:2]
    return f"ws://[{host}]:{port}" if ":" in host else f"ws://{host}:{port}"


def _host_and_port(spec: str) -> tuple[str, int]:
    host, colon, port = spec.rpartition(":")
    bare = host.removeprefix("[").removesuffix("]")
    is_port = port.isascii() and port.isdigit() and int(port) <= _HIGHEST_PORT
    if not (colon and bare and is_port) or (":" in bare and bare == host):
        raise UserError(f"{shown(spec)}: no address; write HOST:PORT, as 127.0.0.1:8765")
    return bare, int(port)


def _holder_of(port: int) -> str:
    """Who listens on a port, as far as we may look: `` by process 12 (name)``, or nothing."""
    found = (each.inode for each in tcp_sockets() if each.listens and each.port == port)
    inodes = {f"socket:[{inode}]" for inode in found}
    for folder in _PROC.glob("[0-9]*"):
        with contextlib.suppress(OSError):
            for fd in os.listdir(folder / "fd"):
                if os.readlink(folder / "fd" / fd) in inodes:
                    name = (folder / "comm").read_text().strip()
                    return f" by process {folder.name} ({name})"
    return ""
