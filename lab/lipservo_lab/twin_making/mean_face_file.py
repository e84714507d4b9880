"""`python -m lipservo_lab.twin_making.mean_face_file FACE_MEAN.npz OUT.npz`: the shipped face anew.

FACE_MEAN.npz holds `vertices_mm` (478, 3) and `triangles`, as the corpus has them.
"""

import io
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lipservo_lab.twin_making.head_shell import head_shell, ring_of, shell_triangles
from lipservo_lab.twin_making.subdivision import subdivide, through_points
from lipsync.arrays import Array, Indices
from lipsync.extras import check_extra
from lipsync.output_file import write_whole
from lipsync.twin.landmarks import FACE_RIM, LEFT_IRIS, N_SKIN, RIGHT_IRIS

#: So many rounds of progressive interpolation: the surface then misses the tracked points by less
#: than they are noisy; more would follow their noise.
_ROUNDS = 4
#: Places are kept to a micrometre, so that the file packs well.
_DECIMALS = 3


def mean_face_arrays(points_mm: Array, triangles: Indices) -> dict[str, NDArray[Any]]:
    """What the shipped file holds: points_mm (478, 3), triangles (n, 3), outward."""
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
    """Without the triangles all of whose edges belong to two others, and turned one way.

    A list of triangles that was collected from a list of edges also holds rings of three edges that
    are no triangle of the surface. Raises MissingExtraError.
    """
    check_extra("trimesh", "making a mean face")
    import trimesh
    from trimesh.repair import fix_winding

    turn: Callable[[trimesh.Trimesh], None] = fix_winding
    edges = Counter(edge for triangle in triangles for edge in _edges(triangle))
    real = np.array([t for t in triangles if any(edges[edge] <= 2 for edge in _edges(t))])
    mesh = trimesh.Trimesh(np.zeros((real.max() + 1, 3)), real, process=False, validate=False)
    turn(mesh)
    faces = np.asarray(mesh.faces, dtype=np.int64)
    as_given = {_turned(t) for t in real}
    kept = sum(_turned(t) in as_given for t in faces)
    return faces if 2 * kept > len(faces) else faces[:, ::-1]


def _edges(triangle: Indices) -> list[tuple[int, int]]:
    a, b, c = sorted(int(each) for each in triangle)
    return [(a, b), (b, c), (a, c)]


def _turned(triangle: Indices) -> tuple[int, ...]:
    """The same for every corner that it may begin with, but not for the other side."""
    first = int(np.argmin(triangle))
    return tuple(int(each) for each in np.roll(triangle, -first))


def main(source: Path, destination: Path) -> None:
    """Read a tracked face, write the smooth one. Raises OSError, KeyError, OutputError."""
    with np.load(source, allow_pickle=False) as file:
        arrays = mean_face_arrays(file["vertices_mm"].astype(np.float64), file["triangles"])
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    write_whole(destination, buffer.getvalue())


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
