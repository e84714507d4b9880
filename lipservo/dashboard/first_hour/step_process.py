"""One step of a new face's setup as a child process: its orders, events, messages and end."""

import contextlib
import json
import math
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
#: Bytes of a line that a step writes; a longer one is no event.
_LONGEST_LINE: Final = 1 << 18
_LONGEST_NOTE: Final = 500
#: Lines of a complaint with several: the first of them, and the last, which says what to do.
_MOST_SHOWN: Final = 2
#: Easing to rest, and letting go of servos that answer late, take a few seconds at most.
END_S: Final = 15.0
_POLL_S: Final = 0.2
#: With this the program begins each line of an error message.
_PREFIX: Final = "lipservo: "
#: Status of a process that a signal ended softly, less the signal's number.
_BY_SIGNAL: Final = 128


class StepProcess:
    """A process `lipservo builder-process STEP`, from its start to its end.

    Methods may be called by any thread; only `wait` blocks.

    step: its name. events: the newest of each kind, by name. notes: its messages, the newest last.
    error: why it failed, one line; None: it runs, or ended well. was_unwatched: it was ended
    because no page was open. was_killed: it did not end when requested. is_limp: whether its servos
    confirmed torque off, as it ended or later (`store_release`, in words `release_words`).
    duration_s: of the whole step; 0 while it runs.
    """

    def __init__(
        self,
        step: str,
        request: Mapping[str, Any],
        *,
        may_run: Callable[[], bool] = lambda: True,
        on_end: Callable[["StepProcess"], object] = lambda _: None,
        end_s: float = END_S,
    ) -> None:
        """Start the process for `step`.

        request: what the step needs, sent as JSON. may_run: polled; once it returns False, the
        process is ended softly. on_end: called once with this object when the process has ended, in
        its own thread. end_s: seconds that a soft end may last before the process is killed.
        """
        self.step = step
        self.events: dict[str, Mapping[str, Any]] = {}
        self.notes: deque[str] = deque(maxlen=_MOST_NOTES)
        self.error: str | None = None
        self.was_unwatched = self.was_killed = self.is_limp = False
        self.release_words = ""
        self.began_s = time.monotonic()
        self.duration_s = 0.0
        self._request = json.dumps(request)
        self._may_run, self._on_end, self._end_s = may_run, on_end, end_s
        self._process: subprocess.Popen[bytes] | None = None
        self._has_ended = threading.Event()
        self._end_requested = threading.Event()
        #: Lines of the program's last complaint: the cause first, advice at the end.
        self._complaint: list[str] = []
        # The thread lives as long as the process: the kernel ends a child when the thread that
        # started it ends.
        threading.Thread(target=self._run_process, name=f"step {step}", daemon=True).start()

    @property
    def runs(self) -> bool:
        """Whether the process has not ended yet, so that it may own the port."""
        return not self._has_ended.is_set()

    @property
    def pid(self) -> int | None:
        """The process's id; None before it has started."""
        return None if self._process is None else self._process.pid

    def order(self, order: Mapping[str, Any]) -> None:
        """Send the process an order; it is lost if the process hangs or has ended."""
        process = self._process
        if process is not None and process.stdin is not None:
            with contextlib.suppress(OSError, ValueError):
                # Past its buffer, so that nothing waits in it; shorter than a pipe takes at once.
                os.write(process.stdin.fileno(), json.dumps(order).encode() + b"\n")

    def end(self, within_s: float = math.inf) -> None:
        """Request a soft end: the face goes to rest, then torque goes off. Returns at once.

        A process that still runs after `end_s`, or `within_s` if that is less, is killed.
        """
        self._end_s = min(self._end_s, within_s)
        self._end_requested.set()

    def store_release(self, words: str, *, is_confirmed: bool) -> None:
        """Store in words what became of the servos of a process that died without reporting it.

        is_confirmed: whether all of them confirmed torque off.
        """
        self.release_words, self.is_limp = words, is_confirmed
        if self.was_killed:
            self.error = f"the step hung and was killed; {words}"

    def wait(self) -> None:
        """Wait, after `end`, until the process has ended; `end_s` and 2 s at most."""
        self._has_ended.wait(self._end_s + 2.0)

    def _run_process(self) -> None:
        """Start the process, wait for its end, and store how it ended. Runs in a thread."""
        command = [sys.executable, "-P", "-m", "lipservo", "builder-process", self.step]
        command += [self._request, "--parent", str(os.getpid())]
        pipe = subprocess.PIPE
        try:
            process = subprocess.Popen(
                command, stdin=pipe, stdout=pipe, stderr=pipe, process_group=0
            )
        except OSError as error:
            self._finish(f"cannot be started: {error.strerror}")
            return
        assert process.stdin is not None
        with process.stdin:
            os.set_blocking(process.stdin.fileno(), False)
            self._process = process
            signalled = self._wait_for_end(process)
        status = process.returncode
        self.was_killed = signalled and status == -signal.SIGKILL
        # Where servos did not confirm torque off, the status is UNCONFIRMED or that of an error.
        self.is_limp = status in (0, ExitStatus.STOPPED_EARLY) or status > _BY_SIGNAL
        self._finish(self._failure(status, signalled=signalled))

    def _wait_for_end(self, process: "subprocess.Popen[bytes]") -> bool:
        """Wait until the process has ended and its output is read.

        It is sent SIGTERM when an end is requested or no page is open, and killed if it then takes
        too long. Return whether it was sent SIGTERM.
        """
        readers = [
            threading.Thread(target=read, args=[process], name=f"step {self.step}", daemon=True)
            for read in (self._read_events, self._read_notes)
        ]
        for reader in readers:
            reader.start()
        signalled_s = None
        while process.poll() is None:
            self.was_unwatched = self.was_unwatched or not self._may_run()
            if signalled_s is None and (self._end_requested.is_set() or self.was_unwatched):
                process.send_signal(signal.SIGTERM)
                signalled_s = time.monotonic()
            if signalled_s is None:
                self._end_requested.wait(_POLL_S)
                continue
            if time.monotonic() - signalled_s > self._end_s:
                process.kill()
            time.sleep(_POLL_S)
        for reader in readers:
            reader.join(1.0)
        return signalled_s is not None

    def _finish(self, error: str | None) -> None:
        self.error = error
        self.duration_s = time.monotonic() - self.began_s
        self._on_end(self)
        self._has_ended.set()

    def _failure(self, status: int, *, signalled: bool) -> str | None:
        """Return in one line why the process failed; None if it ended well or on request.

        status: as `Popen.returncode`, negative for a signal. signalled: an end was requested; a
        process that had to be killed then has failed.
        """
        if self.was_killed:
            return (
                f"the step did not end within {self._end_s:g} s and was killed: its servos may "
                "still hold; switch their supply off"
            )
        last = f": {self.notes[-1]}" if self.notes else ""
        if status == ExitStatus.UNCONFIRMED and not self._complaint:
            return f"its servos may still hold, keep your hands away{last}"
        if status in (0, ExitStatus.STOPPED_EARLY) or (signalled and not self._complaint):
            return None  # a person's stop is no error; the page shows beside STOP what it did
        # Of the program's error message the first two lines, the cause, and the last, the advice.
        if self._complaint:
            cause, rest = self._complaint[:_MOST_SHOWN], self._complaint[_MOST_SHOWN:]
            return "; ".join([*cause, *(["..."] if len(rest) > 1 else []), *rest[-1:]])
        end = f"was killed by signal {-status}" if status < 0 else f"ended with status {status}"
        return f"the step {end}{last}"

    def _read_events(self, process: "subprocess.Popen[bytes]") -> None:
        """Store the events that the process writes to stdout until it ends. Runs in a thread.

        A line that is not an event, a JSON object with its name, is stored as a note.
        """
        assert process.stdout is not None
        with process.stdout:
            while line := process.stdout.readline(_LONGEST_LINE):
                try:
                    event = dict(json.loads(line))
                    self.events[str(event.pop("event"))] = event
                except (ValueError, KeyError, TypeError):
                    self._store_note(line)

    def _read_notes(self, process: "subprocess.Popen[bytes]") -> None:
        assert process.stderr is not None
        with process.stderr:  # also written by its port's guard process, which outlives the step
            while line := process.stderr.readline(_LONGEST_LINE):
                self._store_note(line)

    def _store_note(self, line: bytes) -> None:
        """Store a line of output as a note, and, if it begins with `lipservo: `, as a complaint."""
        text = line.decode("utf-8", "replace").strip()[:_LONGEST_NOTE]
        if text:
            # A line of an error message follows those before; any other line begins a new message.
            complaint = text.removeprefix(_PREFIX)
            earlier = self._complaint[: _MOST_NOTES - 1] if text.startswith(_PREFIX) else None
            self._complaint = [] if earlier is None else [*earlier, complaint]
            self.notes.append(complaint)
