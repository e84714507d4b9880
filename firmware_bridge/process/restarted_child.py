"""A watched process with the rules by which it is killed when it hangs and started again."""

import signal
from collections.abc import Callable
from typing import Final, Protocol

from firmware_bridge.process.lifeline import Message

_RESTART_S, _LONGEST_RESTART_S = 0.2, 5.0
#: A process that ran for so long had started well: the next failure is a new one.
_WELL_S: Final = 10.0


class WatchedChild(Protocol):
    """What a supervisor needs of a process: `firmware_bridge.process.child.Child`."""

    name: str

    @property
    def pid(self) -> int | None:
        """Its number; None while there is no process."""

    @property
    def has_beaten(self) -> bool:
        """Whether the newest process has given a heartbeat."""

    def filenos(self) -> list[int]:
        """What becomes readable when it says something or ends."""

    def start(self, arguments: list[str], now_s: float) -> None:
        """Run it with these further arguments."""

    def read(self) -> list[Message]:
        """What it said since the last call."""

    def hung_at_s(self, now_s: float) -> float:
        """When it has to be taken for hung."""

    def ended(self) -> int | None:
        """Its exit status, once; negative for a signal."""

    def send(self, number: signal.Signals) -> None:
        """A signal, if it runs."""

    def end(self, timeout_s: float) -> None:
        """Ask it to end, wait for it, and kill it when it does not."""


class RestartDelay:
    """How long to wait before a process is started again: twice as long each time it fails."""

    def __init__(self) -> None:
        self._wait_s = _RESTART_S

    def after(self, ran_s: float) -> float:
        """The wait after a process that ran for `ran_s`."""
        wait_s = _RESTART_S if ran_s > _WELL_S else self._wait_s
        self._wait_s = min(2.0 * wait_s, _LONGEST_RESTART_S)
        return wait_s


class RestartedChild:
    """Decides by deadlines only; times are monotonic seconds. say: one line for the log."""

    def __init__(self, child: WatchedChild, say: Callable[[str], None]) -> None:
        self.child = child
        self.due_s = 0.0  # when it may start again
        self.is_killed = False
        self._say = say
        self._delay = RestartDelay()
        self._started_s = 0.0

    @property
    def serves(self) -> bool:
        """Whether it runs, has given a heartbeat, and is not being killed."""
        return self.child.pid is not None and self.child.has_beaten and not self.is_killed

    def start(self, arguments: list[str], now_s: float) -> None:
        """Run it with these further arguments."""
        self.child.start(arguments, now_s)
        self.is_killed = False
        self._started_s = now_s
        self._say(f"{self.child.name} runs as process {self.child.pid}")

    def read(self) -> list[Message]:
        """What it said since the last call."""
        return self.child.read()

    def kill_if_hung(self, now_s: float) -> None:
        """Kill it when it has given no heartbeat for too long."""
        if now_s >= self.child.hung_at_s(now_s):
            self.kill("hangs: no heartbeat from it")

    def kill(self, why: str) -> None:
        """Kill it, once."""
        if not self.is_killed:
            self.is_killed = True
            self._say(f"{self.child.name} {why}; it is killed")
            self.child.send(signal.SIGKILL)

    def note_end(self, status: int, now_s: float) -> None:
        """It ended with this status: note when it may start again."""
        how = f"signal {-status}" if status < 0 else f"status {status}"
        self._say(f"{self.child.name} died ({how})")
        self.due_s = now_s + self._delay.after(now_s - self._started_s)

    def next_s(self, now_s: float) -> float:
        """When there is something to decide although nothing comes."""
        if self.child.pid is None:
            return self.due_s
        return float("inf") if self.is_killed else self.child.hung_at_s(now_s)
