"""What a fresh calibration says of itself, for people."""

import numpy as np

from calibration.calibration import Calibration
from calibration.measured import MeasuredFit
from lipsync.phonemes import VISEME_CLASSES

#: A viseme class with fewer of its shapes in reach than this is warned of.
_WELL_REACHED = 0.9


def report_lines(fit: MeasuredFit, calibration: Calibration, written: str) -> list[str]:
    """Errors in millimetres, then each joint, then what the robot cannot reach."""
    errors = calibration.errors
    lines = [
        f"{written}: on {errors.n_frames} frames left out the lips are {errors.lip_rms_mm:.2f} mm "
        f"from the shapes asked for (the best this face can do: {errors.nearest_lip_rms_mm:.2f})",
        f"learnt face: {fit.face.kind}; poses left out {fit.face.left_out_rms_mm:.2f} mm off in "
        f"each axis, of which the tracker's noise is about {fit.face.noise_mm:.2f}",
        f"the mouth moves {fit.retargeting.scale[1]:.2f} times as much as the talker's up and "
        f"down, {fit.retargeting.scale[0]:.2f} times across",
    ]
    following = calibration.following
    for i, name in enumerate(calibration.servo_names):
        parts = [f"{errors.joint_rms_deg[i]:.1f} deg off the best pose"]
        if following is not None:
            parts.append(f"play {following.backlash_deg[i]:.1f} deg")
            if np.isfinite(following.bandwidth_hz[i]):
                parts.append(f"{following.lag_s[i] * 1e3:.0f} ms late")
                parts.append(f"follows up to {following.bandwidth_hz[i]:.1f} Hz at 5 deg")
        lines.append(f"  {name}: {', '.join(parts)}")
    phonemes = {viseme[0]: " ".join(viseme) for viseme in VISEME_CLASSES}
    poor = {v: r for v, r in calibration.coverage.items() if r.reachable < _WELL_REACHED}
    for viseme, reach in poor.items():
        lines.append(
            f"out of reach: {1 - reach.reachable:.0%} of the shapes of {phonemes[viseme]}; "
            "wider limits may help"
        )
    if not poor:
        lines.append("every viseme class is within reach")
    return lines
