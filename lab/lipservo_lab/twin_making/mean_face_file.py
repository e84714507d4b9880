"""`python -m lipservo_lab.twin_making.mean_face_file FACE_MEAN.npz OUT.npz`: make the shipped face.

FACE_MEAN.npz has `vertices_mm` (478, 3) and `triangles`, as in the corpus.

The coarse mesh becomes a smooth surface by Loop's subdivision, of trimesh. Loop (1987) gives a
surface that is smooth in its second derivatives except at few vertices, so it does not look
faceted; old vertices keep their numbers, so markers stay vertices. The surface does not pass
through the given vertices: `through_points` moves them until it does.

The back of the head, which no camera tracked, is rings from the rim of the face to a pole. Each
vertex of the rim starts a cubic Bezier curve that leaves the face backwards and ends at the pole.
Its shape is generated, not measured.
"""

import io
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array, Indices
from lipsync.errors import check_extra
from lipsync.output_file import write_whole
from lipsync.twin.head_surface import FACE_RIM, LEFT_IRIS, N_SKIN, RIGHT_IRIS

#: Rounds of subdivision; each splits a triangle into four: 1,824 become 29,184.
ROUNDS = 2


def subdivide(vertices: Array, triangles: Indices, rounds: int = ROUNDS) -> tuple[Array, Indices]:
    """Subdivide a surface by Loop's scheme. Raises MissingExtraError.

    Further columns beyond x, y and z are interpolated in the same way.

    Parameters
    ----------
    vertices : Array
        (n, d).
    triangles : Indices
        (m, 3).
    rounds : int
        Number of subdivisions.

    Returns
    -------
    tuple[Array, Indices]
        Vertices (k, d), of which the first n are the old ones, and triangles (4^rounds m, 3).
    """
    check_extra("trimesh", "making a mean face")
    from trimesh.remesh import subdivide_loop

    loop: Callable[..., tuple[Array, Indices]] = subdivide_loop
    n_columns = vertices.shape[1]
    padded = np.zeros((len(vertices), -(-n_columns // 3) * 3))
    padded[:, :n_columns] = vertices
    parts = [
        loop(padded[:, first : first + 3], triangles, iterations=rounds)
        for first in range(0, padded.shape[1], 3)
    ]
    values = np.hstack([each for each, _ in parts])[:, :n_columns]
    return np.asarray(values, dtype=np.float64), np.asarray(parts[0][1], dtype=np.int64)


def through_points(vertices: Array, triangles: Indices, rounds: int) -> Array:
    """Return vertices whose Loop surface nearly passes through the given ones.

    By progressive iterative approximation (Cheng, Fan, Deng, Lin, Wang and Bao, "Loop subdivision
    surface based progressive interpolation", J. Comput. Sci. Technol. 24(1), 2009): each round
    moves a vertex by what its place on the surface is off.

    Parameters
    ----------
    vertices : Array
        (n, 3).
    triangles : Indices
        (m, 3).
    rounds : int
        Number of rounds; more come nearer.

    Returns
    -------
    Array
        (n, 3).
    """
    control = vertices.copy()
    for _ in range(rounds):
        surface, _ = subdivide(control, triangles)
        control += vertices - surface[: len(vertices)]
    return control


#: Rings between rim and pole.
N_RINGS = 13
#: Where the pole is: behind the eyes, and above them.
_BACK_MM, _POLE_UP_MM = -176.0, 2.0
#: Distances of the two inner control points of a curve from its ends, for curves from the top, the
#: side and the chin.
_LEAVING_MM = np.array([60.0, 62.0, 42.0])
_ARRIVING_MM = np.array([96.0, 84.0, 86.0])
#: Direction in which a curve leaves the rim: weights of the skin's own direction, of backwards, and
#: of outwards; for the top, the side and the chin.
_GOING_ON = np.array([0.75, 0.35, 0.0])
_BACKWARDS = np.array([0.35, 0.75, 1.0])
_OUTWARDS = np.array([0.35, 0.30, 0.0])


def head_shell(skin_mm: Array, rim: Indices, triangles: Indices) -> Array:
    """Return the back of the head: rings from the rim of the skin backwards, and the pole.

    Parameters
    ----------
    skin_mm : Array
        (n_vertices, 3).
    rim : Indices
        (n,), vertices of the rim in order.
    triangles : Indices
        (m, 3), of the skin.

    Returns
    -------
    Array
        (N_RINGS * n + 1, 3), ring after ring, then the pole.
    """
    rim_mm = skin_mm[rim]
    centre = (rim_mm.max(axis=0) + rim_mm.min(axis=0)) / 2
    pole = np.array([centre[0], _POLE_UP_MM, _BACK_MM])
    outward = _unit((rim_mm - centre) * (1.0, 1.0, 0.0))
    leaving, arriving, going_on, backwards, outwards = (
        _by_height(outward[:, 1], each)[:, None]
        for each in (_LEAVING_MM, _ARRIVING_MM, _GOING_ON, _BACKWARDS, _OUTWARDS)
    )
    heading = _unit(
        going_on * _skin_heading(skin_mm, rim, triangles)
        + backwards * np.array([0.0, 0.0, -1.0])
        + outwards * outward
    )
    p1 = rim_mm + leaving * heading
    p2 = pole + arriving * outward
    # Points of the cubic Bezier curves from rim_mm to pole.
    along = (np.arange(1, N_RINGS + 1) / (N_RINGS + 1))[:, None, None]
    rings = (
        (1 - along) ** 3 * rim_mm
        + 3 * (1 - along) ** 2 * along * p1
        + 3 * (1 - along) * along**2 * p2
        + along**3 * pole
    )
    return np.asarray(np.vstack([rings.reshape(-1, 3), pole]), dtype=np.float64)


def ring_of(n_rim: int) -> Array:
    """Return how many rings behind the rim each vertex of the shell is.

    Parameters
    ----------
    n_rim : int
        Number of vertices of the rim.

    Returns
    -------
    Array
        (N_RINGS * n_rim + 1,), 1 for the first ring.
    """
    rings = np.repeat(np.arange(1.0, N_RINGS + 1), n_rim)
    return np.asarray(np.append(rings, N_RINGS + 1.0), dtype=np.float64)


def _skin_heading(skin_mm: Array, rim: Indices, triangles: Indices) -> Array:
    """Return the direction in which the skin ends at each rim vertex, (n, 3), smoothed.

    From the inner vertices of the triangles at the rim to the rim vertex.
    """
    place_on_rim = {int(vertex): place for place, vertex in enumerate(rim)}
    heading = np.zeros((len(rim), 3))
    for triangle in triangles:
        inner = [vertex for vertex in triangle if int(vertex) not in place_on_rim]
        for vertex in triangle:
            place = place_on_rim.get(int(vertex))
            if place is not None and inner:
                heading[place] += _unit((skin_mm[vertex] - skin_mm[inner].mean(axis=0))[None])[0]
    for _ in range(3):
        heading = _unit(np.roll(heading, 1, 0) + 2 * heading + np.roll(heading, -1, 0))
    return heading


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True), dtype=np.float64)


def shell_triangles(rim: Indices, first: int) -> Indices:
    """Return the triangles between rim, rings and pole, facing outward.

    rim: its vertices, clockwise as seen from the front. first: index of the first vertex of the
    first ring.
    """
    n = len(rim)
    loops = np.vstack([rim, first + np.arange(N_RINGS * n).reshape(N_RINGS, n)])
    inner, outer = loops[:-1], loops[1:]
    ahead_inner, ahead_outer = np.roll(inner, -1, axis=1), np.roll(outer, -1, axis=1)
    bands = [
        np.stack([inner, ahead_inner, outer], axis=-1),
        np.stack([ahead_inner, ahead_outer, outer], axis=-1),
    ]
    last = loops[-1]
    cap = np.column_stack([last, np.roll(last, -1), np.full(n, first + N_RINGS * n)])
    return np.asarray(np.vstack([*(b.reshape(-1, 3) for b in bands), cap]), dtype=np.int64)


def _by_height(height: Array, top_side_chin: Array) -> Array:
    """Return values interpolated between those for top, side and chin, (n,).

    height: (n,), vertical part of the direction from the middle to the rim: 1 top, -1 chin.
    """
    return np.asarray(np.interp(height, [-1.0, 0.0, 1.0], top_side_chin[::-1]), dtype=np.float64)


#: Rounds of progressive interpolation: the surface then is off the tracked points by less than
#: their noise; more rounds would follow the noise.
_ROUNDS = 4
#: Coordinates are rounded to a micrometre, so that the file compresses well.
_DECIMALS = 3


def mean_face_arrays(points_mm: Array, triangles: Indices) -> dict[str, NDArray[Any]]:
    """Return the arrays of the shipped file: points_mm (478, 3), triangles (n, 3), outward."""
    skin = points_mm[:N_SKIN]
    rim = np.array(FACE_RIM)
    faces = repaired(triangles)
    vertices = np.vstack([skin, head_shell(skin, rim, faces)])
    faces = np.vstack([faces, shell_triangles(rim, N_SKIN)])
    behind = np.concatenate([np.zeros(N_SKIN), ring_of(len(rim))])
    control = through_points(vertices, faces, _ROUNDS)
    surface, fine = subdivide(np.column_stack([control, behind]), faces)
    return {
        "vertices_mm": np.round(surface[:, :3], _DECIMALS).astype(np.float32),
        "triangles": fine.astype(np.uint16),
        "behind": np.round(surface[:, 3], _DECIMALS).astype(np.float32),
        "irises_mm": points_mm[[RIGHT_IRIS, LEFT_IRIS]].astype(np.float32),
    }


def repaired(triangles: Indices) -> Indices:
    """Remove triangles that are not of the surface, and turn all the same way.

    A list of triangles made from a list of edges also has rings of three edges that are not
    triangles of the surface: each of their edges belongs to two other triangles. Most triangles
    keep their orientation. Raises MissingExtraError.
    """
    check_extra("trimesh", "making a mean face")
    import trimesh
    from trimesh.repair import fix_winding

    turn_alike: Callable[[trimesh.Trimesh], None] = fix_winding
    edges = Counter(edge for triangle in triangles for edge in _edges(triangle))
    real = np.array([t for t in triangles if any(edges[edge] <= 2 for edge in _edges(t))])
    mesh = trimesh.Trimesh(np.zeros((real.max() + 1, 3)), real, process=False, validate=False)
    turn_alike(mesh)
    faces = np.asarray(mesh.faces, dtype=np.int64)
    as_given = {_least_first(t) for t in real}
    n_kept = sum(_least_first(t) in as_given for t in faces)
    return faces if 2 * n_kept > len(faces) else faces[:, ::-1]


def _edges(triangle: Indices) -> list[tuple[int, int]]:
    a, b, c = sorted(int(index) for index in triangle)
    return [(a, b), (b, c), (a, c)]


def _least_first(triangle: Indices) -> tuple[int, ...]:
    """Return the triangle with its least corner first, so that only its orientation matters."""
    first = int(np.argmin(triangle))
    return tuple(int(index) for index in np.roll(triangle, -first))


def main(source: Path, destination: Path) -> None:
    """Read a tracked face, write the smooth one.

    Raises OSError, KeyError, OutputError.
    """
    with np.load(source, allow_pickle=False) as file:
        arrays = mean_face_arrays(file["vertices_mm"].astype(np.float64), file["triangles"])
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    write_whole(destination, buffer.getvalue())


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
