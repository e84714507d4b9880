"""One step of the first hour as a child process: its output, its input, how it ended."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Final

from firmware_bridge.stopping import ExitStatus

_MOST_NOTES: Final = 40
#: Of a line that a step writes; one that is longer is none of ours.
_LONGEST_LINE: Final = 1 << 18
_LONGEST_NOTE: Final = 500
#: Easing to rest, and letting go of servos that answer late, take a few seconds at most.
_END_S: Final = 15.0
_LOOK_S: Final = 0.2
#: How the program begins its own complaints.
_COMPLAINS: Final = "lipservo: "


class StepProcess:
    """`lipservo builder-process STEP`, from its start to its end.

    Methods may be called by any thread; but for `wait`, none waits.

    step: its name. events: the newest of each kind, by name. notes: its lines for a person, the
    newest last. error: why it ended, one line; None: it has not, or ended well. was_left: it is
    wanted by no page any more.
    """

    def __init__(
        self,
        step: str,
        request: Mapping[str, Any],
        *,
        is_wanted: Callable[[], bool] = lambda: True,
        ended: Callable[["StepProcess"], object] = lambda _: None,
    ) -> None:
        """is_wanted: called again and again; False: it is ended softly. ended: called once."""
        self.step = step
        self.events: dict[str, Mapping[str, Any]] = {}
        self.notes: deque[str] = deque(maxlen=_MOST_NOTES)
        self.error: str | None = None
        self.was_left = False
        self.began_s = time.monotonic()
        self.seconds = 0.0
        self._request = json.dumps(request)
        self._is_wanted, self._ended = is_wanted, ended
        self._process: subprocess.Popen[bytes] | None = None
        self._is_over = threading.Event()
        self._must_end = threading.Event()
        self._has_complained = False
        # The thread lives as long as the process: the kernel ends a child when the thread that
        # started it ends.
        threading.Thread(target=self._run, name=f"step {step}", daemon=True).start()

    @property
    def runs(self) -> bool:
        """Whether it may hold the port."""
        return not self._is_over.is_set()

    @property
    def pid(self) -> int | None:
        """None before it has started."""
        return None if self._process is None else self._process.pid

    def order(self, order: Mapping[str, Any]) -> None:
        """One order of the page; left out where the step hangs, or has ended: its state says so."""
        process = self._process
        if process is not None and process.stdin is not None:
            with contextlib.suppress(OSError, ValueError):
                # Past its buffer, so that nothing waits in it; shorter than a pipe takes at once.
                os.write(process.stdin.fileno(), json.dumps(order).encode() + b"\n")

    def end(self) -> None:
        """Softly: to rest, then limp."""
        self._must_end.set()

    def wait(self) -> None:
        """Until it is over, for as long as a soft end takes at most; then it is killed."""
        if not self._is_over.wait(_END_S) and self._process is not None:
            self._process.kill()
            self._is_over.wait(1.0)

    def _run(self) -> None:
        command = [sys.executable, "-m", "lipservo", "builder-process", self.step, self._request]
        command += ["--parent", str(os.getpid())]
        pipe = subprocess.PIPE
        try:
            process = subprocess.Popen(
                command, stdin=pipe, stdout=pipe, stderr=pipe, process_group=0
            )
        except OSError as error:
            self._over(f"cannot be started: {error.strerror}")
            return
        with process:
            assert process.stdin is not None
            os.set_blocking(process.stdin.fileno(), False)
            self._process = process
            signalled = self._follow(process)
        self._over(self._why(process.returncode, signalled=signalled))

    def _follow(self, process: "subprocess.Popen[bytes]") -> bool:
        """Follow it until it has ended and its output is read.

        Return whether it was ended on request.
        """
        readers = [
            threading.Thread(target=read, args=[process], name=f"step {self.step}", daemon=True)
            for read in (self._read_events, self._read_notes)
        ]
        for each in readers:
            each.start()
        signalled = False
        while process.poll() is None:
            self.was_left = self.was_left or not self._is_wanted()
            if not signalled and (self._must_end.is_set() or self.was_left):
                process.send_signal(signal.SIGTERM)
                signalled = True
            if signalled:
                time.sleep(_LOOK_S)
            else:
                self._must_end.wait(_LOOK_S)
        for each in readers:
            each.join(1.0)
        return signalled

    def _over(self, error: str | None) -> None:
        self.error = error
        self.seconds = time.monotonic() - self.began_s
        self._ended(self)
        self._is_over.set()

    def _why(self, status: int, *, signalled: bool) -> str | None:
        if status in (0, ExitStatus.STOPPED_EARLY) or (signalled and not self._has_complained):
            return None  # a person's stop is no error: what servos confirmed is told beside STOP
        if self._has_complained:
            return self.notes[-1]
        last = f": {self.notes[-1]}" if self.notes else ""
        how = f"was killed by signal {-status}" if status < 0 else f"ended with status {status}"
        return f"the step {how}{last}"

    def _read_events(self, process: "subprocess.Popen[bytes]") -> None:
        assert process.stdout is not None
        while line := process.stdout.readline(_LONGEST_LINE):
            try:
                event = dict(json.loads(line))
                self.events[str(event.pop("event"))] = event
            except (ValueError, KeyError, TypeError):
                self._note(line)

    def _read_notes(self, process: "subprocess.Popen[bytes]") -> None:
        assert process.stderr is not None
        while line := process.stderr.readline(_LONGEST_LINE):
            self._note(line)

    def _note(self, line: bytes) -> None:
        text = line.decode("utf-8", "replace").strip()[:_LONGEST_NOTE]
        if text:
            self._has_complained = text.startswith(_COMPLAINS)
            self.notes.append(text.removeprefix(_COMPLAINS))
