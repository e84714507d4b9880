"""Starts by a person after a servo has failed for good, of a cause that is over.

Speech has a whole processor: on a machine that does other things it falls silent, and a servo that
follows nothing does not fail.
"""

import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from lipservo_lab.bench.stops.busy_computer import ProcessorShare, processor_share
from lipservo_lab.bench.stops.raw_control import request_stop
from lipservo_lab.bench.stops.robot_at_port import CLIP
from lipservo_lab.bench.stops.running_face import RunningFace, running_face
from lipservo_lab.repeated_recording import repeated

LEVELS: Final = ("soft", "limp", "freeze")
_SOUND_S: Final = 3600.0
#: A jam is named four times, with a second's rest and two to catch up between.
_FAILS_S: Final = 240.0
_STOPS_S: Final = 15.0
_DRIVEN_S: Final = 30.0


def play_starts(cases: Sequence[tuple[int, str]]) -> list[str]:
    """Fail, stop and start servos of a daemon; return "" for each start that drove the face.

    Otherwise a line that says why; then a new daemon follows. cases: (number of the servo that
    fails, level of the stop).
    """
    outcomes: list[str] = []
    with tempfile.TemporaryDirectory() as folder, processor_share("starts", 1.0) as share:
        sound = repeated(CLIP, Path(folder) / "sound.wav", _SOUND_S)
        while len(outcomes) < len(cases):
            with running_face(sound=sound) as face:
                while len(outcomes) < len(cases):
                    index, level = cases[len(outcomes)]
                    outcomes.append(_play(face, share, index, level))
                    if outcomes[-1]:
                        break
    return outcomes


def _play(face: RunningFace, share: ProcessorShare, number: int, level: str) -> str:
    """Return why the face is not driven after the start; empty: it is."""
    robot = face.robot
    index = number % len(robot.servos)
    name = robot.servos[index].joint.name
    case = f"{name} failed, {level}"
    robot.seen.clear()
    share.keep(face.child("speech"))
    robot.chain.motors.jammed[index] = True
    failed = _look_until_servo(face, name, "failed", _FAILS_S)
    robot.chain.motors.jammed[index] = False
    if not failed:
        return f"{case}: it did not fail: {face.status().get('troubles')}"
    request_stop(face.at.control, level, _STOPS_S)
    if not face.look_until_state("frozen" if level == "freeze" else "stopped", _STOPS_S):
        return f"{case}: it is {face.status().get('state')!r} after the stop"
    answer = face.start_again()
    robot.look_until(lambda: bool(robot.torque.all()), _DRIVEN_S)
    if robot.torque.all() and _look_until_servo(face, name, "driven", _STOPS_S):
        return ""
    return f"{case}: not driven: {answer}, {face.status().get('servos')}"


def _look_until_servo(face: RunningFace, name: str, state: str, timeout_s: float) -> bool:
    give_up_s = time.monotonic() + timeout_s
    while time.monotonic() < give_up_s:
        if (face.status().get("servos") or {}).get(name) == state:
            return True
        face.robot.look(0.2)
    return False
