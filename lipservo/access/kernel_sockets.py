"""TCP sockets as the Linux kernel lists them: ports, user and inode of each, readable by everybody.

It is how a client of this computer knows whose program listens on a port before it sends a token
there, and how a server knows which user's program has connected.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

_TABLES: Final = (Path("/proc/net/tcp"), Path("/proc/net/tcp6"))
_LISTEN: Final = "0A"  # TCP_LISTEN of the kernel's include/net/tcp_states.h


@dataclass(frozen=True, slots=True)
class TcpSocket:
    """One row: ports of its own and the other end, the user who made it, and its inode."""

    port: int
    peer_port: int
    uid: int
    inode: str
    listens: bool


def tcp_sockets() -> Iterator[TcpSocket]:
    """Every TCP socket of this network namespace; none where the kernel does not list them."""
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
    """Whether this system lists its sockets at all."""
    return any(table.exists() for table in _TABLES)


def listening_users(port: int) -> set[int]:
    """The users whose programs listen on a port."""
    return {each.uid for each in tcp_sockets() if each.listens and each.port == port}


def connected_users(port: int, server_port: int) -> set[int]:
    """The users who made a socket with this port, connected to `server_port` of this computer."""
    return {
        each.uid
        for each in tcp_sockets()
        if each.port == port and each.peer_port == server_port and not each.listens
    }
