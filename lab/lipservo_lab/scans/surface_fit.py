"""A mesh is bent onto a scan: feature markers first, then closest points with smoothness.

The displacement u of the template's vertices, in the pose of the head, minimises

    sum_v A_v w_v (n_v . (x_v + u_v - q_v))^2  +  m sum_k |x_k + u_k - p_k|^2
        +  l^4 u' (L' S M^-1 L - k L) u

with q_v the point of the scan nearest to vertex v and n_v its normal (Chen and Medioni, "Object
modelling by registration of multiple range images", 1992), A_v the area round the vertex, p_k the
markers, and the bending and stretching of a thin shell (`lipsync.twin.head_surface`). Closest
points are looked for anew, and the length l, below which the shell hardly bends, is shortened from
coarse to fine, as by Amberg, Romdhani and Vetter ("Optimal step nonrigid ICP algorithms for surface
registration", CVPR 2007). Distances along the surface count nothing: there the shell alone holds
the vertices, which neither lets them slide as nearest points do nor holds them back.

Scans of one person, one after the other, onto one mesh.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg, splu
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from lipservo_lab.scans.head_alignment import Pose, Template, find_pose, misfit_mm, rigid_motion
from lipservo_lab.scans.scan import Scan, ScanError, vertex_normals
from lipsync.arrays import Array, Indices
from lipsync.twin.head_surface import cotangent_laplacian

#: k, per square mm: a tenth of the twin's, which holds motion along the surface back.
_MEMBRANE_PER_MM2 = 0.005
#: S in the upper face, against 1 below: speech bends it little, and it would slide otherwise.
_UPPER_STIFFNESS = 30.0
#: A surface is matched where it looks the same way, and not across its edge or a hole.
_LEAST_COSINE = 0.5
_WITHIN_SPACINGS = 4.0
#: m, in square mm of surface that a marker weighs as much as.
_MARKER_MM2 = 20.0
#: Keeps what nothing holds in its place.
_DAMPING = 1e-4
#: Steps of conjugate gradients for each set of closest points.
_STEPS = 16
#: Distances beyond this many medians count less and less.
_FAR, _LEAST_FAR_MM = 3.0, 0.6


@dataclass(frozen=True, slots=True)
class Level:
    """l, how many times closest points are looked for, and how far away."""

    length_mm: float
    n_rounds: int
    reach_mm: float


#: For a face whose shape is known, and for a stranger's.
LEVELS = (Level(10.0, 3, 15.0), Level(5.0, 3, 6.0), Level(3.0, 3, 3.0))
STRANGER_LEVELS = (Level(30.0, 6, 25.0), Level(12.0, 6, 15.0), *LEVELS)


@dataclass(frozen=True, slots=True)
class Markers:
    """Vertices (k,) of the template and where they were seen in the scan, (k, 3) in mm."""

    vertices: Indices
    seen_mm: Array


@dataclass(frozen=True, slots=True)
class Fit:
    """displacement_mm (n, 3) in the pose of the head, and the pose in the scan.

    matched (n,): whether a vertex has its surface in the scan; off_mm (n,): how far the surface of
    the scan is from it, along the normal; meaningless where there is none.
    """

    displacement_mm: Array
    pose: Pose
    matched: np.ndarray
    off_mm: Array


class SurfaceFit:
    """Bends one template onto scans; what all scans have in common is factorised once."""

    def __init__(self, template: Template, levels: Sequence[Level] = LEVELS) -> None:
        self._template = template
        self._levels = levels
        laplacian, areas = cotangent_laplacian(template.vertices_mm, template.triangles)
        self._areas = np.maximum(areas, 1e-3 * float(areas.max()))
        bending = np.where(template.still, _UPPER_STIFFNESS, 1.0) / self._areas
        self._shell = sparse.csr_array(
            laplacian.T @ sparse.diags_array(bending) @ laplacian - _MEMBRANE_PER_MM2 * laplacian
        )
        with threadpool_limits(limits=1):
            self._factors = [self._factorised(level.length_mm) for level in levels]

    def _factorised(self, length_mm: float) -> Any:
        """Factorise the shell with every vertex held in all directions: the preconditioner."""
        held = length_mm**4 * self._shell + sparse.diags_array(self._areas)
        return splu(
            sparse.csc_array(held),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        )

    def fit(
        self, scan: Scan, pose: Pose, start_mm: Array | None = None, markers: Markers | None = None
    ) -> Fit:
        """Fit the template to a scan from a pose that is nearly right.

        Parameters
        ----------
        scan : Scan
            The scan.
        pose : Pose
            Of the face in it.
        start_mm : Array | None
            (n, 3), a displacement to begin with; None: 0.
        markers : Markers | None
            Named points; None: none.

        Returns
        -------
        Fit
            Displacements (n, 3) mm.
        """
        rest = self._template.vertices_mm
        moved = np.zeros_like(rest) if start_mm is None else start_mm
        tree = cKDTree(scan.points_mm)
        still = self._template.still
        with threadpool_limits(limits=1):
            for level, factors in zip(self._levels, self._factors, strict=True):
                for _ in range(level.n_rounds):
                    match = self._match(moved, pose, scan, tree, level.reach_mm)
                    moved = self._solved(moved, match, level.length_mm, factors, pose, markers)
                    turn = rigid_motion((rest + moved)[still], rest[still])
                    moved = (rest + moved) @ turn[0].T + turn[1] - rest
                    pose = pose.after(*turn)
        match = self._match(moved, pose, scan, tree, self._levels[-1].reach_mm)
        off_mm = ((match.nearest - rest - moved) * match.normals).sum(axis=1)
        return Fit(moved, pose, match.found, off_mm)

    def _match(
        self, moved: Array, pose: Pose, scan: Scan, tree: cKDTree, reach_mm: float
    ) -> "_Match":
        """Return each vertex's nearest point of the scan, its normal, and whether they match.

        moved: (n, 3) mm, displacement of the template so far. A match lies within `reach_mm`, faces
        the same way, and is not beyond a hole's or the scan's edge.
        """
        places = self._template.vertices_mm + moved
        in_scan = pose.in_scan(places)
        distances, at = tree.query(in_scan, distance_upper_bound=reach_mm)
        found = np.isfinite(distances)
        at = np.where(found, at, 0)
        normals = scan.normals[at]
        across = in_scan - scan.points_mm[at]
        across = across - (across * normals).sum(axis=1, keepdims=True) * normals
        normals = normals @ pose.rotation
        alike = (vertex_normals(places, self._template.triangles) * normals).sum(axis=1)
        found &= alike > _LEAST_COSINE
        found &= np.linalg.norm(across, axis=1) < _WITHIN_SPACINGS * scan.spacing_mm
        return _Match(pose.on_face(scan.points_mm[at]), normals, found)

    def _solved(
        self,
        moved: Array,
        match: "_Match",
        length_mm: float,
        factors: Any,
        pose: Pose,
        markers: Markers | None,
    ) -> Array:
        """Return the displacement (n, 3), mm, that minimises the energy of the module's docstring.

        Solved by conjugate gradients from `moved` on, `_STEPS` at most. Matches that are far off,
        beside the median, count less. length_mm: below it the shell hardly bends.
        """
        rest, n = self._template.vertices_mm, len(moved)
        normals = match.normals
        off = ((match.nearest - rest - moved) * normals).sum(axis=1)
        typical = float(np.median(np.abs(off[match.found]))) if match.found.any() else 0.0
        far = max(_FAR * typical, _LEAST_FAR_MM)
        weights = self._areas * match.found / (1.0 + (off / far) ** 2)
        right = (weights * ((match.nearest - rest) * normals).sum(axis=1))[:, None] * normals
        held = np.full(n, _DAMPING) * self._areas
        if markers is not None:
            held[markers.vertices] += _MARKER_MM2
            wanted = pose.on_face(markers.seen_mm) - rest[markers.vertices]
            right[markers.vertices] += _MARKER_MM2 * wanted
        shell = length_mm**4 * self._shell

        def applied(flat: Array) -> Array:
            u = flat.reshape(n, 3)
            along = weights * (u * normals).sum(axis=1)
            return np.asarray(shell @ u + along[:, None] * normals + held[:, None] * u).ravel()

        def preconditioned(flat: Array) -> Array:
            return np.asarray(factors.solve(flat.reshape(n, 3))).ravel()

        size = (3 * n, 3 * n)
        solved, _ = cg(
            LinearOperator(size, matvec=applied),
            right.ravel(),
            x0=moved.ravel(),
            maxiter=_STEPS,
            M=LinearOperator(size, matvec=preconditioned),
        )
        return np.asarray(solved.reshape(n, 3), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class _Match:
    """For each vertex: the nearest point of the scan and its normal, on the face; found (n,)."""

    nearest: Array
    normals: Array
    found: np.ndarray


#: Where the head is not found, the face is farther from the scan than any mouth moves.
_LOST_MM = 8.0
#: Worse scans teach nothing.
_LEAST_MATCHED, _MOST_ERROR_MM = 0.5, 1.0
#: A head that seems smaller or larger than this was not found.
_SCALES = (0.7, 1.4)


@dataclass(frozen=True, slots=True)
class RegisteredScan:
    """points_mm (n_vertices, 3): in the pose of the head; fit: the rest of what is known."""

    points_mm: Array
    fit: Fit

    @property
    def in_scan_mm(self) -> Array:
        """The places of the same points in the scan, with head motion.

        Returns
        -------
        Array
            (n_vertices, 3).
        """
        return self.fit.pose.in_scan(self.points_mm)

    @property
    def matched(self) -> float:
        """The share of the mesh that found a matching surface."""
        return float(self.fit.matched.mean())

    @property
    def errors_mm(self) -> Array:
        """Distances along the normal.

        Returns
        -------
        Array
            (n_matched,) mm.
        """
        return np.asarray(np.abs(self.fit.off_mm[self.fit.matched]), dtype=np.float64)


def worn_template(template: Template, neutral: Scan, markers: Markers | None = None) -> Template:
    """The template in the shape and size of the person of a neutral scan; names stay.

    Raises ScanError for a scan that the template does not fit.
    """
    pose = find_pose(template.vertices_mm, neutral, scaled=True)
    if not _SCALES[0] < pose.scale < _SCALES[1]:
        raise ScanError(f"the face is {pose.scale:.2f} times as large as usual")
    sized = replace(template, vertices_mm=pose.scale * template.vertices_mm)
    fit = SurfaceFit(sized, STRANGER_LEVELS).fit(neutral, replace(pose, scale=1.0), None, markers)
    registered = RegisteredScan(sized.vertices_mm + fit.displacement_mm, fit)
    check_registered(registered)
    return replace(sized, vertices_mm=registered.points_mm)


def check_registered(scan: RegisteredScan) -> None:
    """Raises ScanError for a mesh that is not the scan."""
    if scan.matched < _LEAST_MATCHED:
        raise ScanError(f"only {scan.matched:.0%} of the face is in the scan")
    error_mm = float(np.median(scan.errors_mm))
    if error_mm > _MOST_ERROR_MM:
        raise ScanError(f"the face fitted is {error_mm:.1f} mm off the scan")


class Registration:
    """Registers scan after scan, each from where the one before was."""

    def __init__(self, template: Template) -> None:
        """template: of the person, see `worn_template`."""
        self._template = template
        self._fit = SurfaceFit(template)
        self.begin()

    def begin(self) -> None:
        """A new take: the next scan is found from the face at rest."""
        self._moved: Array | None = None

    def register(self, scan: Scan, markers: Markers | None = None) -> RegisteredScan:
        """Raises ScanError for a scan whose face is not found, or hardly there."""
        rest = self._template.vertices_mm
        moved = np.zeros_like(rest) if self._moved is None else self._moved
        pose = find_pose(rest + moved, scan)
        lost_mm = misfit_mm(rest + moved, scan, pose)
        if lost_mm > _LOST_MM:
            raise ScanError(f"no face found: the nearest fit is {lost_mm:.1f} mm off")
        fit = self._fit.fit(scan, pose, moved, markers)
        registered = RegisteredScan(rest + fit.displacement_mm, fit)
        check_registered(registered)
        self._moved = fit.displacement_mm
        return registered
