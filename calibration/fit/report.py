"""What a fresh calibration says of itself, for people."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from calibration.calibration import Calibration
from calibration.fit.servo_response import CHIRP_END_HZ, chirp_amplitude_deg
from calibration.grade import LearntLips, lips_off_mm
from calibration.joint_range import JointRange
from lipsync.phonemes import VISEME_CLASSES

if TYPE_CHECKING:  # loads scikit-learn, and `calibrate show` does without it
    from calibration.fit.measured import MeasuredFit

#: A viseme class with fewer of its shapes in reach than this is warned of.
_WELL_REACHED = 0.9


def report_lines(
    calibration: Calibration, written: str, fit: "MeasuredFit | None", *, with_servos: bool = True
) -> list[str]:
    """How far off the map is, then each joint, then what the robot cannot reach.

    fit: of a measured calibration; None for the others. with_servos: with a line for each servo.
    """
    lines = [f"{written}: {_summary(calibration)}"]
    lips = calibration.learnt_lips
    if lips is not None:
        kind = "" if fit is None else f"{fit.face.kind}; "
        lines.append(
            f"learnt face: {kind}poses left out {lips.left_out_rms_mm:.2f} mm off in each axis, of "
            f"which the tracker's noise is about {lips.noise_mm:.2f}"
        )
        lines.append(_closing_line(lips, fit))
    if fit is not None:
        lines.append(f"the mouth moves {fit.retargeting.scale:.2f} times as much as the speaker's")
    if calibration.origin.not_measured:
        lines.append(
            f"not measured: {calibration.origin.not_measured}, for one camera sees no depth; no "
            "figure here knows how far the lips are off forward"
        )
    lines += _worst_markers(calibration.errors.each_marker_rms_mm)
    if with_servos:
        lines += following_lines(calibration)
    if calibration.touch is not None:
        lines.append(
            "so that lips which meet are not pressed hard, give the mouth's servos max_current_ma: "
            f"{calibration.touch.current_cap_ma:.0f} in the YAML, then run `lipservo setup-servos`"
        )
    return lines + (_reach_lines(calibration) if fit is not None else [])


def _closing_line(lips: LearntLips, fit: "MeasuredFit | None") -> str:
    pressed = "" if fit is None else f"; closures go {fit.retargeting.press_mm:.1f} mm past it"
    if not lips.stop:
        return (
            "contact: the lips were not seen to stop each other; closed is taken as the narrowest "
            f"gap seen, {lips.own_gap_mm:.1f} mm between the dots{pressed}"
        )
    return f"contact: closing stops at a gap of {lips.own_gap_mm:.1f} mm between the dots{pressed}"


def _summary(calibration: Calibration) -> str:
    errors, origin = calibration.errors, calibration.origin
    if origin.method == "guided":
        off_deg, servo = max(zip(errors.joint_rms_deg, calibration.servo_names, strict=True))
        return (
            f"from {origin.poses} poses made by eye. A pose left out is {off_deg:.1f} deg off at "
            f"most (rms, {servo}). On simulated robots such a map was 1.2 mm off in the median, a "
            "measured one 0.3 (docs/benchmarks.md)"
        )
    if origin.method == "jaw alone":
        return (
            f"on {errors.n_frames} frames left out the jaw line is {errors.marker_rms_mm:.2f} mm "
            "from where the speaker's would be; lips were not seen"
        )
    grade = calibration.grade
    if grade is not None:
        doubt_mm = 0.0 if calibration.learnt_lips is None else calibration.learnt_lips.doubt_mm
        off_mm = lips_off_mm(grade, calibration.learnt_lips)
        return (
            f"measured at {grade.n_poses} poses of speech that were never fitted, the lips are "
            f"{off_mm:.2f} mm from the shapes of speech ({grade.lip_rms_mm:.2f} from those asked "
            f"for, which may be {doubt_mm:.2f} off themselves), the lip gap "
            f"{grade.gap_rms_mm:.2f} mm (noise included); {max(grade.gap_slope, 0.0):.0%} of an "
            f"opening is made{_kept_text(grade.small_gaps_kept)}, closed lips are "
            f"{max(grade.closed_gap_mm, 0.0):.1f} mm apart; {errors.clipped_share:.0%} of the "
            "frames reach a limit"
        )
    if origin.method == "measured":
        kept, slope = _kept_text(errors.small_gaps_kept), errors.gap_slope
        made = "" if slope is None else f"{max(slope, 0.0):.0%} of an opening is made{kept}, "
        return (
            f"estimated, not measured: on {errors.n_frames} frames left out the map is "
            f"{errors.lip_rms_mm:.2f} mm from the shapes asked for, on the face as it was learnt; "
            f"{made}closed lips are {errors.closed_gap_mm:.1f} mm apart; "
            f"{errors.clipped_share:.0%} of the frames reach a limit"
        )
    return (
        f"on {errors.n_frames} frames left out the lips are {errors.lip_rms_mm:.2f} mm off (the "
        f"nearest poses of this face: {errors.nearest_lip_rms_mm:.2f}), the lip gap "
        f"{errors.gap_rms_mm:.2f} mm; {errors.clipped_share:.1%} of the frames reach a limit"
    )


def _kept_text(small_gaps_kept: float | None) -> str:
    if small_gaps_kept is None:
        return ""
    return f", {small_gaps_kept:.0%} of small openings stay open"


def _reach_lines(calibration: Calibration) -> list[str]:
    phonemes = {viseme[0]: " ".join(viseme) for viseme in VISEME_CLASSES}
    poor = {v: r for v, r in calibration.coverage.items() if r.reachable < _WELL_REACHED}
    if not poor:
        return ["every viseme class is within reach"]
    told = ", ".join(f"{phonemes[v]} {1 - reach.reachable:.0%}" for v, reach in poor.items())
    return [f"out of reach of the shapes of each class: {told}; wider limits may help"]


def following_lines(calibration: Calibration) -> list[str]:
    """How each joint does, and how it follows."""
    lines = []
    following = calibration.following
    for i, name in enumerate(calibration.servo_names):
        parts = [f"{calibration.errors.joint_rms_deg[i]:.1f} deg off the best pose"]
        if following is not None:
            parts.append(f"backlash {following.backlash_deg[i]:.1f} deg")
            if np.isfinite(following.bandwidth_hz[i]):
                parts.append(f"{following.lag_s[i] * 1e3:.0f} ms late")
                low, high = calibration.min_deg[i], calibration.max_deg[i]
                degrees = chirp_amplitude_deg(JointRange(name, float(low), float(high)))
                bandwidth_hz = float(following.bandwidth_hz[i])
                beyond = " or more" if bandwidth_hz >= CHIRP_END_HZ else ""
                parts.append(f"follows up to {bandwidth_hz:.1f} Hz{beyond} at {degrees:.0f} deg")
        lines.append(f"  {name}: {', '.join(parts)}")
    return lines


def _worst_markers(each_rms_mm: Mapping[str, float]) -> list[str]:
    """The three that are farthest off."""
    worst = sorted(each_rms_mm.items(), key=lambda item: -item[1])[:3]
    listed = ", ".join(f"{name} {rms_mm:.2f} mm" for name, rms_mm in worst)
    return [f"farthest off: {listed}"] if worst else []
