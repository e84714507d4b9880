"""What a person has put into a calibration stays when the face is calibrated again."""

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from calibration.calibration import Calibration, CalibrationError
from calibration.files.calibration_file import load_calibration
from calibration.mouth_servos import MouthServos
from lipservo.calibrating.hand_poses import with_hand_poses
from lipsync.arrays import Array

#: A trim that goes farther than its joint can turn belongs to other limits.
_REMEDY: Final = "set them anew with `lipservo calibrate trim`"


def with_hand_made(
    fresh: Calibration, servos: MouthServos, output: Path
) -> tuple[Calibration, list[str]]:
    """A fresh calibration with trims, hand poses and touch pose of the file it replaces.

    The second part says, for a person, what was kept and what was not, and why.
    """
    if not output.exists():
        return fresh, []
    try:
        before = load_calibration(output)
    except CalibrationError as error:
        return fresh, [f"trims and hand poses, if it had any, are not kept: {error}"]
    if set(before.servo_names) != set(fresh.servo_names):
        had = before.trim or before.hand_poses
        why = f"{output} was of other servos: its trims and hand poses are not kept; {_REMEDY}"
        return fresh, [why] if had else []
    order = [before.servo_names.index(name) for name in fresh.servo_names]
    kept, lines = _with_trims(fresh, before, order)
    if before.touch is not None and fresh.touch is None:
        touch = replace(before.touch, positions_deg=before.touch.positions_deg[order])
        kept = replace(kept, touch=touch)
        lines.append("the touch pose is kept")
    if not before.hand_poses:
        return kept, lines
    was, now = before.origin.servo_memories, fresh.origin.servo_memories
    if was and now and [was[n] for n in order] != list(now):
        lines.append(
            "hand poses are not kept: the servos were set up anew since; `lipservo calibrate "
            "by-hand` makes them again"
        )
        return kept, lines
    poses = {name: deg[order] for name, deg in before.hand_poses.items()}
    cap_ma = 0.0 if before.touch is None else before.touch.current_cap_ma
    lines.append(f"hand poses are kept: {', '.join(poses)}")
    return with_hand_poses(kept, servos, poses, cap_ma), lines


def _with_trims(
    fresh: Calibration, before: Calibration, order: list[int]
) -> tuple[Calibration, list[str]]:
    span_deg = fresh.max_deg - fresh.min_deg
    trims: dict[str, Array] = {}
    lost: list[str] = []
    for viseme, degrees in before.trim.items():
        added_deg = degrees[order]
        if np.all(np.abs(added_deg) <= span_deg):
            trims[viseme] = added_deg
        else:
            lost.append(viseme)
    lines = [f"trims are kept: {', '.join(trims)}"] if trims else []
    if lost:
        lines.append(
            f"trims of {', '.join(lost)} are not kept: farther than the joints turn; {_REMEDY}"
        )
    return replace(fresh, trim={**fresh.trim, **trims}), lines
