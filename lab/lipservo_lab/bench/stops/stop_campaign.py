"""Stops against everything that may go wrong around them, on real processes and simulated servos.

A daemon speaks through a serial port of simulated servos that live in this process, so that torque
and shafts are seen as they are, whatever a program says of them. Then something goes wrong, a
client requests a stop at some moment of it, and what happens afterwards is watched. A daemon that a
start has brought back serves the next case; after a case that was not kept the next has a new one.
"""

import contextlib
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
from lipservo_lab.bench.stops.stop_cases import StopCase
from lipservo_lab.bench.stops.stop_clients import (
    Addresses,
    Requested,
    StopClient,
    request_stop_by,
)
from lipservo_lab.bench.stops.stop_judge import (
    count_undone,
    judge_frozen,
    judge_limp,
    judge_others,
    judge_start,
    judge_waiting,
)
from lipservo_lab.bench.stops.stop_outcome import StopOutcome
from lipservo_lab.bench.stops.troubles import (
    NEED_START,
    PLUG_OUT_S,
    Trouble,
    gone_wrong,
    n_others,
)

#: A face that was started again speaks for so long before the next case.
_SPEAKS_S: Final = 0.7
_MEETS_S: Final = 10.0
_WATCH_MEETING_S: Final = 3.0


def play_batch(cases: Sequence[StopCase]) -> list[StopOutcome]:
    """Play cases that one face can serve, each to its end; takes some ten seconds a case."""
    outcomes = []
    waiting = deque(cases)
    while waiting:
        n_waiting = len(waiting)
        try:
            with _face_for(waiting[0]) as face:
                is_starting = waiting[0].trouble is Trouble.STARTING
                has_start = is_starting or face.knows_start()
                while waiting and not face.spent:
                    outcomes.append(_played(waiting.popleft(), face, has_start=has_start))
        except (OSError, RuntimeError, subprocess.SubprocessError) as error:
            if len(waiting) == n_waiting:
                failed = f"{type(error).__name__}: {error}"
                outcomes.append(StopOutcome(waiting.popleft(), error=failed))
    return outcomes


@contextlib.contextmanager
def _face_for(case: StopCase) -> Iterator[RunningFace]:
    """A face as the case needs it: driven, or just launched."""
    if case.trouble is not Trouble.STARTING:
        with running_face(
            page=case.page, agents=case.agents, n_others=n_others(case.trouble)
        ) as face:
            yield face
        return
    with robot_at_port() as robot:
        daemon = start_daemon(robot, "--listen", "none")
        launched_s = time.monotonic()
        if not robot.look_until(lambda: bool(robot.controls), START_S):
            raise RuntimeError(f"no control socket: {robot.last_said}")
        robot.look(max(0.0, launched_s + case.moment_s - time.monotonic()))
        yield RunningFace(robot, daemon, Addresses(robot.controls[0]))


def _played(case: StopCase, face: RunningFace, *, has_start: bool) -> StopOutcome:
    outcome = StopOutcome(case)
    face.robot.seen.clear()
    try:
        if case.trouble in NEED_START and not has_start:
            outcome.no_start = True
            return outcome
        _play(case, face, outcome, has_start=has_start)
    except (OSError, RuntimeError, subprocess.SubprocessError) as error:
        outcome.error = f"{type(error).__name__}: {error}"
    if not outcome.kept or face.daemon.poll() is not None:
        face.spent = True
    return outcome


def _play(case: StopCase, face: RunningFace, outcome: StopOutcome, *, has_start: bool) -> None:
    robot = face.robot
    with gone_wrong(case.trouble, face) as reachable_s:
        if case.trouble in NEED_START:
            requested = _meet(case, face, outcome)
            if requested is None:
                judge_start(face, outcome)
                return
        else:
            robot.look(0.0 if case.trouble is Trouble.STARTING else case.moment_s)
            requested = request_stop_by(case.client, case.level, robot, face.daemon, face.at)
        if case.trouble is Trouble.UNPLUGGED:
            robot.look(PLUG_OUT_S)
            robot.chain.plug_in()
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
    if outcome.undone or case.client is StopClient.SIGNAL:
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


def _meet(case: StopCase, face: RunningFace, outcome: StopOutcome) -> Requested | None:
    """A stop and a start that meet; None: the start came after the confirmed stop, and counts.

    START_AGAIN: a stopped face is started, then stopped. The others: stopped, then started; the
    face may be driven only where the stop was confirmed before the start was accepted.
    """
    robot, path = face.robot, face.at.control
    give_up_s = time.monotonic() + _MEETS_S
    if case.trouble is Trouble.START_AGAIN:
        _, report = request_stop(path, "limp", _MEETS_S)
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
        robot.look_until(lambda: not any(each.is_alive() for each in threads), _MEETS_S)
        robot.look(_WATCH_MEETING_S)
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
    """The answer; of a stop its end, too. came_s: when each came."""
    for each in (name, "ended") if name == "accepted" else (name,):
        with contextlib.suppress(OSError):
            answers[each] = receive(end, give_up_s)
            if answers[each] is not None:
                came_s[each] = time.monotonic()
