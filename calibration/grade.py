"""What a calibration is worth: measured on the robot where it was, else by the learnt face."""

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class VisemeReach:
    """How well a robot makes the shapes of one viseme class.

    On the face as it was learnt, so estimated: reachable, the part of its frames, 0..1, of which
    the face has opening and width within 1 mm; off_mm, how far the calibrated face is from the
    shapes wanted, rms over the lips; gap_slope, openings made over openings asked for;
    closed_gap_mm, how far closed lips stay apart in 95 % of the frames in which the speaker's are
    closed; small_gaps_kept, the part of small openings that stay open; at_limit, the part of the
    frames in which a joint stands at a limit. None where the class has no such frames, or an older
    file does not say.
    Measured: measured_mm, the lips' distance from what was asked for in n_measured graded poses.
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
    """What the captured poses have taught of a face.

    left_out_rms_mm: error in each axis of poses left out, the tracker's noise_mm included;
    own_gap_mm: between the dots of lips that are closed; stop: whether lips were seen to stop each
    other there, else it is the narrowest gap that was seen.
    """

    left_out_rms_mm: float
    noise_mm: float
    own_gap_mm: float
    stop: bool

    @property
    def doubt_mm(self) -> float:
        """How far the shapes that it says a robot can make may be off, in space.

        What poses left out are off by beyond the tracker's noise, in three axes.
        """
        return math.sqrt(3.0 * max(self.left_out_rms_mm**2 - self.noise_mm**2, 0.0))


@dataclass(frozen=True, slots=True)
class Grade:
    """What was measured on the robot at poses of speech that were never fitted.

    Distances from the shapes asked for, without the tracker's noise in lip_rms_mm; each pose counts
    by the share of speech that it stands for. closed_gap_mm: how far lips that should be closed
    were apart, beyond the robot's own closed gap; gap_slope: openings made over openings asked
    for; small_gaps_kept: the part of small openings that are at least half made, None where none
    was measured.
    """

    n_poses: int
    lip_rms_mm: float
    gap_rms_mm: float
    closed_gap_mm: float
    gap_slope: float
    small_gaps_kept: float | None = None


def lips_off_mm(grade: Grade, lips: LearntLips | None) -> float:
    """How far the lips are from the shapes of speech.

    As measured from the shapes asked for, and what those themselves may be off by. Without the
    second it would be a fifth too little (elastic robots of seeds 100 to 117, whose true shapes
    no calibration was told).
    """
    return math.hypot(grade.lip_rms_mm, 0.0 if lips is None else lips.doubt_mm)
