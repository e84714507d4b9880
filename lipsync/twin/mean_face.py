"""The shipped mean face: a smooth surface whose first 468 vertices are the tracked points."""

from dataclasses import dataclass
from importlib import resources

import numpy as np

from lipsync.arrays import Array, Indices

SHIPPED_FACE = "mean_face"


@dataclass(frozen=True, slots=True)
class MeanFace:
    """A head without colour or motion.

    vertices_mm (n, 3): x to the picture's right, y up, z to the viewer; the first 468 are numbered
    as in the 478-point face mesh. triangles (n_triangles, 3), outward. behind (n,): 0 on the face,
    and how many rings behind its rim on the back of the head. irises_mm (2, 5, 3): centre and four
    points of the edge, right and left eye.
    """

    vertices_mm: Array
    triangles: Indices
    behind: Array
    irises_mm: Array


def load_mean_face() -> MeanFace:
    """The one that comes with the package; OSError or ValueError where it is damaged."""
    place = resources.files("lipsync.models") / f"{SHIPPED_FACE}.npz"
    with place.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
        return MeanFace(
            file["vertices_mm"].astype(np.float64),
            file["triangles"].astype(np.int64),
            file["behind"].astype(np.float64),
            file["irises_mm"].astype(np.float64),
        )
