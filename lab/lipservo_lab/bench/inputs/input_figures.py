"""Odd inputs of every kind: how many end in a traceback, hang, or are read wrongly unsaid."""

import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from lipservo_lab.bench.inputs.label_inputs import LABEL_KINDS
from lipservo_lab.bench.inputs.odd_input import verdict
from lipservo_lab.bench.inputs.other_inputs import OTHER_KINDS
from lipservo_lab.bench.inputs.sound_inputs import SOUND_KINDS

KINDS: Final = {**LABEL_KINDS, **SOUND_KINDS, **OTHER_KINDS}
#: Of each kind so many wrong ones are named.
_NAMED: Final = 3


def input_figures(
    n_each: int, seed: int, advance: Callable[[str, int, int], None]
) -> dict[str, object]:
    """Let readers read `n_each` odd inputs of each kind; return how many they read wrongly.

    `wrong`: by kind, the number of wrong ones and a line for each of the first. seed: of the
    inputs. advance: called with the kind, its number, and the number of kinds.
    """
    counts: Counter[str] = Counter()
    wrong_lines: dict[str, list[str]] = {}
    for number, (kind, make) in enumerate(KINDS.items()):
        advance(kind, number, len(KINDS))
        for n in range(n_each):
            rng = np.random.default_rng([seed, number, n])
            with tempfile.TemporaryDirectory() as folder:
                result, why = verdict(make(rng, Path(folder)))
            counts[result] += 1
            if why:
                wrong_lines.setdefault(kind, []).append(f"{n}: {result}: {why[:400]}")
    return {
        "inputs": n_each * len(KINDS),
        "kinds": len(KINDS),
        "tracebacks": counts["traceback"],
        "hangs": counts["hang"],
        "silently_wrong": counts["silently_wrong"],
        "refused_wrongly": counts["refused_wrongly"],
        "wrong": {kind: [len(lines), *lines[:_NAMED]] for kind, lines in wrong_lines.items()},
    }
