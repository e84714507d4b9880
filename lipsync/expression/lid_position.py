"""Where lids are: with the gaze, as awake as the face is, and shut by a blink."""

from lipsync.expression.bounded import bounded

#: Lids go down with the eyes and up with them, in shares of the way to shut per degree.
_PER_DEG_DOWN, _MOST_DOWN = 0.02, 0.5
_PER_DEG_UP, _MOST_UP = 0.01, 0.15
#: Wide open and sleepily open.
WIDEST, _SLEEPIEST = -0.4, 0.65


def lid_position(eye_pitch_deg: float, offset: float, size: float, blink: float) -> float:
    """0 open, 1 shut, below 0 wider than at rest.

    offset: by arousal. size: of all but the blink, 0 to 1. blink: 0 to 1, goes the rest of the way
    from wherever the lid is, so that 1 is shut and neither end has a corner.
    """
    if eye_pitch_deg < 0.0:
        follow = min(_MOST_DOWN, -_PER_DEG_DOWN * eye_pitch_deg)
    else:
        follow = -min(_MOST_UP, _PER_DEG_UP * eye_pitch_deg)
    base = size * bounded(follow + offset, WIDEST, _SLEEPIEST)
    return base + (1.0 - base) * blink
