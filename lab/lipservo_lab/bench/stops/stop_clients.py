"""All who may request a stop, each as it really does: processes, sockets, HTTP, WebSocket, signals.

Each requests it in a thread or a process of its own and none of them is waited for, so that the
servos are watched from the moment of the request on.
"""

import contextlib
import http.client
import json
import signal
import subprocess
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from firmware_bridge.stopping import StopLevel
from lipservo_lab.bench.stops.raw_control import request_stop
from lipservo_lab.bench.stops.robot_at_port import RobotAtPort

#: A process has to load before it can request anything; that long counts for its start.
LOADS_S: Final = 1.0
#: As lipservo/dashboard/static/stop.js has them.
_PAGE_TIMEOUT_S, _PAGE_RETRY_S, _PAGE_TRIES, _PAGE_WAIT_S = 2.0, 0.3, 40, 15
#: A program that waits for the confirmed end.
_API_WAIT_S: Final = 10
_LONGEST_S: Final = 30.0
_LONGEST_LINE: Final = 200
_CONNECT: Final = (
    "import sys, lipservo\n"
    "with lipservo.connect(sys.argv[1]) as face:\n"
    "    print(face.stop(sys.argv[2]))\n"
)


class StopClient(StrEnum):
    """Who requests a stop."""

    SOCKET = "socket"  # bytes on the control socket
    SIGNAL = "signal"  # SIGTERM to the daemon; a second one: limp
    COMMAND = "command"  # `lipservo stop`, a process, to every face that runs
    PAGE_EARLY = "page_early"  # the page's button before its script is there: one request
    PAGE_SCRIPT = "page_script"  # stop.js: two requests at once, repeated
    API = "api"  # POST /api/stop that waits for the end
    CONTROL = "control"  # /control of the agent server
    CONNECT = "connect"  # a process: lipservo.connect().stop()
    NO_ONE = "nobody"  # none: the face itself must let go, with all its processes dead

    @property
    def loads_s(self) -> float:
        """Seconds that a client may need to start before it can request anything."""
        is_loaded = (StopClient.COMMAND, StopClient.CONNECT, StopClient.NO_ONE)
        return LOADS_S if self in is_loaded else 0.0


#: Those who request something.
CLIENTS: Final = tuple(each for each in StopClient if each is not StopClient.NO_ONE)


#: Clients that need a daemon's page, and those that need its server of voice agents.
NEEDS_PAGE: Final = (StopClient.PAGE_EARLY, StopClient.PAGE_SCRIPT, StopClient.API)
NEEDS_AGENTS: Final = (StopClient.CONTROL, StopClient.CONNECT)


@dataclass(frozen=True, slots=True)
class Addresses:
    """Where a face can be reached. page: http://...; agents: ws://...; empty: nowhere."""

    control: Path
    page: str = ""
    agents: str = ""


@dataclass(slots=True)
class Requested:
    """A stop that has been requested. requested_s: monotonic time of the request.

    process: the client, where it is a process; None: a thread. answers: what the client received so
    far, or the error that it got, as text for the report of a case that fails.
    """

    requested_s: float
    process: subprocess.Popen[bytes] | None = None
    answers: list[str] = field(default_factory=list)


def request_stop_by(
    client: StopClient,
    level: StopLevel,
    robot: RobotAtPort,
    daemon: subprocess.Popen[bytes],
    addresses: Addresses,
) -> Requested:
    """Let a client request a stop; return at once, without waiting for the answer.

    robot: where processes are started. at: the face's addresses. Answers are added later.
    """
    send_request: Callable[[], object]
    requested = Requested(time.monotonic())
    match client:
        case StopClient.COMMAND:
            option = [] if level is StopLevel.SOFT else [f"--{level}"]
            requested.process = robot.start("stop", *option)
            return requested
        case StopClient.CONNECT:
            requested.process = robot.start_python("-c", _CONNECT, addresses.agents, level.value)
            return requested
        case StopClient.NO_ONE:
            return requested
        case StopClient.SOCKET:
            send_request = partial(request_stop, addresses.control, level.value, _LONGEST_S)
        case StopClient.SIGNAL:
            send_request = partial(_send_signals, daemon, twice=level is StopLevel.LIMP)
        case StopClient.PAGE_EARLY:
            send_request = partial(post_stop, addresses.page, level, 0, _LONGEST_S)
        case StopClient.PAGE_SCRIPT:
            send_request = partial(press_stop, addresses.page, level)
        case StopClient.API:
            send_request = partial(post_stop, addresses.page, level, _API_WAIT_S, _LONGEST_S)
        case StopClient.CONTROL:
            send_request = partial(stop_by_control, addresses.agents, level)
    _in_thread(send_request, requested.answers)
    return requested


def post_stop(
    page: str, level: str, wait_s: int, timeout_s: float, browser: str = "campaign"
) -> tuple[int, dict[str, object]]:
    """POST /api/stop as a browser does from the face's own page.

    Returns the HTTP status and the JSON answer, {} if it is no JSON. wait_s: how long the server
    shall wait for the end of the stop. browser: the User-Agent. Raises OSError or
    http.client.HTTPException where no answer comes within `timeout_s`.
    """
    connection = http.client.HTTPConnection(urlsplit(page).netloc, timeout=timeout_s)
    with contextlib.closing(connection):
        body = json.dumps({"level": level, "wait_s": wait_s})
        headers = {
            "Content-Type": "application/json",
            "Origin": page,
            "Sec-Fetch-Site": "same-origin",
            "User-Agent": browser,
        }
        connection.request("POST", "/api/stop", body, headers)
        answer = connection.getresponse()
        raw = answer.read()
        try:
            return answer.status, dict(json.loads(raw))
        except ValueError:
            return answer.status, {}


def press_stop(page: str, level: str, post: Callable[..., tuple[int, object]] = post_stop) -> int:
    """Do what stop.js does when its button is pressed; block until the stop is accepted.

    It sends two requests at once: one that is answered when the stop is accepted, repeated until it
    is, and, in a thread, one that is answered when the servos have confirmed the end. Returns how
    many of the former were sent; 0: never accepted, or refused. post: sends one request.
    """

    def wait_for_end() -> None:
        post(page, level, _PAGE_WAIT_S, _PAGE_TIMEOUT_S + _PAGE_WAIT_S)

    waiting_thread: threading.Thread | None = None
    for n_requests in range(1, _PAGE_TRIES + 1):
        if waiting_thread is None or not waiting_thread.is_alive():
            waiting_thread = _in_thread(wait_for_end)
        status = 503
        with contextlib.suppress(OSError, http.client.HTTPException):
            status, _ = post(page, level, 0, _PAGE_TIMEOUT_S)
        if status < 300:
            return n_requests
        if 400 <= status < 500:
            return 0
        time.sleep(_PAGE_RETRY_S)
    return 0


def stop_by_control(
    agents: str, level: str, timeout_s: float = _LONGEST_S, number: int | str = 1
) -> str | bytes:
    """Send a stop to `/control` of the agent server, without a token; return the first message.

    number: the request's id.
    """
    from websockets.sync.client import connect

    with connect(f"{agents}/control", open_timeout=timeout_s) as client:
        client.send(json.dumps({"type": "stop", "id": number, "level": level}))
        return client.recv(timeout_s)


def _send_signals(daemon: subprocess.Popen[bytes], *, twice: bool) -> None:
    daemon.send_signal(signal.SIGTERM)
    if twice:
        time.sleep(0.05)
        daemon.send_signal(signal.SIGTERM)


def _in_thread(work: Callable[[], object], answers: list[str] | None = None) -> threading.Thread:
    """Start `work` in a daemon thread; append its result or exception as text to `answers`."""

    def note_result() -> None:
        try:
            answer = str(work())
        except Exception as error:  # whatever goes wrong here is seen at the servos
            answer = f"{type(error).__name__}: {error}"
        if answers is not None:
            answers.append(answer[:_LONGEST_LINE])

    thread = threading.Thread(target=note_result, daemon=True)
    thread.start()
    return thread
