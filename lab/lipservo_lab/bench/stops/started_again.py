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
    """Let servos of a daemon fail, stop it and start it again; return a text for each case.

    Empty: the start drove the face; else why not, and the next case gets a new daemon. cases:
    (number of the servo that fails, level of the stop).
    """
    failures: list[str] = []
    with tempfile.TemporaryDirectory() as folder, processor_share("starts", 1.0) as share:
        sound = repeated(CLIP, Path(folder) / "sound.wav", _SOUND_S)
        while len(failures) < len(cases):
            with running_face(sound=sound) as face:
                while len(failures) < len(cases):
                    index, level = cases[len(failures)]
                    failures.append(_fail_stop_and_start(face, share, index, level))
                    if failures[-1]:
                        break
    return failures


def _fail_stop_and_start(face: RunningFace, share: ProcessorShare, number: int, level: str) -> str:
    """Jam a servo until it counts as failed, stop the face, and start it again.

    Returns why the face is not driven then; empty: it is. share: keeps a whole processor for
    speech.
    """
    robot = face.robot
    index = number % len(robot.servos)
    name = robot.servos[index].joint.name
    case = f"{name} failed, {level}"
    robot.seen.clear()
    share.keep(face.child("speech"))
    robot.chain.motors.jammed[index] = True
    has_failed = _look_until_servo(face, name, "failed", _FAILS_S)
    robot.chain.motors.jammed[index] = False
    if not has_failed:
        return f"{case}: it did not fail: {face.status().get('troubles')}"
    request_stop(face.at.control, level, _STOPS_S)
    if not face.look_until_state("frozen" if level == "freeze" else "stopped", _STOPS_S):
        return f"{case}: it is {face.status().get('state')!r} after the stop"
    start_answer = face.start_again()
    robot.look_until(lambda: bool(robot.torque.all()), _DRIVEN_S)
    if robot.torque.all() and _look_until_servo(face, name, "driven", _STOPS_S):
        return ""
    return f"{case}: not driven: {start_answer}, {face.status()}; log: {robot.last_output}"


def _look_until_servo(face: RunningFace, name: str, state: str, timeout_s: float) -> bool:
    """Watch until the status has this state for a servo; return whether it came in time."""
    give_up_s = time.monotonic() + timeout_s
    while time.monotonic() < give_up_s:
        if (face.status().get("servos") or {}).get(name) == state:
            return True
        face.robot.look(0.2)
    return False
