"""A stop beside connections that take a server's places: how long until the face has it.

As a program, it is the crowd: of clients that send nothing, half a request, a byte a second, or
all but a body, and that come again when they are dropped.
"""

import contextlib
import selectors
import socket
import struct
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final
from urllib.parse import urlsplit

from lipservo_lab.bench.stops.running_face import RunningFace, running_face
from lipservo_lab.bench.stops.stop_clients import post_stop, stop_by_control

N_IDLE: Final = 300
_N_STOPS: Final = 40
_PAUSE_S: Final = 0.2
_STANDS: Final = "all of the crowd have come"
_STANDS_S: Final = 30.0
_SETTLED_S: Final = 3.0
#: A stop that is not answered by then, or is refused, counts as this long.
_LOST_S: Final = 10.0
_DRIP_S: Final = 1.0
#: Closes with RST, so that nothing of a dropped connection stays behind.
_AT_ONCE: Final = struct.pack("ii", 1, 0)
_HEAD: Final = b"HTTP/1.1\r\nHost: 127.0.0.1\r\n"
_BODY: Final = b"Content-Length: 40\r\n\r\n{"
_HANDSHAKE: Final = (
    b"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
)


@dataclass(frozen=True, slots=True)
class Opening:
    """What a connection of the crowd sends once connected. drips: then also a byte a second."""

    sent: bytes
    drips: bool = False


#: By server, what leaves a connection of it open and idle.
OPENINGS: Final = {
    "page": (
        Opening(b""),
        Opening(b"GET / " + _HEAD),
        Opening(b"GET / " + _HEAD + b"X: ", drips=True),
        Opening(b"GET /api/status " + _HEAD + b"\r\n"),
        Opening(b"POST /api/say " + _HEAD + _BODY),
        Opening(b"POST /api/stop " + _HEAD + _BODY, drips=True),
    ),
    "agents": (
        Opening(b""),
        Opening(b"GET /control " + _HEAD),
        Opening(b"GET /control " + _HEAD + b"X: ", drips=True),
        Opening(b"GET /control " + _HEAD + _HANDSHAKE),
    ),
}


class IdleCrowd:
    """Many idle connections from several addresses of this computer to one server.

    n_came: how often a connection was made.
    """

    def __init__(
        self,
        server: tuple[str, int],
        n_peers: int,
        openings: Sequence[Opening],
        n: int = N_IDLE,
    ) -> None:
        """Make `n` connections when `run` is called. server: host and port.

        n_peers: number of addresses that they come from; 1: all come from 127.0.0.1, as stops do.
        openings: what they send, in turn.
        """
        self.n_came = 0
        self._server = server
        first = 1 if n_peers == 1 else 2
        self._peers = [f"127.0.0.{first + each}" for each in range(n_peers)]
        self._openings = openings
        self._n = n

    def run(self, is_over: Callable[[], bool]) -> None:
        """Connect, and connect again whatever is dropped, until `is_over` returns True."""
        unconnected = list(range(self._n))
        drips_s = time.monotonic() + _DRIP_S
        with selectors.DefaultSelector() as selector:
            while not is_over():
                unconnected = [each for each in unconnected if not self._connect(each, selector)]
                for key, _ in selector.select(0.05):
                    if _is_dropped(key.fileobj):
                        selector.unregister(key.fileobj)
                        unconnected.append(key.data)
                if time.monotonic() > drips_s:
                    drips_s += _DRIP_S
                    self._drip(selector)
            for key in list(selector.get_map().values()):
                _close(key.fileobj)

    def _connect(self, number: int, selector: selectors.BaseSelector) -> bool:
        """Open one connection, send its opening bytes and register it; return whether it succeeded.

        number: of the connection; selects address and opening.
        """
        client = socket.socket()
        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _AT_ONCE)
        client.settimeout(0.1)
        try:
            client.bind((self._peers[number % len(self._peers)], 0))
            client.connect(self._server)
            client.sendall(self._openings[number % len(self._openings)].sent)
        except OSError:
            client.close()
            return False
        client.setblocking(False)
        selector.register(client, selectors.EVENT_READ, number)
        self.n_came += 1
        return True

    def _drip(self, selector: selectors.BaseSelector) -> None:
        """Send a byte over each connection whose opening drips."""
        for key in selector.get_map().values():
            if self._openings[key.data % len(self._openings)].drips:
                with contextlib.suppress(OSError):
                    _end_of(key.fileobj).send(b" ")


def _end_of(fileobj: object) -> socket.socket:
    assert isinstance(fileobj, socket.socket)
    return fileobj


def _is_dropped(fileobj: object) -> bool:
    """Read a connection of the crowd; return whether it has ended, and close it then."""
    client = _end_of(fileobj)
    try:
        if client.recv(1 << 16):
            return False
    except BlockingIOError:
        return False
    except OSError:
        pass
    client.close()
    return True


def _close(fileobj: object) -> None:
    _end_of(fileobj).close()


def stop_beside_idle() -> dict[str, Any]:
    """Stop a real daemon many times beside crowds of idle connections; return the worst delay.

    `stop_beside_idle_s`: longest time from a new client's request to the face's answer, s.
    `stop_beside_idle_rows`: a row for each server (page, agents) and number of the crowd's
    addresses.
    """
    rows = []
    with running_face(page=True, agents=True) as face:
        for server in ("page", "agents"):
            rows += [_measure_server(face, server, n_peers) for n_peers in (10, 1)]
    return {
        "stop_beside_idle_s": max(row["worst_s"] for row in rows),
        "stop_beside_idle_rows": rows,
    }


def _measure_server(face: RunningFace, server: str, n_peers: int) -> dict[str, Any]:
    """Freeze a face again and again beside one crowd at a server; return the row of figures.

    `worst_s`: the longest delay of an answer; `lost`: freezes without an answer in time.

    n_peers: number of addresses from which the crowd connects. Raises RuntimeError where the crowd
    does not get its connections.
    """
    address = getattr(face.at, server)
    n_before = face.robot.output.count(_STANDS)
    netloc = urlsplit(address).netloc
    crowd = face.robot.start_python("-m", __name__, server, netloc, str(n_peers))
    try:
        if not face.robot.look_until(
            lambda: face.robot.output.count(_STANDS) > n_before, _STANDS_S
        ):
            raise RuntimeError(f"the crowd does not stand: {face.robot.last_output}")
        face.robot.look(_SETTLED_S)
        delays_s = []
        for _ in range(_N_STOPS):
            delays_s.append(_stop_delay_s(face, server))
            face.robot.look(_PAUSE_S)
    finally:
        crowd.kill()
        crowd.wait()
    lost = sum(each >= _LOST_S for each in delays_s)
    return {"server": server, "peers": n_peers, "worst_s": max(delays_s), "lost": lost}


def _stop_delay_s(face: RunningFace, server: str) -> float:
    """Return how long a server needs to accept a freeze, s; `_LOST_S` if it does not accept it."""
    began_s = time.monotonic()
    try:
        if server == "page":
            status, answer = post_stop(face.at.page, "freeze", 0, _LOST_S)
            is_taken = status == 200 and "accepted" in answer
        else:
            is_taken = '"accepted"' in str(stop_by_control(face.at.agents, "freeze", _LOST_S))
    except Exception:  # of which kind does not matter: it was not taken
        return _LOST_S
    return min(_LOST_S, time.monotonic() - began_s) if is_taken else _LOST_S


def _main(server: str, netloc: str, n_peers: str) -> None:
    """Run a crowd until it is killed; write `_STANDS` to standard error once all have connected.

    netloc: HOST:PORT. n_peers: how many addresses they come from.
    """
    host, port = netloc.rsplit(":", 1)
    crowd = IdleCrowd((host, int(port)), int(n_peers), OPENINGS[server])
    is_announced = False

    # Called by the crowd again and again; it runs until it is killed.
    def announce_all_connected() -> bool:
        nonlocal is_announced
        if crowd.n_came >= N_IDLE and not is_announced:
            is_announced = True
            sys.stderr.write(f"{_STANDS}\n")
        return False

    crowd.run(announce_all_connected)


if __name__ == "__main__":
    _main(*sys.argv[1:])
