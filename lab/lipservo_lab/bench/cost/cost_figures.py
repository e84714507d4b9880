"""What a face's speech process costs at rest and speaking, beside another checkout of the program.

Both checkouts run their own `run_speech_process`, whole, on a virtual clock (`speech_turns`), the
same speech and the same rest in turns, so that a busy computer slows both alike.
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from importlib import resources
from pathlib import Path
from statistics import median
from typing import Any, Final

import numpy as np

from lipservo_lab.bench.cost import speech_turns
from lipservo_lab.own_processes import started_alone
from lipsync.errors import UserError

_ROOT: Final = Path(speech_turns.__file__).parents[4]
#: The turns of a cycle, in order.
TURNS: Final = ("speaking", "idle")
_END_S: Final = 60.0


class _Process:
    """The speech process of a checkout, which runs one turn at a time, when `turn` is called."""

    def __init__(self, root: Path, output: Path, face: str, sound: str, n_cycles: int) -> None:
        with resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip:
            command = [sys.executable, speech_turns.__file__, root, output, face, sound, clip]
            self._process = started_alone(
                [*map(str, command), str(n_cycles)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
        self._root, self._output = root, output

    def turn(self, *, counts_calls: bool) -> dict[str, float]:
        """Run the next turn; return its `seconds` of sound and `spent_s`, processor time.

        counts_calls: also return `python_calls` and `c_calls`. Raises UserError if the process has
        ended.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        line = ""
        try:
            self._process.stdin.write("count\n" if counts_calls else "run\n")
            self._process.stdin.flush()
            line = self._process.stdout.readline()
        except BrokenPipeError:
            pass
        if not line:
            raise UserError(
                f"{self._root}: its speech process ended; is it a checkout of lipservo?"
            )
        found: dict[str, float] = json.loads(line)
        return found

    def targets(self) -> tuple[np.ndarray, np.ndarray]:
        """End the process; return when its targets were published and due, (n, 2) s, and the goals.

        Goals: (n, n_joints) degrees.
        """
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(_END_S)
        with np.load(self._output) as stored:
            return stored["times_s"], stored["goals_deg"]

    def __enter__(self) -> "_Process":
        return self

    def __exit__(self, *exc: object) -> None:
        self._process.kill()
        self._process.wait()


def cost_figures(
    against: Path | None,
    face: str,
    sound: str,
    n_cycles: int,
    advance: Callable[[int, int], None] = lambda _n_done, _n_all: None,
) -> dict[str, Any]:
    """Return the processor time of a face that speaks and rests in turns. Raises UserError.

    against: root of another checkout, run in turns with this one; None: no ratios. face: name of a
    shipped one. sound: "voice" or "file", as in `speech_turns`. n_cycles: cycles of speech and
    rest; one more counts calls. advance: called with turns done and all turns.

    `speaking_ms`, `idle_ms`: ms of processor time for a second of sound, medians. `calls_per_step`:
    calls of C and of Python functions in 10 ms. `speaking_ratio`, `idle_ratio`: our time over the
    other's in the same cycle, medians. `goals_apart_deg`, `goals_apart_s`: the greatest difference
    from the other's targets, in angle, and in when they were published or due.
    """
    checkouts = {"own": _ROOT} if against is None else {"own": _ROOT, "other": against}
    turns: dict[str, list[dict[str, float]]] = {name: [] for name in checkouts}
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="lipservo-bench-")))
        processes = {
            name: stack.enter_context(
                _Process(root, folder / f"{name}.npz", face, sound, n_cycles + 1)
            )
            for name, root in checkouts.items()
        }
        n_turns = (n_cycles + 1) * len(TURNS)
        for number in range(n_turns):
            is_counted = number >= n_cycles * len(TURNS)
            for name, process in processes.items():
                turns[name].append(process.turn(counts_calls=is_counted))
            advance(number + 1, n_turns)
        targets = [process.targets() for process in processes.values()]
    figures = turn_figures(turns)
    if len(targets) > 1:
        figures |= differences(*targets)
    return figures


def turn_figures(turns: Mapping[str, list[dict[str, float]]]) -> dict[str, Any]:
    """Return costs, calls and ratios, as `cost_figures` describes them.

    turns: results of `_Process.turn` in their order, of the process `own`, and of `other` if there
    is one. The last cycle's turns count calls.
    """
    figures: dict[str, Any] = {"calls_per_step": {}}
    for offset, turn_kind in enumerate(TURNS):
        cost = {
            name: [turn["spent_s"] / turn["seconds"] for turn in found[offset :: len(TURNS)]][:-1]
            for name, found in turns.items()
        }
        figures[f"{turn_kind}_ms"] = median(cost["own"]) * 1e3
        if "other" in cost:
            pairs = zip(cost["own"], cost["other"], strict=True)
            figures[f"{turn_kind}_ratio"] = median(own / other for own, other in pairs)
        counted_turn = turns["own"][offset - len(TURNS)]
        figures["calls_per_step"][turn_kind] = {
            kind: round(counted_turn[f"{kind}_calls"] / counted_turn["seconds"] / 100.0)
            for kind in ("c", "python")
        }
    return figures


def differences(
    own: tuple[np.ndarray, np.ndarray], other: tuple[np.ndarray, np.ndarray]
) -> dict[str, float]:
    """Return the greatest differences of two processes' targets: `goals_apart_deg`, `_s`.

    own, other: as `_Process.targets` returns them. Raises UserError if their shapes differ.
    """
    if own[1].shape != other[1].shape:
        raise UserError(
            f"this checkout has sent {len(own[1])} goals to {own[1].shape[1:]} joints, --against "
            f"{len(other[1])} to {other[1].shape[1:]}: these cannot be compared"
        )
    (times_s, goals_deg), (other_times_s, other_goals_deg) = own, other
    return {
        "goals_apart_deg": float(np.abs(goals_deg - other_goals_deg).max()),
        "goals_apart_s": float(np.abs(times_s - other_times_s).max()),
    }
