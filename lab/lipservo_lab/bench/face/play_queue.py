"""What a face costs with five hundred sounds queued at once: threads, and late ticks.

The face is a daemon in a process of its own, with servos in memory: sound, recogniser and ticks
share one process there, so whatever plays disturbs as much as it can.
"""

import contextlib
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final

import numpy as np
import soundfile
from lipservo_client.blocking_face import Face
from lipservo_client.protocol import FaceError

from firmware_bridge.process.control_client import ask

_N_PLAYS: Final = 500
_N_CLIENTS: Final = 2  # each has two of the eight connections that an agent server takes
_SOUND_S, _RATE_HZ = 60.0, 48_000
_PATIENCE_S: Final = 180.0
_LOOK_S: Final = 0.05
_END_S: Final = 30.0
_SETTLE_S: Final = 3.0
_CLOSED: Final = ("refused", "too_many_streams", "too_many_requests")


def play_figures(seconds: float) -> dict[str, float]:
    """Shares of late ticks without and with 500 `play`, and how many threads they add.

    seconds: of each of the two windows. `play_accepted`: how many of them were taken.
    """
    with tempfile.TemporaryDirectory() as folder, _speaking_face(Path(folder)) as (pid, status):
        url = str(status()["listens_on"])
        time.sleep(_SETTLE_S)
        with Face(url, None) as face:  # threads that any client costs are no part of it
            with contextlib.suppress(FaceError):
                face.play("none.wav")
            before = _n_threads(pid)
        quiet, _ = _window(pid, status, seconds)
        with ThreadPoolExecutor(_N_CLIENTS) as clients:
            pending = [
                clients.submit(_play, url, _N_PLAYS // _N_CLIENTS) for _ in range(_N_CLIENTS)
            ]
            late, n_threads = _window(pid, status, seconds)
            accepted = sum(each.result() for each in pending)
    return {
        "play_accepted": accepted,
        "play_threads_added": n_threads - before,
        "play_late_ticks": late,
        "play_late_ticks_without": quiet,
    }


def _play(url: str, times: int) -> int:
    accepted = 0
    with Face(url, None) as face:
        for _ in range(times):
            try:
                face.play("line.wav")
            except FaceError as error:
                if error.code not in _CLOSED:
                    raise
            else:
                accepted += 1
    return accepted


def _window(pid: int, status: Callable[[], dict[str, object]], seconds: float) -> tuple[float, int]:
    """The share of ticks that came too late, in a while, and the most threads that were seen."""
    most, over = [_n_threads(pid)], threading.Event()

    def watch() -> None:
        while not over.wait(_LOOK_S):
            most[0] = max(most[0], _n_threads(pid))

    watching = threading.Thread(target=watch, daemon=True)
    watching.start()
    before = status()
    time.sleep(seconds)
    after = status()
    over.set()
    watching.join()
    n_ticks, n_late = (_grown(name, before, after) for name in ("n_ticks", "n_late"))
    return n_late / max(1, n_ticks + n_late), most[0]  # those are left out


def _grown(name: str, before: dict[str, object], after: dict[str, object]) -> int:
    first, last = before[name], after[name]
    assert isinstance(first, int)
    assert isinstance(last, int)
    return last - first


def _n_threads(pid: int) -> int:
    return len(os.listdir(f"/proc/{pid}/task"))


@contextlib.contextmanager
def _speaking_face(folder: Path) -> Iterator[tuple[int, Callable[[], dict[str, object]]]]:
    """A daemon that plays the sounds of a folder, once it answers: its process, and its status."""
    hum = 0.1 * np.sin(np.arange(round(_SOUND_S * _RATE_HZ)) / 50.0)
    soundfile.write(folder / "line.wav", hum, _RATE_HZ)
    control = folder / "face.sock"
    command = [sys.executable, "-P", "-m", "lipservo", "daemon", "--config", "face_sim", "--quiet"]
    command += ["--sounds", str(folder), "--listen", "127.0.0.1:0", "--control", str(control)]

    def status() -> dict[str, object]:
        return dict(ask(control, "status", _END_S))

    with subprocess.Popen(command) as process:
        try:
            give_up_s = time.monotonic() + _PATIENCE_S
            while not _answers(status):
                if time.monotonic() > give_up_s:
                    raise TimeoutError("the daemon did not start")
                time.sleep(_LOOK_S)
            yield process.pid, status
        finally:
            process.terminate()
            process.wait(_END_S)


def _answers(status: Callable[[], dict[str, object]]) -> bool:
    try:
        return bool(status().get("listens_on"))
    except OSError:
        return False
