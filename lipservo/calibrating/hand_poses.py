"""Poses that a person made with the fingers, and what a calibration learns from them.

`touched` becomes the touch pose; `widest` and `rounded` bound the joints that open and narrow the
mouth; all are kept in the file, as places of the lip gap that somebody has seen and felt.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from calibration.calibration import Calibration, CalibrationError, Touch
from calibration.mouth_servos import MouthServos
from lipsync.arrays import Array

CLOSED, WIDEST, ROUNDED, TOUCHED = "closed", "widest", "rounded", "touched"
#: Encoders and horns are as exact as this; a pose so far beyond a limit counts as at it.
_AT_LIMIT_DEG: Final = 1.0
#: A joint that a pose takes less far than this has not been meant by it, and keeps its limit.
_MEANT_DEG: Final = 2.0
#: Pose, what a positive angle of the joint does, and whether that way is the pose's.
_BOUNDED: Final = (
    (WIDEST, "opens", True),
    (WIDEST, "closes", False),
    (ROUNDED, "narrows", True),
    (ROUNDED, "widens", False),
)


@dataclass(frozen=True, slots=True)
class HandPose:
    """One pose to make: its name, and what to do."""

    name: str
    instruction: str


HAND_POSES: Final = (
    HandPose(CLOSED, "the mouth as it rests in silence, lips together without force"),
    HandPose(WIDEST, "the mouth as wide open as it may ever be in speech"),
    HandPose(ROUNDED, "the corners as near to each other as they may ever be, as for OO"),
    HandPose(TOUCHED, "lips that just touch along their whole length, as for P"),
)


def beyond_limits(servos: MouthServos, positions_deg: Array) -> dict[str, str]:
    """Why a pose cannot be kept, by the name of the joint that is outside the face's limits."""
    low_deg, high_deg = servos.limits_deg
    off_deg = np.maximum(low_deg - positions_deg, positions_deg - high_deg)
    return {
        joint.name: (
            f"{here:.1f} deg is outside its limits, {joint.min_deg:g}..{joint.max_deg:g}; "
            "turn it back, or change min_deg or max_deg in the face's YAML"
        )
        for joint, here, off in zip(servos.joints, positions_deg, off_deg, strict=True)
        if off > _AT_LIMIT_DEG
    }


def with_hand_poses(
    calibration: Calibration, servos: MouthServos, made_deg: Mapping[str, Array], cap_ma: float
) -> Calibration:
    """The same map with these poses (n_servos,), by name, beside those that were kept before.

    cap_ma: proposed with a touch pose where the calibration proposes none. Raises CalibrationError
    where no pose was made, or a joint was nowhere.
    """
    if not made_deg:
        raise CalibrationError("no pose was kept; the calibration stays as it is")
    low_deg, high_deg = servos.limits_deg
    poses = dict(calibration.hand_poses)
    for name, positions_deg in made_deg.items():
        if not np.isfinite(positions_deg).all():
            raise CalibrationError(f"pose {name!r}: a servo has never answered; make it again")
        poses[name] = np.clip(positions_deg, low_deg, high_deg)
    touch = calibration.touch
    if TOUCHED in made_deg:
        touch = Touch(poses[TOUCHED], cap_ma if touch is None else touch.current_cap_ma)
    min_deg, max_deg = _bounds(servos, poses)
    return replace(calibration, hand_poses=poses, touch=touch, min_deg=min_deg, max_deg=max_deg)


def _bounds(servos: MouthServos, poses: Mapping[str, Array]) -> tuple[Array, Array]:
    """Of the face, drawn in where a pose shows how far a joint may go."""
    low_deg, high_deg = (limit.copy() for limit in servos.limits_deg)
    for n, word in enumerate(servos.positive):
        for pose, bounded, upwards in _BOUNDED:
            if word != bounded or pose not in poses:
                continue
            here_deg = poses[pose][n]
            if upwards and here_deg > _MEANT_DEG:
                high_deg[n] = here_deg
            elif not upwards and here_deg < -_MEANT_DEG:
                low_deg[n] = here_deg
    return low_deg, high_deg


def pose_lines(before: Calibration, after: Calibration) -> list[str]:
    """What became of the poses, for a person."""
    lines = []
    for name, positions_deg in after.hand_poses.items():
        places = zip(after.servo_names, positions_deg, strict=True)
        told = ", ".join(f"{joint} {round(deg, 1) + 0.0:.1f}" for joint, deg in places)
        lines.append(f"{name}: {told} deg")
        if name in (WIDEST, ROUNDED) and np.abs(positions_deg).max() < _MEANT_DEG:
            lines.append(f"{name} is where neutral is, so no limit comes of it; was it meant?")
    if after.touch is not None and TOUCHED in after.hand_poses:
        lines.append("touched is the touch pose now")
    for n, name in enumerate(after.servo_names):
        was, now = ((float(each.min_deg[n]), float(each.max_deg[n])) for each in (before, after))
        if was != now:
            lines.append(
                f"{name}: limits {now[0]:.1f}..{now[1]:.1f} deg, were {was[0]:g}..{was[1]:g}"
            )
    if CLOSED in after.hand_poses:
        rest_deg = after.positions_deg(after.rest)
        off_deg = rest_deg - after.hand_poses[CLOSED]
        worst = int(np.abs(off_deg).argmax())
        lines.append(
            f"the map's closed mouth is {abs(off_deg[worst]):.1f} deg from yours at most, at "
            f"{after.servo_names[worst]}"
        )
        if abs(off_deg[worst]) > _MEANT_DEG:
            lines.append(
                "for yours in silence: `lipservo calibrate trim FILE SIL "
                f"{after.servo_names[worst]} {-off_deg[worst]:.1f}`"
            )
    return lines
