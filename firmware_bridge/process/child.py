"""Child processes of a supervisor: start, detect missing heartbeats, kill, start again."""

import contextlib
import logging
import os
import signal
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

from firmware_bridge.process.lifeline import LifelineWatch, Message, lifeline_pair
from firmware_bridge.process.processor_wait import CountThreads, ProcessorWait, thread_counts

_LOG: Final = logging.getLogger(__name__)
#: A supervisor that did not look for so long was stopped itself: no process counts as hung then.
_BLIND_S: Final = 0.5
#: Waits for a processor are read from the kernel only after a process has been silent for this
#: share of the time allowed, which is rare; waits before that count as silence.
_UNREAD_SHARE: Final = 0.1


@dataclass(frozen=True, slots=True)
class HeartbeatTimeouts:
    """The longest silence in s: `start_s` until a process's first heartbeat, `run_s` afterwards.

    Time in which the process waited for a processor does not count; patience: the longest silence
    with such waits, in multiples of these limits.
    """

    start_s: float
    run_s: float
    patience: float = 1.0


class HeartbeatMonitor:
    """Deadlines for the heartbeats of one process; times are monotonic seconds."""

    def __init__(self, timeouts: HeartbeatTimeouts) -> None:
        self._timeouts = timeouts
        self._since_s = self._looked_s = 0.0
        self._wait: ProcessorWait | None = None

    def begin(self, now_s: float) -> None:
        """Start counting the silence of a process that was started at `now_s`."""
        self._since_s = self._looked_s = now_s

    def look(self, now_s: float, beat_s: float | None, counts: CountThreads = dict) -> float:
        """Return the time at which the process counts as hung if no further heartbeat comes.

        At or before `now_s`: the process hangs now. beat_s: time of the newest heartbeat; None:
        none yet. counts: returns how long the process's threads have waited for a processor, which
        prolongs the time; called once a tenth of the time allowed has passed in silence. Call
        `look` often: if the caller itself paused for more than .5 s, silence is counted anew.
        """
        if now_s - self._looked_s > _BLIND_S:
            self._since_s = now_s
        self._looked_s = now_s
        self._since_s = max(self._since_s, beat_s or 0.0)
        allowed_s = self._timeouts.start_s if beat_s is None else self._timeouts.run_s
        if now_s - self._since_s < _UNREAD_SHARE * allowed_s:
            self._wait = None
            return self._since_s + allowed_s
        self._wait = self._wait or ProcessorWait()
        waited_s = self._wait.waited_s(now_s, counts())
        return self._since_s + min(allowed_s + waited_s, self._timeouts.patience * allowed_s)


class Child:
    """A process that is started, watched by its heartbeats, and ended by its supervisor.

    The process has a process group of its own, so that a terminal's Ctrl-C reaches the supervisor
    only. It dies with its supervisor: by the kernel's signal, and when it finds the lifeline, its
    socket to the supervisor, closed.
    """

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        inherited: Mapping[str, int],
        timeouts: HeartbeatTimeouts,
    ) -> None:
        """Set up a process that `start` starts.

        command: its words; `{lifeline}` and the keys of `inherited` are replaced by the numbers of
        the descriptors that the process inherits. name: for the log. timeouts: silences after which
        it counts as hung.
        """
        self.name = name
        self._command = command
        self._inherited = dict(inherited)
        self._process: subprocess.Popen[bytes] | None = None
        self._watch: LifelineWatch | None = None
        self._silence = HeartbeatMonitor(timeouts)
        self._pidfd = -1

    @property
    def pid(self) -> int | None:
        """The process id; None while there is no process."""
        return None if self._process is None else self._process.pid

    @property
    def has_beaten(self) -> bool:
        """Whether the process started last has sent a heartbeat."""
        return self._watch is not None and self._watch.beat_s is not None

    def filenos(self) -> list[int]:
        """Return the descriptors that become readable when the process sends a message or ends.

        [] while there is no process.
        """
        if self._process is None or self._watch is None:
            return []
        return [self._pidfd] if self._watch.closed else [self._pidfd, self._watch.fileno()]

    def start(self, arguments: Sequence[str], now_s: float) -> None:
        """Start the process at `now_s`, with `arguments` after its command."""
        if self._watch is not None:
            self._watch.close()
        end, self._watch = lifeline_pair()
        inherited = {**self._inherited, "{lifeline}": end.fileno()}
        command = [str(inherited.get(part, part)) for part in self._command]
        try:
            self._process = subprocess.Popen(
                [*command, *arguments],
                pass_fds=list(inherited.values()),
                stdin=subprocess.DEVNULL,
                process_group=0,
            )
        finally:
            end.close()
        _LOG.debug("%s started: %s", self.name, [*command, *arguments])
        self._pidfd = os.pidfd_open(self._process.pid)
        self._silence.begin(now_s)

    def read(self) -> list[Message]:
        """Return the messages since the last call, without heartbeats.

        A process that has ended may have left messages.
        """
        return [] if self._watch is None else self._watch.read()

    def hung_at_s(self, now_s: float) -> float:
        """Return the monotonic time at which the process counts as hung if no heartbeat comes.

        Call it often, with the present time as `now_s`.
        """
        beat_s = None if self._watch is None else self._watch.beat_s
        return self._silence.look(now_s, beat_s, partial(thread_counts, self.pid or 0))

    def ended(self) -> int | None:
        """Return the exit status of a process that has ended, once; negative: its signal.

        None: it still runs, or there is none. Call `read` afterwards, for a last message of the
        process.
        """
        if self._process is None or self._process.poll() is None:
            return None
        status = self._process.returncode
        os.close(self._pidfd)
        self._process = None
        return status

    def send(self, number: signal.Signals) -> None:
        """Send the signal `number` to the process if it runs."""
        if self._process is not None:
            with contextlib.suppress(ProcessLookupError):
                self._process.send_signal(number)

    def end(self, timeout_s: float) -> None:
        """Send SIGTERM, and SIGKILL if the process has not ended within `timeout_s`."""
        if self._process is None:
            return
        self.send(signal.SIGTERM)
        try:
            self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self.send(signal.SIGKILL)
            self._process.wait()
        self.ended()


_RESTART_S: Final = 0.2
#: Seconds: a process that ran for so long had started well, so that its failure is a first one; and
#: the longest wait.
_AFTER_CRASH_S: Final = 10.0, 5.0
#: The same for a process that hung: on a busy computer a start alone takes long, and slows other
#: processes. The fifth hang within ten minutes waits as long as the fifth crash.
_AFTER_HANG_S: Final = 600.0, 60.0


class RestartDelay:
    """The wait in s before a process is started again: from .2 s on doubled by each failure.

    A crash waits for 5 s at most, so that servos are soon driven again, a hang for a minute.
    """

    def __init__(self) -> None:
        self._wait_s = _RESTART_S

    def after(self, ran_s: float, *, hung: bool = False) -> float:
        """Return the seconds to wait before restarting a process that ended after `ran_s`.

        hung: whether it was killed for hanging. The wait doubles with each failure; .2 s after a
        process that ran long enough.
        """
        well_s, longest_s = _AFTER_HANG_S if hung else _AFTER_CRASH_S
        wait_s = _RESTART_S if ran_s > well_s else min(self._wait_s, longest_s)
        self._wait_s = 2.0 * wait_s
        return wait_s


class RestartedChild:
    """A `Child` and when its owner's loop must kill or restart it; times are monotonic seconds."""

    def __init__(self, child: Child) -> None:
        """Take over `child`, which is not started yet and may be started at once."""
        self.child = child
        self.due_s = 0.0  # when it may start again
        self.is_killed = False
        self._has_hung = False
        self._delay = RestartDelay()
        self._started_s = 0.0

    @property
    def serves(self) -> bool:
        """Whether the process runs, has sent a heartbeat, and is not being killed."""
        return self.child.pid is not None and self.child.has_beaten and not self.is_killed

    def start(self, arguments: list[str], now_s: float) -> None:
        """Start the process at `now_s`, with `arguments` after its command, and log it."""
        self.child.start(arguments, now_s)
        self.is_killed = self._has_hung = False
        self._started_s = now_s
        _LOG.info("%s runs as process %s", self.child.name, self.child.pid)

    def kill_if_hung(self, now_s: float) -> None:
        """Kill the process if at `now_s` its last heartbeat is older than its timeout."""
        if not self.is_killed and now_s >= self.child.hung_at_s(now_s):
            self._has_hung = True
            self.kill("hangs: no heartbeat from it")

    def kill(self, why: str) -> None:
        """Kill the process and log `why`; do nothing while an earlier kill takes effect."""
        if not self.is_killed:
            self.is_killed = True
            _LOG.warning("%s %s; it is killed", self.child.name, why)
            self.child.send(signal.SIGKILL)

    def note_end(self, status: int, now_s: float) -> None:
        """Log that the process ended with `status`, and set when it may be restarted, `due_s`."""
        how = f"signal {-status}" if status < 0 else f"status {status}"
        _LOG.warning("%s died (%s)", self.child.name, how)
        self.due_s = now_s + self._delay.after(now_s - self._started_s, hung=self._has_hung)

    def next_s(self, now_s: float) -> float:
        """Return when a restart or kill may be due next; infinity: the process is being killed."""
        if self.child.pid is None:
            return self.due_s
        return float("inf") if self.is_killed else self.child.hung_at_s(now_s)
