"""A joint with far more play than the others: named rightly or not at all."""

import numpy as np

from lipsync.arrays import Array

#: One joint is loose with so much play, so many times the usual, and so many times the next's: of
#: healthy simulated robots (1 degree all) the fit says up to 1.7.
_LOOSE_DEG, _LOOSE_TIMES, _AHEAD, _FEWEST_JOINTS = 2.0, 1.8, 1.25, 3


def loose_joint(servo_names: tuple[str, ...], backlash_deg: Array) -> tuple[str, ...]:
    """A line where one joint, and no other, has far more play than is usual for its face.

    Play beyond the last step of a pose (3 degrees) is not seen whole, and joints that hardly move
    the skin are not told from their neighbours: of them nothing is said.
    """
    if len(backlash_deg) < _FEWEST_JOINTS:
        return ()
    order = np.argsort(backlash_deg)[::-1]
    most_deg, second_deg = backlash_deg[order[:2]]
    usual_deg = float(np.median(backlash_deg))
    if most_deg < max(_LOOSE_DEG, _LOOSE_TIMES * usual_deg) or most_deg < _AHEAD * second_deg:
        return ()
    return (
        f"servo {servo_names[order[0]]!r} is loose: it has {most_deg:.1f} deg of play or more, "
        f"where {usual_deg:.1f} is usual in this face; tighten its horn and its rod",
    )
