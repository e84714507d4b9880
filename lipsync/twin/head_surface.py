"""The skin of the twin (a head for displays), its colours and holes; its motion as a thin shell.

The displacement d minimises k_s |grad d|^2 + k_b |lap d|^2 over the surface, with k_b = 1 and d
given at some vertices (Botsch and Sorkine, "On linear variational surface deformation methods",
IEEE TVCG 14(1), 2008, eqs. 8 to 10). x, y and z do not depend on one another, so one matrix of
weights serves all three: Le, Zhu and Deng drive a face by its markers so.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import resources

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from lipsync.arrays import Array, Indices
from lipsync.markers import OUTER_LIP

#: Points of the skin; the ten after them are the irises, which lie on no triangle.
N_SKIN = 468

#: The outer rim of the mesh, from the hairline over the left of the face (the picture's right).
FACE_RIM = (
    10, 338, 297, 332, 284, 251, 389, 356, 454, 323, 361, 288, 397, 365, 379, 378, 400, 377,
    152, 148, 176, 149, 150, 136, 172, 58, 132, 93, 234, 127, 162, 21, 54, 103, 67, 109,
)  # fmt: skip

#: Round each eye from its outer corner over the upper lid; the first nine are corner, upper lid,
#: corner. The speaker's own left and right.
RIGHT_EYE = (33, 246, 161, 160, 159, 158, 157, 173, 133, 155, 154, 153, 145, 144, 163, 7)
LEFT_EYE = (263, 466, 388, 387, 386, 385, 384, 398, 362, 382, 381, 380, 374, 373, 390, 249)
N_UPPER_LID = 9

#: Centre of each iris and four points of its edge.
RIGHT_IRIS = (468, 469, 470, 471, 472)
LEFT_IRIS = (473, 474, 475, 476, 477)

#: Lower and upper edge of each eyebrow, from its outer end.
RIGHT_BROW = ((46, 53, 52, 65, 55), (70, 63, 105, 66, 107))
LEFT_BROW = ((276, 283, 282, 295, 285), (300, 293, 334, 296, 336))

#: What follows the lower jaw most nearly: along the chin, 3-dof jaw of `jaw_motion`.
CHIN = (152, 176, 400, 148, 377, 199, 200, 175)
#: In front of the ears, near the joint of the jaw.
JAW_JOINT = (234, 454)


SHIPPED_FACE = "mean_face"


@dataclass(frozen=True, slots=True)
class MeanFace:
    """A head mesh without colour or motion.

    vertices_mm (n, 3): x to the picture's right, y up, z to the viewer; the first 468 are numbered
    as in the 478-point face mesh. triangles (n_triangles, 3), counter-clockwise seen from outside.
    behind (n,): 0 on the face; on the back of the head, the number of rings behind the face's rim.
    irises_mm (2, 5, 3): centre and four points of the edge, right and left eye.
    """

    vertices_mm: Array
    triangles: Indices
    behind: Array
    irises_mm: Array


def load_mean_face() -> MeanFace:
    """Return the mean head of the package. Raises OSError or ValueError where it is damaged."""
    path = resources.files("lipsync.models") / f"{SHIPPED_FACE}.npz"
    with path.open("rb") as stream, np.load(stream, allow_pickle=False) as file:
        return MeanFace(
            file["vertices_mm"].astype(np.float64),
            file["triangles"].astype(np.int64),
            file["behind"].astype(np.float64),
            file["irises_mm"].astype(np.float64),
        )


_SKIN = (0.91, 0.74, 0.65)
_LIPS = (0.80, 0.50, 0.48)
_CHEEKS = (0.93, 0.66, 0.58)
_BROWS = (0.36, 0.26, 0.21)
_LASHES = (0.24, 0.16, 0.13)
#: The back of the head looks like a robot's, so that it needs no hair and no ears.
_ROBOT = (0.55, 0.60, 0.66)
_CHEEK_MIDDLES, _CHEEK_RADIUS_MM = (205, 425), 22.0
_LIP_EDGE_MM, _LASH_EDGE_MM = 3.0, 1.3
_BROW_HALF_WIDTH_MM = 3.6
#: Farther than this from its line no feature is painted.
_FAR_MM = 8.0
#: The seam between skin and robot: at three heights, how many rings behind the rim it lies.
_SEAM_MM, _SEAM_RINGS = (-115.0, -70.0, 30.0), (4.5, 1.6, 0.9)


def skin_colours(mean: MeanFace) -> Array:
    """Return each vertex's colour: skin with cheeks, lips, brows and lashes, and a robot's back.

    Parameters
    ----------
    mean : MeanFace
        The mean head.

    Returns
    -------
    Array
        (n, 3), 0 to 1, sRGB.
    """
    places = mean.vertices_mm
    colours = np.broadcast_to(np.array(_SKIN), places.shape)
    layers = (
        (_cheek_amount(places), _CHEEKS),
        (_lip_amount(mean), _LIPS),
        (0.85 * _brow_amount(places), _BROWS),
        (0.8 * _lash_amount(places), _LASHES),
        (_robot_amount(mean), _ROBOT),
    )
    for amount, colour in layers:
        colours = (1 - amount[:, None]) * colours + amount[:, None] * np.array(colour)
    return np.asarray(colours, dtype=np.float64)


def _cheek_amount(places: Array) -> Array:
    """Return how much each vertex is cheek (n,): 0.5 in the cheeks' middles, 0 far from them."""
    distances = [np.linalg.norm(places - places[middle], axis=1) for middle in _CHEEK_MIDDLES]
    return 0.5 * np.asarray(np.exp(-((np.min(distances, axis=0) / _CHEEK_RADIUS_MM) ** 2)))


def _lip_amount(mean: MeanFace) -> Array:
    """Return how much each vertex is lip (n,): 1 within the outer lip line, with a soft edge."""
    outline = mean.vertices_mm[list(OUTER_LIP), :2]
    closed = np.vstack([outline, outline[:1]])
    places_xy = mean.vertices_mm[:, :2]
    distance, _ = cKDTree(_polyline(closed, 6)).query(places_xy, distance_upper_bound=_FAR_MM)
    is_inside = _inside_polygon(places_xy, outline) * (mean.behind == 0.0)
    edge = np.where(is_inside > 0, 1.0, -1.0) * np.minimum(distance, _FAR_MM) / _LIP_EDGE_MM
    return np.asarray(np.clip(0.35 + edge, 0.0, 1.0), dtype=np.float64)


def _brow_amount(places: Array) -> Array:
    """Return how much each vertex is brow (n,): 1 along the brows' middle, with soft edges."""
    amount = np.zeros(len(places))
    for lower, upper in (RIGHT_BROW, LEFT_BROW):
        line = _polyline((places[list(lower)] + places[list(upper)]) / 2, 10)
        share = np.linspace(0, 1, len(line))
        width_mm = _BROW_HALF_WIDTH_MM * np.interp(share, (0, 0.5, 0.85, 1), (0.3, 0.9, 1.0, 0.6))
        distance, nearest = cKDTree(line).query(places, distance_upper_bound=_FAR_MM)
        near = np.isfinite(distance)
        amount[near] = np.maximum(amount[near], 1.4 - distance[near] / width_mm[nearest[near]])
    return np.clip(amount, 0.0, 1.0)


def _lash_amount(places: Array) -> Array:
    """Return how much each vertex is lash (n,): 1 along the upper lids' edge, with a soft edge."""
    lines = [_polyline(places[list(each[:N_UPPER_LID])], 8)[8:] for each in (RIGHT_EYE, LEFT_EYE)]
    distance, _ = cKDTree(np.vstack(lines)).query(places, distance_upper_bound=_FAR_MM)
    return np.asarray(np.clip(1.0 - distance / _LASH_EDGE_MM, 0.0, 1.0), dtype=np.float64)


def _robot_amount(mean: MeanFace) -> Array:
    """Return how much each vertex is robot (n,): 0 before the seam, 1 behind it."""
    seam = np.interp(mean.vertices_mm[:, 1], _SEAM_MM, _SEAM_RINGS)
    return np.asarray(np.clip(0.5 + 2.5 * (mean.behind - seam), 0.0, 1.0))


def _polyline(corners: Array, steps: int) -> Array:
    """Return points along the line through `corners` (n, k), `steps` from each to the next."""
    positions = np.linspace(0, len(corners) - 1, steps * (len(corners) - 1) + 1)
    numbers = np.arange(len(corners))
    return np.column_stack([np.interp(positions, numbers, column) for column in corners.T])


def _inside_polygon(points: Array, polygon: Array) -> Array:
    """Return 1 (n,) for points (n, 2) within a polygon (m, 2), else 0.

    By the even-odd rule: from a point within, a ray along +x crosses an odd number of edges.
    """
    start, end = polygon, np.roll(polygon, -1, axis=0)
    x, y = points[:, :1], points[:, 1:]
    spans = (start[:, 1] > y) != (end[:, 1] > y)
    rise = np.where(start[:, 1] == end[:, 1], 1.0, end[:, 1] - start[:, 1])
    crossing = start[:, 0] + (y - start[:, 1]) / rise * (end[:, 0] - start[:, 0])
    return np.asarray((spans & (x < crossing)).sum(axis=1) % 2, dtype=np.float64)


#: 6 per square centimetre. Without this membrane term the lips overshoot beyond the outermost
#: markers; above 10 the surface begins to show a dimple at each (docs/decisions/page-and-kiosk.md).
MEMBRANE_PER_MM2 = 0.06
#: Keeps a triangle without area from dividing by zero.
_LEAST_AREA_MM2 = 1e-9


def influence(stiffness: sparse.csr_array, handles: Sequence[int], anchors: Sequence[int]) -> Array:
    """Return how far each vertex of a surface moves when one handle vertex moves by 1.

    1 at the handle itself, 0 at the other handles and at the anchors, which do not move; a vertex
    that is both is a handle.

    Parameters
    ----------
    stiffness : sparse.csr_array
        As `shell_stiffness` returns it.
    handles,anchors : Sequence[int]
        Vertex numbers.

    Returns
    -------
    Array
        (n_vertices, n_handles).

    Raises
    ------
    ValueError
        A handle is given twice, or a part of the surface has neither handle nor anchor.
    """
    if len(set(handles)) != len(handles):
        raise ValueError("the same vertex is a handle twice")
    constrained = np.concatenate([handles, np.setdiff1d(anchors, handles)]).astype(np.int64)
    return spread(stiffness, constrained, np.eye(len(constrained), len(handles)))


def spread(stiffness: sparse.csr_array, constrained: Indices, given: Array) -> Array:
    """Return the displacements of all vertices of a shell from given ones of some vertices.

    The displacements have the least elastic energy; each of the k columns is independent of the
    others. Raises ValueError if a piece of the surface has no given vertex.

    Parameters
    ----------
    stiffness : sparse.csr_array
        As `shell_stiffness` returns it.
    constrained : Indices
        (n_constrained,) numbers of the vertices whose displacements are given.
    given : Array
        (n_constrained, k), displacements of these vertices.

    Returns
    -------
    Array
        (n_vertices, k).
    """
    n = stiffness.shape[0]
    n_pieces, piece_of = connected_components(stiffness, directed=False)
    if len(np.unique(piece_of[constrained])) < n_pieces:
        raise ValueError("a separate piece of the surface has no handle")
    free = np.setdiff1d(np.arange(n), constrained)
    displacements = np.zeros((n, given.shape[1]))
    displacements[constrained] = given
    rows = stiffness[free]
    # The energy is least where stiffness @ displacements is 0 at each free vertex.
    # Threads gain nothing on blocks as small as these, and lose on a busy machine.
    with threadpool_limits(limits=1):
        factors = splu(
            rows[:, free].tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        displacements[free] = factors.solve(-(rows[:, constrained] @ given))
    return displacements


def shell_stiffness(
    vertices_mm: Array, triangles: Indices, membrane_per_mm2: float = MEMBRANE_PER_MM2
) -> sparse.csr_array:
    """Return a shell's stiffness matrix, by which `spread` computes its displacements.

    Q = L^T M^-1 L - k_s L (Botsch and Sorkine, IEEE TVCG 14(1), 2008), with L the Laplacian and M
    the vertices' areas: symmetric, positive semi-definite.

    Parameters
    ----------
    vertices_mm : Array
        (n_vertices, 3).
    triangles : Indices
        (n_triangles, 3).
    membrane_per_mm2 : float
        k_s, the weight of stretching against bending.

    Returns
    -------
    sparse.csr_array
        (n_vertices, n_vertices).
    """
    laplacian, areas = cotangent_laplacian(vertices_mm, triangles)
    inverse = sparse.diags_array(1.0 / np.maximum(areas, _LEAST_AREA_MM2))
    return sparse.csr_array(laplacian.T @ inverse @ laplacian - membrane_per_mm2 * laplacian)


def cotangent_laplacian(vertices_mm: Array, triangles: Indices) -> tuple[sparse.csr_array, Array]:
    """Return the Laplacian L, negative semi-definite, whose rows sum to 0, and vertex areas.

    Pinkall and Polthier, Experimental Mathematics 2(1), 1993: half the sum of the cotangents of the
    two angles opposite an edge.

    Parameters
    ----------
    vertices_mm : Array
        (n, 3).
    triangles : Indices
        (n_triangles, 3).

    Returns
    -------
    tuple[sparse.csr_array, Array]
        (n, n), and (n,) mm^2: a third of the area round each vertex.
    """
    n = len(vertices_mm)
    corner = vertices_mm[triangles]
    rows, columns, values = [], [], []
    for opposite, (a, b) in enumerate(((1, 2), (2, 0), (0, 1))):
        u, v = corner[:, a] - corner[:, opposite], corner[:, b] - corner[:, opposite]
        twice_area = np.linalg.norm(np.cross(u, v), axis=1)
        half_cotangent = 0.5 * (u * v).sum(axis=1) / np.maximum(twice_area, _LEAST_AREA_MM2)
        rows += [triangles[:, a], triangles[:, b]]
        columns += [triangles[:, b], triangles[:, a]]
        values += [half_cotangent, half_cotangent]
    off_diagonal = sparse.coo_array(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(n, n)
    ).tocsr()
    laplacian = off_diagonal - sparse.diags_array(off_diagonal.sum(axis=1))
    # A triangle's area is the same from each of its corners; a third of it goes to each.
    thirds = np.repeat(twice_area / 6, 3)
    areas = np.bincount(triangles.ravel(), thirds, minlength=n).astype(np.float64)
    return sparse.csr_array(laplacian), areas


#: Skin above this height or behind this depth moves with no marker.
_UPPER_FACE_MM, _BACK_MM = -20.0, -80.0


@dataclass(frozen=True)
class HeadSurface:
    """A coloured head: places_mm (n, 3), triangles (m, 3), colours (n, 3), 0 to 1, in sRGB."""

    places_mm: Array
    triangles: Indices
    colours: Array

    @cached_property
    def anchors(self) -> Indices:
        """Numbers of the vertices of upper face, eyes and back of the head, which do not move."""
        above = self.places_mm[:, 1] > _UPPER_FACE_MM
        return np.flatnonzero(above | (self.places_mm[:, 2] < _BACK_MM))

    @cached_property
    def stiffness(self) -> sparse.csr_array:
        """The stiffness matrix of the surface, as `shell_stiffness` returns it."""
        return shell_stiffness(self.places_mm, self.triangles)

    @cached_property
    def loops(self) -> list[list[int]]:
        """The numbers of the vertices round each hole of the surface, in order."""
        return boundary_loops(self.triangles)

    def loop_from(self, first: int, then: int) -> list[int]:
        """Return the numbers of vertices round a hole, from `first` the shorter way to `then`."""
        (loop,) = (each for each in self.loops if first in each)
        start = loop.index(first)
        rotated = loop[start:] + loop[:start]
        return rotated if rotated.index(then) < len(rotated) / 2 else [first, *rotated[:0:-1]]


def head_surface(mean: MeanFace) -> HeadSurface:
    """Return the surface of a mean head with the colours in which it is drawn."""
    return HeadSurface(mean.vertices_mm, mean.triangles, skin_colours(mean))


def boundary_loops(triangles: Indices) -> list[list[int]]:
    """Return the vertices round each hole, in order; a hole's edges have one triangle each."""
    start = triangles.ravel()
    end = np.roll(triangles, -1, axis=1).ravel()
    n = int(triangles.max()) + 1
    # Edges, as start * n + end, whose reverse belongs to no triangle.
    is_boundary = ~np.isin(start * n + end, end * n + start)
    next_vertex = dict(zip(start[is_boundary].tolist(), end[is_boundary].tolist(), strict=True))
    loops = []
    while next_vertex:
        first = next(iter(next_vertex))
        loop = [first]
        while (following := next_vertex.pop(loop[-1])) != first:
            loop.append(following)
        loops.append(loop)
    return loops
