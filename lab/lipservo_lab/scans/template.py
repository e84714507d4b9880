"""The mesh that scans are brought onto: the shipped face, or that in the shape of a person."""

from dataclasses import dataclass

import numpy as np

from lipsync.arrays import Array, Indices
from lipsync.face_mesh import INNER_LIP, OUTER_LIP
from lipsync.markers import INNER_LIP_GROUP, OUTER_LIP_GROUP, PointLayout
from lipsync.twin.landmarks import N_SKIN
from lipsync.twin.mean_face import MeanFace, load_mean_face

#: Skin above this height moves little in speech: the head is held by it.
_UPPER_FACE_MM = -20.0
#: The first 468 vertices are those of the 478-point mesh, under their numbers; the others get
#: numbers that are no landmark's.
_OTHERS_FROM = 1000
#: How far behind the rim of the face, in rings, the mesh reaches.
_RIM = 0.5
#: Round the lips, as far as a lip's height: what `lips` counts.
_LIPS_MM = 6.0


@dataclass(frozen=True, slots=True)
class Template:
    """vertices_mm (n, 3) at rest, triangles (m, 3), outward; landmarks (n,), a number for each.

    still, lips (n,): whether a vertex lies in the upper face, and on or beside the lips.
    """

    vertices_mm: Array
    triangles: Indices
    landmarks: Indices
    still: np.ndarray
    lips: np.ndarray

    @property
    def layout(self) -> PointLayout:
        """All vertices, with the lips in their groups."""
        known = {*OUTER_LIP, *INNER_LIP}
        skin = tuple(int(n) for n in self.landmarks if int(n) not in known)
        groups = ((OUTER_LIP_GROUP, OUTER_LIP), (INNER_LIP_GROUP, INNER_LIP), ("skin", skin))
        return PointLayout(f"scans-{len(self.landmarks)}", groups, (13, 14))

    def rows_of(self, landmarks: tuple[int, ...]) -> Indices:
        """Which vertices have these numbers; KeyError for one that none has."""
        row_of = {int(number): row for row, number in enumerate(self.landmarks)}
        return np.array([row_of[number] for number in landmarks], dtype=np.int64)


def shipped_template(mean: MeanFace | None = None) -> Template:
    """The face of the twin up to its rim: 7,134 vertices."""
    mean = mean or load_mean_face()
    inside = mean.behind <= _RIM
    chosen = np.flatnonzero(inside)
    new = np.full(len(inside), -1)
    new[chosen] = np.arange(len(chosen))
    triangles = new[mean.triangles]
    triangles = triangles[(triangles >= 0).all(axis=1)]
    places = mean.vertices_mm[chosen]
    landmarks = np.where(chosen < N_SKIN, chosen, chosen + _OTHERS_FROM)
    lip_points = places[np.isin(landmarks, [*OUTER_LIP, *INNER_LIP])]
    away = np.linalg.norm(places[:, None] - lip_points[None], axis=2).min(axis=1)
    return Template(
        places,
        np.asarray(triangles, dtype=np.int64),
        landmarks.astype(np.int64),
        places[:, 1] > _UPPER_FACE_MM,
        away < _LIPS_MM,
    )
