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
    """Yield scans of a mean face: the first at rest, the others as likely as in speech.

    Each is far from the one before. noise_mm: standard deviation of each coordinate.
    """
    rng = np.random.default_rng(seed)
    places, targets = _moving_mesh(face, mean, spread)
    sampled = mean.triangles[(mean.behind[mean.triangles] <= _RINGS).all(axis=1)]
    width = np.linalg.cholesky(face.covariance)
    free = rng.normal(size=face.n_components)
    for number in range(n_scans):
        free = 0.6 * free + 0.8 * rng.normal(size=face.n_components)
        coefficients = face.rest if number == 0 else width @ free
        vertices = places + np.tensordot(coefficients, targets, axes=1)
        yield _scanned(vertices, sampled, noise_mm, rng)


def _moving_mesh(face: FaceModel, mean: MeanFace, spread: Spread) -> tuple[Array, Array]:
    """Return the mean's vertices, (n, 3) mm, and the displacement by a component each.

    The latter has shape (n_components, n, 3).
    """
    surface = head_surface(mean)
    if spread == "shell":
        skin = skin_morphs(face, surface)
        return skin.places_mm, skin.targets_mm
    points = tuple(i for i, number in enumerate(face.layout.landmarks) if number < N_SKIN)
    handles = [face.layout.landmarks[i] for i in points]
    graph = _edges(surface.places_mm, surface.triangles)
    near = 1.0 / (dijkstra(graph, indices=handles) ** 2 + _E_MM**2) ** 2
    still_mm = dijkstra(graph, indices=surface.anchors, min_only=True)
    still = _STILL_WEIGHT / (still_mm**2 + _E_MM**2) ** 2
    weights = (near / (near.sum(axis=0) + still)).T
    on_head = surface.places_mm[handles]
    at_mean, basis = worn_face(face, on_head, points)
    places = surface.places_mm + weights @ (at_mean - on_head)
    return places, np.stack([weights @ each for each in basis])


def _scanned(
    vertices: Array, triangles: Indices, noise_mm: float, rng: np.random.Generator
) -> KnownScan:
    """Return a scan of a mesh: sampled anew, with holes and noise, turned, and shifted.

    Vertices (n, 3), mm, are turned along, so that each registered point's true place is known.
    noise_mm: standard deviation of each coordinate.
    """
    n_points = int(rng.integers(_FEWEST_POINTS, _MOST_POINTS))
    points, corners = _sampled(vertices, triangles, n_points, rng)
    kept = np.ones(len(points), dtype=bool)
    for centre in points[rng.choice(len(points), _HOLES)]:
        kept &= np.linalg.norm(points - centre, axis=1) > rng.uniform(*_HOLE_MM)
    order = rng.permutation(np.flatnonzero(kept))
    new = np.full(len(points), -1)
    new[order] = np.arange(len(order))
    corners = new[corners]
    corners = rng.permutation(corners[(corners >= 0).all(axis=1)])
    noisy = points[order] + rng.normal(0.0, noise_mm, (len(order), 3))
    angles = rng.uniform(-_TURN_DEG, _TURN_DEG, 3)
    rotation = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
    shift = np.array(_PLACE_MM) + rng.uniform(-_MOVE_MM, _MOVE_MM, 3)
    return KnownScan(noisy @ rotation.T + shift, corners, vertices @ rotation.T + shift)


def _sampled(
    vertices: Array, triangles: Indices, n_points: int, rng: np.random.Generator
) -> tuple[Array, Indices]:
    """Draw random points of a surface, unevenly dense, and join them to triangles of their own.

    Two points are neighbours where the parts of the surface that are nearest to them touch.
    """
    from trimesh.remesh import subdivide

    split: Callable[..., tuple[Array, Indices]] = subdivide
    fine, parts = vertices, triangles
    for _ in range(_SPLITS):
        fine, parts = split(fine, parts)
    corner = fine[parts]
    crossed = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    thirds = np.repeat(np.linalg.norm(crossed, axis=1) / 6.0, 3)
    areas = np.bincount(parts.ravel(), thirds, minlength=len(fine))
    tilt = rng.normal(size=3) * _TILT_PER_MM
    density = areas * np.exp((fine - fine.mean(axis=0)) @ tilt)
    chosen = rng.choice(len(fine), n_points, replace=False, p=density / density.sum())
    _, _, nearest = dijkstra(
        _edges(fine, parts), indices=chosen, min_only=True, return_predecessors=True
    )
    part_of = np.full(len(fine), -1)
    part_of[chosen] = np.arange(n_points)
    meeting = part_of[nearest][parts]
    distinct = (meeting != np.roll(meeting, 1, axis=1)).all(axis=1)
    beside = np.zeros(len(fine), dtype=np.int64)
    beside[parts.ravel()] = np.repeat(np.arange(len(parts)), 3)
    shares = rng.dirichlet((1.0, 1.0, 1.0), n_points)
    points = np.einsum("nk,nkc->nc", shares, fine[parts[beside[chosen]]])
    return points, meeting[distinct]


def _edges(vertices: Array, triangles: Indices) -> Any:
    """The lengths of all edges, as a graph."""
    ends = np.vstack([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    n = len(vertices)
    _, first = np.unique(ends.min(axis=1) * n + ends.max(axis=1), return_index=True)
    one, other = ends[first].T
    lengths = np.linalg.norm(vertices[one] - vertices[other], axis=1)
    both = (np.concatenate([one, other]), np.concatenate([other, one]))
    return sparse.csr_array((np.concatenate([lengths, lengths]), both), shape=(n, n))


#: A point that speech moves by more than this counts as moved.
_MOVED_MM = 1.0
#: Seen markers are off by so much along each axis.
_MARKER_NOISE_MM = 0.2


@dataclass(frozen=True, slots=True)
class ScanFigures:
    """Distances of points of the mesh from the same points of the truth, mm, over all scans.

    All of the face, most of which speech hardly moves; its lips and 6 mm round them; what speech
    moved by more than 1 mm. unregistered: what laying the resting face on the true head gives,
    without any registration.
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
    """Return registration errors by kind of truth, with and without 47 named points.

    The figures of the first and hardest case, Shepard's weights without named points, are also at
    the top level.
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
    """Return registration errors for one kind of truth.

    The template takes its shape from the first scan, at rest, as in use.
    """
    rng = np.random.default_rng([seed, 1])
    mean = load_mean_face()
    shipped = shipped_template(mean)
    rows = np.where(shipped.landmarks < N_SKIN, shipped.landmarks, shipped.landmarks - 1000)
    off, unmoved, seconds = [], [], []
    registration: Registration | None = None
    at_rest: Array = shipped.vertices_mm
    for number, known in enumerate(known_scans(face, mean, n_scans, seed, spread=spread), start=1):
        truth = known.truth_mm[rows]
        markers = _seen(shipped, truth, rng) if with_markers else None
        scan = scan_of(known.points_mm, known.triangles)
        if registration is None:
            registration = Registration(worn_template(shipped, scan, markers))
            at_rest = truth
        began_s = time.perf_counter()
        registered = registration.register(scan, markers).in_scan_mm
        seconds.append(time.perf_counter() - began_s)
        rotation, shift = rigid_motion(at_rest[shipped.still], truth[shipped.still])
        off.append(np.linalg.norm(registered - truth, axis=1))
        unmoved.append(np.linalg.norm(at_rest @ rotation.T + shift - truth, axis=1))
        advance(number)
    errors, still = np.array(off), np.array(unmoved)
    figures = {
        "": errors,
        "lips_": errors[:, shipped.lips],
        "moved_": errors[still > _MOVED_MM],
        "unregistered_": still,
    }
    found = {
        f"{name}{key}": round(float(np.percentile(values, share)), 3) if values.size else 0.0
        for name, values in figures.items()
        for key, share in (("median_mm", 50), ("p95_mm", 95))
    }
    chosen = {each.name: found[each.name] for each in fields(ScanFigures) if each.name in found}
    return ScanFigures(**chosen, scans=n_scans, seconds_per_scan=round(float(np.mean(seconds)), 2))


def _seen(template: Template, truth_mm: Array, rng: np.random.Generator) -> Markers:
    rows = template.rows_of(MARKERS_47.landmarks)
    return Markers(rows, truth_mm[rows] + rng.normal(0.0, _MARKER_NOISE_MM, (len(rows), 3)))
