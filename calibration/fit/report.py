"""What a fresh calibration says of itself, for people."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from calibration.calibration import Calibration
from calibration.fit.servo_response import CHIRP_END_HZ, chirp_amplitude_deg
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
    if fit is not None:
        lines += [
            f"learnt face: {fit.face.kind}; poses left out {fit.face.left_out_rms_mm:.2f} mm off "
            f"in each axis, of which the tracker's noise is about {fit.face.noise_mm:.2f}",
            f"the mouth moves {fit.retargeting.scale[1]:.2f} times as much as the speaker's up and "
            f"down, {fit.retargeting.scale[0]:.2f} times across",
        ]
    lines += _worst_markers(calibration.errors.each_marker_rms_mm)
    if with_servos:
        lines += following_lines(calibration)
    if calibration.touch is not None:
        lines.append(
            "so that lips which meet are not pressed hard, give the mouth's servos max_current_ma: "
            f"{calibration.touch.current_cap_ma:.0f} in the YAML, then run `lipservo setup-servos`"
        )
    return lines + (_reach_lines(calibration) if fit is not None else [])


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
    if origin.method == "measured":
        return (
            f"on {errors.n_frames} frames left out the lips are {errors.lip_rms_mm:.2f} mm from "
            f"the shapes asked for (the best this face can do: {errors.nearest_lip_rms_mm:.2f})"
        )
    return (
        f"on {errors.n_frames} frames left out the lips are {errors.lip_rms_mm:.2f} mm off (the "
        f"nearest poses of this face: {errors.nearest_lip_rms_mm:.2f}), the lip gap "
        f"{errors.gap_rms_mm:.2f} mm; {errors.clipped_share:.1%} of the frames reach a limit"
    )


def _reach_lines(calibration: Calibration) -> list[str]:
    phonemes = {viseme[0]: " ".join(viseme) for viseme in VISEME_CLASSES}
    poor = {v: r for v, r in calibration.coverage.items() if r.reachable < _WELL_REACHED}
    if not poor:
        return ["every viseme class is within reach"]
    return [
        f"out of reach: {1 - reach.reachable:.0%} of the shapes of {phonemes[viseme]}; "
        "wider limits may help"
        for viseme, reach in poor.items()
    ]


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
