"""Processor time of the whole bridge process, beside a loop with dynamixel-sdk or rustypot."""

import ctypes
import mmap
import os
import signal
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Final

import numpy as np

from firmware_bridge.clock import MonotonicClock, ticks
from firmware_bridge.process.control_socket import ControlSocket
from firmware_bridge.process.lifeline import LifelineWatch, Ready, lifeline_pair
from firmware_bridge.process.socket_channel import SocketTargetChannel, channel_pair
from firmware_bridge.targets import ServoTargets
from lipservo.bench.bus.servo_clients import BAUD_RATE, canned_peer
from lipservo.status.live_board import BoardLayout, LiveBoard
from lipservo.status.servo_board import FACE_STATES
from lipservo.status.status_board import StatusBoard
from lipservo.street.run_request import RunRequest, request_json
from lipservo.street.sources import SILENCE

N_SERVOS: Final = 10
RATE_HZ: Final = 100.0
#: Turns of each process; of a turn the beginning, in which caches are filled again and answers of
#: before come late, does not count.
_TURNS: Final = 30
_SETTLES_S, _COUNTED_S = 0.15, 0.6
#: Targets are dated ahead as the speech side dates them, by the lag of the servos.
_AHEAD_S: Final = 0.02
_STARTS_S: Final = 30.0
_COUNT: Final = struct.Struct("<Q")
#: What the ratio over each loop is called: cpu_process*_ratio.
_LOOPS: Final = {
    "sdk": "",
    "sdk_all_fast": "_all_fast",
    "sdk_in_turn": "_in_turn",
    "sdk_waiting": "_waiting",
    "sdk_in_turn_waiting": "_in_turn_waiting",
    "rustypot_in_turn": "_rustypot",
}


def process_ratios() -> dict[str, float]:
    """CPU a tick of `lipservo bridge-process` over that of a process with the others' loop.

    Ours is the process that a daemon starts, whole: grid, control socket, lifeline, targets through
    a socket, gate, goals written, places read (fast), one servo's health read, supervision, live
    board. The others: goals through the same socket, written; places read (fast); voltage and
    temperature of all read (sync read; `all_fast`: fast, too), or, `in_turn`, the very reads of our
    tick, one servo's health, in turn; no gate, nobody who may stop them, no status.
    User and system time of the whole process, all threads, by its own clock; medians of the turns.
    One process runs at a time, the others are stopped by SIGSTOP; each has a peer of its own, which
    answers at once. dynamixel-sdk polls while it waits for it; `waiting`: with a port that waits in
    the kernel instead, which the SDK does not offer. Its polling for the time on the wire is left
    out, as there is no wire.
    """
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="lipservo-bench-")))
        kinds = [kind for kind in _LOOPS if "rustypot" not in kind or find_spec("rustypot")]
        loops: dict[str, _Measured] = {"own": stack.enter_context(_bridge_process(folder))}
        for kind in kinds:
            loops[kind] = stack.enter_context(_client_process(kind))
        for _ in range(_TURNS):
            for each in loops.values():
                each.take_turn()
    middle_us = {name: statistics.median(each.spent_us) for name, each in loops.items()}
    figures = {"cpu_process_us": middle_us["own"], "cpu_process_ticks": loops["own"].n_counted}
    for kind in kinds:
        figures[f"cpu_process{_LOOPS[kind]}_ratio"] = middle_us["own"] / middle_us[kind]
    return figures


def moving_deg(time_s: float) -> np.ndarray:
    """Where the joints are wanted: 4 degrees to and fro at 2 Hz, (n_servos,)."""
    return np.asarray(4.0 * np.sin(2.0 * np.pi * 2.0 * time_s + 0.3 * np.arange(N_SERVOS)))


@dataclass(slots=True)
class _Measured:
    """A process that is stopped but in its turns. spent_us: CPU a tick, of each turn."""

    pid: int
    channel: SocketTargetChannel
    counted: "_Rounds"
    lifeline: LifelineWatch | None = None
    spent_us: list[float] = field(default_factory=list)
    n_counted: int = 0

    def take_turn(self) -> None:
        """Run for a while with targets that move; then stand still again."""
        clock = _cpu_clock(self.pid)
        self._publish(time.monotonic())
        os.kill(self.pid, signal.SIGCONT)
        self._drive(_SETTLES_S)
        began_s, began_n = time.clock_gettime(clock), self.counted.n
        self._drive(_COUNTED_S)
        spent_s, n = time.clock_gettime(clock) - began_s, self.counted.n - began_n
        os.kill(self.pid, signal.SIGSTOP)
        self.n_counted += n
        if n:
            self.spent_us.append(spent_s / n * 1e6)

    def _drive(self, seconds: float) -> None:
        until_s = time.monotonic() + seconds
        for time_s, _ in ticks(MonotonicClock(), RATE_HZ):
            if time_s >= until_s:
                return
            self._publish(time_s)
            if self.lifeline is not None:
                self.lifeline.read()

    def _publish(self, time_s: float) -> None:
        self.channel.publish(ServoTargets(time_s + _AHEAD_S, moving_deg(time_s)))


class _Rounds:
    """How many rounds a process has made, as it says in memory that is shared."""

    def __init__(self, fd: int) -> None:
        os.ftruncate(fd, _COUNT.size)
        self._memory = mmap.mmap(fd, 0)

    @property
    def n(self) -> int:
        """So far."""
        return int(_COUNT.unpack_from(self._memory, 0)[0])


class _BoardRounds(_Rounds):
    """The same of a bridge, by its live board."""

    def __init__(self, board: LiveBoard) -> None:
        self._board = board
        self._number = self._n = 0

    @property
    def n(self) -> int:
        for number, record in self._board.servos_since(self._number):
            self._number, self._n = number, int(record["n_ticks"])
        return self._n


@contextmanager
def _client_process(kind: str) -> Iterator[_Measured]:
    """Somebody else's loop, stopped."""
    with ExitStack() as stack:
        port = stack.enter_context(canned_peer(N_SERVOS))
        writer, reader = (stack.enter_context(end) for end in channel_pair())
        count = os.memfd_create("rounds")
        stack.callback(os.close, count)
        rounds = _Rounds(count)
        numbers = [N_SERVOS, RATE_HZ, reader.fileno(), count]
        command = [sys.executable, "-m", "lipservo.bench.bus.client_loop", kind, port]
        process = stack.enter_context(
            _running([*command, *map(str, numbers)], [reader.fileno(), count])
        )
        _wait_until(lambda: rounds.n > RATE_HZ, process)
        process.send_signal(signal.SIGSTOP)
        yield _Measured(process.pid, SocketTargetChannel(writer), rounds)


@contextmanager
def _bridge_process(folder: Path) -> Iterator[_Measured]:
    """A `bridge-process` whose servos are driven at full strength, stopped."""
    face = folder / "face.yaml"
    face.write_text(_face_yaml())
    with ExitStack() as stack:
        port = stack.enter_context(canned_peer(N_SERVOS))
        board = stack.enter_context(StatusBoard.create())
        names = tuple(f"joint_{n + 1}" for n in range(N_SERVOS))
        layout = BoardLayout("bench", str(face), names, FACE_STATES, (), 1, RATE_HZ)
        live = stack.enter_context(LiveBoard.create(layout))
        control = stack.enter_context(ControlSocket.bind(folder / "bench.sock"))
        writer, reader = (stack.enter_context(end) for end in channel_pair())
        end, lifeline = lifeline_pair()
        stack.callback(lifeline.close)
        request = RunRequest(str(face), SILENCE, port=port, rate_hz=RATE_HZ, quiet=True)
        inherited = {
            "--channel": reader.fileno(),
            "--lifeline": end.fileno(),
            "--control": control.fileno(),
            "--board": board.fileno(),
            "--live": live.fileno(),
        }
        command = [sys.executable, "-m", "lipservo", "bridge-process"]
        command += ["--request", request_json(request), "--control-path", str(control.path)]
        for name, fd in inherited.items():
            command += [name, str(fd)]
        process = stack.enter_context(_running(command, list(inherited.values()), folder))
        end.close()
        measured = _Measured(process.pid, SocketTargetChannel(writer), _BoardRounds(live), lifeline)
        _wait_until(lambda: Ready() in lifeline.read(), process)
        measured.take_turn()
        for _ in range(3):  # full strength comes a second and some after torque
            os.kill(process.pid, signal.SIGCONT)
            measured._drive(0.6)
        os.kill(process.pid, signal.SIGSTOP)
        measured.spent_us.clear()
        measured.n_counted = 0
        yield measured


def _face_yaml() -> str:
    """Ten XL330 as they come, every second one mounted the other way round."""
    lines = ["name: bench", f"rate_hz: {RATE_HZ:g}", f"bus: {{baud_rate: {BAUD_RATE}}}", "servos:"]
    for n in range(1, N_SERVOS + 1):
        lines.append(
            f"  joint_{n}: {{id: {n}, model: XL330-M288, positive: opens, min_deg: -40, "
            f"max_deg: 40, max_speed_deg_s: 300, sign: {1 if n % 2 else -1}}}"
        )
    return "\n".join(lines) + "\n"


@contextmanager
def _running(
    command: Sequence[str], fds: Sequence[int], folder: Path | None = None
) -> Iterator[subprocess.Popen[bytes]]:
    """A process; gone afterwards. folder: where it keeps what it writes."""
    environment = dict(os.environ)
    if folder is not None:
        environment |= {"XDG_STATE_HOME": str(folder), "XDG_RUNTIME_DIR": str(folder)}
    process = subprocess.Popen(command, pass_fds=list(fds), env=environment)
    try:
        yield process
    finally:
        process.kill()  # its peer answers nobody else, and holds no servo
        process.wait()


def _wait_until(condition: Callable[[], bool], process: subprocess.Popen[bytes]) -> None:
    give_up_s = time.monotonic() + _STARTS_S
    while not condition():
        if process.poll() is not None or time.monotonic() > give_up_s:
            raise RuntimeError(f"a process to measure does not start: {process.args!r}")
        time.sleep(0.02)


def _cpu_clock(pid: int) -> int:
    """The clock of the processor time of another process, for `time.clock_gettime`."""
    clock = ctypes.c_int()
    error = ctypes.CDLL(None).clock_getcpuclockid(pid, ctypes.byref(clock))
    if error:
        raise OSError(error, os.strerror(error))
    return clock.value
