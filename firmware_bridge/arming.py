"""What must be true before torque comes on: every servo answers and is told to stay put."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.bus import ServoError
from firmware_bridge.joints import Joint

#: A goal read back may differ from the one written by one encoder step, 360 / 4096 deg.
_ENCODER_STEP_DEG = 360.0 / 4096.0


def check_held(
    joints: Sequence[Joint], present_deg: NDArray[np.float64], goals_deg: NDArray[np.float64]
) -> None:
    """Raise ServoError for the first servo whose goal is not where it stands."""
    for joint, stands_deg, goal_deg in zip(joints, present_deg, goals_deg, strict=True):
        servo = named(joint)
        if np.isnan(stands_deg):
            raise ServoError(f"{servo} does not answer; check its power and cable")
        if not abs(goal_deg - stands_deg) <= _ENCODER_STEP_DEG:
            raise ServoError(
                f"{servo} stands at {stands_deg:.1f} deg and will not hold there; move it into "
                f"{joint.min_deg:g}..{joint.max_deg:g} deg by hand"
            )


def named(joint: Joint) -> str:
    """How a servo is called in a message."""
    return f"servo {joint.name!r} (id {joint.servo_id})"
