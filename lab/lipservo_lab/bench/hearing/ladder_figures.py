"""How a face recognises while other programs take the computer: `lipservo bench ladder`.

A whole `lipservo run` process recognises speech in real time, ten simulated servos at 100 Hz, and
writes its trace. Beside it, every minute, other processes keep every core busy for 1, 2 and 5 s.
What is measured is read from the trace: in a tick in which the network listens `"hears"` has a
value, in one of a lesser recogniser it has none.

The ticks of a face under load, from its trace, and what they amount to.
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields
from importlib import resources
from pathlib import Path
from typing import Any, Final

import numpy as np
import soundfile
from numpy.typing import NDArray

from firmware_bridge.process.control_client import ask
from lipservo.runtime.settled_phonemes import settled_events
from lipservo_lab.own_processes import started
from lipsync.arrays import Array
from lipsync.audio.file import FileSource, read_speech
from lipsync.audio_block import BLOCK_S, SAMPLE_RATE_HZ, AudioBlock
from lipsync.errors import UserError
from lipsync.phonemes import SILENCE
from lipsync.recognition.network_recognizer import NetworkRecognizer
from lipsync.recognition.recognizers import make_recognizer

RATE_HZ: Final = 100.0
#: In each minute: when a load begins, and how long it lasts.
LOADS_S: Final = ((8.0, 1.0), (22.0, 2.0), (38.0, 5.0))


class LadderError(UserError):
    """A process that was to be measured did not work; the message is one line."""


@dataclass(frozen=True, slots=True)
class Load:
    """Every core was busy from and to these monotonic times."""

    begin_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class Ticks:
    """The ticks of a trace, (n,) each.

    time_s: monotonic. heard_s: the sound time that was heard then. is_network: whether the network
    recognised, and not a lesser recogniser. over_s: how much later than declared the targets were.
    late: number of ticks missed before this one.
    """

    time_s: Array
    heard_s: Array
    is_network: NDArray[np.bool_]
    over_s: Array
    late: NDArray[np.int64]

    def until(self, sound_s: float) -> "Ticks":
        """Return the ticks in which the sound before `sound_s` was processed."""
        kept = self.heard_s < sound_s
        return Ticks(*(getattr(self, each.name)[kept] for each in fields(self)))


def read_ticks(trace: Path, first_s: float) -> Ticks:
    """Read the ticks of a trace file, whose first tick was at monotonic `first_s`.

    Raises LadderError for a trace that is not whole.
    """
    columns: list[tuple[float, float, bool, float, int]] = []
    try:
        with trace.open(encoding="utf-8") as file:
            delay_s = float(json.loads(file.readline())["delay_s"])
            n = 0
            for line in file:
                record: dict[str, Any] = json.loads(line)
                if "ticks" in record:
                    continue
                n += record["late"]
                columns.append(
                    (
                        first_s + n / RATE_HZ,
                        record["sound_s"] + delay_s,
                        record["hears"] is not None,
                        record["target_age_s"] or 0.0,
                        record["late"],
                    )
                )
                n += 1
    except (OSError, ValueError, KeyError) as error:
        raise LadderError(f"{trace.name}: not the trace of a whole run ({error})") from error
    if not columns:
        raise LadderError(f"{trace.name}: has no ticks")
    return Ticks(*(np.array(each) for each in zip(*columns, strict=True)))


def figures_of(
    ticks: Ticks, loads: Sequence[Load], is_speech: NDArray[np.bool_]
) -> dict[str, object]:
    """Return the figures of a run's ticks.

    Parameters
    ----------
    ticks : Ticks
        Of the whole run.
    loads : Sequence[Load]
        When other programs kept all cores busy.
    is_speech : NDArray[np.bool_]
        (n_blocks,), whether each 10 ms of one turn of the sound is speech; the sound repeats.

    Returns
    -------
    dict[str, object]
        network_share: share of speech recognised by the network, 0 to 1. delay_over_p99_ms: 99th
        percentile, under load, of the delay beyond the declared one. changes: of the recogniser.
    """
    # A tick also stands for the ticks missed before it.
    weights = 1 + ticks.late
    frame = np.floor(np.maximum(ticks.heard_s, 0.0) / BLOCK_S).astype(np.int64)
    speaks = is_speech[frame % len(is_speech)] & (ticks.heard_s >= 0.0)
    over_ms: list[float] = []
    for load in loads:
        in_load = (ticks.time_s >= load.begin_s) & (ticks.time_s < load.end_s)
        for index in np.flatnonzero(in_load).tolist():
            missed_s = np.arange(ticks.late[index] + 1) / RATE_HZ
            over_ms += (1e3 * (ticks.over_s[index] + missed_s)).tolist()
    return {
        "network_share": float((weights * ticks.is_network)[speaks].sum() / weights[speaks].sum()),
        "delay_over_p99_ms": float(np.percentile(over_ms, 99)) if over_ms else 0.0,
        "loads": len(loads),
        "changes": int(np.count_nonzero(np.diff(ticks.is_network))),
        "late_ticks": int(ticks.late.sum()),
    }


#: Between two repetitions of the clip.
_PAUSE_S: Final = 0.6
_STARTS_S, _ENDS_S, _POLL_S = 60.0, 30.0, 0.02
_N_TICKS: Final = 50
#: Of the slowed process: how many times as long as its sound the network takes; how long it runs.
_SLOWED: Final = 10.0
_SLOWED_S: Final = 8.0

#: The whole program.
RUN = "from lipservo.__main__ import main; main()"
_RUN_SLOWED = (
    "from lipservo_lab.bench.hearing.ladder_figures import slow_the_network as slow; "
    f"slow({_SLOWED}); {RUN}"
)
_STOPPED: Final = "stopped before the end: no figures"
#: Burns for as many seconds as each line says.
_BURN = """
import sys, time
for line in sys.stdin:
    until_s = time.monotonic() + float(line)
    while time.monotonic() < until_s:
        pass
"""


def ladder_figures(
    minutes: float,
    n_busy: int,
    folder: Path,
    progress: Callable[[float, float], None],
    is_over: Callable[[], bool],
) -> dict[str, object]:
    """Let a face listen for `minutes` under load; return the figures of `bench ladder`.

    n_busy: busy processes for each core, scheduled as the face is. folder: gets sound, trace and
    log. progress: called with seconds done and all. is_over: called often; True ends the run early,
    with LadderError. Raises LadderError also where the face does not work.
    """
    (folder / "session").mkdir(mode=0o700)
    seconds = minutes * 60.0
    sound, is_speech = repeated_speech(folder / "speech.wav", seconds)
    with _busy_processes(n_busy * (os.cpu_count() or 1)) as burn:
        ticks, loads = _listen_under_load(folder, sound, seconds, burn, progress, is_over)
    fallback_s = _fallback_time_s(folder, sound, is_over)
    return {**figures_of(ticks.until(seconds), loads, is_speech), "fallback_s": fallback_s}


def slow_the_network(times: float) -> None:
    """Patch this process so that the network takes `times` as long as its sound lasts, busy."""
    prepare = NetworkRecognizer.prepare

    def prepare_slowly(self: NetworkRecognizer, blocks: Sequence[AudioBlock]) -> None:
        sound_s = sum(len(block.samples) / block.sample_rate_hz for block in blocks)
        until_s = time.perf_counter() + times * sound_s
        prepare(self, blocks)
        while time.perf_counter() < until_s:
            pass

    NetworkRecognizer.prepare = prepare_slowly  # type: ignore[method-assign]


def repeated_speech(path: Path, seconds: float) -> tuple[Path, NDArray[np.bool_]]:
    """Write the bundled clip, repeated for so many seconds; return the path and where speech is.

    The latter: (n_blocks,), for each 10 ms of one turn of the clip.
    """
    with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip:
        samples = read_speech(clip)
        events = list(settled_events(FileSource(clip), make_recognizer("network")))
    n_blocks = -(-(len(samples) + round(_PAUSE_S * SAMPLE_RATE_HZ)) // 160)
    one_turn = np.zeros(n_blocks * 160, np.float32)
    one_turn[: len(samples)] = samples
    soundfile.write(path, np.resize(one_turn, round(seconds * SAMPLE_RATE_HZ)), SAMPLE_RATE_HZ)
    is_speech = np.zeros(n_blocks, np.bool_)
    for event in events:
        if event.phoneme != SILENCE and event.end_s is not None:
            is_speech[round(event.start_s / BLOCK_S) : round(event.end_s / BLOCK_S)] = True
    return path, is_speech


def _listen_under_load(
    folder: Path,
    sound: Path,
    seconds: float,
    burn: Callable[[float], None],
    progress: Callable[[float, float], None],
    is_over: Callable[[], bool],
) -> tuple[Ticks, list[Load]]:
    """Let a face listen for `seconds`, loading all cores at the times of `LOADS_S` each minute.

    burn: keeps all cores busy for some seconds. Returns the ticks of the trace, and the loads.
    """
    trace = folder / "trace.jsonl"
    load_times = [
        (minute * 60.0 + at_s, length_s)
        for minute in range(int(np.ceil(seconds / 60.0)))
        for at_s, length_s in LOADS_S
        if minute * 60.0 + at_s + length_s < seconds
    ]
    loads: list[Load] = []
    with listening_face(RUN, folder, sound, trace) as process:
        first_s = first_tick_s(folder, process, is_over)
        for at_s, length_s in load_times:
            wait_until(first_s + at_s, process, is_over)
            begin_s = time.monotonic()
            burn(length_s)
            loads.append(Load(begin_s, begin_s + length_s))
            progress(at_s, seconds)
        wait_until(first_s + seconds + _ENDS_S, process, is_over, may_end=True)
    return read_ticks(trace, first_s), loads


def _fallback_time_s(folder: Path, sound: Path, is_over: Callable[[], bool]) -> float | None:
    """Return how long after its start a too slow network is replaced by the loudness recogniser, s.

    None: it is not.
    """
    short_sound = folder / "short.wav"
    samples = soundfile.read(sound, frames=round(_SLOWED_S * SAMPLE_RATE_HZ), dtype="float32")[0]
    soundfile.write(short_sound, samples, SAMPLE_RATE_HZ)
    trace = folder / "slowed.jsonl"
    with listening_face(_RUN_SLOWED, folder, short_sound, trace) as process:
        until_s = time.monotonic() + _STARTS_S + _SLOWED_S + _ENDS_S
        wait_until(until_s, process, is_over, may_end=True)
    ticks = read_ticks(trace, 0.0).until(_SLOWED_S)
    fallback_ticks = np.flatnonzero(~ticks.is_network[:-1])
    # The tick in which it was left took long: it ended before the next one.
    return float(ticks.time_s[fallback_ticks[0] + 1]) if len(fallback_ticks) else None


@contextmanager
def listening_face(
    code: str, folder: Path, sound: Path, trace: Path
) -> Iterator[subprocess.Popen[bytes]]:
    """Run a whole `lipservo run` in a runtime folder of its own, until the block ends.

    code: Python program that starts the command line. The process also ends with this process.
    """
    environment = {
        **os.environ,
        "XDG_RUNTIME_DIR": str(folder / "session"),
        "XDG_STATE_HOME": str(folder / "state"),
        "OPENBLAS_NUM_THREADS": "1",  # as `lipservo run` itself sets it
    }
    environment.pop("RUNTIME_DIRECTORY", None)
    face_yaml = (resources.files("lipservo.config") / "face_sim.yaml").read_text()
    face_file = folder / "face.yaml"
    face_file.write_text(face_yaml.replace("rate_hz: 30", f"rate_hz: {RATE_HZ:g}"))
    arguments = ["run", "--wav", str(sound), "--trace", str(trace), "--config", str(face_file)]
    with (
        (folder / "log").open("ab") as log,
        started(
            [sys.executable, "-c", code, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            env=environment,
        ) as process,
    ):
        yield process


@contextmanager
def _busy_processes(n_processes: int) -> Iterator[Callable[[float], None]]:
    """Start idle processes; yield a function that keeps all of them busy for some seconds."""
    command = [sys.executable, "-c", _BURN]
    with ExitStack() as stack:
        processes = [
            stack.enter_context(started(command, stdin=subprocess.PIPE)) for _ in range(n_processes)
        ]

        def burn(seconds: float) -> None:
            for process in processes:
                assert process.stdin is not None
                process.stdin.write(f"{seconds}\n".encode())
                process.stdin.flush()

        yield burn


def first_tick_s(
    folder: Path,
    process: subprocess.Popen[bytes],
    is_over: Callable[[], bool],
    n_ticks: int = _N_TICKS,
) -> float:
    """Return the monotonic time of a face's first tick, from the tick counts in its status.

    The result is right to some 10 ms: the least of `n_ticks` estimates. Raises LadderError where
    the face does not start, or `is_over` returns True.
    """
    give_up_s = time.monotonic() + _STARTS_S
    estimates_s: list[float] = []
    while len(estimates_s) < n_ticks:
        if time.monotonic() > give_up_s or process.poll() is not None:
            log_lines = (folder / "log").read_text(errors="replace").strip().splitlines()
            raise LadderError(
                f"the face did not start: {log_lines[-1] if log_lines else 'it printed nothing'}"
            )
        if is_over():
            raise LadderError(_STOPPED)
        time.sleep(_POLL_S)
        for path in (folder / "session").glob("**/*.sock"):
            try:
                status = ask(path, "status")
            except OSError:
                continue
            if status.get("n_ticks"):
                n_passed = status["n_ticks"] + status["n_late"]
                estimates_s.append(time.monotonic() - n_passed / RATE_HZ)
    return min(estimates_s)


def wait_until(
    time_s: float,
    process: subprocess.Popen[bytes],
    is_over: Callable[[], bool],
    *,
    may_end: bool = False,
) -> None:
    """Wait until a monotonic time; raise LadderError if `is_over` or if the process ends before.

    may_end: return instead when the process ends.
    """
    while time.monotonic() < time_s:
        if is_over():
            raise LadderError(_STOPPED)
        if process.poll() is not None:
            if may_end:
                return
            raise LadderError(f"the face ended with exit status {process.returncode}")
        time.sleep(min(0.05, max(0.0, time_s - time.monotonic())))
