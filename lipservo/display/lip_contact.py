"""Corrections of a warped photograph: lips touch when they should, and no triangle turns over."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from lipservo.display.photo_face import PhotoFace
from lipsync.arrays import Array, Indices
from lipsync.face.frame import Frame

#: Rounds after which a triangle may stay as it is.
_MOST_ROUNDS = 200
#: A triangle keeps this share of its area at least.
_LEAST_SHARE = 0.02
#: How far from its rim a lip moves with it when lips are brought together, mm.
_LIP_MM = 6.0


@dataclass(frozen=True, slots=True)
class Mesh:
    """The flat mesh of a photograph; its triangles are drawn from the back to the front.

    rest_px (n, 2): its vertices in the photograph. triangles (n_triangles, 3): rows of `rest_px`,
    in drawing order. skin: the rows of `triangles` that are skin.
    """

    rest_px: Array
    triangles: Indices
    skin: slice


class LipContact:
    """A correction that brings a photograph's lips together where the model's lips touch.

    Photographed lips are moved as far as the recorded speaker's, which have another shape: where
    the speaker's touch, a gap remains. It is removed in proportion as the model's lips come nearer
    to each other than they are in the photograph. Lips that would overlap meet in the middle. "own"
    is what belongs to the photograph itself, before it is moved. Attributes are public for
    `photo_packed.py`: a web page computes the same from them.
    """

    def __init__(self, photo: PhotoFace, own_px: Array, lips: Indices) -> None:
        """Prepare the correction for `photo`.

        own_px (n, 3): the skin's vertices as photographed, in pixels and depth. lips: rows of
        `own_px` round the inner rim of the lips, from a corner over the upper lip to the other and
        back.
        """
        # The vertices between the corners, of both lips from the first corner to the other.
        half = len(lips) // 2
        self.upper, self.lower = lips[1:half], lips[:half:-1]
        self.gaps = photo.lip_gaps
        corner, other = own_px[lips[0], :2], own_px[lips[half], :2]
        along = (other - corner) / np.linalg.norm(other - corner)
        #: Unit vector from the upper lip to the lower one.
        self.down = np.array([-along[1], along[0]])
        share = np.linspace(0.0, 1.0, half + 1)[1:-1]
        own_gap = self._gap_px(own_px)
        # The photographed gap less the model's own in the same mouth: it is to vanish in contact.
        self.excess_px = own_gap - photo.lip_gaps.at(share, photo.own) * photo.px_per_mm
        # Where landmarks overlap in the photograph, they may.
        self.least_px = np.minimum(own_gap, 0.0)
        self.own_gap_mm = max(self._widest_mm(photo.own), 1e-3)
        reach_px = _LIP_MM * photo.px_per_mm
        #: Of the upper and the lower lip, how far each vertex of the skin moves with the rim.
        self.felt = [
            _motion_with_rim(own_px[:, :2], rim, reach_px, side * self.down)
            for rim, side in ((self.upper, -1.0), (self.lower, 1.0))
        ]

    def _gap_px(self, skin_px: Array) -> Array:
        """Return the gaps (n_pairs,) between facing vertices of the lips; below 0: overlap."""
        return np.asarray((skin_px[self.lower, :2] - skin_px[self.upper, :2]) @ self.down)

    def _widest_mm(self, coefficients: Array) -> float:
        """Return the widest gap between the lips of the model's face with these coefficients."""
        return float(self.gaps.gaps_mm(coefficients).max())

    def bring_together(self, skin_px: Array, frame: Frame) -> Array:
        """Move the lips in `skin_px` into contact where they should touch, in place.

        Parameters
        ----------
        skin_px : Array
            (n, 3) pixels and depth of the skin's vertices, changed.
        frame : Frame
            Frame whose coefficients give the wanted gaps.

        Returns
        -------
        Array
            `skin_px`.
        """
        # 0 while the model's lips are as far apart as photographed or farther, 1 when they touch.
        nearness = 1.0 - self._widest_mm(frame.coefficients) / self.own_gap_mm
        closing = self.excess_px * min(1.0, max(0.0, nearness))
        closing = np.minimum(closing, self._gap_px(skin_px) - self.least_px) / 2
        # Each lip takes half of the way.
        for weights, shift in zip(self.felt, (closing, -closing), strict=True):
            skin_px[:, :2] += (weights @ shift)[:, None] * self.down
        return skin_px


def _motion_with_rim(own_px: Array, rim: Indices, reach_px: float, side: Array) -> sparse.csr_array:
    """Return how far each skin vertex moves with each vertex of a lip's rim: (n, n_rim), 0 to 1.

    A vertex moves with the nearest one of the rim alone. own_px (n, 2): the vertices; rim: rows of
    `own_px`. reach_px: distance at which 1/e is left. side (2,): direction from the rim to its lip;
    vertices at the other side do not move.
    """
    differences = own_px[:, None] - own_px[None, rim]
    nearest = np.argmin((differences**2).sum(axis=2), axis=1)
    from_rim = differences[np.arange(len(own_px)), nearest]
    share = np.exp(-((from_rim**2).sum(axis=1)) / reach_px**2)
    # The rim itself, and of the rest what lies on its own side.
    share[(share < 0.02) | (from_rim @ side < 0.0)] = 0.0
    share[rim] = 1.0
    rows = np.flatnonzero(share)
    return sparse.csr_array((share[rows], (rows, nearest[rows])), (len(own_px), len(rim)))


class Unfolding:
    """A correction of a moved mesh: triangles of skin that would turn over are moved as a whole.

    Such a triangle has the opposite orientation of that in the photograph, or hardly an area.
    """

    def __init__(self, rest_px: Array, mesh: Mesh) -> None:
        self._rest, self._triangles = rest_px, mesh.triangles[mesh.skin]
        self._areas = areas_px2(rest_px, self._triangles)

    def unfolded(self, moved_px: Array) -> Array:
        """Return the vertices with the corners of each folded triangle moved as their mean moves.

        That is repeated until no triangle is folded, at most 200 times.

        Parameters
        ----------
        moved_px : Array
            (n, 2) pixels.

        Returns
        -------
        Array
            (n, 2) pixels.
        """
        moves = moved_px - self._rest
        for _ in range(_MOST_ROUNDS):
            areas = areas_px2(self._rest + moves, self._triangles)
            folded = areas * np.sign(self._areas) < _LEAST_SHARE * np.abs(self._areas)
            if not folded.any():
                break
            corners = self._triangles[folded]
            mean_moves = np.repeat(moves[corners].mean(axis=1), 3, axis=0)
            # A vertex of several folded triangles moves by the mean of what they ask for.
            rows, which = np.unique(corners.ravel(), return_inverse=True)
            counts = np.bincount(which)
            sums = np.stack([np.bincount(which, column) for column in mean_moves.T], axis=1)
            moves[rows] = sums / counts[:, None]
        return self._rest + moves


def areas_px2(places_px: Array, triangles: Indices) -> Array:
    """Return twice the area of triangles in square pixels, signed by their orientation.

    Parameters
    ----------
    places_px : Array
        (n, 2) pixels.
    triangles : Indices
        (n_triangles, 3), rows of `places_px`.

    Returns
    -------
    Array
        (n_triangles,).
    """
    a, b, c = (places_px[triangles[:, corner]] for corner in range(3))
    across, down = b - a, c - a
    return np.asarray(across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0])
