"""Saccades found in a track of gaze, with their sizes and durations."""

from dataclasses import dataclass

import numpy as np

from lipsync.arrays import Array
from lipsync.expression.cue import CUE_PERIOD_S

#: Between two saccades gaze holds; rounding alone moves it less.
_HOLDS_DEG = 1e-6


@dataclass(frozen=True, slots=True)
class GazeShifts:
    """(k,) each: when they begin, how large they are, how long they take."""

    start_s: Array
    magnitude_deg: Array
    duration_s: Array

    @property
    def seconds_per_deg(self) -> float:
        """Slope of duration over magnitude, least squares."""
        return float(np.polyfit(self.magnitude_deg, self.duration_s, 1)[0])


def gaze_shifts(gaze_deg: Array) -> GazeShifts:
    """Find the saccades of a source whose gaze holds between them.

    Parameters
    ----------
    gaze_deg : Array
        (n, 2), in the robot's frame.

    Returns
    -------
    GazeShifts
        Starts and durations in s, sizes in degrees.
    """
    moves = np.hypot(*np.diff(gaze_deg, axis=0).T) > _HOLDS_DEG
    edges = np.diff(np.concatenate([[False], moves, [False]]).astype(int))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    way_deg = gaze_deg[ends] - gaze_deg[starts]
    magnitude_deg = np.asarray(np.hypot(way_deg[:, 0], way_deg[:, 1]), np.float64)
    duration_s = np.asarray((ends - starts) * CUE_PERIOD_S, np.float64)
    return GazeShifts(np.asarray(starts * CUE_PERIOD_S, np.float64), magnitude_deg, duration_s)
