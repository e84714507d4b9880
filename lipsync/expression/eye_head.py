"""How eyes and head share a direction of gaze."""

import math

from lipsync.expression.bounded import bounded, smoothstep

#: Pitch, yaw and roll that a head goes to in conversation, either way.
MOST_PITCH_DEG, MOST_YAW_DEG, MOST_ROLL_DEG = 15.0, 25.0, 10.0
#: How far eyes turn in the head, either way; a robot's own limits come later.
MOST_EYE_PITCH_DEG, MOST_EYE_YAW_DEG = 25.0, 35.0
#: Eyes do not stay further out than this where the head can come to help.
_EASY_EYE_PITCH_DEG, _EASY_EYE_YAW_DEG = 18.0, 28.0
#: The head's share of small and of large directions, and where the one becomes the other.
_LEAST_SHARE, _MOST_SHARE = 0.25, 0.6
_SMALL_DEG, _LARGE_DEG = 10.0, 40.0


def head_part_deg(aim_deg: tuple[float, float]) -> tuple[float, float]:
    """(yaw, pitch) of the head for a direction of gaze: more of it the further out.

    People turn the head little for what the eyes reach with ease, and nearly all of the rest of
    the way beyond that (Stahl, Experimental Brain Research 126, 1999).
    """
    yaw_deg, pitch_deg = aim_deg
    far = (math.hypot(yaw_deg, pitch_deg) - _SMALL_DEG) / (_LARGE_DEG - _SMALL_DEG)
    share = _LEAST_SHARE + (_MOST_SHARE - _LEAST_SHARE) * smoothstep(far)
    return (
        _part(yaw_deg, share, _EASY_EYE_YAW_DEG, MOST_YAW_DEG),
        _part(pitch_deg, share, _EASY_EYE_PITCH_DEG, MOST_PITCH_DEG),
    )


def eyes_deg(
    direction_deg: tuple[float, float], head_yaw_deg: float, head_pitch_deg: float
) -> tuple[float, float]:
    """(yaw, pitch) of the eyes in the head, so that gaze stays put in the world.

    The vestibulo-ocular reflex, to first order: gaze - head. Roll turns the eyes about the line of
    sight and is left out; at 3 degrees of it, eyes 10 degrees off centre miss by half a degree.
    """
    return (
        bounded(direction_deg[0] - head_yaw_deg, -MOST_EYE_YAW_DEG, MOST_EYE_YAW_DEG),
        bounded(direction_deg[1] - head_pitch_deg, -MOST_EYE_PITCH_DEG, MOST_EYE_PITCH_DEG),
    )


def _part(angle_deg: float, share: float, easy_deg: float, most_deg: float) -> float:
    far_deg = abs(angle_deg)
    return math.copysign(min(most_deg, max(share * far_deg, far_deg - easy_deg)), angle_deg)
