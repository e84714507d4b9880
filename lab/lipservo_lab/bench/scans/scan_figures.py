"""How far registered points are from where they really are."""

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from typing import get_args

import numpy as np

from lipservo_lab.bench.scans.synthetic_scans import Spread, known_scans
from lipservo_lab.scans.head_alignment import rigid_motion
from lipservo_lab.scans.registration import Registration, worn_template
from lipservo_lab.scans.scan import scan_of, vertex_normals
from lipservo_lab.scans.surface_fit import Markers
from lipservo_lab.scans.template import Template, shipped_template
from lipsync.arrays import Array
from lipsync.face.model import FaceModel
from lipsync.markers import MARKERS_47
from lipsync.twin.landmarks import N_SKIN
from lipsync.twin.mean_face import load_mean_face

#: A point that speech moves by more than this counts as moved.
_MOVED_MM = 1.0
#: Seen markers are off by so much along each axis.
_MARKER_NOISE_MM = 0.2

Advance = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True)
class ScanFigures:
    """Distances of points of the mesh from the same points of the truth, mm, over all scans.

    All of the face, most of which speech hardly moves; its lips and 6 mm round them; what speech
    moved by more than 1 mm. unregistered: what laying the resting face on the true head gives,
    without any registration. surface_median_mm: along the normal alone, which tells no sliding.
    """

    median_mm: float
    p95_mm: float
    lips_median_mm: float
    lips_p95_mm: float
    moved_median_mm: float
    moved_p95_mm: float
    unregistered_median_mm: float
    unregistered_lips_median_mm: float
    unregistered_moved_median_mm: float
    surface_median_mm: float
    scans: int
    seconds_per_scan: float


def scan_figures(face: FaceModel, n_scans: int, seed: int, advance: Advance) -> dict[str, object]:
    """By how truth is spread and whether 47 named points are seen; the first at the top too.

    Closest points alone, truth by Shepard's weights: what is hardest.
    """
    rows: dict[str, dict[str, object]] = {}
    cases = [(spread, seen) for spread in get_args(Spread) for seen in (False, True)]
    for number, (spread, seen) in enumerate(cases, start=1):
        done = number - 1

        def told(n: int, done: int = done) -> None:
            advance("registering", done * n_scans + n, len(cases) * n_scans)

        name = f"{spread}, {'47 markers' if seen else 'closest points'}"
        found = registered_figures(face, n_scans, seed, spread, with_markers=seen, advance=told)
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
    """Of one kind of truth. The first scan, at rest, gives the template its shape, as in use."""
    rng = np.random.default_rng([seed, 1])
    mean = load_mean_face()
    shipped = shipped_template(mean)
    rows = np.where(shipped.landmarks < N_SKIN, shipped.landmarks, shipped.landmarks - 1000)
    off, along, unmoved, seconds = [], [], [], []
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
        missed = registered - truth
        off.append(np.linalg.norm(missed, axis=1))
        along.append(np.abs((missed * vertex_normals(truth, shipped.triangles)).sum(axis=1)))
        unmoved.append(np.linalg.norm(at_rest @ rotation.T + shift - truth, axis=1))
        advance(number)
    errors, still, lips = np.array(off), np.array(unmoved), shipped.lips
    moved = still > _MOVED_MM
    figures = {
        "": errors, "lips_": errors[:, lips], "moved_": errors[moved], "surface_": np.array(along),
        "unregistered_": still, "unregistered_lips_": still[:, lips],
        "unregistered_moved_": still[moved],
    }  # fmt: skip
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
