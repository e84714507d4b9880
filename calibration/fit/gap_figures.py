"""What becomes of the openings of the lips: how much of them is made, which are lost."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.hold_out import CLOSED_GAP_MM, SMALL_GAPS_MM
from lipsync.arrays import Array

#: A small opening of which less than this is made is lost.
_HALF = 0.5
#: Of openings that are nearly all the same nobody can say how they follow.
_LEAST_SPREAD_MM = 0.3


@dataclass(frozen=True, slots=True)
class GapFigures:
    """None where no frame can tell.

    slope: openings made over openings asked for; closed_mm: how far lips stay apart in 95 % of the
    frames in which the speaker's are closed; small_kept: the part of small openings that are at
    least half made.
    """

    slope: float | None
    closed_mm: float | None
    small_kept: float | None


def gap_figures(
    asked_mm: Array, made_mm: Array, human_gap_mm: Array, shares: Array | None = None
) -> GapFigures:
    """(n,) each: openings beyond the robot's own closed gap, NaN where nobody saw; the speaker's.

    shares: (n,), of speech that each frame stands for; None: all the same.
    """
    known = np.isfinite(made_mm)
    weights = np.ones(len(made_mm)) if shares is None else shares
    asked, made, human = asked_mm[known], made_mm[known], human_gap_mm[known]
    closed, small = human <= CLOSED_GAP_MM, is_small(human)
    is_told = len(asked) > 2 and float(np.ptp(asked)) > _LEAST_SPREAD_MM
    slope = np.polyfit(asked, made, 1, w=np.sqrt(weights[known]))[0] if is_told else None
    kept = made[small] >= _HALF * asked[small]
    return GapFigures(
        slope=None if slope is None else float(slope),
        closed_mm=max(0.0, float(np.quantile(made[closed], 0.95))) if closed.any() else None,
        small_kept=float(np.average(kept, weights=weights[known][small])) if small.any() else None,
    )


def is_small(human_gap_mm: Array) -> NDArray[np.bool_]:
    """(n,): whether the speaker's lips are a little open."""
    least_mm, most_mm = SMALL_GAPS_MM
    return np.asarray((human_gap_mm >= least_mm) & (human_gap_mm <= most_mm))
