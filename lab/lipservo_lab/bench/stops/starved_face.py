"""A face of sixteen servos that speaks on a tenth of a processor: who is accused, who is killed.

A daemon on simulated servos, which live in this process; bridge and speech get a tenth of a
processor each. Meanwhile real jams must be named, and processes that are held by SIGSTOP killed:
first the jams, then the holds. Only while a jam is waited for may speech run more: at a tenth it
falls silent, the face lets go of its servos, and nothing would have to follow.
"""

import contextlib
import os
import re
import signal
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from io import TextIOWrapper
from pathlib import Path
from typing import Final

from firmware_bridge.process.control_client import switch_servo
from firmware_bridge.process.runtime_folder import ControlError
from firmware_bridge.stopping import ServoSwitch
from lipservo_lab.bench.stops.busy_computer import ProcessorShare, processor_share
from lipservo_lab.bench.stops.robot_at_port import CLIP
from lipservo_lab.bench.stops.running_face import RunningFace, running_face
from lipservo_lab.repeated_recording import repeated
from lipservo_lab.seen_processes import children_of, processor_s, state_of

_FACE: Final = "face_head"
#: Those that speech moves all the time.
_N_MOUTH: Final = 10
#: Bars: a jam is named within so much time that the bridge ran; a held process is killed within its
#: time, and what the supervisor takes to look.
NAMED_WITHIN_S: Final = 5.0
_TO_LOOK_S: Final = 0.5
_HUNG_S: Final = {"bridge": 1.0, "speech": 3.0}
#: Jams take this share of the minutes; the holds come afterwards, and take the time they take.
_JAMS_SHARE: Final = 0.6
#: What each process gets of a processor, and speech while servos must follow it.
_SHARE, _SPEAKS_SHARE = 0.1, 0.8
_STEP_S: Final = 0.05
_PATIENCE_S: Final = 300.0
_NAMED: Final = re.compile(r"servo '(\w+)' \(id \d+\) does not (?:follow|move)")
_CALLED_SILENT: Final = re.compile(r"servo '(\w+)' \(id \d+\) does not (?:answer|take)")


@dataclass(slots=True)
class StarvedOutcome:
    """The result of the campaign. failures: a line for each thing that must not happen.

    accused: servos reported as jammed that were not. called_silent: reports that a healthy servo
    does not answer; no limit. killed_starved: processes that ended although they were not held.
    jams_named: jams reported in time. held, hung_killed: processes held by SIGSTOP, and those of
    them killed in time. driven: share of servos with torque, at each step.
    """

    accused: int = 0
    called_silent: int = 0
    killed_starved: int = 0
    jams: int = 0
    jams_named: int = 0
    held: int = 0
    hung_killed: int = 0
    driven: list[float] = field(default_factory=list)
    minutes: float = 0.0
    failures: list[str] = field(default_factory=list)


class StarvedFace:
    """A running face whose processes starve, with its log so far."""

    def __init__(
        self, face: RunningFace, shares: dict[str, ProcessorShare], log: TextIOWrapper
    ) -> None:
        self.face = face
        self.outcome = StarvedOutcome()
        self._shares = shares
        #: The bridge needs less than a tenth; with it in its group is a loop that uses up the rest.
        self._hog = face.robot.start_python("-c", "while True: pass").pid
        self._kinds = {self._hog: "bridge"}
        self._log = log
        self._names = list(face.status()["servos"])
        self._jammed_names: set[str] = set()
        self._named_now: set[str] = set()
        self.named: list[str] = []
        self._held_pids: set[int] = set()

    def step(self, seconds: float = _STEP_S) -> None:
        """Let time pass; keep every process of the face in its group, and read the log."""
        until_s = time.monotonic() + seconds
        while True:
            for pid in {*children_of(self.face.daemon.pid), *self._kinds}:
                if kind := self._process_kind(pid):
                    self._shares[kind].keep(pid)
            for line in self._log.readlines():
                self._read_log_line(line)
            self.outcome.driven.append(float(self.face.robot.torque.mean()))
            if time.monotonic() >= until_s:
                return
            time.sleep(_STEP_S)

    def step_until(self, condition: Callable[[], bool], timeout_s: float = _PATIENCE_S) -> bool:
        """Do steps until `condition` holds; return False if it does not within `timeout_s`."""
        give_up_s = time.monotonic() + timeout_s
        while time.monotonic() < give_up_s:
            self.step()
            if condition():
                return True
        return False

    def _process_kind(self, pid: int) -> str:
        """Return whether a process is the "bridge" or "speech" process; empty: neither, or unknown.

        A bridge's hog counts as "bridge".
        """
        if pid not in self._kinds:
            with contextlib.suppress(OSError):
                command_line = Path(f"/proc/{pid}/cmdline").read_text(errors="replace")
                for kind in self._shares:
                    if f"{kind}-process" in command_line:
                        self._kinds[pid] = kind
        return self._kinds.get(pid, "")

    def _read_log_line(self, line: str) -> None:
        """Count the servos that a line of the log calls jammed or silent.

        A report of a jam is right for a servo that is jammed.
        """
        self.outcome.called_silent += len(_CALLED_SILENT.findall(line))
        named = set(_NAMED.findall(line))
        for name in named - self._named_now:
            self.named.append(name)
            if name not in self._jammed_names:
                self.outcome.accused += 1
                self.outcome.failures.append(f"accused although it was not jammed: {line.strip()}")
        if named or "holds again" in line:
            self._named_now = named

    def _is_driven(self, name: str) -> bool:
        """Return whether a servo is driven; switch one on that has failed, as a person would."""
        state = self.face.status().get("servos", {}).get(name)
        self.face.robot.seen.clear()
        if state == "failed":
            with contextlib.suppress(OSError, ControlError):
                switch_servo(self.face.at.control, name, ServoSwitch.ON)
        return bool(state == "driven")

    def jam(self, number: int) -> None:
        """Jam one servo of the mouth until a log line names it; wait until it is driven again.

        A jam has to be named before the bridge has run for `NAMED_WITHIN_S` of processor time.
        """
        motors = self.face.robot.chain.motors
        index = number % _N_MOUTH
        name = self._names[index]
        self.outcome.jams += 1
        self._shares["speech"].share = _SPEAKS_SHARE
        if not self.step_until(lambda: self._is_driven(name)):
            self.outcome.failures.append(f"{name} was not driven, and could not be jammed")
            return
        bridge = self.face.child("bridge")
        # Seconds of the bridge's processor time: only while it runs can it notice the jam.
        began_s, n_named = processor_s(bridge), len(self.named)
        self._jammed_names.add(name)
        motors.jammed[index] = True
        self.step_until(
            lambda: name in self.named[n_named:] or processor_s(bridge) > began_s + NAMED_WITHIN_S
        )
        needed_s = processor_s(bridge) - began_s
        if name in self.named[n_named:] and needed_s <= NAMED_WITHIN_S:
            self.outcome.jams_named += 1
        else:
            self.outcome.failures.append(f"{name} was jammed, and not named in {needed_s:.1f} s")
        motors.jammed[index] = False
        self._shares["speech"].share = _SHARE
        if self.step_until(lambda: self._is_driven(name)):
            self._jammed_names.discard(name)

    def hold(self, kind: str) -> None:
        """Hold a process by SIGSTOP after a heartbeat; count whether it is killed in time.

        kind: "bridge" or "speech".
        """
        if not self.step_until(lambda: self._has_heartbeat(kind)):
            self.outcome.held += 1
            self.outcome.failures.append(f"{kind} did not begin, and could not be held")
            return
        pid = self.face.child(kind)
        self.outcome.held += 1
        self._held_pids.add(pid)
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGSTOP)
        self.step_until(lambda: state_of(pid) in ("T", ""))
        held_s = time.monotonic()
        while state_of(pid) and time.monotonic() < held_s + _HUNG_S[kind] + _TO_LOOK_S:
            time.sleep(0.01)
        if state_of(pid):
            self.outcome.failures.append(
                f"{kind} was held, and not killed within {_HUNG_S[kind]:g} s"
            )
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)
        else:
            self.outcome.hung_killed += 1
        self.step_until(lambda: pid not in children_of(self.face.daemon.pid))

    def note_ended(self) -> None:
        """Count the processes that have ended although they were not held."""
        excused = {self._hog, *self._held_pids, *children_of(self.face.daemon.pid)}
        for pid in sorted(self._kinds.keys() - excused):
            self.outcome.killed_starved += 1
            self.outcome.failures.append(f"{self._kinds[pid]} {pid} ended although it was not held")

    def _has_heartbeat(self, kind: str) -> bool:
        """Return whether the process that runs now has sent a heartbeat. kind: as of `hold`."""
        status = self.face.status()
        self.face.robot.seen.clear()
        if kind == "bridge":  # only one that beats is asked, and answers so
            try:
                return status.get("bridge_pid") == self.face.child("bridge")
            except RuntimeError:  # killed, and the next one waits its turn: restarts back off
                return False
        output = self.face.robot.output
        # The first began before anything was starved; the later ones say where they go on.
        return output.count("speech runs as process") <= output.count(" goes on at ") + 1


def play_starved(minutes: float, advance: Callable[[int, int], None]) -> StarvedOutcome:
    """Play the campaign: 20 jams and 20 held processes in 20 minutes, fewer in less time.

    advance: called with jams and holds done, and all of them.
    """
    n_each = max(1, round(min(minutes, 20.0)))
    with _starved_face(minutes) as starved:
        began_s = time.monotonic()
        for number in range(n_each):
            starved.jam(number)
            due_s = began_s + 60.0 * minutes * _JAMS_SHARE * (number + 1) / n_each
            starved.step(max(0.0, due_s - time.monotonic()))
            advance(number + 1, 2 * n_each)
        for number in range(n_each):
            starved.hold(("speech", "bridge")[number % 2])
            advance(n_each + number + 1, 2 * n_each)
        starved.step(max(0.0, began_s + 60.0 * minutes - time.monotonic()))
        starved.note_ended()
        starved.outcome.minutes = (time.monotonic() - began_s) / 60.0
        return starved.outcome


@contextlib.contextmanager
def _starved_face(minutes: float) -> Iterator[StarvedFace]:
    """Yield a face once it speaks and starves."""
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        shares = {each: stack.enter_context(processor_share(each, _SHARE)) for each in _HUNG_S}
        sound = repeated(CLIP, Path(folder) / "sound.wav", 60.0 * (2.0 * minutes + 10.0))
        face = stack.enter_context(running_face(face=_FACE, sound=sound))
        log = stack.enter_context(face.robot.log.open(errors="replace"))
        yield StarvedFace(face, shares, log)
