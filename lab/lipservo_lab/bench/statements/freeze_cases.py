"""Freezes in every state a face can be in, and whether what was answered is what was.

A freeze is answered with which servos hold and which are limp. From the answer on, until a start,
those that hold go on to hold, those that are limp stay limp, no servo gets torque, and no shaft
moves once it has braked. All of it by the servos' own log.
"""

import contextlib
import os
import signal
import subprocess
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import groupby, pairwise
from typing import Any, Final

from lipservo_lab.bench.statements.claims import OLD_S
from lipservo_lab.bench.statements.heard_face import HeardFace, heard_face
from lipservo_lab.bench.stops.faces_on_buses import BUSES
from lipservo_lab.bench.stops.raw_control import Answer
from lipservo_lab.bench.stops.robot_at_port import CLIP

#: What is known of the face is watched for so long after the answer.
_WATCH_S: Final = 1.2
#: A moving shaft brakes for so long; then it may not move by more than this.
_BRAKES_S, _STILL_DEG = 0.4, 1.0
#: Bytes that were sent before the answer may arrive so much later.
_ON_THE_WIRE_S: Final = 0.03
_STARTS_S: Final = 60.0


class Frozen(StrEnum):
    """The state in which the freeze comes."""

    RUN_STARTING = "run starting"  # a plain `run` arms its servos
    START_REQUESTED = "told to start"  # a stopped daemon with a critical servo
    STARTING = "starting"  # the same, once its first servo has torque
    DRIVEN = "driven"
    FROZEN = "frozen"
    EASING = "easing"
    LETTING_GO = "letting go"
    STOPPED = "stopped"
    SILENT = "silent"
    PORT_OUT = "port out"
    REPLUGGED = "replugged"
    BRIDGE_DEAD = "bridge dead"


#: How long after the state has begun the freeze comes.
_DELAYS_S: Final[dict[Frozen, tuple[float, ...]]] = {
    Frozen.RUN_STARTING: (0.0, 0.02, 0.3),
    Frozen.START_REQUESTED: (0.0, 0.3),
    Frozen.STARTING: (0.0, 0.02, 0.05, 0.12, 0.3, 0.55),
    Frozen.DRIVEN: (0.0, 0.37),
    Frozen.FROZEN: (0.2,),
    Frozen.EASING: (0.05, 0.3),
    Frozen.LETTING_GO: (0.0, 0.03),
    Frozen.STOPPED: (0.3,),
    Frozen.SILENT: (0.3,),
    Frozen.PORT_OUT: (0.0, 0.6),
    Frozen.REPLUGGED: (0.05,),
    Frozen.BRIDGE_DEAD: (0.0, 0.15),
}


@dataclass(frozen=True, slots=True)
class FreezeCase:
    """One freeze: on which bus, in which state, how long after that has begun."""

    bus: str
    state: Frozen
    delay_s: float

    def __str__(self) -> str:
        return f"freeze, {self.state}, {self.delay_s:g} s later, {self.bus}"


def freeze_cases() -> Iterator[FreezeCase]:
    """Yield all freezes: every bus, state and delay."""
    for bus in BUSES:
        for state, delays_s in _DELAYS_S.items():
            for delay_s in delays_s:
                yield FreezeCase(bus, state, delay_s)


@dataclass(slots=True)
class FreezeOutcome:
    """The outcome of one freeze. untrue: a line for each part of the answer that is not true.

    answer: as the face gave it. armed: how often a servo got torque after the answer. moved: shafts
    that moved. n_unknown: servos whose state the answer calls unknown. error: why the case itself
    did not work; empty: it did.
    """

    case: FreezeCase
    answer: Answer = field(default_factory=dict)
    untrue: list[str] = field(default_factory=list)
    armed: int = 0
    moved: int = 0
    n_unknown: int = 0
    error: str = ""

    @property
    def kept(self) -> bool:
        """Whether everything was as the answer says."""
        return not (self.untrue or self.armed or self.moved or self.error)

    def __str__(self) -> str:
        found = [*self.untrue, *([f"{self.armed} armed after it"] if self.armed else [])]
        found += [f"{self.moved} moved"] if self.moved else []
        found += [self.error] if self.error else []
        lists = {key: self.answer.get(key) for key in ("accepted", "holds", "limp", "unknown")}
        return f"{self.case}: {'; '.join(found) or 'kept'} (answered: {lists})"


def freeze_batches(cases: Sequence[FreezeCase]) -> list[list[FreezeCase]]:
    """Return the cases in batches that share a face; a case that starts a program has its own."""

    def batch_key(case: FreezeCase) -> tuple[str, bool]:
        return case.bus, case.state is Frozen.RUN_STARTING

    return [list(group) for _, group in groupby(sorted(cases, key=batch_key), batch_key)]


def play_freezes(cases: Sequence[FreezeCase]) -> list[FreezeOutcome]:
    """Play the cases of one batch, in some four seconds each; return an outcome for each case."""
    outcomes: list[FreezeOutcome] = []
    waiting = list(cases)
    while waiting:
        outcome = FreezeOutcome(waiting[0])
        try:
            with heard_face(waiting[0].bus, critical=True) as face:
                if waiting[0].state is Frozen.RUN_STARTING:
                    _play_during_run(face, waiting[0], outcome)
                    outcomes.append(outcome)
                    waiting.pop(0)
                    continue
                daemon = face.begin_face("daemon", "--listen", "none", "--wav", str(CLIP))
                while waiting:
                    if not face.wait_until_driven(_STARTS_S):
                        raise RuntimeError(f"not driven: {face.last_status.get('troubles')}")
                    face.wait(0.3)
                    outcome = FreezeOutcome(waiting[0])
                    _play_case(face, daemon, waiting[0], outcome)
                    outcomes.append(outcome)
                    waiting.pop(0)
                    _start_again(face)
        except (OSError, RuntimeError, subprocess.SubprocessError) as error:
            outcome.error = f"{type(error).__name__}: {error}"
            if waiting and outcome.case is waiting[0]:
                outcomes.append(outcome)
                waiting.pop(0)
    return outcomes


def freeze_figures(outcomes: Sequence[FreezeOutcome]) -> dict[str, Any]:
    """Return the number of cases and of untrue answers, and what servos did after a freeze.

    armed_after_freeze counts how often a servo got torque, moved_after_freeze shafts.
    freeze_unknown_share: share of servos of which an answer says only that their state is not
    known.
    """
    lists = [each.answer.get(key, ()) for each in outcomes for key in ("holds", "limp", "unknown")]
    n_named = sum(map(len, lists))
    n_unknown = sum(each.n_unknown for each in outcomes)
    return {
        "freeze_cases": len(outcomes),
        "untrue_answers": sum(bool(each.untrue) for each in outcomes),
        "armed_after_freeze": sum(each.armed for each in outcomes),
        "moved_after_freeze": sum(each.moved for each in outcomes),
        "freeze_unknown_share": n_unknown / n_named if n_named else 0.0,
        "freeze_errors": sum(bool(each.error) for each in outcomes),
    }


def _play_during_run(face: HeardFace, case: FreezeCase, outcome: FreezeOutcome) -> None:
    """Freeze a `run` while it switches the servos' torque on."""
    face.begin_face("run", "--wav", str(CLIP))
    _wait_for_torque(face)
    _freeze_and_judge(face, case, outcome)


def _play_case(
    face: HeardFace, daemon: subprocess.Popen[bytes], case: FreezeCase, outcome: FreezeOutcome
) -> None:
    """Bring a driven face into the state of a case, freeze it there, and judge the answer.

    Results are added to `outcome`. Raises RuntimeError where a stop or torque that the state needs
    does not come.
    """
    device = face.robot.device
    with contextlib.ExitStack() as undo:
        match case.state:
            case Frozen.START_REQUESTED | Frozen.STARTING:
                _stop_and_wait(face)
                face.send("start")
                if case.state is Frozen.STARTING:
                    _wait_for_torque(face)
            case Frozen.FROZEN:
                face.send("freeze")
            case Frozen.EASING:
                face.send("soft")
            case Frozen.LETTING_GO:
                face.send("limp")
            case Frozen.STOPPED:
                _stop_and_wait(face)
            case Frozen.SILENT:
                os.kill(face.child(daemon, "speech"), signal.SIGSTOP)
                face.wait_for_state("silent", timeout_s=10.0)
            case Frozen.PORT_OUT:
                device.unplug()
                undo.callback(device.plug_in)
                face.wait_until(lambda: face.last_status.get("plugged") is False, 5.0)
            case Frozen.REPLUGGED:
                device.unplug()
                face.wait(0.8)
                device.plug_in()
            case Frozen.BRIDGE_DEAD:
                os.kill(face.child(daemon, "bridge"), signal.SIGKILL)
            case _:
                pass
        _freeze_and_judge(face, case, outcome)


def _freeze_and_judge(face: HeardFace, case: FreezeCase, outcome: FreezeOutcome) -> None:
    """Request a freeze after the case's delay, watch the servos, and add results to `outcome`."""
    face.wait(case.delay_s)
    requested_s = time.monotonic()
    answer = outcome.answer = face.send("freeze")
    answered_s = time.monotonic()
    face.wait(_WATCH_S)
    judge_freeze(face, outcome, requested_s, answered_s)
    if not answer:
        outcome.untrue.append("no answer")


def judge_freeze(
    face: HeardFace, outcome: FreezeOutcome, requested_s: float, answered_s: float
) -> None:
    """Compare a freeze's answer with the servos' log, from the answer on until now.

    Adds to `outcome` what is untrue, servos that got torque, and shafts that moved. requested_s,
    answered_s: monotonic times.
    """
    device, answer = face.robot.device, outcome.answer
    names = list(face.robot.settings.servos)
    settled_s, now_s = answered_s + _ON_THE_WIRE_S, time.monotonic()
    records = device.during(settled_s, now_s)
    outcome.armed = sum(
        later.on[n] and not earlier.on[n]
        for earlier, later in pairwise(records)
        for n in range(len(names))
    )
    outcome.moved = int((device.travelled_deg(settled_s + _BRAKES_S) > _STILL_DEG).sum())
    outcome.n_unknown = len(answer.get("unknown", ()))
    is_listed = "holds" in answer
    claimed_torque = {
        "hold": (answer.get("holds", ()), True),
        "are limp": (answer.get("limp", ()), False),
    }
    for wording, (names_listed, on) in claimed_torque.items():
        wrong_names = [n for n in names_listed if not _was_always(records, names.index(n), on=on)]
        if wrong_names:
            outcome.untrue.append(f"{', '.join(wrong_names)} {wording}, it says")
    all_named = [each for key in ("holds", "limp", "unknown") for each in answer.get(key, ())]
    if is_listed and sorted(all_named) != sorted(names):
        outcome.untrue.append("not every servo is named once")
    records_around = device.during(requested_s - OLD_S, now_s)
    if answer.get("accepted") == "freeze" and not is_listed:
        if not any(any(each.on) for each in records_around):
            outcome.untrue.append("accepted, and nothing is held")
        if outcome.armed:
            outcome.untrue.append("accepted, and servos were armed after it")


def _was_always(records: Sequence[Any], index: int, *, on: bool) -> bool:
    return all(each.on[index] is on for each in records)


def _wait_for_torque(face: HeardFace) -> None:
    if not face.wait_until(lambda: bool(face.robot.torque.any()), _STARTS_S):
        raise RuntimeError("no servo got torque")


def _stop_and_wait(face: HeardFace) -> None:
    face.send("limp", until_end=True)
    if not face.wait_for_state("stopped", timeout_s=20.0):
        raise RuntimeError("it does not come to a stop")


def _start_again(face: HeardFace) -> None:
    """Request a start until it is accepted, the face is driven, or `_STARTS_S` have passed."""
    give_up_s = time.monotonic() + _STARTS_S
    while "error" in (answer := face.send("start")) or not answer:
        if "the next stop ends it" in answer.get("error", ""):
            face.send("limp", until_end=True)
        if face.last_status.get("state") == "driven" or time.monotonic() > give_up_s:
            return
        face.wait(0.3)
