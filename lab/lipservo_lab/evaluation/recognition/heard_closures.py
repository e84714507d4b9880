"""Closures heard against closures spoken: recall, precision, and how far their onsets lie apart."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

#: A hit may lie this many frames beside: the boundaries of forced alignment are not better.
SLACK_FRAMES = 2
_FRAME_MS = 10.0


@dataclass(slots=True)
class HeardClosures:
    """Counts of one kind of closure, or of openings, added up over utterances.

    onset_errors_ms: of each closure found, how much later than spoken it was heard to begin.
    """

    n_spoken: int = 0
    n_found: int = 0
    n_said: int = 0
    n_true: int = 0
    onset_errors_ms: list[float] = field(default_factory=list)

    def add(self, said: NDArray[np.bool_], spoken: NDArray[np.bool_]) -> None:
        """Count one utterance: whether each frame (n,) was heard, and was spoken, as a closure."""
        said_runs, spoken_runs = _runs(said), _runs(spoken)
        self.n_spoken += len(spoken_runs)
        self.n_said += len(said_runs)
        self.n_true += sum(_touches(run, spoken) for run in said_runs)
        for run in spoken_runs:
            if _touches(run, said):
                self.n_found += 1
                nearest = min(said_runs, key=lambda other: _apart(other, run))
                self.onset_errors_ms.append(_FRAME_MS * (nearest[0] - run[0]))

    def figures(self, name: str) -> dict[str, float]:
        """Shares, 0 where nothing was counted; onset errors: median, 95th percentile of sizes."""
        errors_ms = np.array(self.onset_errors_ms or [0.0])
        return {
            f"{name}_recall": self.n_found / self.n_spoken if self.n_spoken else 0.0,
            f"{name}_precision": self.n_true / self.n_said if self.n_said else 0.0,
            f"{name}_onset_error_ms_p50": float(np.median(errors_ms)),
            f"{name}_onset_error_ms_abs_p95": float(np.percentile(np.abs(errors_ms), 95)),
        }


def _runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """(first, after the last) of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(np.int8), [0]))))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _touches(run: tuple[int, int], flags: NDArray[np.bool_]) -> bool:
    """Whether a True of `flags` lies in the run or within the slack of it."""
    first, end = run
    return bool(flags[max(0, first - SLACK_FRAMES) : end + SLACK_FRAMES].any())


def _apart(one: tuple[int, int], other: tuple[int, int]) -> tuple[int, int]:
    """Frames between two runs, 0 where they overlap; and between their onsets."""
    return max(0, one[0] - other[1], other[0] - one[1]), abs(one[0] - other[0])
