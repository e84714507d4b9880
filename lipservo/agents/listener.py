"""The admission of voice agents: the limits, the listening socket, and each HTTP request.

Tokens and origins are checked by `lipservo/access/admission.py`, as for the dashboard; this module
adds the paths, the number of clients, and access for a stop where other commands are refused.
"""

import contextlib
import errno
import os
import socket
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from http import HTTPStatus
from pathlib import Path
from typing import Final, Literal, Protocol
from urllib.parse import urlsplit

from lipservo_client.local_token import is_loopback, tcp_sockets

from lipservo.access.admission import Policy, Refusal, Request, merged_headers, refusal
from lipservo.access.doorway import BACKLOG
from lipservo.agents.messages import Play, Say
from lipsync.errors import UserError, shown

#: Of what is sent, the kernel holds so much for a client that does not read; by itself megabytes.
_KERNEL_BYTES: Final = 1 << 16
_HIGHEST_PORT: Final = 65_535
_PROC: Final = Path("/proc")
STREAM_PATH, CONTROL_PATH = "/stream", "/control"
#: Answered to a plain GET, for programs that watch over a service.
HEALTH_PATHS: Final = frozenset({"/", "/status"})
#: The protocol for programs that read it (`protocol_schema.py`).
PROTOCOL_PATH: Final = "/protocol.json"


class Utterance(Protocol):
    """A text or file that the face itself speaks: one stream to play, or several of one name."""

    @property
    def is_whole(self) -> bool:
        """Whether all of the text or file was read or synthesised: no further stream follows."""

    @property
    def is_cut_short(self) -> bool:
        """Whether it was cut off or failed, so that some of it is never spoken."""

    @property
    def n_streams(self) -> int:
        """Number of streams into which it was divided so far."""

    @property
    def duration_s(self) -> float:
        """Duration in s of the part that is synthesised so far; of all once `is_whole`."""


#: Says a text, or plays a file, under a name. Called in a thread of its own. A ValueError is told
#: to the client as it stands.
SayText = Callable[[Say, str], Utterance]
PlayFile = Callable[[Play, str], Utterance]


@dataclass(frozen=True, slots=True)
class AgentSettings:
    """The limits of an `AgentServer`.

    policy: which clients may connect. when_busy: whether a stream is refused or waits while one of
    another client is spoken. most_streams: streams spoken or waiting, of all clients together.
    messages_per_s: of one client; further ones wait in its socket. first_message_s: a client
    without a message by then is disconnected. stalled_s: a stream without audio for this long is
    ended. position_s: interval of position events that are sent unrequested. ping_s: interval of
    pings; a client has twice as long to answer, so that a lost one is noticed within ten seconds.
    """

    policy: Policy = field(default_factory=Policy)
    when_busy: Literal["refuse", "queue"] = "refuse"
    most_connections: int = 8
    most_streams: int = 8
    most_message_bytes: int = 1 << 20
    messages_per_s: float = 2000.0
    first_message_s: float = 10.0
    stalled_s: float = 60.0
    position_s: float = 0.25
    ping_s: float = 3.0


def bind_listener(spec: str, token: str | None) -> socket.socket:
    """Return a socket listening at `spec`, HOST:PORT ([HOST]:PORT for IPv6); port 0: any free one.

    Raises UserError for a bad address, one in use, or one beyond loopback if `token` is None.
    """
    host, port = host_and_port(spec)
    if not is_loopback(host) and not token:
        beyond = "can be reached from other computers and needs a token"
        raise UserError(f"{spec}: {beyond}; give one, or listen at 127.0.0.1:{port}")
    listener = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        address = socket.getaddrinfo(host, port, listener.family, socket.SOCK_STREAM)[0][4]
        listener.bind(address)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _KERNEL_BYTES)
        listener.listen(BACKLOG)
    except OSError as error:
        listener.close()
        if error.errno == errno.EADDRINUSE:
            holder = _holder_of(port)
            raise UserError(f"{spec}: is taken{holder}; stop that, or choose another") from error
        raise UserError(f"{spec}: cannot listen there: {error.strerror or error}") from error
    return listener


def url_of(listener: socket.socket) -> str:
    """Return the URL at which clients connect to a listening socket, as `ws://127.0.0.1:8765`."""
    host, port = listener.getsockname()[:2]
    return f"ws://[{host}]:{port}" if ":" in host else f"ws://{host}:{port}"


def host_and_port(spec: str) -> tuple[str, int]:
    """Return host and port of `spec`, HOST:PORT, or [HOST]:PORT for IPv6. Raises UserError."""
    host, colon, port = spec.rpartition(":")
    bare = host.removeprefix("[").removesuffix("]")
    is_port = port.isascii() and port.isdigit() and int(port) <= _HIGHEST_PORT
    if not (colon and bare and is_port) or (":" in bare and bare == host):
        raise UserError(f"{shown(spec)} is not an address; write HOST:PORT, such as 127.0.0.1:8765")
    return bare, int(port)


def _holder_of(port: int) -> str:
    """Return words for an error message, ` by process 12 (name)`: the listener at a TCP port.

    Empty if it is not found.
    """
    found = (each.inode for each in tcp_sockets() if each.listens and each.port == port)
    inodes = {f"socket:[{inode}]" for inode in found}
    for folder in _PROC.glob("[0-9]*"):
        with contextlib.suppress(OSError):
            for fd in os.listdir(folder / "fd"):
                if os.readlink(folder / "fd" / fd) in inodes:
                    name = (folder / "comm").read_text().strip()
                    return f" by process {folder.name} ({name})"
    return ""


@dataclass(frozen=True, slots=True)
class Handshake:
    """The verdict on a request. refused: the HTTP error, None if accepted.

    may_only_stop: why all commands but stops are refused; None: all are accepted.
    """

    refused: Refusal | None = None
    may_only_stop: Refusal | None = None


def request_of(target: str, headers: Iterable[tuple[str, str]], peer: str) -> Request:
    """Return a GET request of the address `peer`, from its path and query, `target`, and headers.

    Raises ValueError if it is malformed.
    """
    split = urlsplit(target)
    merged = merged_headers(headers)
    is_websocket = merged.get("upgrade", "").lower() == "websocket"
    return Request("GET", split.path, split.query, merged, is_websocket, peer)


def handshake(request: Request, settings: AgentSettings, n_connected: int) -> Handshake:
    """Decide whether a request gets full access, no access, or access for stops only.

    `/control` accepts stops where all else is refused: for a missing token on this computer, or
    because `n_connected` clients, too many, are connected already.
    """
    refused = _refused(request, settings, n_connected)
    may_stop = request.path == CONTROL_PATH and request.is_websocket
    if refused and may_stop and refusal(request, settings.policy, is_stop=True) is None:
        return Handshake(None, may_only_stop=refused)
    return Handshake(refused)


def _refused(request: Request, settings: AgentSettings, n_connected: int) -> Refusal | None:
    """Return the reason to refuse full access to a request; None: it has full access.

    Full access is for WebSockets of /stream and /control, and for a plain GET of the health and
    protocol paths. n_connected: clients at present.
    """
    refused = refusal(request, settings.policy)
    if refused is not None:
        return refused
    if request.path in {*HEALTH_PATHS, PROTOCOL_PATH} and "upgrade" not in request.headers:
        return None
    if request.path not in (STREAM_PATH, CONTROL_PATH):
        return Refusal(HTTPStatus.NOT_FOUND, f"there are {STREAM_PATH} and {CONTROL_PATH}")
    if not request.is_websocket:
        return Refusal(HTTPStatus.UPGRADE_REQUIRED, "this is a WebSocket; use ws://")
    if n_connected >= settings.most_connections:
        most = f"{settings.most_connections} clients are connected already"
        return Refusal(HTTPStatus.SERVICE_UNAVAILABLE, most)
    return None
