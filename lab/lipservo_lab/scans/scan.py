"""One scan: a surface as points with normals, whatever its file holds; units and axes of scans.

Scans are converted to those of a face: millimetres, y up, z to the viewer. Nothing is guessed
silently: what looks like other units or axes is an error that names the option to give.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from lipsync.arrays import Array, Indices
from lipsync.errors import UserError, check_extra

#: Millimetres in each unit of the option --unit.
UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4}
#: Twice the median distance of points from their middle is about 130 mm for a face, 400 mm for head
#: and shoulders. Such a number below the first of these bounds is in that unit.
_SIZES = ((1.0, "m"), (9.0, "in"), (45.0, "cm"), (900.0, "mm"))


class ScanFrameError(UserError):
    """Units or axes that cannot be used; one line."""


@dataclass(frozen=True)
class ScanFrame:
    """Unit and axes of a scan.

    unit: a key of `UNITS_MM`. axes: (3, 3) of 0, 1 and -1; row i says which axis of the scan,
    signed, is axis i of a face. A face has x to the picture's right, y up, z out of it to the
    viewer.
    """

    unit: str = "mm"
    axes: Array = field(default_factory=lambda: np.eye(3))

    def in_mm(self, points: Array) -> Array:
        """Return the scanner's points in mm along the axes of a face.

        Parameters
        ----------
        points : Array
            (n, 3).

        Returns
        -------
        Array
            (n, 3) mm.
        """
        return np.asarray(UNITS_MM[self.unit] * points @ self.axes.T, dtype=np.float64)


def scan_frame(unit: str, axes: str) -> ScanFrame:
    """Parse unit and axes of a scan. Raises ScanFrameError.

    axes: such as `x,y,z`, `x,z,-y`: the scan's axes to the right, up, and to the viewer.
    """
    if unit not in UNITS_MM:
        raise ScanFrameError(f"unit {unit!r}: one of {', '.join(UNITS_MM)}")
    rows = np.zeros((3, 3))
    named = [each.strip().lower() for each in axes.split(",")]
    letters = [each.removeprefix("-").removeprefix("+") for each in named]
    if sorted(letters) != ["x", "y", "z"]:
        raise ScanFrameError(f"axes {axes!r}: name each of x, y and z once, such as x,z,-y")
    for row, (name, letter) in enumerate(zip(named, letters, strict=True)):
        rows[row, "xyz".index(letter)] = -1.0 if name.startswith("-") else 1.0
    return ScanFrame(unit, rows)


def axes_text(axes: Array) -> str:
    """Return axes as text, such as "x,z,-y": the scan's axes to the right, up, and to the viewer.

    Parameters
    ----------
    axes : Array
        (3, 3), of 0, 1 and -1.

    Returns
    -------
    str
        As the option --axes takes it.
    """
    columns = np.abs(axes).argmax(axis=1)
    return ",".join(("-" if axes[row, i] < 0 else "") + "xyz"[i] for row, i in enumerate(columns))


def check_unit(points_mm: Array, unit: str, name: str) -> None:
    """Refuse points whose size shows that their unit is another one.

    Parameters
    ----------
    points_mm : Array
        (n, 3).
    unit : str
        The unit that was assumed.
    name : str
        Name of the scan, for the error.

    Raises
    ------
    ScanFrameError
        With the unit to give.
    """
    spread = 2.0 * float(
        np.median(np.linalg.norm(points_mm - np.median(points_mm, axis=0), axis=1))
    )
    size = spread / UNITS_MM[unit]
    looks_like = next((each for bound, each in _SIZES if size < bound), None)
    if 60.0 < spread < _SIZES[-1][0]:
        return
    if looks_like is None or looks_like == unit or size <= 0.0:
        raise ScanFrameError(
            f"{name}: half of its points lie in {spread:.3g} mm, which is no face; scale the scans "
            "to millimetres"
        )
    raise ScanFrameError(
        f"{name}: half of its points lie in {size:.3g} {unit}: it is in "
        f"{ {'m': 'metres', 'in': 'inches', 'cm': 'centimetres', 'mm': 'millimetres'}[looks_like] }"
        f"; give --unit {looks_like}"
    )


#: Endings of scan files.
SCAN_ENDINGS = (".ply", ".obj")
#: Fewer points are no scan of a face.
LEAST_POINTS = 500
#: Neighbours from which the normal of a point without triangles is computed.
_NEIGHBOURS = 12
#: Coarser triangles are subdivided, so that the nearest point of a surface is near.
_LONGEST_EDGE_MM = 2.5
_MOST_POINTS = 400_000


class ScanError(UserError):
    """A scan or a folder of scans that cannot be used; one line: which, why, what to do."""


@dataclass(frozen=True, slots=True)
class Scan:
    """A surface as points.

    points_mm: (n, 3), x to the picture's right, y up, z out of the face; normals: (n, 3) of length
    1, outward; spacing_mm: median distance of neighbouring points.
    """

    points_mm: Array
    normals: Array
    spacing_mm: float


def read_scan(path: Path, frame: ScanFrame) -> Scan:
    """Read a PLY or OBJ file of triangles or points; colours and textures are ignored.

    Raises ScanError for a file that is damaged, empty, or holds too few points.
    """
    points, triangles = _read(path)
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        raise ScanError(f"{path}: {int((~finite).sum())} points are not numbers; scan it again")
    return scan_of(frame.in_mm(points), triangles, str(path))


def scan_of(points_mm: Array, triangles: Indices, name: str = "scan") -> Scan:
    """Make a scan of points and triangles. Raises ScanError for too few points.

    Parameters
    ----------
    points_mm : Array
        (n, 3).
    triangles : Indices
        (m, 3) indices of points; m may be 0.
    name : str
        Name of the scan, for the error.

    Returns
    -------
    Scan
        Coarse triangles subdivided; without points that are in no triangle.
    """
    if len(triangles):
        points_mm, triangles = _refined(*_used_points(points_mm, triangles))
        normals = vertex_normals(points_mm, triangles)
        has_normal = np.linalg.norm(normals, axis=1) > 0.5
        points_mm, normals = points_mm[has_normal], normals[has_normal]
    if len(points_mm) < LEAST_POINTS:
        raise ScanError(
            f"{name}: {len(points_mm)} points; a scan of a face has {LEAST_POINTS} at least"
        )
    tree = cKDTree(points_mm)
    if not len(triangles):
        normals = _fitted_normals(points_mm, tree)
    # The order of corners gives all normals the same side, but not which side is outside.
    outwards = points_mm - (points_mm.mean(axis=0) - (0.0, 0.0, 60.0))
    if len(triangles):
        normals = normals * (1.0 if np.median((normals * outwards).sum(axis=1)) > 0 else -1.0)
    else:
        normals = normals * np.where((normals * outwards).sum(axis=1) < 0, -1.0, 1.0)[:, None]
    nearest_mm, _ = tree.query(points_mm[:: max(1, len(points_mm) // 2000)], k=2)
    return Scan(points_mm, normals, max(float(np.median(nearest_mm[:, 1])), 1e-3))


def vertex_normals(vertices: Array, triangles: Indices) -> Array:
    """Return the normal at each vertex: the mean over its triangles, weighted by area.

    Outward if corners go counter-clockwise as seen from outside; 0 for a vertex without triangles.

    Parameters
    ----------
    vertices : Array
        (n, 3).
    triangles : Indices
        (m, 3).

    Returns
    -------
    Array
        (n, 3), of length 1 or 0.
    """
    corners = vertices[triangles]
    area_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sums = np.empty_like(vertices)
    for axis in range(3):
        weights = np.repeat(area_normals[:, axis], 3)
        sums[:, axis] = np.bincount(triangles.ravel(), weights, minlength=len(vertices))
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.asarray(sums / np.maximum(lengths, np.finfo(float).tiny), dtype=np.float64)


def _read(path: Path) -> tuple[Array, Indices]:
    """Read all meshes of a PLY or OBJ file as one: points (n, 3) as stored, triangles (m, 3).

    Raises ScanError for a file that is empty, damaged, or cannot be read.
    """
    check_extra("trimesh", "reading scans")
    import trimesh

    load: Callable[..., Any] = trimesh.load
    try:
        if path.stat().st_size == 0:
            raise ScanError(f"{path}: an empty file; scan it again")
        loaded = load(path, process=False, skip_materials=True)
        meshes = list(getattr(loaded, "geometry", {"": loaded}).values())
        points = [np.asarray(mesh.vertices, dtype=np.float64).reshape(-1, 3) for mesh in meshes]
        faces = [np.asarray(getattr(mesh, "faces", ()), np.int64).reshape(-1, 3) for mesh in meshes]
        first = np.cumsum([0, *map(len, points)])
        triangles = [each + start for each, start in zip(faces, first, strict=False)]
        everything = np.concatenate([np.empty((0, 3)), *points])
        joined = np.concatenate([np.empty((0, 3), dtype=np.int64), *triangles])
        if len(joined) and (joined.min() < 0 or joined.max() >= len(everything)):
            raise ValueError("a triangle names a point that does not exist")
    except ScanError:
        raise
    except OSError as error:
        raise ScanError(f"{path}: cannot be read: {error.strerror or error}") from error
    except Exception as error:  # trimesh raises whatever the place of the damage makes it raise
        why = str(error).splitlines()[0][:80] if str(error) else type(error).__name__
        raise ScanError(f"{path}: damaged or no PLY or OBJ ({why}); export it again") from error
    return everything, joined


def _used_points(points: Array, triangles: Indices) -> tuple[Array, Indices]:
    """Return the points that are in a triangle, and the triangles renumbered."""
    used, renumbered = np.unique(triangles, return_inverse=True)
    return points[used], np.asarray(renumbered.reshape(-1, 3), dtype=np.int64)


def _refined(points: Array, triangles: Indices) -> tuple[Array, Indices]:
    """Return the mesh with triangles subdivided until its edges are short, or it is large."""
    from trimesh.remesh import subdivide

    split: Callable[[Array, Indices], tuple[Array, Indices]] = subdivide
    while len(points) < _MOST_POINTS // 4:
        edges = np.linalg.norm(points[triangles] - points[np.roll(triangles, 1, axis=1)], axis=2)
        if np.median(edges) <= _LONGEST_EDGE_MM:
            break
        points, triangles = split(points, triangles)
    return np.asarray(points, dtype=np.float64), np.asarray(triangles, dtype=np.int64)


def _fitted_normals(points: Array, tree: cKDTree) -> Array:
    """Return the normals of planes through each point's neighbours, to either side, (n, 3)."""
    _, neighbours = tree.query(points, k=_NEIGHBOURS)
    offsets = points[neighbours] - points[neighbours].mean(axis=1, keepdims=True)
    _, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets))
    return np.asarray(vectors[:, :, 0], dtype=np.float64)
