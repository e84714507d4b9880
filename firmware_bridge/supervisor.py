"""Keeps the processes of one face alive, and the face safe while one of them is not."""

import signal
import socket
import subprocess
import time
from collections.abc import Callable, Sequence
from typing import Final

_LOOK_S: Final = 0.05
#: Easing to neutral takes two seconds at most, limp a few packets more.
_END_S: Final = 5.0
_RESTART_S, _LONGEST_RESTART_S = 0.2, 5.0
#: A process that ran for so long had started well: the next failure is a new one.
_WELL_S: Final = 10.0


class Supervisor:
    """Runs bridge and speech, joined by a channel; restarts what dies.

    after_bridge_death: makes the face limp by itself and says how it went; called before the bridge
    starts again. say: one line for the log. The children die with this process: they ask the kernel
    for a signal, and look.
    """

    def __init__(
        self,
        bridge: Sequence[str],
        speech: Sequence[str],
        channel: tuple[socket.socket, socket.socket],
        *,
        after_bridge_death: Callable[[], str],
        say: Callable[[str], None],
        alive: Callable[[], None] = lambda: None,
    ) -> None:
        """`{fd}` in a command stands for the number of its end of the channel."""
        self._ends = {"speech": channel[0], "bridge": channel[1]}
        self._commands = {"bridge": bridge, "speech": speech}
        self._after_bridge_death = after_bridge_death
        self._say = say
        self._alive = alive
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._started_s: dict[str, float] = {}
        self._wait_s = dict.fromkeys(self._commands, _RESTART_S)

    def run(self, stopped: Callable[[], bool]) -> int:
        """Until `stopped`, or until the bridge ends of its own will; the exit status."""
        try:
            for name in self._commands:
                self._start(name)
            while not stopped():
                time.sleep(_LOOK_S)
                self._alive()
                for name in ("bridge", "speech"):
                    status = self._running[name].poll()
                    if status is None:
                        continue
                    if name == "bridge" and status == 0:
                        return 0
                    if name == "bridge" and self._never_started():
                        return status if status > 0 else 1
                    self._revive(name, status)
            return 0
        finally:
            self._end()

    def _never_started(self) -> bool:
        """A bridge that fails at its first start has said why; trying again would not help."""
        first = self._wait_s["bridge"] == _RESTART_S
        status = self._running["bridge"].returncode
        return first and status > 0 and time.monotonic() - self._started_s["bridge"] < _WELL_S

    def _start(self, name: str) -> None:
        end = self._ends[name]
        command = [part.replace("{fd}", str(end.fileno())) for part in self._commands[name]]
        self._running[name] = subprocess.Popen(command, pass_fds=[end.fileno()])
        self._started_s[name] = time.monotonic()
        self._say(f"{name} runs as process {self._running[name].pid}")

    def _revive(self, name: str, status: int) -> None:
        how = f"signal {-status}" if status < 0 else f"status {status}"
        self._say(f"{name} died ({how})")
        if name == "bridge":
            self._say(self._after_bridge_death())
        if time.monotonic() - self._started_s[name] > _WELL_S:
            self._wait_s[name] = _RESTART_S
        time.sleep(self._wait_s[name])
        self._wait_s[name] = min(2.0 * self._wait_s[name], _LONGEST_RESTART_S)
        self._start(name)

    def _end(self) -> None:
        """Speech first, then the bridge, which brings the face to rest; by force if need be."""
        for name in ("speech", "bridge"):
            process = self._running.get(name)
            if process is not None and process.poll() is None:
                process.send_signal(signal.SIGTERM)
        for name, process in self._running.items():
            try:
                process.wait(_END_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
                if name == "bridge":
                    self._say(self._after_bridge_death())
