"""Where the dashboard listens: what was asked for, or the usual port, or the next that is free."""

import socket
from typing import Final
from urllib.parse import urlencode

from lipservo.agents.listener import bind_listener, url_of
from lipsync.errors import UserError

HOST: Final = "127.0.0.1"
FIRST_PORT: Final = 8080
_TRIES: Final = 20


def bound_dashboard(listen: str | None, token: str | None) -> socket.socket:
    """listen: HOST:PORT; None: 8080 of this computer, or the next port that is free.

    Raises UserError: no such address, one beyond loopback without a token, one that is taken.
    """
    if listen is not None:
        return bind_listener(listen, token)
    for port in range(FIRST_PORT, FIRST_PORT + _TRIES):
        try:
            return bind_listener(f"{HOST}:{port}", token)
        except UserError:
            continue
    return bind_listener(f"{HOST}:0", token)


def address_of(listener: socket.socket, token: str | None = None) -> str:
    """What to type into a browser. token: that opens the page; it becomes a cookie there."""
    address = url_of(listener).replace("ws://", "http://", 1)
    return address if token is None else f"{address}/?{urlencode({'token': token})}"
