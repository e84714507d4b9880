"""Stops against everything that may go wrong around them, on real processes and simulated servos.

A daemon speaks through a serial port of simulated servos that live in this process, so that torque
and shafts are seen as they are, whatever a program says of them. Then something goes wrong, a
client requests a stop at some moment of it, and what happens afterwards is watched. A daemon that a
start has brought back serves the next case; after a case that was not kept the next has a new one.

Whether a stop was kept, by the servos alone, and whether the face waits and comes back.

Rules. A servo is late that has torque 2 s after the stop was requested and it could be reached,
whichever came later; a soft stop eases within these 2 s. For a client that is a process (command
line, `connect`) the request is its launch and 1 s to load. A frozen shaft may brake for 0.4 s, for
1 s where the request goes through another process. Undone is every servo that gets torque after
0.4 s from the request on until a start is sent, or the watch is over.
"""

import contextlib
import os
import signal
import socket
import subprocess
import time
from collections import deque
from collections.abc import Iterator, Sequence
from threading import Thread
from typing import Final

from firmware_bridge.stopping import StopLevel
from lipservo_lab.bench.stops.raw_control import Answer, connected, receive, request_stop
from lipservo_lab.bench.stops.robot_at_port import robot_at_port
from lipservo_lab.bench.stops.running_face import START_S, RunningFace, running_face, start_daemon
from lipservo_lab.bench.stops.stop_cases import StopCase, StopOutcome
from lipservo_lab.bench.stops.stop_clients import (
    Addresses,
    Requested,
    StopClient,
    request_stop_by,
)
from lipservo_lab.bench.stops.troubles import (
    FIRST_TROUBLES,
    NEED_START,
    PLUG_OUT_S,
    Trouble,
    gone_wrong,
    n_others,
)

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
    """Count servos whose torque is late, comes back, or is on at the end of the watch.

    Counts are added to `outcome`. since_s: monotonic time of the request, or from which on the
    servos could be reached, whichever is later.
    """
    robot = face.robot
    robot.look(max(0.0, since_s + LATE_S - time.monotonic()))
    outcome.late = int(robot.torque.sum()) + _count_others_late(face, case)
    _watch(face, case, requested, outcome)
    outcome.torque_left_on = int(robot.torque.sum())
    outcome.limp_after_s = robot.stiff_until_s(since_s) if not outcome.undone else None


def judge_frozen(face: RunningFace, case: StopCase, since_s: float, outcome: StopOutcome) -> None:
    """Count shafts that move in a freeze, and servos that get torque; add both to `outcome`.

    For `FIRST_TROUBLES` a servo then gets a fault, which the status has to show. since_s: as of
    `judge_limp`.
    """
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
        outcome.fault_unseen = int(not _is_fault_shown(face))
        face.spent = True


def count_undone(face: RunningFace, case: StopCase, requested: Requested) -> int:
    """Return how many times a servo got torque since the stop's request had time to take effect."""
    return face.robot.switched_on(requested.requested_s + case.client.loads_s + BRAKES_S)


def judge_waiting(
    face: RunningFace, case: StopCase, requested: Requested, outcome: StopOutcome
) -> None:
    """Check that a face waits, limp, after a plain stop, whatever is killed or unplugged.

    What is wrong is added to `outcome`.
    """
    robot = face.robot
    if not face.look_until_state("stopped", _WAITS_S):
        has_ended = face.daemon.poll() is not None
        state = "its process has ended" if has_ended else f"it is {face.status().get('state')!r}"
        outcome.broken.append(f"after a plain stop it does not wait: {state}")
        outcome.undone = count_undone(face, case, requested)
        face.spent = True
        return
    _kill_children(face, case)
    if not face.look_until_state("stopped", _SERVED_S):
        outcome.broken.append("after its children were killed it does not wait")
    robot.look(0.3)
    robot.device.unplug()
    robot.look(_PLUG_OUT_S)
    robot.device.plug_in()
    robot.look(_PLUG_IN_S)
    outcome.undone = count_undone(face, case, requested)
    outcome.torque_left_on = max(outcome.torque_left_on, int(robot.torque.sum()))


def judge_start(face: RunningFace, outcome: StopOutcome) -> None:
    """Check that a start drives the face again; set `outcome.came_back`."""
    is_driven = face.status().get("state") == "driven"
    answer = {} if is_driven else face.start_again()
    outcome.came_back = face.robot.look_until(
        lambda: bool(face.robot.torque.all()), _STARTS_S
    ) and face.look_until_state("driven", _STARTS_S)
    if not outcome.came_back:
        status = face.status()
        outcome.answers += [f"start: {answer}", f"{status.get('state')}: {status.get('servos')}"]
        outcome.answers.append(f"log: ... {face.robot.last_output[-_LOG_END:]}")


def _watch(face: RunningFace, case: StopCase, requested: Requested, outcome: StopOutcome) -> None:
    """Watch until anything that undoes the stop would have shown; count it in `outcome`.

    Ends earlier once it has shown, the daemon has ended, or the status says that it is stopped. A
    daemon that should have ended, but has not, is added to `outcome.broken`.
    """
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


def _count_others_late(face: RunningFace, case: StopCase) -> int:
    """Return how many servos of the other faces still hold though they can be reached.

    Only a stop from the command line stops these.
    """
    if case.client is not StopClient.COMMAND or case.trouble is not Trouble.OTHER_DEAF:
        return 0
    return sum(int(other.robot.torque[1:].sum()) for other in face.others)


def judge_others(
    face: RunningFace, case: StopCase, requested: Requested, outcome: StopOutcome
) -> None:
    """Check that `lipservo stop` also releases a hung face by force, before the command ends.

    Does nothing for other clients and troubles. What is wrong is added to `outcome`.
    """
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
    """Kill the bridge of a stopped face, and for `FIRST_TROUBLES` its speech process, too."""
    child_names = ["bridge"]
    if case.trouble in FIRST_TROUBLES and not case.agents:
        child_names.append("speech")  # loading it again takes the most of a core
    for name in child_names:
        with contextlib.suppress(OSError, RuntimeError):
            os.kill(face.child(name), signal.SIGKILL)
    face.robot.look(0.1)


def _is_fault_shown(face: RunningFace) -> bool:
    """Give the first servo a hardware error; return whether the status shows it in time."""
    face.robot.chain.servos[0].latch(_HARDWARE_SHOCK)
    give_up_s = time.monotonic() + _SHOWN_S
    while time.monotonic() < give_up_s:
        if "shock" in " ".join(map(str, face.status().get("troubles", []))):
            return True
        face.robot.look(0.1)
    return False


#: A face that was started again speaks for so long before the next case.
_SPEAKS_S: Final = 0.7
_OVERLAP_TIMEOUT_S: Final = 10.0
_WATCH_OVERLAP_S: Final = 3.0


def play_batch(cases: Sequence[StopCase]) -> list[StopOutcome]:
    """Play cases that one face can serve, each to its end, in some ten seconds a case.

    Returns an outcome for each case. A new face is started where the last one cannot be used again.
    """
    outcomes = []
    waiting = deque(cases)
    while waiting:
        n_waiting = len(waiting)
        try:
            with _face_for(waiting[0]) as face:
                is_starting = waiting[0].trouble is Trouble.STARTING
                has_start = is_starting or face.knows_start()
                while waiting and not face.spent:
                    outcomes.append(_outcome_of(waiting.popleft(), face, has_start=has_start))
        except (OSError, RuntimeError, subprocess.SubprocessError) as error:
            if len(waiting) == n_waiting:
                failed = f"{type(error).__name__}: {error}"
                outcomes.append(StopOutcome(waiting.popleft(), error=failed))
    return outcomes


@contextlib.contextmanager
def _face_for(case: StopCase) -> Iterator[RunningFace]:
    """Yield a face for a case: driven, or for `Trouble.STARTING` just launched."""
    if case.trouble is not Trouble.STARTING:
        with running_face(
            bus=case.bus, page=case.page, agents=case.agents, n_others=n_others(case.trouble)
        ) as face:
            yield face
        return
    with robot_at_port(case.bus) as robot:
        daemon = start_daemon(robot, "--listen", "none")
        launched_s = time.monotonic()
        if not robot.look_until(lambda: bool(robot.controls), START_S):
            raise RuntimeError(f"no control socket: {robot.last_output}")
        robot.look(max(0.0, launched_s + case.moment_s - time.monotonic()))
        yield RunningFace(robot, daemon, Addresses(robot.controls[0]))


def _outcome_of(case: StopCase, face: RunningFace, *, has_start: bool) -> StopOutcome:
    """Return the outcome of one case; an exception becomes its `error`.

    Where the stop was not kept, or the daemon has ended, the face is marked as spent: no further
    case is played at it. has_start: the program under test knows the request `start`.
    """
    outcome = StopOutcome(case)
    face.robot.seen.clear()
    try:
        if case.trouble in NEED_START and not has_start:
            outcome.no_start = True
            return outcome
        _play_case(case, face, outcome, has_start=has_start)
    except (OSError, RuntimeError, subprocess.SubprocessError) as error:
        outcome.error = f"{type(error).__name__}: {error}"
    if not outcome.kept or face.daemon.poll() is not None:
        face.spent = True
    return outcome


def _play_case(case: StopCase, face: RunningFace, outcome: StopOutcome, *, has_start: bool) -> None:
    """Begin the case's trouble, request its stop, and add to `outcome` what servos did afterwards.

    At the end the face is started again where that is due, else marked as spent.
    """
    robot = face.robot
    if case.trouble is Trouble.EVERYBODY_KILLED:
        robot.look(case.moment_s)
    with gone_wrong(case.trouble, face) as reachable_s:
        if case.trouble in NEED_START:
            requested = _overlap_stop(case, face, outcome)
            if requested is None:
                judge_start(face, outcome)
                return
        else:
            is_past = case.trouble in (Trouble.STARTING, Trouble.EVERYBODY_KILLED)
            robot.look(0.0 if is_past else case.moment_s)
            requested = request_stop_by(case.client, case.level, robot, face.daemon, face.at)
        if case.trouble is Trouble.UNPLUGGED:
            robot.look(PLUG_OUT_S)
            robot.device.plug_in()
            reachable_s = time.monotonic()
        since_s = max(requested.requested_s + case.client.loads_s, reachable_s)
        if case.level is StopLevel.FREEZE:
            judge_frozen(face, case, since_s, outcome)
        else:
            judge_limp(face, case, requested, since_s, outcome)
        judge_others(face, case, requested, outcome)
    if requested.process is not None:
        requested.process.kill()  # it would request the stop once more of a face that is driven
    outcome.answers = list(requested.answers)
    if outcome.undone or case.client in (StopClient.SIGNAL, StopClient.NO_ONE):
        face.spent = True
    elif not has_start:
        outcome.no_start = case.is_plain
        face.spent = True
    elif case.trouble is Trouble.STARTING and not face.knows_start():
        outcome.no_start = face.spent = True
    elif case.is_plain:
        judge_waiting(face, case, requested, outcome)
        if outcome.kept and not face.spent:
            judge_start(face, outcome)
    elif not face.spent:
        judge_start(face, outcome)  # a frozen face goes on
    robot.look(_SPEAKS_S)


def _overlap_stop(case: StopCase, face: RunningFace, outcome: StopOutcome) -> Requested | None:
    """Send a stop and a start that overlap, as the case's trouble says.

    START_AGAIN: a stopped face is started, then stopped. Other troubles: the face is stopped, then
    started; it may be driven only if the stop was confirmed before the start was accepted. Returns
    the stop to be checked; None if the start came later, so that the face has to be driven.
    """
    robot, path = face.robot, face.at.control
    give_up_s = time.monotonic() + _OVERLAP_TIMEOUT_S
    if case.trouble is Trouble.START_AGAIN:
        _, report = request_stop(path, "limp", _OVERLAP_TIMEOUT_S)
        if report is None:
            raise RuntimeError("the stop before the start was not confirmed")
        answer = face.start_again()
        if answer.get("accepted") != "start":
            raise RuntimeError(f"a stopped face does not start: {answer}")
        robot.look(case.moment_s)
        robot.seen.clear()
        return request_stop_by(case.client, case.level, robot, face.daemon, face.at)
    with connected(path, give_up_s) as stopping, connected(path, give_up_s) as starting:
        requested = Requested(time.monotonic())
        stopping.send(case.level.value.encode())
        robot.look(case.moment_s)
        try:
            starting.send(b"start")
        except ConnectionError:
            return None  # all connections end with a confirmed stop
        came_s: dict[str, float] = {}
        answers: dict[str, Answer | None] = {}
        threads = [
            Thread(target=_receive_until, args=(each, name, came_s, answers, give_up_s))
            for each, name in ((stopping, "accepted"), (starting, "start"))
        ]
        for thread in threads:
            thread.start()
        robot.look_until(lambda: not any(each.is_alive() for each in threads), _OVERLAP_TIMEOUT_S)
        robot.look(_WATCH_OVERLAP_S)
    requested.answers = [f"{name}: {answer}" for name, answer in answers.items()]
    accepted = (answers.get("start") or {}).get("accepted") == "start"
    if accepted and came_s.get("ended", float("inf")) <= came_s["start"]:
        return None
    if accepted and count_undone(face, case, requested):
        outcome.broken.append("a start was accepted before the stop was confirmed")
    return requested


def _receive_until(
    end: socket.socket,
    name: str,
    came_s: dict[str, float],
    answers: dict[str, Answer | None],
    give_up_s: float,
) -> None:
    """Receive a request's answer, and of a stop also the report of its end; runs in a thread.

    name: "accepted" for the stop, "start" for the start. answers gets the answer under this name,
    the report under "ended"; came_s the monotonic times at which they came.
    """
    for key in (name, "ended") if name == "accepted" else (name,):
        with contextlib.suppress(OSError):
            answers[key] = receive(end, give_up_s)
            if answers[key] is not None:
                came_s[key] = time.monotonic()
