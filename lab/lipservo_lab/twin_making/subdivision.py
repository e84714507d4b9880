"""Coarse mesh to smooth surface: Loop's subdivision, of trimesh.

Loop (1987) gives a surface that is smooth in its second derivatives but at few vertices, so it does
not look faceted; old vertices keep their numbers, so markers stay vertices. It does not pass
through the vertices that it is given: `through_points` moves those until it does.
"""

from collections.abc import Callable

import numpy as np

from lipsync.arrays import Array, Indices
from lipsync.extras import check_extra

#: Each splits a triangle into four: 1,824 become 29,184.
ROUNDS = 2


def subdivide(vertices: Array, triangles: Indices, rounds: int = ROUNDS) -> tuple[Array, Indices]:
    """Vertices (n, d), of which the first are the old ones, and triangles (4^rounds as many, 3).

    Each of the d columns is subdivided as the three of a place are. Raises MissingExtraError.
    """
    check_extra("trimesh", "making a mean face")
    from trimesh.remesh import subdivide_loop

    loop: Callable[..., tuple[Array, Indices]] = subdivide_loop
    columns = vertices.shape[1]
    padded = np.zeros((len(vertices), -(-columns // 3) * 3))
    padded[:, :columns] = vertices
    done = [
        loop(padded[:, at : at + 3], triangles, iterations=rounds)
        for at in range(0, padded.shape[1], 3)
    ]
    places = np.hstack([each for each, _ in done])[:, :columns]
    return np.asarray(places, dtype=np.float64), np.asarray(done[0][1], dtype=np.int64)


def through_points(vertices: Array, triangles: Indices, rounds: int) -> Array:
    """Vertices whose Loop surface comes near the ones given; nearer with each round.

    Progressive iterative approximation (Cheng, Fan, Deng, Lin, Wang and Bao, "Loop subdivision
    surface based progressive interpolation", J. Comput. Sci. Technol. 24(1), 2009): each vertex
    moves by what its place on the surface misses.
    """
    control = vertices.copy()
    for _ in range(rounds):
        surface, _ = subdivide(control, triangles)
        control += vertices - surface[: len(vertices)]
    return control
