"""A surface as a thin shell: where every vertex goes when some of them are moved.

The displacement d minimises k_s |grad d|^2 + k_b |lap d|^2 over the surface, with k_b = 1 and d
given at some vertices (Botsch and Sorkine, "On linear variational surface deformation methods",
IEEE TVCG 14(1), 2008, eqs. 8 to 10). x, y and z do not depend on one another, so one matrix of
weights serves all three: Le, Zhu and Deng drive a face by its markers so.
"""

from collections.abc import Sequence

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu
from threadpoolctl import threadpool_limits

from lipsync.arrays import Array, Indices

#: 6 per square centimetre. Without this membrane term the lips overshoot beyond the outermost
#: markers; above 10 the surface begins to show a dimple at each (docs/decisions/0023).
MEMBRANE_PER_MM2 = 0.06
#: Keeps a triangle without area from dividing by zero.
_LEAST_AREA_MM2 = 1e-9


def influence(stiffness: sparse.csr_array, handles: Sequence[int], anchors: Sequence[int]) -> Array:
    """(n_vertices, n_handles): how far each vertex goes with a handle that moves by 1.

    stiffness: of `shell_stiffness`. 1 at the handle itself, 0 at the others and at the anchors; a
    vertex that is both is a handle. Raises ValueError for a handle that stands there twice,
    and for a part of the surface that hangs on neither handle nor anchor.
    """
    if len(set(handles)) != len(handles):
        raise ValueError("a vertex is a handle twice")
    still = np.setdiff1d(anchors, handles)
    held = np.concatenate([handles, still]).astype(np.int64)
    return spread(stiffness, held, np.eye(len(held), len(handles)))


def spread(stiffness: sparse.csr_array, held: Indices, given: Array) -> Array:
    """Displacements (n_vertices, k) of the whole surface, of which `given` (n_held, k) are known.

    Each of the k columns is a problem of its own. Raises as `influence` does.
    """
    n = stiffness.shape[0]
    n_pieces, piece = connected_components(stiffness, directed=False)
    if len(np.unique(piece[held])) < n_pieces:
        raise ValueError("a piece of the surface hangs on nothing")
    free = np.setdiff1d(np.arange(n), held)
    moved = np.zeros((n, given.shape[1]))
    moved[held] = given
    rows = stiffness[free]
    # Threads gain nothing on blocks as small as these, and lose on a busy machine.
    with threadpool_limits(limits=1):
        factors = splu(
            rows[:, free].tocsc(),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )
        moved[free] = factors.solve(-(rows[:, held] @ given))
    return moved


def shell_stiffness(
    vertices_mm: Array, triangles: Indices, membrane_per_mm2: float = MEMBRANE_PER_MM2
) -> sparse.csr_array:
    """Q = L^T M^-1 L - k_s L, (n_vertices, n_vertices): symmetric, positive semi-definite."""
    laplacian, areas = cotangent_laplacian(vertices_mm, triangles)
    inverse = sparse.diags_array(1.0 / np.maximum(areas, _LEAST_AREA_MM2))
    return sparse.csr_array(laplacian.T @ inverse @ laplacian - membrane_per_mm2 * laplacian)


def cotangent_laplacian(vertices_mm: Array, triangles: Indices) -> tuple[sparse.csr_array, Array]:
    """L (n, n), negative semi-definite, rows sum to 0; and a third of the area round each vertex.

    Pinkall and Polthier, Experimental Mathematics 2(1), 1993: half the sum of the cotangents of the
    two angles opposite an edge.
    """
    n = len(vertices_mm)
    corner = vertices_mm[triangles]
    rows, columns, values = [], [], []
    for at, (a, b) in enumerate(((1, 2), (2, 0), (0, 1))):
        u, v = corner[:, a] - corner[:, at], corner[:, b] - corner[:, at]
        twice_area = np.linalg.norm(np.cross(u, v), axis=1)
        half_cotangent = 0.5 * (u * v).sum(axis=1) / np.maximum(twice_area, _LEAST_AREA_MM2)
        rows += [triangles[:, a], triangles[:, b]]
        columns += [triangles[:, b], triangles[:, a]]
        values += [half_cotangent, half_cotangent]
    off = sparse.coo_array(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(n, n)
    ).tocsr()
    laplacian = off - sparse.diags_array(off.sum(axis=1))
    thirds = np.repeat(twice_area / 6, 3)
    areas = np.bincount(triangles.ravel(), thirds, minlength=n).astype(np.float64)
    return sparse.csr_array(laplacian), areas
