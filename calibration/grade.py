"""Figures of a calibration's quality: errors on held-out motion, reach by viseme class, grade.

A grade is measured on the robot; errors and reach are estimated with the learnt face.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from calibration.closure import CLOSED_GAP_MM
from lipsync.arrays import Array
from lipsync.markers import MARKERS_47

#: Openings of the speaker that a mouth which closes too soon loses, in millimetres.
SMALL_GAPS_MM = (2.0, 4.0)


@dataclass(frozen=True, slots=True)
class HoldOutErrors:
    """Errors of a calibration over recorded frames of speech that were left out of the fit.

    A marker's error is its distance in space; rms runs over frames and markers. 0: not measured.
    """

    n_frames: int = 0
    marker_rms_mm: float = 0.0
    lip_rms_mm: float = 0.0
    """The 20 lip markers alone."""
    nearest_lip_rms_mm: float = 0.0
    """The same for the best angles of each frame: what no calibration of this face can beat."""
    gap_rms_mm: float = 0.0
    """Difference in the distance of the middle inner-lip points."""
    gap_correlation: float = 0.0
    """Of the same distance; 0 where it never changes."""
    n_closures: int = 0
    """Frames with the human's lips closed."""
    closed_gap_mm: float = 0.0
    """The robot's gap in 95 % of those is at most this; 0 without closures."""
    clipped_share: float = 0.0
    """Part of the frames, 0..1, in which some servo stood at a limit."""
    joint_rms_deg: tuple[float, ...] = ()
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
    """Return the errors of a calibration on held-out frames.

    Parameters
    ----------
    human_mm,robot_mm,nearest_mm : Array
        (n, 47, 3) mm, markers of the human, the calibrated face and the best reachable face.
    joint_errors_deg : Array
        (n, n_servos) degrees off the best angles.
    clipped : NDArray[np.bool_]
        (n,): whether a servo was at a limit.

    Returns
    -------
    HoldOutErrors
        In mm and degrees.
    """
    human_gap_mm, robot_gap_mm = _gap_mm(human_mm), _gap_mm(robot_mm)
    is_closed = human_gap_mm <= CLOSED_GAP_MM
    lips = list(MARKERS_47.lips)
    both_move = min(human_gap_mm.std(), robot_gap_mm.std()) > 0.0
    return HoldOutErrors(
        n_frames=len(human_mm),
        marker_rms_mm=_rms(np.linalg.norm(robot_mm - human_mm, axis=2)),
        lip_rms_mm=_rms(np.linalg.norm((robot_mm - human_mm)[:, lips], axis=2)),
        nearest_lip_rms_mm=_rms(np.linalg.norm((nearest_mm - human_mm)[:, lips], axis=2)),
        gap_rms_mm=_rms(robot_gap_mm - human_gap_mm),
        gap_correlation=float(np.corrcoef(human_gap_mm, robot_gap_mm)[0, 1]) if both_move else 0.0,
        n_closures=int(is_closed.sum()),
        closed_gap_mm=float(np.quantile(robot_gap_mm[is_closed], 0.95)) if is_closed.any() else 0.0,
        clipped_share=float(clipped.mean()),
        joint_rms_deg=tuple(_rms(column) for column in joint_errors_deg.T),
        each_marker_rms_mm=each_marker_rms_mm(MARKERS_47.names, robot_mm - human_mm),
    )


def each_marker_rms_mm(marker_names: Sequence[str], off_mm: Array) -> dict[str, float]:
    """Return the rms distance of each marker over the frames.

    Parameters
    ----------
    marker_names : Sequence[str]
        Names of the n_markers markers.
    off_mm : Array
        (n, n_markers, 3) mm, differences from the wanted markers.

    Returns
    -------
    dict[str, float]
        mm by name.
    """
    rms_mm = np.sqrt(np.mean(np.sum(off_mm**2, axis=2), axis=0))
    return dict(zip(marker_names, rms_mm.tolist(), strict=True))


def _gap_mm(markers_mm: Array) -> Array:
    """Return the lip gap of markers (n, 47, 3): distance of the middle inner lips, (n,)."""
    between = markers_mm[:, MARKERS_47.upper_lip] - markers_mm[:, MARKERS_47.lower_lip]
    return np.asarray(np.linalg.norm(between, axis=1))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


@dataclass(frozen=True, slots=True)
class VisemeReach:
    """How well a robot makes the shapes of one viseme class.

    Estimated with the learnt face: reachable, the share of frames, 0..1, for which the face can
    make opening and width within 1 mm; off_mm, rms distance of the calibrated face's lips from the
    wanted shapes; gap_slope, openings made over openings wanted; closed_gap_mm, how far lips stay
    apart in 95 % of the frames with the speaker's lips closed; small_gaps_kept, the share of small
    openings that are at least half made; at_limit, the share of frames with a joint at a limit.
    None where the class has no such frames, or an older file lacks the figure. Measured:
    measured_mm, rms distance of the lips from the target in n_measured graded poses.
    """

    reachable: float
    off_mm: float
    gap_slope: float | None = None
    closed_gap_mm: float | None = None
    small_gaps_kept: float | None = None
    at_limit: float | None = None
    n_measured: int = 0
    measured_mm: float | None = None


@dataclass(frozen=True, slots=True)
class LearntLips:
    """What a capture shows of the lips.

    left_out_rms_mm: error in each axis of poses left out, the tracker's noise_mm included;
    own_gap_mm: between the dots of closed lips; stop: whether lips stopped each other there,
    otherwise own_gap_mm is the narrowest captured gap.
    """

    left_out_rms_mm: float
    noise_mm: float
    own_gap_mm: float
    stop: bool

    @property
    def doubt_mm(self) -> float:
        """The likely error in space, in mm, of the shapes that the learnt face predicts.

        The error of poses left out beyond the tracker's noise, in three axes.
        """
        return math.sqrt(3.0 * max(self.left_out_rms_mm**2 - self.noise_mm**2, 0.0))


#: What says whether lips meet: they stop each other, their dots pass one another, or joints stand
#: at their limits and nothing of both was seen.
CONTACT, PASSED, LIMITS = "contact", "passed", "limits"


@dataclass(frozen=True, slots=True)
class Closing:
    """Whether the robot's lips meet, by evidence from poses that close them step by step.

    evidence: CONTACT: they stopped each other; PASSED: dots of both lips passed one another;
    LIMITS: joints reached their limits before.

    For LIMITS: apart_mm, how far lips stay apart at most, for dots may lie beside the lips' edges;
    joint, the one at its limit that closes lips most, and missing_deg, how much farther it would
    have to turn. 0 and empty otherwise.
    """

    evidence: str
    apart_mm: float = 0.0
    joint: str = ""
    missing_deg: float = 0.0

    @property
    def closes(self) -> bool:
        """Whether the lips were seen to meet."""
        return self.evidence != LIMITS

    @property
    def description(self) -> str:
        """Text for a message: how far lips stay apart, and which joint lacks how many degrees."""
        return (
            f"does not close: lips stay up to {self.apart_mm:.1f} mm apart, {self.joint} is at its "
            f"limit and up to {self.missing_deg:.1f} deg are missing"
        )


@dataclass(frozen=True, slots=True)
class Grade:
    """Errors measured on the robot at poses of speech that were left out of the fit.

    Distances are from the wanted shapes, without the tracker's noise in lip_rms_mm; each pose
    counts by the share of speech that it represents. closed_gap_mm: how far lips that should be
    closed were apart, beyond the robot's own closed gap; gap_slope: openings made over openings
    wanted; small_gaps_kept: the share of small openings that are at least half made, None where
    none was measured.
    """

    n_poses: int
    lip_rms_mm: float
    gap_rms_mm: float
    closed_gap_mm: float
    gap_slope: float
    small_gaps_kept: float | None = None


def lips_off_mm(grade: Grade, lips: LearntLips | None) -> float:
    """Return the lips' rms distance from the shapes of speech, in mm.

    It is the root of the summed squares of the grade's error and of the likely error of the wanted
    shapes themselves (`doubt_mm` of `lips`). Without the doubt the result is a fifth too low
    (elastic robots of seeds 100 to 117, whose true shapes no calibration knows). lips None: the
    grade's error alone.
    """
    if lips is None:
        return grade.lip_rms_mm
    return math.hypot(grade.lip_rms_mm, lips.doubt_mm)


#: A small opening of which less than this is made is lost.
_HALF_MADE = 0.5
#: Of openings that are nearly all the same nobody can say how they follow.
_LEAST_SPREAD_MM = 0.3


@dataclass(frozen=True, slots=True)
class GapFigures:
    """Figures of lip openings; each is None where no frame gives it.

    slope: openings made over openings wanted; closed_mm: how far lips stay apart in 95 % of the
    frames with the speaker's lips closed; small_kept: the share of small openings that are at least
    half made.
    """

    slope: float | None
    closed_mm: float | None
    small_kept: float | None


def gap_figures(
    wanted_mm: Array, made_mm: Array, human_gap_mm: Array, shares: Array | None = None
) -> GapFigures:
    """Return figures that compare made lip openings with wanted ones.

    Parameters
    ----------
    wanted_mm,made_mm : Array
        (n,) mm: openings beyond the robot's own closed gap, NaN where not measured.
    human_gap_mm : Array
        (n,) mm: the speaker's gaps.
    shares : Array | None
        (n,), share of speech that each frame represents; None: all equal.

    Returns
    -------
    GapFigures
        Slope, closed gap in mm, and share of small openings kept.
    """
    known = np.isfinite(made_mm)
    weights = np.ones(len(made_mm)) if shares is None else shares
    wanted, made, human = wanted_mm[known], made_mm[known], human_gap_mm[known]
    closed, small = human <= CLOSED_GAP_MM, is_slightly_open(human)
    has_spread = len(wanted) > 2 and float(np.ptp(wanted)) > _LEAST_SPREAD_MM
    slope = np.polyfit(wanted, made, 1, w=np.sqrt(weights[known]))[0] if has_spread else None
    kept = made[small] >= _HALF_MADE * wanted[small]
    return GapFigures(
        slope=None if slope is None else float(slope),
        closed_mm=max(0.0, float(np.quantile(made[closed], 0.95))) if closed.any() else None,
        small_kept=float(np.average(kept, weights=weights[known][small])) if small.any() else None,
    )


def is_slightly_open(human_gap_mm: Array) -> NDArray[np.bool_]:
    """Return whether the speaker's lips are a little open, by 2 to 4 mm.

    Parameters
    ----------
    human_gap_mm : Array
        (n,) mm.

    Returns
    -------
    NDArray[np.bool_]
        (n,).
    """
    least_mm, most_mm = SMALL_GAPS_MM
    return np.asarray((human_gap_mm >= least_mm) & (human_gap_mm <= most_mm))
