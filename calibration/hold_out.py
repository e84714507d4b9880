"""How well a calibrated face follows motion it was not fitted to."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array
from lipsync.markers import MARKERS_47

#: The human's lips count as closed at this gap, as in training.
CLOSED_GAP_MM = 1.0
#: Openings of the speaker that a mouth which closes too soon loses, in millimetres.
SMALL_GAPS_MM = (2.0, 4.0)


@dataclass(frozen=True, slots=True)
class HoldOutErrors:
    """Errors over frames of AnimPhos that the fit never saw.

    A marker's error is its distance in space; rms runs over frames and markers.
    """

    n_frames: int
    marker_rms_mm: float
    lip_rms_mm: float
    """The 20 lip markers alone."""
    nearest_lip_rms_mm: float
    """The same for the best angles of each frame: what no calibration of this face can beat."""
    gap_rms_mm: float
    """Difference in the distance of the middle inner-lip points."""
    gap_correlation: float
    """Of the same distance; 0 where it never changes."""
    n_closures: int
    """Frames with the human's lips closed."""
    closed_gap_mm: float
    """The robot's gap in 95 % of those is at most this; 0 without closures."""
    clipped_share: float
    """Part of the frames, 0..1, in which some servo stood at a limit."""
    joint_rms_deg: tuple[float, ...]
    """For each servo, against the best angles of each frame."""
    each_marker_rms_mm: Mapping[str, float] = field(default_factory=dict)
    """For each marker by its name; empty where none was measured."""
    gap_slope: float | None = None
    """Openings made over openings asked for; None where it was not looked at."""
    small_gaps_kept: float | None = None
    """Part of the speaker's small openings that are at least half made; None: not looked at."""


def measure_hold_out(
    human_mm: Array,
    robot_mm: Array,
    nearest_mm: Array,
    joint_errors_deg: Array,
    clipped: NDArray[np.bool_],
) -> HoldOutErrors:
    """From markers (n, 47, 3) of the human, the calibrated face and the best reachable face.

    joint_errors_deg: (n, n_servos); clipped: (n,).
    """
    human_gap_mm, robot_gap_mm = _gap_mm(human_mm), _gap_mm(robot_mm)
    closed = human_gap_mm <= CLOSED_GAP_MM
    lips = list(MARKERS_47.lips)
    moves = min(human_gap_mm.std(), robot_gap_mm.std()) > 0.0
    return HoldOutErrors(
        n_frames=len(human_mm),
        marker_rms_mm=_rms(np.linalg.norm(robot_mm - human_mm, axis=2)),
        lip_rms_mm=_rms(np.linalg.norm((robot_mm - human_mm)[:, lips], axis=2)),
        nearest_lip_rms_mm=_rms(np.linalg.norm((nearest_mm - human_mm)[:, lips], axis=2)),
        gap_rms_mm=_rms(robot_gap_mm - human_gap_mm),
        gap_correlation=float(np.corrcoef(human_gap_mm, robot_gap_mm)[0, 1]) if moves else 0.0,
        n_closures=int(closed.sum()),
        closed_gap_mm=float(np.quantile(robot_gap_mm[closed], 0.95)) if closed.any() else 0.0,
        clipped_share=float(clipped.mean()),
        joint_rms_deg=tuple(_rms(column) for column in joint_errors_deg.T),
        each_marker_rms_mm=each_marker_rms_mm(MARKERS_47.names, robot_mm - human_mm),
    )


def each_marker_rms_mm(marker_names: Sequence[str], off_mm: Array) -> dict[str, float]:
    """(n, n_markers, 3), how far each marker is off -> rms over the frames, by name."""
    rms_mm = np.sqrt(np.mean(np.sum(off_mm**2, axis=2), axis=0))
    return dict(zip(marker_names, rms_mm.tolist(), strict=True))


def _gap_mm(markers_mm: Array) -> Array:
    """(n, 47, 3) -> (n,)."""
    between = markers_mm[:, MARKERS_47.upper_lip] - markers_mm[:, MARKERS_47.lower_lip]
    return np.asarray(np.linalg.norm(between, axis=1))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
