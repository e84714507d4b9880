"""A neck and a collar for the head to stand on: a surface of revolution that stays where it is."""

import numpy as np
from scipy.interpolate import PchipInterpolator

from lipsync.twin.part import Part

#: What the head turns about: the top of the spine.
PIVOT_MM = (0.0, -70.0, -88.0)
#: Height below the pivot, radius and grey; the neck is wider than deep.
_PROFILE = (
    (0.0, 44.0, 0.32),
    (-45.0, 46.0, 0.38),
    (-68.0, 50.0, 0.41),
    (-82.0, 62.0, 0.50),
    (-100.0, 90.0, 0.53),
    (-124.0, 126.0, 0.53),
    (-165.0, 156.0, 0.51),
    (-250.0, 172.0, 0.48),
)
_TINT = (0.92, 1.0, 1.10)
_DEPTH_SHARE = 0.72
_SIDES = 64
_ROWS = 40


def neck() -> Part:
    """From inside the head downwards."""
    profile = np.array(_PROFILE)
    steps = np.linspace(0, len(profile) - 1, _ROWS)
    height, radius, grey = PchipInterpolator(np.arange(len(profile)), profile)(steps).T
    around = np.linspace(0, 2 * np.pi, _SIDES, endpoint=False)
    places = np.stack(
        [
            np.outer(radius, np.sin(around)),
            np.repeat(height[:, None], _SIDES, axis=1),
            np.outer(radius, np.cos(around)) * _DEPTH_SHARE,
        ],
        axis=-1,
    ).reshape(-1, 3) + np.array(PIVOT_MM)
    corner = np.arange(_ROWS * _SIDES).reshape(_ROWS, _SIDES)
    here, below = corner[:-1], corner[1:]
    ahead, below_ahead = np.roll(here, -1, axis=1), np.roll(below, -1, axis=1)
    bands = [np.stack([here, below, ahead], -1), np.stack([ahead, below, below_ahead], -1)]
    triangles = np.concatenate([band.reshape(-1, 3) for band in bands])
    return Part(
        "neck", places, triangles, np.repeat(np.outer(grey, _TINT), _SIDES, axis=0), stays=True
    )
