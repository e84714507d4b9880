"""Whether a stop was kept, by the servos alone, and whether the face waits and comes back.

Rules. A servo is late that has torque 2 s after the stop was requested and it could be reached,
whichever came later; a soft stop eases within these 2 s. For a client that is a process (command
line, `connect`) the request is its launch and 1 s to load. A frozen shaft may brake for 0.4 s, for
1 s where the request goes through another process. Undone is every servo that gets torque after
0.4 s from the request on until a start is sent, or the watch is over.
"""

import contextlib
import os
import signal
import time
from typing import Final

from firmware_bridge.stopping import StopLevel
from lipservo_lab.bench.stops.running_face import RunningFace
from lipservo_lab.bench.stops.stop_cases import StopCase
from lipservo_lab.bench.stops.stop_clients import Requested, StopClient
from lipservo_lab.bench.stops.stop_outcome import StopOutcome
from lipservo_lab.bench.stops.troubles import FIRST_TROUBLES, Trouble

#: Torque must be off so long after the servos can be reached.
LATE_S: Final = 2.0
#: A frozen face brakes first; then no shaft may move by more than this.
BRAKES_S, _THROUGH_OTHERS_S, _STILL_DEG = 0.4, 0.6, 1.0
#: After that everything is watched for so much longer; a slow name service takes 4 s, a bridge that
#: hung in it is killed after another, and one more begins to drive some seconds later.
_WATCH_S: Final = 4.0
_WATCH_SLOW_S: Final = 14.0
#: A face that has come to its end within that watch, and says so, is watched no longer than this.
_SETTLED_S: Final = 0.7
#: A fault of a frozen servo must be in the status within this time.
_SHOWN_S: Final = 6.0
_WAITS_S: Final = 15.0
_SERVED_S: Final = 20.0
_STARTS_S: Final = 20.0
_OTHERS_S: Final = 30.0
_PLUG_OUT_S, _PLUG_IN_S = 0.4, 1.0
_LOG_END: Final = 500
_HARDWARE_SHOCK: Final = 0x10
_STATUS_TROUBLES: Final = (Trouble.STATUS_RAISES, Trouble.STATUS_HANGS)


def judge_limp(
    face: RunningFace, case: StopCase, requested: Requested, since_s: float, outcome: StopOutcome
) -> None:
    """Torque off in time, and still off at the end of the watch. since_s: of both, the later."""
    robot = face.robot
    robot.look(max(0.0, since_s + LATE_S - time.monotonic()))
    outcome.late = int(robot.torque.sum()) + _others_late(face, case)
    _watch(face, case, requested, outcome)
    outcome.torque_left_on = int(robot.torque.sum())
    outcome.limp_after_s = robot.stiff_until_s(since_s) if not outcome.undone else None


def judge_frozen(face: RunningFace, case: StopCase, since_s: float, outcome: StopOutcome) -> None:
    """Held or limp, but where it was; none gets torque; a servo's fault is in the status."""
    robot = face.robot
    brakes_s = BRAKES_S + (0.0 if case.client is StopClient.SOCKET else _THROUGH_OTHERS_S)
    robot.look(max(0.0, since_s + brakes_s - time.monotonic()))
    watched_s = time.monotonic()
    robot.look(_WATCH_S)
    if case.trouble is Trouble.NAME_SERVICE and face.status().get("state") != "frozen":
        robot.look(_WATCH_SLOW_S - _WATCH_S)
    outcome.moved_frozen = int((robot.moved_deg(watched_s) > _STILL_DEG).sum())
    outcome.undone = robot.switched_on(watched_s)
    if case.trouble in FIRST_TROUBLES:
        outcome.fault_unseen = int(not _fault_shown(face))
        face.spent = True


def count_undone(face: RunningFace, case: StopCase, requested: Requested) -> int:
    """How many times a servo got torque since the stop."""
    return face.robot.switched_on(requested.requested_s + case.client.loads_s + BRAKES_S)


def judge_waiting(
    face: RunningFace, case: StopCase, requested: Requested, outcome: StopOutcome
) -> None:
    """After a plain stop: it waits, limp, whatever is killed or unplugged, until it is started."""
    robot = face.robot
    if not face.look_until_state("stopped", _WAITS_S):
        ended = face.daemon.poll() is not None
        state = "its process has ended" if ended else f"it is {face.status().get('state')!r}"
        outcome.broken.append(f"after a plain stop it does not wait: {state}")
        outcome.undone = count_undone(face, case, requested)
        face.spent = True
        return
    _kill_children(face, case)
    if not face.look_until_state("stopped", _SERVED_S):
        outcome.broken.append("after its children were killed it does not wait")
    robot.look(0.3)
    robot.chain.unplug()
    robot.look(_PLUG_OUT_S)
    robot.chain.plug_in()
    robot.look(_PLUG_IN_S)
    outcome.undone = count_undone(face, case, requested)
    outcome.torque_left_on = max(outcome.torque_left_on, int(robot.torque.sum()))


def judge_start(face: RunningFace, outcome: StopOutcome) -> None:
    """A start drives it again."""
    is_driven = face.status().get("state") == "driven"
    answer = {} if is_driven else face.start_again()
    outcome.came_back = face.robot.look_until(
        lambda: bool(face.robot.torque.all()), _STARTS_S
    ) and face.look_until_state("driven", _STARTS_S)
    if not outcome.came_back:
        status = face.status()
        outcome.answers += [f"start: {answer}", f"{status.get('state')}: {status.get('servos')}"]
        outcome.answers.append(f"log: ... {face.robot.last_said[-_LOG_END:]}")


def _watch(face: RunningFace, case: StopCase, requested: Requested, outcome: StopOutcome) -> None:
    """Long enough that whatever undoes a stop shows; shorter where it has, or nothing is left."""
    began_s = time.monotonic()
    slow = case.trouble is Trouble.NAME_SERVICE or not case.is_plain
    while (watched_s := time.monotonic() - began_s) < (_WATCH_SLOW_S if slow else _WATCH_S):
        face.robot.look(0.2)
        outcome.undone = count_undone(face, case, requested)
        is_over = face.daemon.poll() is not None
        if outcome.undone or (is_over and watched_s > _SETTLED_S):
            return
        may_look = case.is_plain and case.trouble not in _STATUS_TROUBLES
        if watched_s > _SETTLED_S and may_look and face.status().get("state") == "stopped":
            return
    if not case.is_plain:
        outcome.broken.append("the daemon has not ended")


def _others_late(face: RunningFace, case: StopCase) -> int:
    """Servos of the faces beside it that can be reached: only the command line stops these."""
    if case.client is not StopClient.COMMAND or case.trouble is not Trouble.OTHER_DEAF:
        return 0
    return sum(int(other.robot.torque[1:].sum()) for other in face.others)


def judge_others(
    face: RunningFace, case: StopCase, requested: Requested, outcome: StopOutcome
) -> None:
    """`lipservo stop` lets go of a face that hangs, too, by force, before it ends."""
    process = requested.process
    if process is None or case.client is not StopClient.COMMAND or not face.others:
        return
    face.spent = True
    if case.trouble is not Trouble.OTHER_HUNG or case.level is StopLevel.FREEZE:
        return
    if not face.robot.look_until(lambda: process.poll() is not None, _OTHERS_S):
        outcome.broken.append(f"`lipservo stop` has not ended within {_OTHERS_S:g} s")
    for other in face.others:
        outcome.torque_left_on += int(other.robot.torque.sum())


def _kill_children(face: RunningFace, case: StopCase) -> None:
    names = ["bridge"]
    if case.trouble in FIRST_TROUBLES and not case.agents:
        names.append("speech")  # loading it again takes the most of a core
    for name in names:
        with contextlib.suppress(OSError, RuntimeError):
            os.kill(face.child(name), signal.SIGKILL)
    face.robot.look(0.1)


def _fault_shown(face: RunningFace) -> bool:
    face.robot.chain.servos[0].latch(_HARDWARE_SHOCK)
    give_up_s = time.monotonic() + _SHOWN_S
    while time.monotonic() < give_up_s:
        if "shock" in " ".join(map(str, face.status().get("troubles", []))):
            return True
        face.robot.look(0.1)
    return False
