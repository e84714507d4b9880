"""Eyeballs that fit behind the lids of the mean face, and what lines the lids."""

from typing import Literal

import numpy as np

from lipsync.arrays import Array
from lipsync.twin.head_surface import HeadSurface
from lipsync.twin.landmarks import LEFT_EYE, RIGHT_EYE
from lipsync.twin.part import Eyeball, Part

#: Larger than an eyeball (12 mm): a tracked lid has no thickness, and at 12 mm the corners of the
#: eye would show what is behind it.
_RADIUS_MM = 16.5
#: The lid stands so far off the eyeball.
_CLEARANCE_MM = 0.5
#: How far the lining of the lids reaches back, and inwards as a share.
_LINING_MM, _LINING_SHARE = 7.0, 0.10
_LINING, _LASHES = (0.80, 0.55, 0.50), (0.22, 0.15, 0.12)


def eyeballs(surface: HeadSurface, irises_mm: Array) -> tuple[Eyeball, Eyeball]:
    """Left and right. irises_mm (2, 5, 3), right first, give how wide the irises are."""
    edges = irises_mm[:, 1:] - irises_mm[:, :1]
    iris_mm = float(np.linalg.norm(edges[:, :, :2], axis=2).mean())
    left = _eyeball("left", surface.places_mm[list(LEFT_EYE)], iris_mm)
    right = _eyeball("right", surface.places_mm[list(RIGHT_EYE)], iris_mm)
    return left, right


def _eyeball(side: Literal["left", "right"], rim_mm: Array, iris_mm: float) -> Eyeball:
    """Between the corners, as far back as the middle third of both lids asks for."""
    corners = rim_mm[[0, len(rim_mm) // 2]]
    x = corners[:, 0].mean()
    y = (rim_mm[:, 1].max() + rim_mm[:, 1].min()) / 2
    middle = rim_mm[np.abs(rim_mm[:, 0] - x) < np.ptp(corners[:, 0]) / 3]
    reach = (_RADIUS_MM + _CLEARANCE_MM) ** 2 - ((middle[:, :2] - (x, y)) ** 2).sum(axis=1)
    z = float((middle[:, 2] - np.sqrt(reach)).min())
    return Eyeball(side, np.array([x, y, z]), _RADIUS_MM, iris_mm)


def lid_lining(surface: HeadSurface, morphs: dict[str, Array], eye: Eyeball) -> Part:
    """The inner side of the lids of one eye: a strip from the rim backwards, dark at the lashes."""
    rim = np.array(surface.loop_from(*(LEFT_EYE if eye.side == "left" else RIGHT_EYE)[:2]))
    n = len(rim)
    front = surface.places_mm[rim]
    inwards = (eye.centre_mm - front) * (1.0, 1.0, 0.0) * _LINING_SHARE
    back = front + inwards - (0.0, 0.0, _LINING_MM)
    upper = np.arange(n) <= n // 2
    colours = np.vstack(
        [np.where(upper[:, None], _LASHES, _LINING), np.broadcast_to(_LINING, (n, 3))]
    )
    here, ahead = np.arange(n), np.roll(np.arange(n), -1)
    triangles = np.vstack(
        [np.column_stack([here, ahead, here + n]), np.column_stack([ahead, ahead + n, here + n])]
    )
    moves = {
        name: np.vstack([morph[rim], morph[rim]])
        for name, morph in morphs.items()
        if np.abs(morph[rim]).max() > 0.0
    }
    return Part(f"lids_{eye.side}", np.vstack([front, back]), triangles, colours, moves)
