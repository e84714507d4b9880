"""The back of the head, which no camera tracked: rings from the rim of the face to a pole.

Each vertex of the rim starts a cubic Bezier curve that leaves the face backwards and ends at the
pole. The shape is generated, not measured.
"""

import numpy as np

from lipsync.arrays import Array, Indices

#: Rings between rim and pole.
N_RINGS = 13
#: How far behind the eyes the head ends, and how far above them its pole is.
_BACK_MM, _POLE_UP_MM = -176.0, 2.0
#: Reach of the two inner control points of a curve, by where it starts: top, side, chin.
_LEAVING_MM = np.array([60.0, 62.0, 42.0])
_ARRIVING_MM = np.array([96.0, 84.0, 86.0])
#: How much a curve leaves as the skin before it goes on, how much backwards and how much outwards.
_GOING_ON = np.array([0.75, 0.35, 0.0])
_BACKWARDS = np.array([0.35, 0.75, 1.0])
_OUTWARDS = np.array([0.35, 0.30, 0.0])


def head_shell(skin_mm: Array, rim: Indices, triangles: Indices) -> Array:
    """(N_RINGS * n + 1, 3): rings from the rim (n,) of the skin backwards, and the pole."""
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
    along = (np.arange(1, N_RINGS + 1) / (N_RINGS + 1))[:, None, None]
    rings = (
        (1 - along) ** 3 * rim_mm
        + 3 * (1 - along) ** 2 * along * p1
        + 3 * (1 - along) * along**2 * p2
        + along**3 * pole
    )
    return np.asarray(np.vstack([rings.reshape(-1, 3), pole]), dtype=np.float64)


def ring_of(n_rim: int) -> Array:
    """(N_RINGS * n_rim + 1,): how many rings behind the rim each vertex of the shell lies."""
    rings = np.repeat(np.arange(1.0, N_RINGS + 1), n_rim)
    return np.asarray(np.append(rings, N_RINGS + 1.0), dtype=np.float64)


def _skin_heading(skin_mm: Array, rim: Indices, triangles: Indices) -> Array:
    """(n, 3): which way the skin runs where it ends, smoothed along the rim."""
    place_on_rim = {int(vertex): at for at, vertex in enumerate(rim)}
    heading = np.zeros((len(rim), 3))
    for triangle in triangles:
        inner = [vertex for vertex in triangle if int(vertex) not in place_on_rim]
        for vertex in triangle:
            at = place_on_rim.get(int(vertex))
            if at is not None and inner:
                heading[at] += _unit((skin_mm[vertex] - skin_mm[inner].mean(axis=0))[None])[0]
    for _ in range(3):
        heading = _unit(np.roll(heading, 1, 0) + 2 * heading + np.roll(heading, -1, 0))
    return heading


def _unit(vectors: Array) -> Array:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True), dtype=np.float64)


def shell_triangles(rim: Indices, first: int) -> Indices:
    """Triangles between rim, rings and pole, outward; `first` is the first ring's first vertex.

    rim: its vertices, clockwise as the viewer sees them.
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
    """Between three values, by the cosine of where on the rim a vertex lies: 1 top, -1 chin."""
    return np.asarray(np.interp(height, [-1.0, 0.0, 1.0], top_side_chin[::-1]), dtype=np.float64)
