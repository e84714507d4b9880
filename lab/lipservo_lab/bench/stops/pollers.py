"""Twenty clients that poll the status of a face, in a process of their own.

`python -m lipservo_lab.bench.stops.pollers CONTROL PAGE AGENTS [TOKEN]`: seven at the control
socket, seven at the page's /api/status, six at /control; each ten times a second, until killed.
"""

import contextlib
import http.client
import json
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from firmware_bridge.process.operating_system import die_with_parent
from lipservo_lab.bench.stops.raw_control import request

AT_CONTROL, AT_PAGE, AT_AGENTS = 7, 7, 6
_PERIOD_S: Final = 0.1
_TIMEOUT_S: Final = 2.0


def poll_control(path: Path) -> None:
    """Request the status over a new connection, as `lipservo status` does."""
    request(path, "status", _TIMEOUT_S)


def poll_page(page: str, token: str) -> None:
    """Request the status from the page, as a program does."""
    connection = http.client.HTTPConnection(urlsplit(page).netloc, timeout=_TIMEOUT_S)
    with contextlib.closing(connection):
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        connection.request("GET", "/api/status", headers=headers)
        connection.getresponse().read()


def poll_agents(agents: str, token: str) -> None:
    """Request the status again and again over one connection; return only by an exception."""
    from websockets.sync.client import connect

    headers = {"Authorization": f"Bearer {token}"} if token else {}
    with connect(f"{agents}/control", additional_headers=headers) as client:
        while True:
            client.send(json.dumps({"type": "status", "id": 1}))
            client.recv(_TIMEOUT_S)
            time.sleep(_PERIOD_S)


def _repeat(poll: Callable[[], None]) -> None:
    """Call `poll` every `_PERIOD_S`, whatever it raises."""
    while True:
        with contextlib.suppress(Exception):  # a face that is stopped, restarted, or refuses
            poll()
        time.sleep(_PERIOD_S)


def main(control: str, page: str, agents: str, token: str = "") -> None:
    """Run all 20 clients in threads until killed.

    control: path of the control socket. page, agents: URLs. token: empty where none is needed.
    """
    die_with_parent()
    polls: list[Callable[[], None]] = [lambda: poll_control(Path(control))] * AT_CONTROL
    polls += [lambda: poll_page(page, token)] * AT_PAGE
    polls += [lambda: poll_agents(agents, token)] * AT_AGENTS
    for n, poll in enumerate(polls):
        threading.Thread(target=_repeat, args=(poll,), name=f"client {n}", daemon=True).start()
    while True:
        time.sleep(1.0)


if __name__ == "__main__":
    main(*sys.argv[1:])
