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
    """Return the source files that a stop passes, from the page's STOP to the torque register.

    A face is started and stopped for that. Raises RuntimeError where the stop does not get there.
    """
    with running_face(page=True, tracer=traced) as face:
        page, marker = face.at.page, traced.MARKER
        walk = traced_stop(face, lambda: post_stop(page, level, 0, TIMEOUT_S, marker))["walk"]
        came = face.robot.look_until(lambda: bool(_read_walks(face.inject, "register")), _COMES_S)
        if not came:
            raise RuntimeError(f"a {level} stop did not come to the register of torque: {walk}")
        register_calls = _read_walks(face.inject, "register")[0]["calls"]
    passed_files = {call.rpartition(":")[0] for calls in walk.values() for call in calls}
    return passed_files | {file for file, _ in register_calls}


def traced_stop(face: RunningFace, stop: Callable[[], object]) -> dict[str, Any]:
    """Request a stop of a traced face; return the files and calls that it passes, as `counted`.

    stop: requests it, with `MARKER` in the request. Raises RuntimeError where the stop does not
    reach the command queue.
    """
    for path in face.inject.glob("walk.*.json"):
        path.unlink()
    flag = face.inject / traced.FLAG
    flag.touch()
    face.robot.look(_FLAG_S)
    try:
        stop()
        came = face.robot.look_until(lambda: _has_reached_queue(face.inject), _COMES_S)
    finally:
        face.robot.look(_FLAG_S)
        flag.unlink()
    walks = _read_walks(face.inject)
    if not came:
        raise RuntimeError(f"a stop did not come to the queue: {walks}")
    return counted(walks)


def counted(walks: Sequence[Walk]) -> dict[str, Any]:
    """Return how many files and calls one stop's walks have, and its functions by process."""
    all_calls = [tuple(call) for walk in walks for call in walk["calls"]]
    return {
        "files": len({file for file, _ in all_calls}),
        "calls": len(all_calls),
        "walk": {
            walk["role"]: [f"{file}:{function}" for file, function in walk["calls"]]
            for walk in walks
        },
    }


def _read_walks(folder: Path, kind: str = "walk") -> list[Walk]:
    """Read the walks of the newest stop that processes have written; the server's comes first.

    kind: "walk", or "register" for that of the tick that clears the torque register.
    """
    found = [json.loads(path.read_text()) for path in sorted(folder.glob(f"{kind}.*.json"))]
    return sorted(found, key=lambda walk: walk["role"] == _OWNER)


def _has_reached_queue(folder: Path) -> bool:
    """Return whether a stop has reached the command queue in some process."""
    return any(walk["calls"][-1][1] == traced.QUEUE for walk in _read_walks(folder))
