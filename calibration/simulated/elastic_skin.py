"""An elastic skin with a mouth in it: a small finite-element model, solved once for each robot.

In the plane of the face constant-strain triangles in plane stress, out of it a membrane under
tension (Zienkiewicz and Taylor, The Finite Element Method, 2000, chapters 4 and 7); both lie on a
soft foundation, part skull and part jaw. Rods pull at patches of it. Displacements are small
against the face, so one stiffness matrix serves all poses: what is not linear are the horns, the
jaw and the lips that meet (elastic_robot.py).
Loads SciPy; the live path never does.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator
from scipy.spatial import Delaunay

from lipsync.arrays import Array
from lipsync.markers import MARKERS_47

#: Silicone of 2 mm and 0.2 MPa (about Shore A 10): stiffness in the plane, and Poisson's ratio.
SHEET_N_PER_MM, POISSON = 0.4, 0.45
#: Tension out of the plane, of the same order; foam behind: with the sheet it lets a pull fade
#: over sqrt(0.4 / 0.001) = 20 mm.
TENSION_N_PER_MM, FOAM_N_PER_MM3 = 0.3, 0.001
#: Lips hang free: less foam behind them, fading in over so many millimetres from the slit.
_LIP_FOAM, _LIP_MM = 0.3, 9.0
_GRID_MM, _CLEAR_MM = 9.0, 4.5
#: Lips are thicker than the skin around them, fading out over the same millimetres.
_LIP_THICKNESS = 6.0
#: The slit is this wide in the mesh alone, so that triangles know their lip.
_SLIT_MM = 0.75
#: Pairs of opposite points along the lips' edges, without the corners.
N_PAIRS = 9
_ROD_PATCH_MM = 7.0
_UPPER_INNER, _LOWER_INNER, _INNER_CORNERS = (82, 13, 312), (87, 14, 317), (78, 308)
_LANDMARKS = MARKERS_47.landmarks


def _at(landmark: int) -> int:
    return _LANDMARKS.index(landmark)


@dataclass(frozen=True, slots=True)
class ElasticSkin:
    """A skin in n nodes, and what is seen of it.

    places_mm: (n, 3), at rest; the first N_PAIRS nodes are the upper lip's edge, the next N_PAIRS
    the lower's, from the robot's right to its left.
    stiffness: (3 n, 3 n), x of all nodes, then y, then z, without rods; foam: (n,), N/mm;
    jaw_share: (n,), what part of the foam lies on the jaw. dots: (47, n), each marker as a mean of
    nodes; dots_mm: (47, 3), where it is at rest; off_edge_mm: (6,), of the inner lips' dots.
    """

    places_mm: Array
    stiffness: Array
    foam: Array
    jaw_share: Array
    dots: Array
    dots_mm: Array
    off_edge_mm: Array

    def patch(self, place_mm: Array, below_slit: bool | None) -> Array:
        """(n,) weights that add up to 1: where a rod holds; below_slit: the lip it leaves alone."""
        apart_mm = np.linalg.norm(self.places_mm[:, :2] - place_mm[:2], axis=1)
        weight = np.exp(-0.5 * (apart_mm / _ROD_PATCH_MM) ** 2)
        if below_slit is not None:
            weight[self.jaw_share < 0.5 if below_slit else self.jaw_share > 0.5] = 0.0
        return np.asarray(weight / weight.sum())


def elastic_skin(rest_mm: Array, gaps_mm: Array, off_edge_mm: Array) -> ElasticSkin:
    """The skin of a closed mouth (47, 3), its lips apart by gaps_mm (N_PAIRS,).

    off_edge_mm: (6,), how far each dot of the inner lips lies beside the edge, upper lip first.
    """
    seam = rest_mm[[_at(_INNER_CORNERS[0]), *map(_at, _UPPER_INNER), _at(_INNER_CORNERS[1])]].copy()
    seam[1:4] = (seam[1:4] + rest_mm[[_at(n) for n in _LOWER_INNER]]) / 2
    along = np.linspace(0.0, 1.0, N_PAIRS + 2)[1:-1]
    steps = (seam[:, 0] - seam[0, 0]) / (seam[-1, 0] - seam[0, 0])
    edge_mm = np.stack([np.interp(along, steps, seam[:, k]) for k in range(3)], axis=1)
    half = np.zeros((N_PAIRS, 3))
    half[:, 1] = gaps_mm / 2
    outer = [i for i, n in enumerate(_LANDMARKS) if n not in (*_UPPER_INNER, *_LOWER_INNER)]
    known_mm = np.concatenate([edge_mm + half, edge_mm - half, rest_mm[outer]])
    flat = np.concatenate([edge_mm, edge_mm, rest_mm[outer]])[:, :2].copy()
    flat[:N_PAIRS, 1] += _SLIT_MM
    flat[N_PAIRS : 2 * N_PAIRS, 1] -= _SLIT_MM
    further = _background(flat)
    places_mm = np.concatenate([known_mm, _raised(further, known_mm)])
    flat = np.concatenate([flat, further])
    mesh = Delaunay(flat)
    across = _across_slit(mesh.simplices)
    triangles = mesh.simplices[~across]
    from_slit_mm = np.linalg.norm(flat[:, None] - edge_mm[None, :, :2], axis=2).min(axis=1)
    thick = 1.0 + (_LIP_THICKNESS - 1.0) * np.exp(-0.5 * (2.0 * from_slit_mm / _LIP_MM) ** 2)
    area, stiffness = _assembled(flat, triangles, thick)
    foam = FOAM_N_PER_MM3 * area * np.clip(from_slit_mm / _LIP_MM, _LIP_FOAM, 1.0)
    foam[np.unique(mesh.convex_hull)] *= 50.0
    dots_flat, dots_mm = _dots(rest_mm, edge_mm, along, steps, gaps_mm, off_edge_mm)
    return ElasticSkin(
        places_mm=places_mm,
        stiffness=stiffness + np.diag(np.tile(foam, 3)),
        foam=foam,
        jaw_share=_jaw_share(flat, edge_mm),
        dots=_interpolation(mesh, across, flat, dots_flat),
        dots_mm=dots_mm,
        off_edge_mm=off_edge_mm,
    )


def _background(flat: Array) -> Array:
    """(m, 2): a grid over what the markers span, clear of what is there."""
    low, high = flat.min(axis=0) - _GRID_MM, flat.max(axis=0) + _GRID_MM
    x, y = (np.arange(low[k], high[k] + _GRID_MM, _GRID_MM) for k in (0, 1))
    grid = np.stack(np.meshgrid(x, y), axis=2).reshape(-1, 2)
    apart = np.linalg.norm(grid[:, None] - flat[None], axis=2).min(axis=1)
    return np.asarray(grid[apart > _CLEAR_MM])


def _raised(flat: Array, known_mm: Array) -> Array:
    """(m, 2) -> (m, 3), the depth from the points around."""
    inside = LinearNDInterpolator(known_mm[:, :2], known_mm[:, 2])(flat)
    beyond = NearestNDInterpolator(known_mm[:, :2], known_mm[:, 2])(flat)
    return np.column_stack([flat, np.where(np.isnan(inside), beyond, inside)])


def _across_slit(simplices: NDArray[np.int_]) -> NDArray[np.bool_]:
    upper = (simplices < N_PAIRS).any(axis=1)
    lower = ((simplices >= N_PAIRS) & (simplices < 2 * N_PAIRS)).any(axis=1)
    return np.asarray(upper & lower)


def _assembled(flat: Array, triangles: NDArray[np.int_], thick: Array) -> tuple[Array, Array]:
    """Area of each node, (n,), and the stiffness (3 n, 3 n) of sheet and membrane."""
    n = len(flat)
    area, stiffness = np.zeros(n), np.zeros((3 * n, 3 * n))
    plane = np.array([[1, POISSON, 0], [POISSON, 1, 0], [0, 0, (1 - POISSON) / 2]])
    plane *= SHEET_N_PER_MM / (1 - POISSON**2)
    for nodes in triangles:
        (x1, y1), (x2, y2), (x3, y3) = flat[nodes]
        b, c = np.array([y2 - y3, y3 - y1, y1 - y2]), np.array([x3 - x2, x1 - x3, x2 - x1])
        twice = abs((x2 - x1) * (y3 - y1) - (x3 - x1) * (y2 - y1))
        if twice < 1e-6:
            continue
        strain = np.zeros((3, 6))
        strain[0, :3], strain[1, 3:] = b, c
        strain[2, :3], strain[2, 3:] = c, b
        strain /= twice
        at = np.concatenate([nodes, nodes + n])
        stiffness[np.ix_(at, at)] += strain.T @ plane @ strain * twice / 2 * thick[nodes].mean()
        slopes = np.stack([b, c]) / twice
        deep = nodes + 2 * n
        stiffness[np.ix_(deep, deep)] += (
            TENSION_N_PER_MM * slopes.T @ slopes * twice / 2 * thick[nodes].mean()
        )
        area[nodes] += twice / 6
    return area, stiffness


def _jaw_share(flat: Array, edge_mm: Array) -> Array:
    """(n,): 0 skull, 1 jaw; sharp at the lips and broad towards the ears."""
    middle = edge_mm[:, :2].mean(axis=0)
    width_mm = np.maximum(0.45 * np.abs(flat[:, 0] - middle[0]), 1.0)
    height_mm = flat[:, 1] - np.interp(flat[:, 0], edge_mm[:, 0], edge_mm[:, 1])
    share = 1.0 / (1.0 + np.exp(np.clip(height_mm / width_mm, -50.0, 50.0)))
    share[:N_PAIRS], share[N_PAIRS : 2 * N_PAIRS] = 0.0, 1.0
    return np.asarray(share)


def _dots(
    rest_mm: Array, edge_mm: Array, along: Array, steps: Array, gaps_mm: Array, off_mm: Array
) -> tuple[Array, Array]:
    """Where the 47 dots are: in the mesh's plane (47, 2) and in space (47, 3)."""
    flat, places_mm = rest_mm[:, :2].copy(), rest_mm.copy()
    for side, landmarks in ((1.0, _UPPER_INNER), (-1.0, _LOWER_INNER)):
        for k, landmark in enumerate(landmarks):
            at = _at(landmark)
            centre = np.array([np.interp(steps[k + 1], along, edge_mm[:, i]) for i in range(3)])
            off = side * off_mm[k if side > 0 else 3 + k]
            flat[at] = centre[:2] + np.array([0.0, side * _SLIT_MM + off])
            places_mm[at] = centre
            places_mm[at, 1] += side * np.interp(steps[k + 1], along, gaps_mm) / 2 + off
    return flat, places_mm


def _interpolation(mesh: Delaunay, across: NDArray[np.bool_], flat: Array, points: Array) -> Array:
    """(n_points, n) barycentric weights; a point on the slit's edge belongs to the nearest node."""
    weights = np.zeros((len(points), len(flat)))
    for row, (point, triangle) in enumerate(zip(points, mesh.find_simplex(points), strict=True)):
        if triangle < 0 or across[triangle]:
            weights[row, np.linalg.norm(flat - point, axis=1).argmin()] = 1.0
            continue
        to_local = mesh.transform[triangle]
        local = to_local[:2] @ (point - to_local[2])
        weights[row, mesh.simplices[triangle]] = [*local, 1.0 - local.sum()]
    return weights
