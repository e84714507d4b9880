"""The figures of `lipservo bench house`: what each way passes of the source, and its size.

`files` and `hops` of a tick: medians over all ticks of `lipservo replay` of the bundled clip with
`face_sim` (a mouth) and `face_head` (a head), at the face's own rate. A tick is what the thread of
the loop does between two waits of its clock, bridge and speech side alike; its files are those of
ours in which a function is entered, and a hop is a call from a function in one file of ours to one
in another. Calls within a file, comprehensions, and libraries are none.

`stop_files`: files of ours between the arrival of a press of STOP at the page's server and the
write that clears the register of torque: the server and the owner of the control socket as
`stop_path` follows them, then the loop's thread from the beginning of the tick in which it comes.

`processor_s`: user and system time of whole processes, least of some; of `run`, the time until
`lipservo run --wav FILE` waits for its first tick.

`installed_mb`: of the disk, by what is installed: wheel and client, with the page, client alone.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any, Final

import lipservo
from firmware_bridge.stopping import StopLevel
from lipservo.terminal.output import Advance
from lipservo_lab.bench.house import traced_ticks
from lipservo_lab.bench.house.code_lines import budgets, house_table, room_lines
from lipservo_lab.bench.house.installed import installed_mb
from lipservo_lab.bench.stops.stop_path import register_files
from lipsync.errors import UserError

ROOT: Final = Path(lipservo.__file__).parents[1]
#: What each process of `processor_s` is given.
COMMANDS: Final = {
    "help": ["--help"],
    "typo": ["rnu"],
    "status": ["status"],
    "stop": ["stop"],
    "calibrate_fit": ["calibrate", "fit", "--plan", "none.npz", "--markers", "none", "-o", "x"],
}
_N_PROCESSES: Final = 3
_LONGEST_S: Final = 300.0


def house_figures(advance: Advance = lambda _what, _n_done, _n_all: None) -> dict[str, Any]:
    """Return all figures of `bench house`; `over` has a line for each figure above its bar.

    advance: called with the work, steps done and all. Raises UserError where the program is not run
    from a checkout.
    """
    if not (ROOT / "pyproject.toml").is_file():
        raise UserError(f"{ROOT}: no checkout; `pip install -e . -e ./client -e ./lab` in one")
    table = house_table()
    figures: dict[str, Any] = {}
    advance("house", 0, 4)
    figures["ticks"] = {name: tick_figures(name) for name in table["ticks"]}
    advance("house", 1, 4)
    figures["processor_s"] = {name: processor_s(line) for name, line in COMMANDS.items()}
    figures["processor_s"]["run"] = first_tick_s()
    advance("house", 2, 4)
    figures["stop_files"] = len(register_files(StopLevel.LIMP))
    advance("house", 3, 4)
    figures["installed_mb"] = {
        each: round(installed_mb(ROOT, each), 1) for each in table["installed_mb"]
    }
    figures["code_lines"] = room_lines(ROOT)
    return {**figures, "over": above_bars(figures)}


def above_bars(figures: dict[str, Any]) -> list[str]:
    """Return a line for every figure above its bar in `house.yaml`."""
    table = house_table()
    rows = [("stop_files", figures["stop_files"], table["stop_files"])]
    for name, bars in table["ticks"].items():
        rows += [(f"{name} {key}", figures["ticks"][name][key], bar) for key, bar in bars.items()]
    rows += [
        (f"{kind} {key}", figures[kind][key], bar)
        for kind in ("processor_s", "installed_mb")
        for key, bar in table[kind].items()
    ]
    rows += [
        (f"code_lines {name}", figures["code_lines"][name], row.ceiling)
        for name, row in budgets().items()
    ]
    return [f"{name}: {value:.4g}, bar {bar:.4g}" for name, value, bar in rows if value > bar]


def tick_figures(face: str) -> dict[str, Any]:
    """Replay the bundled clip with a shipped face; return medians of its ticks: files and hops."""
    with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip:
        found: dict[str, Any] = _traced("ticks", "replay", str(clip), "--config", face, "--quiet")
    return found


def first_tick_s() -> float:
    """Start a `run` of the bundled clip; return its processor time until its first tick, s."""
    with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip:
        found: float = _traced("first_tick", "run", "--wav", str(clip), "--quiet")
    return found


def processor_s(arguments: Sequence[str]) -> float:
    """Return the processor time of a `lipservo` process, s, where no face runs.

    The least of `_N_PROCESSES` runs. arguments: of the command line.
    """
    with tempfile.TemporaryDirectory(prefix="lipservo-bench-") as folder:
        environment = {**os.environ, "XDG_RUNTIME_DIR": folder}
        return min(_process_time_s(arguments, environment, folder) for _ in range(_N_PROCESSES))


def _process_time_s(arguments: Sequence[str], environment: dict[str, str], folder: str) -> float:
    command = [sys.executable, "-P", "-m", "lipservo", *arguments]
    quiet = subprocess.DEVNULL
    with subprocess.Popen(
        command, stdout=quiet, stderr=quiet, env=environment, cwd=folder
    ) as process:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    return usage.ru_utime + usage.ru_stime


def _traced(what: str, *arguments: str) -> Any:
    """Run a `lipservo` command in a process that `traced_ticks` observes; return the result.

    what: "ticks" or "first_tick". arguments: of the command. Raises RuntimeError with what the
    process wrote to standard error, where there is no result.
    """
    with tempfile.TemporaryDirectory(prefix="lipservo-bench-") as folder:
        output = Path(folder) / "traced.json"
        script = [sys.executable, traced_ticks.__file__, str(ROOT), str(output), what]
        done = subprocess.run(
            [*script, *arguments],
            capture_output=True,
            text=True,
            cwd=folder,
            timeout=_LONGEST_S,
            check=False,
        )
        if not output.is_file():
            raise RuntimeError(f"lipservo {' '.join(arguments)}: {done.stderr}")
        return json.loads(output.read_text("utf-8"))
