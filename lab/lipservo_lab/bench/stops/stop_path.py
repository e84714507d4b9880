"""What of ours a stop passes on its way: files and calls from its arrival to the command queue.

On real processes with the real code; `lipservo_lab.bench.stops.traced` says where a walk begins and
ends. Summed over the processes that a stop passes: the server of the page or of voice agents, then
the process that owns the control socket.
"""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

from firmware_bridge.stopping import StopLevel
from lipservo_lab.bench.stops import traced
from lipservo_lab.bench.stops.running_face import RunningFace, running_face
from lipservo_lab.bench.stops.stop_clients import post_stop

#: The tracer in each process has seen the flag after this.
_FLAG_S: Final = 0.2
_COMES_S: Final = 10.0
TIMEOUT_S: Final = 10.0
_OWNER: Final = "bridge-process"

Walk = dict[str, Any]


def register_files(level: StopLevel) -> set[str]:
    """Files of ours between a press of the page's STOP and the register of torque.

    Raises RuntimeError where the stop does not come to it.
    """
    with running_face(page=True, tracer=traced) as face:
        page, marker = face.at.page, traced.MARKER
        walk = traced_stop(face, lambda: post_stop(page, level, 0, TIMEOUT_S, marker))["walk"]
        came = face.robot.look_until(lambda: bool(_walks(face.inject, "register")), _COMES_S)
        if not came:
            raise RuntimeError(f"a {level} stop did not come to the register of torque: {walk}")
        register = _walks(face.inject, "register")[0]["calls"]
    passed = {call.rpartition(":")[0] for calls in walk.values() for call in calls}
    return passed | {file for file, _ in register}


def traced_stop(face: RunningFace, stop: Callable[[], object]) -> dict[str, Any]:
    """Request a stop and return the files and calls that it passes.

    stop: requests it, with `MARKER` in the request. Raises RuntimeError where the stop does not
    reach the queue.
    """
    for path in face.inject.glob("walk.*.json"):
        path.unlink()
    flag = face.inject / traced.FLAG
    flag.touch()
    face.robot.look(_FLAG_S)
    try:
        stop()
        came = face.robot.look_until(lambda: _comes_to_queue(face.inject), _COMES_S)
    finally:
        face.robot.look(_FLAG_S)
        flag.unlink()
    walks = _walks(face.inject)
    if not came:
        raise RuntimeError(f"a stop did not come to the queue: {walks}")
    return counted(walks)


def counted(walks: Sequence[Walk]) -> dict[str, Any]:
    """Return files and calls of the walks of one stop, and the functions in each process."""
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
