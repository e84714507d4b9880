"""The parts of a calibration that a person makes by hand: hand poses, touch pose, and trims.

Hands move the limp mouth into a pose, encoders are read live, and a key keeps the pose. The hand
pose `touched` becomes the touch pose, in which lips just meet; `widest` and `rounded` limit the
joints that open and narrow the mouth. Trims are degrees added in a viseme class. All are in the
calibration file, and are kept when the face is calibrated again.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from calibration.calibration import Calibration, CalibrationError, Touch
from calibration.files.calibration_file import load_calibration
from calibration.fit.guided import LandmarkPose
from calibration.mouth_servos import MouthServos
from lipsync.arrays import Array

CLOSED, WIDEST, ROUNDED, TOUCHED = "closed", "widest", "rounded", "touched"
#: Encoders and horns are as exact as this; a pose so far beyond a limit counts as at it.
_AT_LIMIT_DEG: Final = 1.0
#: A joint that a pose takes less far than this has not been meant by it, and keeps its limit.
_LEAST_TURN_DEG: Final = 2.0
#: Pose, what a positive angle of the joint does, and whether that way is the pose's.
_LIMITING_POSES: Final = (
    (WIDEST, "opens", True),
    (WIDEST, "closes", False),
    (ROUNDED, "narrows", True),
    (ROUNDED, "widens", False),
)


#: Without a shape of the speaker's: fingers need none.
HAND_POSES: Final = tuple(
    LandmarkPose(name, instruction, np.zeros(0))
    for name, instruction in (
        (CLOSED, "the mouth as it rests in silence, lips together without force"),
        (WIDEST, "the mouth as wide open as it may ever be in speech"),
        (ROUNDED, "the corners as near to each other as they may ever be, as for OO"),
        (TOUCHED, "lips that just touch along their whole length, as for P"),
    )
)


def beyond_limits(servos: MouthServos, positions_deg: Array) -> dict[str, str]:
    """Return an error message for each joint of a pose that is over 1 deg outside its limits.

    Parameters
    ----------
    servos : MouthServos
        Servos of the mouth.
    positions_deg : Array
        (n_servos,) degrees.

    Returns
    -------
    dict[str, str]
        One line by the joint's name; empty if all are inside.
    """
    low_deg, high_deg = servos.limits_deg
    off_deg = np.maximum(low_deg - positions_deg, positions_deg - high_deg)
    return {
        joint.name: (
            f"{angle_deg:.1f} deg is outside its limits, {joint.min_deg:g}..{joint.max_deg:g}; "
            "turn it back, or change min_deg or max_deg in the face's YAML"
        )
        for joint, angle_deg, off in zip(servos.joints, positions_deg, off_deg, strict=True)
        if off > _AT_LIMIT_DEG
    }


def with_hand_poses(
    calibration: Calibration, servos: MouthServos, made_deg: Mapping[str, Array], cap_ma: float
) -> Calibration:
    """Return a calibration with hand poses added, and limits narrowed to those that they imply.

    Parameters
    ----------
    calibration : Calibration
        The present one, with any poses kept before.
    servos : MouthServos
        Servos of the mouth.
    made_deg : Mapping[str, Array]
        (n_servos,) degrees by the name of the pose.
    cap_ma : float
        Current cap of a new touch pose, in mA, if the calibration has none yet.

    Returns
    -------
    Calibration
        The new one, with limits in degrees from the poses.

    Raises
    ------
    CalibrationError
        No pose was made, or a joint's position is unknown (NaN).
    """
    if not made_deg:
        raise CalibrationError("no pose was kept; the calibration stays as it is")
    low_deg, high_deg = servos.limits_deg
    poses = dict(calibration.hand_poses)
    for name, positions_deg in made_deg.items():
        if not np.isfinite(positions_deg).all():
            raise CalibrationError(f"pose {name!r}: a servo gave no position; make it again")
        poses[name] = np.clip(positions_deg, low_deg, high_deg)
    touch = calibration.touch
    if TOUCHED in made_deg:
        touch = Touch(poses[TOUCHED], cap_ma if touch is None else touch.current_cap_ma)
    min_deg, max_deg = _limits_from_poses(servos, poses)
    return replace(calibration, hand_poses=poses, touch=touch, min_deg=min_deg, max_deg=max_deg)


def _limits_from_poses(servos: MouthServos, poses: Mapping[str, Array]) -> tuple[Array, Array]:
    """Return the joints' lower and upper limits, narrowed to `widest` and `rounded` of `poses`.

    Both are (n_servos,) degrees. A joint that a pose turns by 2 deg or less keeps its limit.
    """
    low_deg, high_deg = (limit.copy() for limit in servos.limits_deg)
    for n, word in enumerate(servos.positive):
        for pose, limited_word, limits_maximum in _LIMITING_POSES:
            if word != limited_word or pose not in poses:
                continue
            angle_deg = poses[pose][n]
            if limits_maximum and angle_deg > _LEAST_TURN_DEG:
                high_deg[n] = angle_deg
            elif not limits_maximum and angle_deg < -_LEAST_TURN_DEG:
                low_deg[n] = angle_deg
    return low_deg, high_deg


def pose_lines(before: Calibration, after: Calibration) -> list[str]:
    """Return lines for a person: hand poses of `after`, and limits changed since `before`.

    If the pose `closed` was made, they also compare it with the map's closed mouth, in degrees.
    """
    lines = []
    for name, positions_deg in after.hand_poses.items():
        angle_of_joint = zip(after.servo_names, positions_deg, strict=True)
        angles = ", ".join(f"{joint} {round(deg, 1) + 0.0:.1f}" for joint, deg in angle_of_joint)
        lines.append(f"{name}: {angles} deg")
        if name in (WIDEST, ROUNDED) and np.abs(positions_deg).max() < _LEAST_TURN_DEG:
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
        off_deg = after.positions_deg(after.rest) - after.hand_poses[CLOSED]
        worst = int(np.abs(off_deg).argmax())
        lines.append(
            f"the map's closed mouth is {abs(off_deg[worst]):.1f} deg from yours at most, at "
            f"{after.servo_names[worst]}"
        )
        if abs(off_deg[worst]) > _LEAST_TURN_DEG:
            lines.append(
                "for yours in silence: `lipservo calibrate trim FILE SIL "
                f"{after.servo_names[worst]} {-off_deg[worst]:.1f}`"
            )
    return lines


#: A trim that goes farther than its joint can turn belongs to other limits.
_REMEDY: Final = "set them anew with `lipservo calibrate trim`"


def with_kept_hand_parts(
    fresh: Calibration, servos: MouthServos, output: Path
) -> tuple[Calibration, list[str]]:
    """Return `fresh` with trims, hand poses and touch pose of the file `output`, if it exists.

    output: the file that `fresh` will replace; servos: with the face's limits. Also returned are
    lines for a person: which of these parts were kept, which were not, and why.
    """
    if not output.exists():
        return fresh, []
    try:
        before = load_calibration(output)
    except CalibrationError as error:
        return fresh, [f"trims and hand poses, if it had any, are not kept: {error}"]
    if set(before.servo_names) != set(fresh.servo_names):
        has_parts = before.trim or before.hand_poses
        line = f"{output} was of other servos: its trims and hand poses are not kept; {_REMEDY}"
        return fresh, [line] if has_parts else []
    # For each servo its number in the old file.
    rows = [before.servo_names.index(name) for name in fresh.servo_names]
    combined, lines = _with_kept_trims(fresh, before, rows)
    if before.touch is not None and fresh.touch is None:
        touch = replace(before.touch, positions_deg=before.touch.positions_deg[rows])
        combined = replace(combined, touch=touch)
        lines.append("the touch pose is kept")
    if not before.hand_poses:
        return combined, lines
    old, new = before.origin.servo_memories, fresh.origin.servo_memories
    if old and new and [old[n] for n in rows] != list(new):
        lines.append(
            "hand poses are not kept: the servos were set up anew since; `lipservo calibrate "
            "by-hand` makes them again"
        )
        return combined, lines
    poses = {name: deg[rows] for name, deg in before.hand_poses.items()}
    cap_ma = 0.0 if before.touch is None else before.touch.current_cap_ma
    lines.append(f"hand poses are kept: {', '.join(poses)}")
    return with_hand_poses(combined, servos, poses, cap_ma), lines


def _with_kept_trims(
    fresh: Calibration, before: Calibration, rows: list[int]
) -> tuple[Calibration, list[str]]:
    """Return `fresh` with the trims of `before`, and lines for a person on those kept and dropped.

    The trim of a viseme class is dropped if it exceeds the whole range of any joint. rows: for each
    servo of `fresh` its number in `before`.
    """
    span_deg = fresh.max_deg - fresh.min_deg
    trims = {
        viseme: degrees[rows]
        for viseme, degrees in before.trim.items()
        if np.all(np.abs(degrees[rows]) <= span_deg)
    }
    dropped = [viseme for viseme in before.trim if viseme not in trims]
    lines = [f"trims are kept: {', '.join(trims)}"] if trims else []
    if dropped:
        lines.append(
            f"trims of {', '.join(dropped)} are not kept: farther than the joints turn; {_REMEDY}"
        )
    return replace(fresh, trim={**fresh.trim, **trims}), lines
