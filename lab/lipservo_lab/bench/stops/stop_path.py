"""How much of ours a stop passes on its way: files and calls from its arrival to the command queue.

On real processes with the real code; `lipservo_lab.bench.stops.traced` says where a walk begins and
ends. Summed over the processes that a stop passes: the server of the page or of voice agents, then
the process that owns the control socket.
"""

import contextlib
import http.client
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

from firmware_bridge.stopping import StopLevel
from lipservo_lab.bench.stops import traced
from lipservo_lab.bench.stops.raw_control import request
from lipservo_lab.bench.stops.running_face import RunningFace, running_face

#: Bars of both figures: one file is the room that is kept for stops beside idle connections.
MOST_FILES: Final = 7
MOST_CALLS: Final = 40
#: The tracer in each process has seen the flag after this.
_FLAG_S: Final = 0.2
_COMES_S: Final = 10.0
_TIMEOUT_S: Final = 10.0
_OWNER: Final = "bridge-process"

Walk = dict[str, Any]


def stop_path_figures() -> dict[str, Any]:
    """files, calls: of a freeze by the worst client; by_client: of each, with its walk.

    Raises RuntimeError where a stop does not come to the queue.
    """
    with running_face(page=True, agents=True, tracer=traced) as face:
        found = {name: _traced(face, StopLevel.FREEZE, stop) for name, stop in _CLIENTS.items()}
    return {
        "files": max(each["files"] for each in found.values()),
        "calls": max(each["calls"] for each in found.values()),
        "by_client": found,
    }


def register_files(level: StopLevel) -> set[str]:
    """Files of ours between a press of the page's STOP and the register of torque.

    Raises RuntimeError where the stop does not come to it.
    """
    with running_face(page=True, tracer=traced) as face:
        walk = _traced(face, level, _by_page)["walk"]
        came = face.robot.look_until(lambda: bool(_walks(face.inject, "register")), _COMES_S)
        if not came:
            raise RuntimeError(f"a {level} stop did not come to the register of torque: {walk}")
        register = _walks(face.inject, "register")[0]["calls"]
    passed = {call.rpartition(":")[0] for calls in walk.values() for call in calls}
    return passed | {file for file, _ in register}


def _traced(
    face: RunningFace, level: StopLevel, stop: Callable[[RunningFace, StopLevel], None]
) -> dict[str, Any]:
    for path in face.inject.glob("walk.*.json"):
        path.unlink()
    flag = face.inject / traced.FLAG
    flag.touch()
    face.robot.look(_FLAG_S)
    try:
        stop(face, level)
        came = face.robot.look_until(lambda: _comes_to_queue(face.inject), _COMES_S)
    finally:
        face.robot.look(_FLAG_S)
        flag.unlink()
    walks = _walks(face.inject)
    if not came:
        raise RuntimeError(f"a {level} stop did not come to the queue: {walks}")
    return counted(walks)


def counted(walks: Sequence[Walk]) -> dict[str, Any]:
    """Files and calls of the walks of one stop, and what it passed in each process."""
    calls = [tuple(call) for walk in walks for call in walk["calls"]]
    return {
        "files": len({file for file, _ in calls}),
        "calls": len(calls),
        "walk": {
            walk["role"]: [f"{file}:{function}" for file, function in walk["calls"]]
            for walk in walks
        },
    }


def _walks(folder: Path, kind: str = "walk") -> list[Walk]:
    """Return the walks of the newest stop; the server's first."""
    found = [json.loads(path.read_text()) for path in sorted(folder.glob(f"{kind}.*.json"))]
    return sorted(found, key=lambda walk: walk["role"] == _OWNER)


def _comes_to_queue(folder: Path) -> bool:
    return any(walk["calls"][-1][1] == traced.QUEUE for walk in _walks(folder))


def _by_socket(face: RunningFace, level: StopLevel) -> None:
    """Bytes on the control socket, as the command line sends them."""
    request(face.at.control, level.value, _TIMEOUT_S)


def _by_page(face: RunningFace, level: StopLevel) -> None:
    """Stop by the page's button."""
    _post(face, level, 0)


def _by_api(face: RunningFace, level: StopLevel) -> None:
    """A program that waits for the end."""
    _post(face, level, 1)


def _post(face: RunningFace, level: StopLevel, wait_s: int) -> None:
    connection = http.client.HTTPConnection(urlsplit(face.at.page).netloc, timeout=_TIMEOUT_S)
    headers = {
        "Content-Type": "application/json",
        "Origin": face.at.page,
        "Sec-Fetch-Site": "same-origin",
        "User-Agent": traced.MARKER,
    }
    with contextlib.closing(connection):
        body = json.dumps({"level": level, "wait_s": wait_s})
        connection.request("POST", "/api/stop", body, headers)
        connection.getresponse().read()


def _by_control(face: RunningFace, level: StopLevel) -> None:
    """A voice agent, as `connect().stop()` does."""
    from websockets.sync.client import connect

    with connect(f"{face.at.agents}/control", open_timeout=_TIMEOUT_S) as client:
        client.send(json.dumps({"type": "stop", "id": traced.MARKER, "level": level}))
        client.recv(_TIMEOUT_S)


_CLIENTS: Final = {
    "socket": _by_socket,
    "page": _by_page,
    "api": _by_api,
    "control": _by_control,
}
