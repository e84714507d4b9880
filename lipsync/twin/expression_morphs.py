"""Lids, brows and smile as morph targets: the same shell, with handles of their own.

The amounts are chosen to look right; nothing is learned here.
"""

import numpy as np

from lipsync.arrays import Array
from lipsync.markers import MARKERS_47
from lipsync.twin.head_surface import HeadSurface
from lipsync.twin.landmarks import FACE_RIM, LEFT_BROW, LEFT_EYE, RIGHT_BROW, RIGHT_EYE
from lipsync.twin.part import Eyeball
from lipsync.twin.shell import spread

#: How much of its way to the other the lower lid goes, and the clearance of a lid over the eyeball.
_LOWER_SHARE, _CLEARANCE_MM = 0.12, 0.7
#: Skin behind this depth follows no expression.
_TEMPLE_MM = -50.0
#: A raised brow, from its outer end inwards.
_BROW_UP_MM = np.array([3.5, 6.0, 7.0, 6.5, 5.0])
#: A broad smile of the face's left half: out, up, forward in mm by landmark; the right mirrors it.
_SMILE_LEFT_MM = {
    291: (6.5, 4.5, -3.5), 308: (6.0, 3.8, -3.2), 269: (2.6, 1.6, -1.2), 405: (3.0, 1.6, -1.2),
    267: (0.9, 0.4, -0.9), 314: (1.1, 0.5, -0.9), 312: (1.4, 0.4, -1.0), 317: (1.5, 0.6, -1.0),
    436: (3.0, 3.6, 0.6), 432: (4.8, 3.0, -0.8), 425: (1.0, 3.2, 2.4), 427: (1.8, 2.8, 0.8),
    411: (1.0, 1.4, 0.4), 280: (0.2, 1.6, 1.4), 327: (0.7, 0.3, 0.0), 365: (0.5, 0.4, 0.0),
    397: (0.6, 0.5, 0.0),
}  # fmt: skip
_SMILE_MIDDLE_MM = {0: (0.0, 0.0, -0.9), 17: (0.0, 0.2, -0.9), 13: (0.0, 0.1, -1.0),
                    14: (0.0, 0.3, -1.0)}  # fmt: skip
_MIRRORED = {
    291: 61, 308: 78, 269: 39, 405: 181, 267: 37, 314: 84, 312: 82, 317: 87, 436: 216, 432: 212,
    425: 205, 427: 207, 411: 187, 280: 50, 327: 98, 365: 136, 397: 172,
}  # fmt: skip
#: A smile of the eyes: the lower lids rise.
_SMILING_LID_MM = 0.9


def expression_morphs(surface: HeadSurface, eyes: tuple[Eyeball, ...]) -> dict[str, Array]:
    """Displacements (n, 3) in mm for 1 of each: lid_left, lid_right, brow, smile.

    And lid_left_over, lid_right_over, for lid (1 - lid) of each: a straight way would lead a lid
    through the eyeball; with it the lid passes over.
    """
    places = surface.places_mm
    rims = [np.array(surface.loop_from(*each[:2])) for each in (LEFT_EYE, RIGHT_EYE)]
    brows = np.array([*LEFT_BROW[0], *LEFT_BROW[1], *RIGHT_BROW[0], *RIGHT_BROW[1]])
    given = np.zeros((len(places), 4, 3))
    for at, rim in enumerate(rims):
        given[rim, at] = _shutting(places[rim])
        given[rim, 3, 1] = _SMILING_LID_MM * _lower_lid(len(rim))
    given[brows, 2, 1] = np.tile(_BROW_UP_MM, 4)
    for landmark in MARKERS_47.landmarks:
        given[landmark, 3] = _smile_mm(landmark)
    held = (places[:, 2] < _TEMPLE_MM) | (places[:, 1] > places[FACE_RIM[0], 1])
    held[[*rims[0], *rims[1], *brows, *MARKERS_47.landmarks]] = True
    at_held = given[held].reshape(held.sum(), -1)
    moved = spread(surface.stiffness, np.flatnonzero(held), at_held)
    lid_left, lid_right, brow, smile = moved.reshape(len(places), 4, 3).transpose(1, 0, 2)
    morphs = {"brow": brow, "smile": smile}
    for lid, eye in ((lid_left, eyes[0]), (lid_right, eyes[1])):
        morphs |= _over_eyeball(f"lid_{eye.side}", places, lid, eye)
    return morphs


def _lower_lid(n: int) -> Array:
    """(n,): 0 on the upper lid, along the lower one from 0 at a corner up to 1 and back."""
    along = np.arange(n) / n
    return np.maximum(0.0, -np.sin(2 * np.pi * along))


def _smile_mm(landmark: int) -> tuple[float, float, float]:
    for left, right in _MIRRORED.items():
        if landmark == right:
            out, up, forward = _SMILE_LEFT_MM[left]
            return -out, up, forward
    return _SMILE_LEFT_MM.get(landmark, _SMILE_MIDDLE_MM.get(landmark, (0.0, 0.0, 0.0)))


def _shutting(rim_mm: Array) -> Array:
    """(n, 3): what brings both lids together; the first half of the rim is the upper lid."""
    half = len(rim_mm) // 2
    upper, lower = rim_mm[: half + 1], np.vstack([rim_mm[half:], rim_mm[:1]])[::-1]
    meeting = (1 - _LOWER_SHARE) * lower + _LOWER_SHARE * upper
    moves = np.zeros_like(rim_mm)
    moves[: half + 1] = meeting - upper
    moves[half:] = meeting[::-1][:-1] - rim_mm[half:]
    moves[[0, half]] = 0.0
    return moves


def _over_eyeball(name: str, places: Array, lid: Array, eye: Eyeball) -> dict[str, Array]:
    """Both targets of a lid, outside the eyeball when shut and when half shut."""
    near = np.linalg.norm(lid, axis=1) > 0.05

    def outside(at: Array) -> Array:
        ray = at - eye.centre_mm
        length = np.linalg.norm(ray, axis=1, keepdims=True)
        least = np.where(near & (ray[:, 2] > 0), eye.radius_mm + _CLEARANCE_MM, 0.0)[:, None]
        return np.asarray(eye.centre_mm + ray * np.maximum(1.0, least / length), dtype=np.float64)

    shut = outside(places + lid) - places
    half = outside(places + 0.5 * shut) - places
    return {name: shut, f"{name}_over": 4.0 * (half - 0.5 * shut)}
