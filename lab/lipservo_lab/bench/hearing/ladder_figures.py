"""How a face recognises while other programs take the computer: `lipservo bench ladder`.

A whole `lipservo run` process recognises speech in real time, ten simulated servos at 100 Hz, and
writes its trace. Beside it, every minute, other processes keep every core busy for 1, 2 and 5 s.
What is measured is read from the trace: in a tick in which the network listens `"hears"` has a
value, in one of a lesser recogniser it has none.

The ticks of a face under load, from its trace, and what they amount to.
"""

import json
import os
import statistics
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
from lipsync.arrays import Array
from lipsync.audio.file import FileSource, read_speech
from lipsync.audio_block import BLOCK_S, SAMPLE_RATE_HZ, AudioBlock
from lipsync.errors import UserError
from lipsync.face.model import load_face
from lipsync.phonemes import SILENCE
from lipsync.recognition.network_recognizer import NetworkRecognizer
from lipsync.recognition.recognizers import make_recognizer

RATE_HZ: Final = 100.0
#: In each minute: when a load begins, and how long it lasts.
LOADS_S: Final = ((8.0, 1.0), (22.0, 2.0), (38.0, 5.0))
#: Loads that should not take the network away.
_SHORT_S: Final = 2.0
#: Around a change the mouth is looked at for so long.
_AROUND_S: Final = 0.02


class LadderError(UserError):
    """A process that was to be measured did not work; one line."""


@dataclass(frozen=True, slots=True)
class Load:
    """Every core was busy from and to these monotonic times; length_s: as scripted."""

    begin_s: float
    end_s: float
    length_s: float


@dataclass(frozen=True, slots=True)
class Ticks:
    """The ticks of a trace, (n,) each, by monotonic time.

    heard_s: the sound time heard then; shown_s: the one shown. is_network: whether it listens.
    over_s: how much later than declared its targets are. gap_mm: between the lips. late: ticks
    missed before.
    """

    time_s: Array
    heard_s: Array
    shown_s: Array
    is_network: NDArray[np.bool_]
    over_s: Array
    gap_mm: Array
    late: NDArray[np.int64]

    def until(self, sound_s: float) -> "Ticks":
        """Those in which the sound before `sound_s` was heard; afterwards the face is let go."""
        kept = self.heard_s < sound_s
        return Ticks(*(getattr(self, each.name)[kept] for each in fields(self)))


def read_ticks(trace: Path, first_s: float) -> Ticks:
    """The ticks of a trace whose first was at monotonic `first_s`. Raises LadderError."""
    face = load_face()
    columns: list[tuple[float, float, bool, float, float, int]] = []
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
                        record["sound_s"],
                        record["hears"] is not None,
                        record["target_age_s"] or 0.0,
                        face.lip_gap_mm(np.array(record["coefficients"])),
                        record["late"],
                    )
                )
                n += 1
    except (OSError, ValueError, KeyError) as error:
        raise LadderError(f"{trace.name}: no trace of a whole run ({error})") from error
    if not columns:
        raise LadderError(f"{trace.name}: holds no tick")
    times_s, shown_s, networks, overs_s, gaps_mm, late = (
        np.array(each) for each in zip(*columns, strict=True)
    )
    return Ticks(times_s, shown_s + delay_s, shown_s, networks, overs_s, gaps_mm, late)


def figures_of(
    ticks: Ticks, loads: Sequence[Load], is_speech: NDArray[np.bool_]
) -> dict[str, object]:
    """Return the figures of a run's ticks.

    Parameters
    ----------
    ticks : Ticks
        Of the trace.
    loads : Sequence[Load]
        Times in s at which other programs ran.
    is_speech : NDArray[np.bool_]
        (n,), each 10 ms of the sound, which repeats.

    Returns
    -------
    dict[str, object]
        Shares 0 to 1 and times in s.
    """
    weights = 1 + ticks.late
    frame = np.floor(np.maximum(ticks.heard_s, 0.0) / BLOCK_S).astype(np.int64)
    speaks = is_speech[frame % len(is_speech)] & (ticks.heard_s >= 0.0)
    network_share = float((weights * ticks.is_network)[speaks].sum() / weights[speaks].sum())
    backs_s: list[float] = []
    left: dict[float, int] = {length_s: 0 for _, length_s in LOADS_S}
    over_ms: list[float] = []
    ends_s = [*(load.begin_s for load in loads[1:]), float("inf")]
    for load, until_s in zip(loads, ends_s, strict=True):
        within = (ticks.time_s >= load.begin_s) & (ticks.time_s < until_s)
        away_s = ticks.time_s[within & ~ticks.is_network]
        if len(away_s):
            left[load.length_s] += 1
            backs_s.append(max(0.0, float(away_s[-1]) - load.end_s))
        for index in np.flatnonzero(within & (ticks.time_s < load.end_s)).tolist():
            missed = np.arange(ticks.late[index] + 1) / RATE_HZ
            over_ms += (1e3 * (ticks.over_s[index] + missed)).tolist()
    # Over missed ticks it is spread: how late the mouth is, is a figure of its own.
    steps_mm = np.abs(np.diff(ticks.gap_mm, prepend=ticks.gap_mm[:1])) / weights
    at_change = _near_changes(ticks)
    return {
        "network_share": network_share,
        "back_median_s": statistics.median(backs_s) if backs_s else 0.0,
        "back_worst_s": max(backs_s, default=0.0),
        "delay_over_p99_ms": float(np.percentile(over_ms, 99)) if over_ms else 0.0,
        "widest_step_mm": float(steps_mm[at_change].max()) if at_change.any() else 0.0,
        "widest_step_in_speech_mm": float(steps_mm[~at_change].max()),
        "loads": len(loads),
        "left_by_loads": sum(left.values()),
        "left_by_loads_up_to_2_s": sum(n for s, n in left.items() if s <= _SHORT_S),
        "changes": int(np.count_nonzero(np.diff(ticks.is_network))),
        "late_ticks": int(ticks.late.sum()),
    }


def _near_changes(ticks: Ticks) -> NDArray[np.bool_]:
    """Ticks that show the mouth at a change.

    When it happens, as what is planned may change then; and where phonemes of the one recogniser
    meet those of the other: at the sound heard then, less what the recogniser waits.
    """
    near = np.zeros(len(ticks.time_s), np.bool_)
    for index in np.flatnonzero(np.diff(ticks.is_network)) + 1:
        near |= np.abs(ticks.time_s - ticks.time_s[index]) <= _AROUND_S
        arrived_s = ticks.heard_s[index]
        near |= (ticks.shown_s >= arrived_s - 0.1 - _AROUND_S) & (
            ticks.shown_s <= arrived_s + _AROUND_S
        )
    return near


#: Between two repetitions of the clip.
_PAUSE_S: Final = 0.6
_STARTS_S, _ENDS_S, _ASK_S = 60.0, 30.0, 0.02
_N_TICKS: Final = 50
#: Of the slowed process: how many times as long as its sound the network takes; how long it runs.
_SLOWED: Final = 10.0
_SLOWED_S: Final = 8.0

#: The whole program. One whose parent died before it could ask for the signal ends by itself.
_RUN = (
    "import os; from firmware_bridge.process.operating_system import die_with_parent; "
    f"die_with_parent(); os.getppid() == {os.getpid()} or os._exit(1); "
    "from lipservo.__main__ import main; main()"
)
_RUN_SLOWED = (
    "from lipservo_lab.bench.hearing.ladder_figures import slow_the_network as slow; "
    f"slow({_SLOWED}); {_RUN}"
)
_STOPPED: Final = "stopped before the end: no figures"
#: Burns for as many seconds as each line says.
_HOG = """
import signal, sys, time
from firmware_bridge.process.operating_system import die_with_parent
die_with_parent(signal.SIGKILL)
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
    """The figures, by name. n_busy: processes for each core, scheduled as ours is.

    folder: for the files; is_over: called often, to end early.
    Raises LadderError.
    """
    (folder / "session").mkdir(mode=0o700)
    seconds = minutes * 60.0
    sound, is_speech = _speech(folder / "speech.wav", seconds)
    with _hogs(n_busy * (os.cpu_count() or 1)) as burn:
        ticks, loads = _under_load(folder, sound, seconds, burn, progress, is_over)
    fallback_s = _slowed(folder, sound, is_over)
    return {**figures_of(ticks.until(seconds), loads, is_speech), "fallback_s": fallback_s}


#: Faces that go on alone have the network back within this, or not at all: a try that fails is
#: repeated after 8 s at the latest (docs/recognition.md), and takes over within 8 s.
_COMES_BACK_S: Final = 120.0


def crowd_figures(
    n_faces: int, seconds: float, folder: Path, is_over: Callable[[], bool]
) -> dict[str, object]:
    """So many faces hear speech at once for so long; then all but one for each core end.

    lost: how many left the network while all ran. kept: how many go on, those that lost it first;
    kept_back: how many of these have it again; kept_back_worst_s: the last one, from the end of the
    others. Raises LadderError.
    """
    whole_s = seconds + _STARTS_S + _COMES_BACK_S
    sound, _ = _speech(folder / "speech.wav", whole_s)
    with ExitStack() as stack:
        faces: list[tuple[Path, subprocess.Popen[bytes], ExitStack]] = []
        for n in range(n_faces):
            own, own_stack = folder / str(n), stack.enter_context(ExitStack())
            (own / "session").mkdir(parents=True, mode=0o700)
            face = _face(_RUN, own, sound, own / "trace.jsonl")
            faces.append((own, own_stack.enter_context(face), own_stack))
        for own, process, _ in faces:
            _first_tick_s(own, process, is_over, n_ticks=1)
        losers: set[int] = set()
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            _wait_until(time.monotonic() + 1.0, faces[0][1], is_over)
            losers |= {n for n, face in enumerate(faces) if _level(face[0])}
        order = sorted(range(n_faces), key=lambda n: (n not in losers, n))
        n_kept = min(n_faces, os.cpu_count() or 1)
        for n in order[n_kept:]:
            faces[n][1].terminate()
        for n in order[n_kept:]:
            faces[n][2].close()
        ended_s = time.monotonic()
        back_s: dict[int, float] = {}
        while len(back_s) < n_kept and time.monotonic() < ended_s + _COMES_BACK_S:
            for n in order[:n_kept]:
                _wait_until(time.monotonic() + 0.1, faces[n][1], is_over)
                if n not in back_s and _level(faces[n][0]) == 0:
                    back_s[n] = time.monotonic() - ended_s
    return {
        "lost": len(losers),
        "kept": n_kept,
        "kept_back": len(back_s),
        "kept_back_worst_s": max(back_s.values(), default=None),
    }


def _level(folder: Path) -> int | None:
    """How many recognisers better than the one in use a face has; None: it does not answer."""
    for path in (folder / "session").glob("**/*.sock"):
        try:
            status = ask(path, "status")
        except OSError:
            continue
        return int(status["fallback_level"])
    return None


def slow_the_network(times: float) -> None:
    """In this process the network takes `times` as long as its sound lasts, busy all the while."""
    prepare = NetworkRecognizer.prepare

    def slowly(self: NetworkRecognizer, blocks: Sequence[AudioBlock]) -> None:
        sound_s = sum(len(block.samples) / block.sample_rate_hz for block in blocks)
        until_s = time.perf_counter() + times * sound_s
        prepare(self, blocks)
        while time.perf_counter() < until_s:
            pass

    NetworkRecognizer.prepare = slowly  # type: ignore[method-assign]


def _speech(path: Path, seconds: float) -> tuple[Path, NDArray[np.bool_]]:
    """The bundled clip repeated, and for each 10 ms of one turn whether there is speech."""
    with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip:
        samples = read_speech(clip)
        events = list(settled_events(FileSource(clip), make_recognizer("network")))
    n_turn = -(-(len(samples) + round(_PAUSE_S * SAMPLE_RATE_HZ)) // 160)
    turn = np.zeros(n_turn * 160, np.float32)
    turn[: len(samples)] = samples
    soundfile.write(path, np.resize(turn, round(seconds * SAMPLE_RATE_HZ)), SAMPLE_RATE_HZ)
    is_speech = np.zeros(n_turn, np.bool_)
    for event in events:
        if event.phoneme != SILENCE and event.end_s is not None:
            is_speech[round(event.start_s / BLOCK_S) : round(event.end_s / BLOCK_S)] = True
    return path, is_speech


def _under_load(
    folder: Path,
    sound: Path,
    seconds: float,
    burn: Callable[[float], None],
    progress: Callable[[float, float], None],
    is_over: Callable[[], bool],
) -> tuple[Ticks, list[Load]]:
    """Let a face listen for so long, and burn by the script."""
    trace = folder / "trace.jsonl"
    script = [
        (minute * 60.0 + at_s, length_s)
        for minute in range(int(np.ceil(seconds / 60.0)))
        for at_s, length_s in LOADS_S
        if minute * 60.0 + at_s + length_s < seconds
    ]
    loads: list[Load] = []
    with _face(_RUN, folder, sound, trace) as process:
        first_s = _first_tick_s(folder, process, is_over)
        for at_s, length_s in script:
            _wait_until(first_s + at_s, process, is_over)
            begin_s = time.monotonic()
            burn(length_s)
            loads.append(Load(begin_s, begin_s + length_s, length_s))
            progress(at_s, seconds)
        _wait_until(first_s + seconds + _ENDS_S, process, is_over, may_end=True)
    return read_ticks(trace, first_s), loads


def _slowed(folder: Path, sound: Path, is_over: Callable[[], bool]) -> float | None:
    """After how long energy takes over from a recogniser that is too slow; None: it did not."""
    short = folder / "short.wav"
    samples = soundfile.read(sound, frames=round(_SLOWED_S * SAMPLE_RATE_HZ), dtype="float32")[0]
    soundfile.write(short, samples, SAMPLE_RATE_HZ)
    trace = folder / "slowed.jsonl"
    with _face(_RUN_SLOWED, folder, short, trace) as process:
        until_s = time.monotonic() + _STARTS_S + _SLOWED_S + _ENDS_S
        _wait_until(until_s, process, is_over, may_end=True)
    ticks = read_ticks(trace, 0.0).until(_SLOWED_S)
    lesser = np.flatnonzero(~ticks.is_network[:-1])
    # The tick in which it was left took long: it ended before the next one.
    return float(ticks.time_s[lesser[0] + 1]) if len(lesser) else None


@contextmanager
def _face(code: str, folder: Path, sound: Path, trace: Path) -> Iterator[subprocess.Popen[bytes]]:
    """A whole `lipservo run` in a runtime folder of its own.

    It ends with this block, or with us.
    """
    environment = {
        **os.environ,
        "XDG_RUNTIME_DIR": str(folder / "session"),
        "XDG_STATE_HOME": str(folder / "state"),
        "OPENBLAS_NUM_THREADS": "1",  # as `lipservo run` itself sets it
    }
    environment.pop("RUNTIME_DIRECTORY", None)
    shipped = (resources.files("lipservo.config") / "face_sim.yaml").read_text()
    face = folder / "face.yaml"
    face.write_text(shipped.replace("rate_hz: 30", f"rate_hz: {RATE_HZ:g}"))
    arguments = ["run", "--wav", str(sound), "--trace", str(trace), "--config", str(face)]
    with (folder / "log").open("ab") as log:
        process = subprocess.Popen(
            [sys.executable, "-c", code, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            env=environment,
        )
    try:
        yield process
    finally:
        if process.poll() is None:
            process.terminate()
            try:
                process.wait(_ENDS_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


@contextmanager
def _hogs(n_processes: int) -> Iterator[Callable[[float], None]]:
    """A function that lets so many processes be busy for so many seconds, from now on."""
    busy = [
        subprocess.Popen([sys.executable, "-c", _HOG], stdin=subprocess.PIPE)
        for _ in range(n_processes)
    ]

    def burn(seconds: float) -> None:
        for process in busy:
            assert process.stdin is not None
            process.stdin.write(f"{seconds}\n".encode())
            process.stdin.flush()

    try:
        yield burn
    finally:
        for process in busy:
            process.kill()
            process.wait()
            if process.stdin is not None:
                process.stdin.close()


def _first_tick_s(
    folder: Path,
    process: subprocess.Popen[bytes],
    is_over: Callable[[], bool],
    n_ticks: int = _N_TICKS,
) -> float:
    """The monotonic time of the face's first tick, of its counts: to some 10 ms."""
    give_up_s = time.monotonic() + _STARTS_S
    found_s: list[float] = []
    while len(found_s) < n_ticks:
        if time.monotonic() > give_up_s or process.poll() is not None:
            log_lines = (folder / "log").read_text(errors="replace").strip().splitlines()
            raise LadderError(
                f"the face did not start: {log_lines[-1] if log_lines else 'says nothing'}"
            )
        if is_over():
            raise LadderError(_STOPPED)
        time.sleep(_ASK_S)
        for path in (folder / "session").glob("**/*.sock"):
            try:
                status = ask(path, "status")
            except OSError:
                continue
            if status.get("n_ticks"):
                n_passed = status["n_ticks"] + status["n_late"]
                found_s.append(time.monotonic() - n_passed / RATE_HZ)
    return min(found_s)


def _wait_until(
    time_s: float,
    process: subprocess.Popen[bytes],
    is_over: Callable[[], bool],
    *,
    may_end: bool = False,
) -> None:
    """Raises LadderError where it is to end early, and for a process that ends before its time."""
    while time.monotonic() < time_s:
        if is_over():
            raise LadderError(_STOPPED)
        if process.poll() is not None:
            if may_end:
                return
            raise LadderError(f"the face ended with exit status {process.returncode}")
        time.sleep(min(0.05, max(0.0, time_s - time.monotonic())))
