"""Short lines rendered on a Dask cluster whose workers, and once its scheduler, are killed.

Processes that ended are started again, as by a service manager. Each worker logs which task it
begins and which it has done, so that everything that is computed twice is known.
"""

import contextlib
import json
import os
import random
import re
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any, Final

import soundfile

from lipservo.terminal.output import Advance
from lipsync.errors import UserError
from lipsync.offline.performance import SUFFIX

_PYTHON: Final = (sys.executable, "-P", "-m")
_LINE_S: Final = 1.0
_LOOK_S: Final = 0.2
#: After so long without progress something hangs.
_PATIENCE_S: Final = 900.0
#: Environment variable with the log's path, read by the module that `dask worker --preload` loads.
_LOG: Final = "LIPSERVO_CAMPAIGN_LOG"
_NUMBER: Final = re.compile(r"lipservo-(\d+)-")
_BEGUN, _DONE = "begun", "done"


def cluster_figures(n_lines: int, kill_every_s: float, advance: Advance) -> dict[str, Any]:
    """Return the figures of `lipservo bench cluster`.

    lost: lines without a complete performance at the end. computed_twice: how often workers
    finished a line again; begun_twice: how often they began one again, also those of a killed
    worker. advance: as `progress_bar` yields it. Raises UserError if the command fails.
    """
    start_s = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="lipservo-cluster-") as name:
        folder = Path(name)
        _write_lines(folder / "lines", n_lines)
        command_line = [*_PYTHON, "lipservo", "lines", "render-folder", str(folder / "lines")]
        command_line += ["-o", str(folder / "out"), "--json", "--quiet"]
        with _cluster(folder / "log") as cluster:
            option = ["--dask", f"127.0.0.1:{cluster.port}"]
            with subprocess.Popen(
                [*command_line, *option], stdout=subprocess.PIPE, text=True
            ) as command:
                _kill_while(command, cluster, folder / "out", n_lines, kill_every_s, advance)
                output = command.communicate()[0]
        if command.returncode != 0:
            raise UserError(f"the command failed with status {command.returncode}: {output}")
        again = subprocess.run(command_line, stdout=subprocess.PIPE, text=True, check=True)
        events = Counter((event, number) for event, number, _ in _events(folder / "log"))
    twice = {
        word: sum(n - 1 for (event, _), n in events.items() if event == word)
        for word in (_BEGUN, _DONE)
    }
    return {
        "lines": n_lines,
        "workers": cluster.n_workers,
        "kill_every_s": kill_every_s,
        "workers_killed": cluster.n_killed,
        "schedulers_killed": cluster.n_schedulers_killed,
        "lost": json.loads(again.stdout)["rendered"],
        "computed_twice": twice[_DONE],
        "begun_twice": twice[_BEGUN],
        "seconds": round(time.monotonic() - start_s, 1),
    }


def _events(log: Path) -> Iterator[tuple[str, str, str]]:
    """Yield event, number of the task, and process id of the worker, for each line of the log."""
    text = log.read_text() if log.exists() else ""
    for line in text.splitlines():
        event, number, process = line.split()
        yield event, number, process


def _write_lines(folder: Path, n: int) -> None:
    """Write `n` different sound files of one second, cut from the shipped clip."""
    folder.mkdir()
    with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip:
        samples, rate_hz = soundfile.read(clip, dtype="int16")
    n_samples = round(_LINE_S * rate_hz)
    starts = random.Random(1).sample(range(len(samples) - n_samples), n)
    for number, start in enumerate(starts):
        piece = samples[start : start + n_samples]
        soundfile.write(folder / f"line{number:04d}.flac", piece, rate_hz)


@dataclass(slots=True)
class _Cluster:
    """A scheduler and workers on this computer.

    processes: by name, "scheduler" and "worker N".
    """

    port: int
    log: Path
    n_workers: int
    processes: dict[str, "subprocess.Popen[bytes]"] = field(default_factory=dict)
    n_killed: int = 0
    n_schedulers_killed: int = 0

    def start_what_has_ended(self) -> None:
        """Start the scheduler and each worker that is not running; a thread calls this often."""
        host = ["--host", "127.0.0.1"]
        programs = {"scheduler": ["scheduler", *host, "--port", str(self.port), "--no-dashboard"]}
        for n in range(self.n_workers):
            programs[f"worker {n}"] = [
                "worker", f"127.0.0.1:{self.port}", *host, "--nthreads", "1", "--no-nanny",
                "--no-dashboard", "--preload", __name__,
            ]  # fmt: skip
        for name, arguments in programs.items():
            process = self.processes.get(name)
            if process is None or process.poll() is not None:
                self.processes[name] = subprocess.Popen(
                    [*_PYTHON, "dask", *arguments],
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    env={**os.environ, _LOG: str(self.log)},
                )

    def kill(self, name: str) -> None:
        self.processes[name].send_signal(signal.SIGKILL)
        self.processes[name].wait()

    def computing(self) -> str | None:
        """Return the name of a running worker that has a task, the oldest of several, or None."""
        n_tasks = Counter[str]()
        for event, _, process in _events(self.log):
            n_tasks[process] += 1 if event == _BEGUN else -1
        busy = {process for process, n in n_tasks.items() if n > 0}
        found = [
            (process.pid, name)
            for name, process in self.processes.items()
            if process.poll() is None and str(process.pid) in busy
        ]
        return min(found)[1] if found else None


@contextlib.contextmanager
def _cluster(log: Path) -> Iterator[_Cluster]:
    """Run a scheduler and workers on a free port; restart those that end, until the body is left.

    log: file to which workers append the tasks that they begin and finish.
    """
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    cluster = _Cluster(port, log, max(2, os.cpu_count() or 1))
    is_over = threading.Event()

    def restart_ended() -> None:
        while not is_over.wait(_LOOK_S):
            cluster.start_what_has_ended()

    cluster.start_what_has_ended()
    thread = threading.Thread(target=restart_ended)
    thread.start()
    try:
        yield cluster
    finally:
        is_over.set()
        thread.join()
        for name in cluster.processes:
            cluster.kill(name)


def _kill_while(
    command: "subprocess.Popen[str]",
    cluster: _Cluster,
    output: Path,
    n_lines: int,
    kill_every_s: float,
    advance: Advance,
) -> None:
    """Kill a computing worker every `kill_every_s`, and the scheduler once half the lines are done.

    Blocks until the command ends; the first kill follows the first line. Raises UserError if
    nothing is rendered for `_PATIENCE_S`.
    """
    n_done, progress_s = 0, time.monotonic()
    due_s = float("inf")
    while command.poll() is None:
        time.sleep(_LOOK_S)
        now_s = time.monotonic()
        n_now = sum(1 for _ in output.glob(f"*{SUFFIX}"))
        if n_now > n_done:
            n_done, progress_s = n_now, now_s
            due_s = min(due_s, now_s + kill_every_s)
            advance("lines", n_done, n_lines)
        if now_s >= due_s and (victim := cluster.computing()) is not None:
            cluster.kill(victim)
            cluster.n_killed += 1
            due_s = now_s + kill_every_s
        if not cluster.n_schedulers_killed and 2 * n_done >= n_lines:
            cluster.kill("scheduler")
            cluster.n_schedulers_killed += 1
        if now_s - progress_s > _PATIENCE_S:
            command.kill()
            raise UserError(f"nothing was rendered for {_PATIENCE_S:g} s")


def dask_setup(worker: Any) -> None:
    """Make a worker log tasks that it begins and finishes; `dask worker --preload` calls it."""
    from distributed import WorkerPlugin

    class TaskLog(WorkerPlugin):  # type: ignore[misc]
        def transition(self, key: object, start: str, finish: str, **_more: Any) -> None:
            """Append a line to the log when a numbered task begins or is done; Dask calls this."""
            number = _NUMBER.match(str(key))
            event = _BEGUN if finish == "executing" else _DONE if finish == "memory" else None
            if number is not None and event is not None and start != finish:
                line = f"{event} {number[1]} {os.getpid()}\n".encode()
                # Appended by one write: lines of several workers do not mix.
                log = os.open(os.environ[_LOG], os.O_WRONLY | os.O_APPEND | os.O_CREAT)
                os.write(log, line)
                os.close(log)

    worker.plugins["telling"] = TaskLog()
