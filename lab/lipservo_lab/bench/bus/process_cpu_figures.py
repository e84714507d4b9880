"""Processor time of the whole bridge process, beside a loop with dynamixel-sdk or rustypot.

Processes that drive ten servos a hundred times a second, one at a time, and their CPU time.
"""

import ctypes
import mmap
import os
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Final, Protocol

import numpy as np

from firmware_bridge.clock import MonotonicClock, ticks
from firmware_bridge.loop.face_table import FaceState
from firmware_bridge.loop.targets import ServoTargets, SocketTargetChannel, channel_pair
from firmware_bridge.process.control_socket import ControlSocket
from firmware_bridge.process.lifeline import LifelineWatch, Ready, lifeline_pair
from lipservo.runtime.run_request import SILENCE, RunRequest, request_json
from lipservo.runtime.servos.sim_process import simulated_port
from lipservo.runtime.status.live_board import FACE_STATES, BoardLayout, LiveBoard
from lipservo.runtime.status.status_board import StatusBoard
from lipservo_lab.bench.bus import servo_clients
from lipservo_lab.bench.bus.host_witness import HostWitness
from lipservo_lab.bench.bus.servo_clients import canned_peer
from lipservo_lab.bench.bus.tick_cpu_figures import moving_deg
from lipservo_lab.own_processes import started_alone
from lipsync.errors import UserError

N_SERVOS: Final = 10
RATE_HZ: Final = 100.0
#: The beginning of a turn, in which caches are filled again and answers of before come late.
_SETTLES_S: Final = 0.2
_COUNTED_S: Final = 0.6
#: Targets are dated ahead as the speech side dates them, by the lag of the servos.
_AHEAD_S: Final = 0.02
_STARTS_S: Final = 30.0
#: Full strength comes a second after torque, and is repeated.
_FULL_STRENGTH_S: Final = 2.0
_COUNT: Final = struct.Struct("<Q")


class Rounds(Protocol):
    """What a process has done so far."""

    @property
    def n(self) -> int:
        """Rounds of the process's loop so far."""

    @property
    def is_driven(self) -> bool:
        """Whether the process drives its servos."""


@dataclass(slots=True)
class MeasuredProcess:
    """A process whose servo loop is measured; SIGSTOP pauses it except in its turns.

    channel: sends it targets. rounds: counts its loop. lifeline: our end of a bridge's; None: the
    process has none.
    """

    pid: int
    channel: SocketTargetChannel
    rounds: Rounds
    lifeline: LifelineWatch | None = None

    def take_turn(self, witness: HostWitness) -> float:
        """Run the loop for a while, then pause it; return its processor time a round, us.

        The first `_SETTLES_S` do not count. NaN: servos were not driven, or the computer stalled.
        """
        clock, turn_s = _cpu_clock(self.pid), time.monotonic()
        self.run(_SETTLES_S, stop=False)
        began_s, began_n = time.clock_gettime(clock), self.rounds.n
        self.run(_COUNTED_S)
        spent_s, n_rounds = time.clock_gettime(clock) - began_s, self.rounds.n - began_n
        ended_s = time.monotonic()
        witness.settle()
        if not (n_rounds and self.rounds.is_driven) or witness.saw_stall(turn_s, ended_s):
            return float("nan")
        return spent_s / n_rounds * 1e6

    def run(self, seconds: float, *, stop: bool = True) -> None:
        """Continue the process for some seconds, publishing moving targets as speech does.

        stop: pause it by SIGSTOP at the end.
        """
        self._publish(time.monotonic())  # before it looks how old the newest is
        os.kill(self.pid, signal.SIGCONT)
        until_s = time.monotonic() + seconds
        for time_s, _ in ticks(MonotonicClock(), RATE_HZ):
            if time_s >= until_s:
                break
            self._publish(time_s)
            if self.lifeline is not None:
                self.lifeline.read()
        if stop:
            os.kill(self.pid, signal.SIGSTOP)

    def _publish(self, time_s: float) -> None:
        self.channel.publish(ServoTargets(time_s + _AHEAD_S, moving_deg(time_s, N_SERVOS)))


class _CountedRounds:
    """`Rounds` of a client, which counts them in memory shared by a file descriptor."""

    def __init__(self, fd: int) -> None:
        os.ftruncate(fd, _COUNT.size)
        self._memory = mmap.mmap(fd, 0)
        self.is_driven = True

    @property
    def n(self) -> int:
        """The number of rounds so far."""
        return int(_COUNT.unpack_from(self._memory, 0)[0])


class _BridgeTicks:
    """`Rounds` of a bridge process, read from its live board."""

    def __init__(self, board: LiveBoard) -> None:
        self._board = board
        self._number = self._n = 0
        self.is_driven = False

    @property
    def n(self) -> int:
        """Return the number of ticks so far; note whether servos were driven in all new ticks."""
        driven = FACE_STATES.index(FaceState.DRIVEN.value)
        for number, record in self._board.servos_since(self._number):
            self._number, self._n = number, int(record["n_ticks"])
            self.is_driven = bool(record["torque_on"]) and int(record["state"]) == driven
        return self._n


@contextmanager
def client_process(kind: str, port: str, baud_rate: int) -> Iterator[MeasuredProcess]:
    """Run a loop with dynamixel-sdk or rustypot in a process; yield it paused, after a second.

    kind: a key of `CLIENTS`. port: of the servos' peer.
    """
    with ExitStack() as stack:
        writer, reader = (stack.enter_context(end) for end in channel_pair())
        count = os.memfd_create("rounds")
        stack.callback(os.close, count)
        rounds = _CountedRounds(count)
        command = [sys.executable, "-P", "-m", "lipservo_lab.bench.bus.servo_clients", kind, port]
        numbers = [baud_rate, N_SERVOS, RATE_HZ, reader.fileno(), count]
        command += [str(each) for each in numbers]
        process = stack.enter_context(_measured_process(command, [reader.fileno(), count]))
        _wait_until(lambda: rounds.n > RATE_HZ, process)
        process.send_signal(signal.SIGSTOP)
        yield MeasuredProcess(process.pid, SocketTargetChannel(writer), rounds)


@contextmanager
def bridge_process(folder: Path, port: str, baud_rate: int) -> Iterator[MeasuredProcess]:
    """Run a `bridge-process` as a daemon would; yield it paused, with servos at full strength.

    folder: empty; gets the face's YAML, its socket and logs. port: of the servos' peer.
    """
    face = folder / "face.yaml"
    face.write_text(_face_yaml(baud_rate))
    with ExitStack() as stack:
        board = stack.enter_context(StatusBoard.create())
        names = tuple(f"joint_{n + 1}" for n in range(N_SERVOS))
        layout = BoardLayout("bench", str(face), names, FACE_STATES, (), 1, RATE_HZ)
        live_board = stack.enter_context(LiveBoard.create(layout))
        control = stack.enter_context(ControlSocket(folder / "bench.sock"))
        writer, reader = (stack.enter_context(their_end) for their_end in channel_pair())
        their_end, lifeline = lifeline_pair()
        stack.callback(lifeline.close)
        request = RunRequest(
            str(face), SILENCE, port=port, rate_hz=RATE_HZ, control=control.path, quiet=True
        )
        command = [sys.executable, "-P", "-m", "lipservo", "bridge-process"]
        command += ["--request", request_json(request)]
        fds = {
            "channel": reader.fileno(),
            "lifeline": their_end.fileno(),
            "control": control.fileno(),
            "board": board.fileno(),
            "live": live_board.fileno(),
        }
        for name, fd in fds.items():
            command += [f"--{name}", str(fd)]
        process = stack.enter_context(_measured_process(command, list(fds.values()), folder))
        their_end.close()
        _wait_until(lambda: Ready() in lifeline.read(), process)
        rounds, channel = _BridgeTicks(live_board), SocketTargetChannel(writer)
        measured = MeasuredProcess(process.pid, channel, rounds, lifeline)
        measured.run(_FULL_STRENGTH_S)
        yield measured


def _face_yaml(baud_rate: int) -> str:
    """Return the YAML of a face with ten XL330, every second one mounted mirrored."""
    lines = ["name: bench", f"rate_hz: {RATE_HZ:g}", f"bus: {{baud_rate: {baud_rate}}}", "servos:"]
    for n in range(1, N_SERVOS + 1):
        lines.append(
            f"  joint_{n}: {{id: {n}, model: XL330-M288, positive: opens, min_deg: -40, "
            f"max_deg: 40, max_speed_deg_s: 300, sign: {1 if n % 2 else -1}}}"
        )
    return "\n".join(lines) + "\n"


@contextmanager
def _measured_process(
    command: Sequence[str], fds: Sequence[int], folder: Path | None = None
) -> Iterator[subprocess.Popen[bytes]]:
    """Run a process until the block ends, then kill it.

    fds: file descriptors that it inherits. folder: for its state and sockets; None: the user's own.
    """
    environment = dict(os.environ)
    if folder is not None:
        environment |= {"XDG_STATE_HOME": str(folder), "XDG_RUNTIME_DIR": str(folder)}
    with started_alone(command, pass_fds=list(fds), env=environment) as process:
        try:
            yield process
        finally:
            process.kill()  # it stands still by SIGSTOP; its peer holds no servo


def _wait_until(condition: Callable[[], bool], process: subprocess.Popen[bytes]) -> None:
    give_up_s = time.monotonic() + _STARTS_S
    while not condition():
        if process.poll() is not None or time.monotonic() > give_up_s:
            raise RuntimeError(f"a process to measure does not start: {process.args!r}")
        time.sleep(0.02)


def _cpu_clock(pid: int) -> int:
    """Return the id of the clock of a process's CPU time, for `time.clock_gettime`.

    Raises OSError where there is no such process.
    """
    clock = ctypes.c_int()
    error = ctypes.CDLL(None).clock_getcpuclockid(pid, ctypes.byref(clock))
    if error:
        raise OSError(error, os.strerror(error))
    return clock.value


_WIRE_BAUD_RATE: Final = 1_000_000
_SIMULATED: Final = ("--servos", str(N_SERVOS), "--baud-rate", str(_WIRE_BAUD_RATE), "--on-time")


@dataclass(frozen=True, slots=True)
class Comparison:
    """One comparison of our process with clients' loops, at the same kind of servos.

    peer: starts what answers in the servos' place, and yields its port. loops: by client (a key of
    `CLIENTS`), the name of the figure: our processor time over the client's. n_turns: turns each.
    """

    peer: Callable[[], AbstractContextManager[str]]
    baud_rate: int
    loops: Mapping[str, str]
    n_turns: int


AT_ONCE = Comparison(
    partial(canned_peer, N_SERVOS, on_time=True),
    servo_clients.BAUD_RATE,
    {"sdk": "cpu_process_ratio"},
    n_turns=30,
)
ON_THE_WIRE = Comparison(
    partial(simulated_port, _SIMULATED),
    _WIRE_BAUD_RATE,
    {"sdk": "cpu_process_wire_ratio", "rustypot": "cpu_process_wire_ratio_rustypot"},
    n_turns=10,
)


def process_ratios() -> dict[str, float]:
    """Return CPU time a tick of `lipservo bridge-process` over that of a process with another loop.

    Ours is the whole process that a daemon starts: it reads targets from a socket, limits them,
    writes goals, reads all positions (fast) and one servo's health, supervises, serves the control
    socket, and writes the live board. The others read goals from the same kind of socket, write
    them and read all positions (fast); dynamixel-sdk also reads voltage and temperature of all
    (`GroupSyncRead`), rustypot one servo's health, as we do. They have no limits, stop or status.

    Measured is user and system time of all threads of a process, by its own clock, in turns of some
    sixty ticks, while the others are paused. Each ratio compares two turns of the same round; given
    are median and quartiles (`_q1`, `_q3`). Turns in which a core stalled are left out; `..._kept`:
    share of the rounds in which ours and dynamixel-sdk's turns both count. Each process has a peer
    of its own in the servos' place, which answers at once; `wire`: simulated servos that take the
    time of 1 Mbaud. dynamixel-sdk polls while it waits, which is in its figures.

    Raises UserError where the computer stalled in all rounds.
    """
    figures: dict[str, float] = {}
    with HostWitness.watching() as witness:
        for comparison, suffix in ((AT_ONCE, ""), (ON_THE_WIRE, "_wire")):
            turns_us = _turn_times_us(comparison, witness)
            figures[f"cpu_process{suffix}_us"] = _quartiles(turns_us["own"])[1]
            for kind, name in comparison.loops.items():
                if kind not in turns_us:
                    continue
                low, middle, high = _quartiles(turns_us["own"] / turns_us[kind])
                figures[name] = middle
                if kind == "sdk":
                    figures |= {f"{name}_q1": low, f"{name}_q3": high}
                    counted = np.isfinite(turns_us["own"] / turns_us[kind]).mean()
                    figures[f"cpu_process{suffix}_kept"] = float(counted)
    return figures


def _quartiles(values: np.ndarray) -> tuple[float, float, float]:
    """Return first quartile, median and third quartile of the values that are not NaN.

    Raises UserError if all are NaN.
    """
    if not np.isfinite(values).any():
        raise UserError("the computer stood still in every round; run it on a quieter one")
    low, middle, high = np.nanquantile(values, [0.25, 0.5, 0.75]).tolist()
    return low, middle, high


def _turn_times_us(comparison: Comparison, witness: HostWitness) -> dict[str, np.ndarray]:
    """Return the processor time of a tick in each turn, (n_turns,) us, by loop; `own` is ours.

    NaN for turns that do not count: see `take_turn`. rustypot is left out if it is not installed.
    """
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="lipservo-bench-"))
        port, rate = stack.enter_context(comparison.peer()), comparison.baud_rate
        ours = bridge_process(Path(folder), port, rate)
        loops: dict[str, MeasuredProcess] = {"own": stack.enter_context(ours)}
        for kind in comparison.loops:
            if kind != "rustypot" or find_spec("rustypot") is not None:
                port = stack.enter_context(comparison.peer())
                loops[kind] = stack.enter_context(client_process(kind, port, rate))
        rounds = [
            [each.take_turn(witness) for each in loops.values()] for _ in range(comparison.n_turns)
        ]
        return dict(zip(loops, np.array(rounds).T, strict=True))
