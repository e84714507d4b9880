"""How far registered points are from where they really are.

Scans whose truth is known: the mean face speaks, turns, and is sampled anew in each of them.

The markers of the shipped face model move the mesh. So that the truth is not of the very shell that
registration assumes, they move it by default as Shepard's weights of the distance along the surface
do ("A two-dimensional interpolation function for irregularly-spaced data", ACM 1968), which is
rougher than skin; `shell` moves it as the twin's shell does, which is smoother.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, fields
from typing import Any, Literal, get_args

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra
from scipy.spatial.transform import Rotation

from lipservo.terminal.output import Advance
from lipservo_lab.scans.head_alignment import Template, rigid_motion, shipped_template
from lipservo_lab.scans.scan import scan_of
from lipservo_lab.scans.surface_fit import Markers, Registration, worn_template
from lipsync.arrays import Array, Indices
from lipsync.face.model import FaceModel
from lipsync.markers import MARKERS_47
from lipsync.twin.head_surface import N_SKIN, MeanFace, head_surface, load_mean_face
from lipsync.twin.twin import skin_morphs, worn_face

Spread = Literal["shepard", "shell"]

#: Weights are 1 / (d^2 + e^2)^2; those of what stays still count three times.
_E_MM, _STILL_WEIGHT = 6.0, 3.0
#: A scan reaches so many rings behind the rim of the face.
_RINGS = 3.0
_FEWEST_POINTS, _MOST_POINTS = 8_000, 20_000
#: Density rises by this share a millimetre, in some direction.
_TILT_PER_MM = 0.008
_HOLES, _HOLE_MM = 3, (4.0, 9.0)
_TURN_DEG, _PLACE_MM, _MOVE_MM = 12.0, (40.0, -25.0, 300.0), 15.0
_SPLITS = 2


@dataclass(frozen=True, slots=True)
class KnownScan:
    """points_mm (n, 3) and triangles (m, 3) as a scanner would have them, noise and holes included.

    truth_mm (n_vertices, 3): where every vertex of the mean face is in it. at_rest: no speech.
    """

    points_mm: Array
    triangles: Indices
    truth_mm: Array


def known_scans(
    face: FaceModel,
    mean: MeanFace,
    n_scans: int,
    seed: int,
    *,
    spread: Spread = "shepard",
    noise_mm: float = 0.2,
) -> Iterator[KnownScan]:
    """Yield simulated scans of the mean face: the first at rest, the others drawn as from speech.

    The coefficients have the face model's covariance; those of successive scans correlate by 0.6.
    spread: how the model's markers move the rest of the mesh. noise_mm: standard deviation of each
    coordinate of a scanned point.
    """
    rng = np.random.default_rng(seed)
    mean_mm, displacements_mm = _moving_mesh(face, mean, spread)
    face_triangles = mean.triangles[(mean.behind[mean.triangles] <= _RINGS).all(axis=1)]
    factor = np.linalg.cholesky(face.covariance)
    whitened = rng.normal(size=face.n_components)
    for number in range(n_scans):
        whitened = 0.6 * whitened + 0.8 * rng.normal(size=face.n_components)
        coefficients = face.rest if number == 0 else factor @ whitened
        vertices = mean_mm + np.tensordot(coefficients, displacements_mm, axes=1)
        yield _scan_mesh(vertices, face_triangles, noise_mm, rng)


def _moving_mesh(face: FaceModel, mean: MeanFace, spread: Spread) -> tuple[Array, Array]:
    """Return the mean head's vertices, (n, 3) mm, and how each component of the face moves them.

    The latter, (n_components, n, 3) mm, is for a coefficient of 1. spread: "shell" moves the mesh
    as the twin does; "shepard" by weighted means of the markers (Shepard 1968).
    """
    surface = head_surface(mean)
    if spread == "shell":
        skin = skin_morphs(face, surface)
        return skin.places_mm, skin.targets_mm
    skin_points = tuple(i for i, number in enumerate(face.layout.landmarks) if number < N_SKIN)
    handle_vertices = [face.layout.landmarks[i] for i in skin_points]
    graph = _edge_graph(surface.places_mm, surface.triangles)
    # Weight of each marker for each vertex; what stays still takes its share and moves nothing.
    handle_weights = 1.0 / (dijkstra(graph, indices=handle_vertices) ** 2 + _E_MM**2) ** 2
    still_mm = dijkstra(graph, indices=surface.anchors, min_only=True)
    still_weights = _STILL_WEIGHT / (still_mm**2 + _E_MM**2) ** 2
    weights = (handle_weights / (handle_weights.sum(axis=0) + still_weights)).T
    head_handles_mm = surface.places_mm[handle_vertices]
    model_handles_mm, basis = worn_face(face, head_handles_mm, skin_points)
    places = surface.places_mm + weights @ (model_handles_mm - head_handles_mm)
    return places, np.stack([weights @ each for each in basis])


def _scan_mesh(
    vertices: Array, triangles: Indices, noise_mm: float, rng: np.random.Generator
) -> KnownScan:
    """Return a scan of a mesh: sampled anew, with holes and noise, then turned and shifted.

    The scan's `truth_mm` has the vertices, (n, 3) mm, turned and shifted alike. noise_mm: standard
    deviation of each coordinate of a scanned point.
    """
    n_points = int(rng.integers(_FEWEST_POINTS, _MOST_POINTS))
    points, triangle_points = _resample_surface(vertices, triangles, n_points, rng)
    outside_holes = np.ones(len(points), dtype=bool)
    for centre in points[rng.choice(len(points), _HOLES)]:
        outside_holes &= np.linalg.norm(points - centre, axis=1) > rng.uniform(*_HOLE_MM)
    order = rng.permutation(np.flatnonzero(outside_holes))
    # Old to new numbers of the points that are left; -1: the point lay in a hole.
    new_index = np.full(len(points), -1)
    new_index[order] = np.arange(len(order))
    triangle_points = new_index[triangle_points]
    triangle_points = rng.permutation(triangle_points[(triangle_points >= 0).all(axis=1)])
    noisy = points[order] + rng.normal(0.0, noise_mm, (len(order), 3))
    angles = rng.uniform(-_TURN_DEG, _TURN_DEG, 3)
    rotation = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
    shift = np.array(_PLACE_MM) + rng.uniform(-_MOVE_MM, _MOVE_MM, 3)
    return KnownScan(noisy @ rotation.T + shift, triangle_points, vertices @ rotation.T + shift)


def _resample_surface(
    vertices: Array, triangles: Indices, n_points: int, rng: np.random.Generator
) -> tuple[Array, Indices]:
    """Draw random points of a surface, with uneven density, and triangulate them.

    Returns points, (n_points, 3) mm, and triangles (m, 3) of their indices. Three points make a
    triangle where their cells meet: the parts of the surface nearest to each (a dual of Voronoi).
    """
    from trimesh.remesh import subdivide

    split: Callable[..., tuple[Array, Indices]] = subdivide
    fine, fine_triangles = vertices, triangles
    for _ in range(_SPLITS):
        fine, fine_triangles = split(fine, fine_triangles)
    corner = fine[fine_triangles]
    # A third of each triangle's area goes to each of its corners: the areas of the vertices.
    crossed = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    third_areas = np.repeat(np.linalg.norm(crossed, axis=1) / 6.0, 3)
    areas = np.bincount(fine_triangles.ravel(), third_areas, minlength=len(fine))
    tilt = rng.normal(size=3) * _TILT_PER_MM
    density = areas * np.exp((fine - fine.mean(axis=0)) @ tilt)
    chosen = rng.choice(len(fine), n_points, replace=False, p=density / density.sum())
    # The cell of each vertex: the chosen point that is nearest along the surface.
    _, _, nearest = dijkstra(
        _edge_graph(fine, fine_triangles), indices=chosen, min_only=True, return_predecessors=True
    )
    cell_of = np.full(len(fine), -1)
    cell_of[chosen] = np.arange(n_points)
    corner_cells = cell_of[nearest][fine_triangles]
    distinct = (corner_cells != np.roll(corner_cells, 1, axis=1)).all(axis=1)
    triangle_of_vertex = np.zeros(len(fine), dtype=np.int64)
    triangle_of_vertex[fine_triangles.ravel()] = np.repeat(np.arange(len(fine_triangles)), 3)
    # Each point lies at random in a triangle beside its chosen vertex.
    shares = rng.dirichlet((1.0, 1.0, 1.0), n_points)
    points = np.einsum("nk,nkc->nc", shares, fine[fine_triangles[triangle_of_vertex[chosen]]])
    return points, corner_cells[distinct]


def _edge_graph(vertices: Array, triangles: Indices) -> Any:
    """Return a sparse symmetric matrix (n_vertices, n_vertices) of the lengths of all edges."""
    ends = np.vstack([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    n = len(vertices)
    _, first = np.unique(ends.min(axis=1) * n + ends.max(axis=1), return_index=True)
    start, end = ends[first].T
    lengths = np.linalg.norm(vertices[start] - vertices[end], axis=1)
    row_column = (np.concatenate([start, end]), np.concatenate([end, start]))
    return sparse.csr_array((np.concatenate([lengths, lengths]), row_column), shape=(n, n))


#: A point that speech moves by more than this counts as moved.
_MOVED_MM = 1.0
#: Seen markers are off by so much along each axis.
_MARKER_NOISE_MM = 0.2


@dataclass(frozen=True, slots=True)
class ScanFigures:
    """Distances between registered and true places of the same vertices, over all scans, mm.

    Without prefix: of all of the face, most of which speech hardly moves; lips: of the lips and
    6 mm round them; moved: of vertices that speech moved by more than 1 mm; unregistered: where
    the resting face is only moved rigidly onto the scanned head.
    """

    median_mm: float
    p95_mm: float
    lips_median_mm: float
    lips_p95_mm: float
    moved_median_mm: float
    moved_p95_mm: float
    unregistered_median_mm: float
    scans: int
    seconds_per_scan: float


def scan_figures(face: FaceModel, n_scans: int, seed: int, advance: Advance) -> dict[str, object]:
    """Return registration errors for each `Spread` of the true motion, with and without markers.

    `cases`: figures by name of the case. Those of the first and hardest case, Shepard's weights
    without markers, are also at the top level.
    """
    rows: dict[str, dict[str, object]] = {}
    cases = [(spread, seen) for spread in get_args(Spread) for seen in (False, True)]
    for number, (spread, seen) in enumerate(cases, start=1):
        done = number - 1

        def report(n: int, done: int = done) -> None:
            advance("registering", done * n_scans + n, len(cases) * n_scans)

        name = f"{spread}, {'47 markers' if seen else 'closest points'}"
        found = registered_figures(face, n_scans, seed, spread, with_markers=seen, advance=report)
        rows[name] = asdict(found)
    return {**next(iter(rows.values())), "cases": rows}


def registered_figures(
    face: FaceModel,
    n_scans: int,
    seed: int,
    spread: Spread,
    *,
    with_markers: bool,
    advance: Callable[[int], None] = lambda _: None,
) -> ScanFigures:
    """Return registration errors for one `Spread` of the true motion.

    The template takes its shape from the first scan, at rest, as in use. with_markers: the 47
    markers are given with each scan, with noise. advance: called with the number of scans done.
    """
    rng = np.random.default_rng([seed, 1])
    mean = load_mean_face()
    shipped = shipped_template(mean)
    vertex_rows = np.where(shipped.landmarks < N_SKIN, shipped.landmarks, shipped.landmarks - 1000)
    errors_mm, unregistered_mm, seconds = [], [], []
    registration: Registration | None = None
    at_rest: Array = shipped.vertices_mm
    for number, known in enumerate(known_scans(face, mean, n_scans, seed, spread=spread), start=1):
        truth = known.truth_mm[vertex_rows]
        markers = _noisy_markers(shipped, truth, rng) if with_markers else None
        scan = scan_of(known.points_mm, known.triangles)
        if registration is None:
            registration = Registration(worn_template(shipped, scan, markers))
            at_rest = truth
        began_s = time.perf_counter()
        registered = registration.register(scan, markers).in_scan_mm
        seconds.append(time.perf_counter() - began_s)
        rotation, shift = rigid_motion(at_rest[shipped.still], truth[shipped.still])
        errors_mm.append(np.linalg.norm(registered - truth, axis=1))
        unregistered_mm.append(np.linalg.norm(at_rest @ rotation.T + shift - truth, axis=1))
        advance(number)
    errors_all, unregistered_all = np.array(errors_mm), np.array(unregistered_mm)
    figures = {
        "": errors_all,
        "lips_": errors_all[:, shipped.lips],
        "moved_": errors_all[unregistered_all > _MOVED_MM],
        "unregistered_": unregistered_all,
    }
    found = {
        f"{name}{key}": round(float(np.percentile(values, share)), 3) if values.size else 0.0
        for name, values in figures.items()
        for key, share in (("median_mm", 50), ("p95_mm", 95))
    }
    chosen = {each.name: found[each.name] for each in fields(ScanFigures) if each.name in found}
    return ScanFigures(**chosen, scans=n_scans, seconds_per_scan=round(float(np.mean(seconds)), 2))


def _noisy_markers(template: Template, truth_mm: Array, rng: np.random.Generator) -> Markers:
    """Return the 47 markers of a scan as a tracker sees them: true vertices with noise, mm."""
    rows = template.rows_of(MARKERS_47.landmarks)
    return Markers(rows, truth_mm[rows] + rng.normal(0.0, _MARKER_NOISE_MM, (len(rows), 3)))
