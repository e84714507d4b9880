"""The skin at rest: its surface and colours, its holes, and what its shell holds still."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from lipsync.arrays import Array, Indices
from lipsync.twin.mean_face import MeanFace
from lipsync.twin.shell import shell_stiffness
from lipsync.twin.skin_colours import skin_colours

#: Skin above this height or behind this depth moves with no marker.
_UPPER_FACE_MM, _BACK_MM = -20.0, -80.0


@dataclass(frozen=True)
class HeadSurface:
    """places_mm (n, 3) and triangles, as of `MeanFace`; colours (n, 3), 0 to 1, sRGB."""

    places_mm: Array
    triangles: Indices
    colours: Array

    @cached_property
    def anchors(self) -> Indices:
        """Vertices of the upper face, the eyes and the back of the head."""
        above = self.places_mm[:, 1] > _UPPER_FACE_MM
        behind = self.places_mm[:, 2] < _BACK_MM
        return np.flatnonzero(above | behind)

    @cached_property
    def stiffness(self) -> sparse.csr_array:
        """Of its shell."""
        return shell_stiffness(self.places_mm, self.triangles)

    @cached_property
    def loops(self) -> list[list[int]]:
        """Vertices along each hole of the surface, in order."""
        return boundary_loops(self.triangles)

    def loop_from(self, first: int, then: int) -> list[int]:
        """The hole that begins at one vertex and goes on towards another."""
        (loop,) = (each for each in self.loops if first in each)
        at = loop.index(first)
        turned = loop[at:] + loop[:at]
        if turned.index(then) < len(turned) / 2:
            return turned
        return [first, *turned[:0:-1]]


def head_surface(mean: MeanFace) -> HeadSurface:
    """The surface that is drawn."""
    return HeadSurface(mean.vertices_mm, mean.triangles, skin_colours(mean))


def boundary_loops(triangles: Indices) -> list[list[int]]:
    """The closed rows of edges that belong to one triangle only, each in its triangles' sense."""
    start = triangles.ravel()
    end = np.roll(triangles, -1, axis=1).ravel()
    n = int(triangles.max()) + 1
    alone = ~np.isin(start * n + end, end * n + start)
    after = dict(zip(start[alone].tolist(), end[alone].tolist(), strict=True))
    loops = []
    while after:
        first = next(iter(after))
        loop = [first]
        while (following := after.pop(loop[-1])) != first:
            loop.append(following)
        loops.append(loop)
    return loops
