"""Bend a mesh onto a scan: feature markers first, then closest points with smoothness.

The displacement u of the template's vertices, in the pose of the head, minimises

    sum_v A_v w_v (n_v . (x_v + u_v - q_v))^2  +  m sum_k |x_k + u_k - p_k|^2
        +  l^4 u' (L' S M^-1 L - k L) u

with x_v the vertex at rest, q_v the point of the scan nearest to it and n_v its normal (Chen and
Medioni, "Object modelling by registration of multiple range images", 1992), w_v a weight that is
small for distant points, A_v the area round the vertex, p_k the markers, and the bending and
stretching of a thin shell (`lipsync.twin.head_surface`): L the cotangent Laplacian, M the areas, S
the stiffness. Closest points are searched anew in rounds, and the length l, below which the shell
hardly bends, is shortened from coarse to fine, as by Amberg, Romdhani and Vetter ("Optimal step
nonrigid ICP algorithms for surface registration", CVPR 2007). Distances along the surface do not
count: there the shell alone holds the vertices, so that they neither slide as with nearest points,
nor are held back.

`Registration` does so for scans of one person, one after the other, onto one mesh.
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

#: k, per square mm: a tenth of the twin's, which would hold back motion along the surface.
_MEMBRANE_PER_MM2 = 0.005
#: S in the upper face, against 1 below: speech hardly bends it, and otherwise it would slide.
_UPPER_STIFFNESS = 30.0
#: Surfaces match if their normals are this similar; and if the nearest point is not at the scan's
#: edge or a hole: at most so many point spacings aside.
_LEAST_COSINE = 0.5
_WITHIN_SPACINGS = 4.0
#: m: a marker weighs as much as so many square mm of surface.
_MARKER_MM2 = 20.0
#: Weight that keeps vertices in place which nothing else holds.
_DAMPING = 1e-4
#: Steps of conjugate gradients for each set of closest points.
_STEPS = 16
#: Distances beyond this many medians, and this many mm, have small weights.
_FAR, _LEAST_FAR_MM = 3.0, 0.6


@dataclass(frozen=True, slots=True)
class Level:
    """One step from coarse to fine.

    length_mm: l of the energy. n_rounds: searches of closest points. reach_mm: their largest
    distance.
    """

    length_mm: float
    n_rounds: int
    reach_mm: float


#: For a face of known shape, and for that of a new person.
LEVELS = (Level(10.0, 3, 15.0), Level(5.0, 3, 6.0), Level(3.0, 3, 3.0))
STRANGER_LEVELS = (Level(30.0, 6, 25.0), Level(12.0, 6, 15.0), *LEVELS)


@dataclass(frozen=True, slots=True)
class Markers:
    """Vertices (k,) of the template, and their places in the scan, (k, 3) mm."""

    vertices: Indices
    seen_mm: Array


@dataclass(frozen=True, slots=True)
class Fit:
    """A template that was fitted to a scan.

    displacement_mm: (n, 3), in the pose of the head. pose: of the head in the scan. matched: (n,),
    whether a vertex has its surface in the scan; off_mm: (n,), distance of the scan's surface from
    it along the normal, meaningless without a match.
    """

    displacement_mm: Array
    pose: Pose
    matched: np.ndarray
    off_mm: Array


class SurfaceFit:
    """Fits one template to scans; what all scans share of the equations is factorised once."""

    def __init__(self, template: Template, levels: Sequence[Level] = LEVELS) -> None:
        """Factorise the equations of the template for each level."""
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
        """Factorise the shell with all vertices held in all directions, as a preconditioner."""
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
        """Fit the template to a scan, from a pose that is nearly right.

        Parameters
        ----------
        scan : Scan
            The scan.
        pose : Pose
            Of the face in the scan.
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
        shift_mm = np.zeros_like(rest) if start_mm is None else start_mm
        tree = cKDTree(scan.points_mm)
        still = self._template.still
        with threadpool_limits(limits=1):
            for level, factors in zip(self._levels, self._factors, strict=True):
                for _ in range(level.n_rounds):
                    match = self._match(shift_mm, pose, scan, tree, level.reach_mm)
                    shift_mm = self._solve(shift_mm, match, level.length_mm, factors, pose, markers)
                    # Motion of the upper face is motion of the head: it goes from the displacement
                    # to the pose.
                    turn = rigid_motion((rest + shift_mm)[still], rest[still])
                    shift_mm = (rest + shift_mm) @ turn[0].T + turn[1] - rest
                    pose = pose.after(*turn)
        match = self._match(shift_mm, pose, scan, tree, self._levels[-1].reach_mm)
        off_mm = ((match.nearest - rest - shift_mm) * match.normals).sum(axis=1)
        return Fit(shift_mm, pose, match.found, off_mm)

    def _match(
        self, moved: Array, pose: Pose, scan: Scan, tree: cKDTree, reach_mm: float
    ) -> "_Match":
        """Return each vertex's nearest point of the scan, its normal, and whether they match.

        moved: (n, 3) mm, displacement of the template so far. A match lies within `reach_mm`, faces
        the same way, and is not beyond the edge of a hole or of the scan.
        """
        places_mm = self._template.vertices_mm + moved
        in_scan = pose.in_scan(places_mm)
        distances, nearest = tree.query(in_scan, distance_upper_bound=reach_mm)
        is_match = np.isfinite(distances)
        nearest = np.where(is_match, nearest, 0)
        normals = scan.normals[nearest]
        aside_mm = in_scan - scan.points_mm[nearest]
        aside_mm = aside_mm - (aside_mm * normals).sum(axis=1, keepdims=True) * normals
        normals = normals @ pose.rotation
        cosine = (vertex_normals(places_mm, self._template.triangles) * normals).sum(axis=1)
        is_match &= cosine > _LEAST_COSINE
        is_match &= np.linalg.norm(aside_mm, axis=1) < _WITHIN_SPACINGS * scan.spacing_mm
        return _Match(pose.on_face(scan.points_mm[nearest]), normals, is_match)

    def _solve(
        self,
        moved: Array,
        match: "_Match",
        length_mm: float,
        factors: Any,
        pose: Pose,
        markers: Markers | None,
    ) -> Array:
        """Return the displacement (n, 3), mm, that minimises the energy of the module's docstring.

        Solved by conjugate gradients from `moved` on, `_STEPS` at most. Matches that are much
        farther off than the median weigh less. length_mm: l. factors: preconditioner of
        `_factorised`.
        """
        rest, n = self._template.vertices_mm, len(moved)
        normals = match.normals
        off_mm = ((match.nearest - rest - moved) * normals).sum(axis=1)
        median_mm = float(np.median(np.abs(off_mm[match.found]))) if match.found.any() else 0.0
        far_mm = max(_FAR * median_mm, _LEAST_FAR_MM)
        weights = self._areas * match.found / (1.0 + (off_mm / far_mm) ** 2)
        rhs = (weights * ((match.nearest - rest) * normals).sum(axis=1))[:, None] * normals
        holding = np.full(n, _DAMPING) * self._areas
        if markers is not None:
            holding[markers.vertices] += _MARKER_MM2
            target_mm = pose.on_face(markers.seen_mm) - rest[markers.vertices]
            rhs[markers.vertices] += _MARKER_MM2 * target_mm
        shell = length_mm**4 * self._shell

        def apply(flat: Array) -> Array:
            u = flat.reshape(n, 3)
            along = weights * (u * normals).sum(axis=1)
            return np.asarray(shell @ u + along[:, None] * normals + holding[:, None] * u).ravel()

        def precondition(flat: Array) -> Array:
            return np.asarray(factors.solve(flat.reshape(n, 3))).ravel()

        size = (3 * n, 3 * n)
        solved, _ = cg(
            LinearOperator(size, matvec=apply),
            rhs.ravel(),
            x0=moved.ravel(),
            maxiter=_STEPS,
            M=LinearOperator(size, matvec=precondition),
        )
        return np.asarray(solved.reshape(n, 3), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class _Match:
    """For each vertex the nearest point of the scan and its normal, on the face; found: (n,)."""

    nearest: Array
    normals: Array
    found: np.ndarray


#: A face farther from the scan was not found: no mouth moves so far.
_LOST_MM = 8.0
#: Scans with a smaller share matched, or a larger median error, are left out.
_LEAST_MATCHED, _MOST_ERROR_MM = 0.5, 1.0
#: A head that seems smaller or larger than this was not found.
_SCALES = (0.7, 1.4)


@dataclass(frozen=True, slots=True)
class RegisteredScan:
    """A scan as points of the mesh.

    points_mm: (n_vertices, 3), head motion removed. fit: pose, matches and distances.
    """

    points_mm: Array
    fit: Fit

    @property
    def in_scan_mm(self) -> Array:
        """The same points in the scan, with head motion.

        Returns
        -------
        Array
            (n_vertices, 3) mm.
        """
        return self.fit.pose.in_scan(self.points_mm)

    @property
    def matched(self) -> float:
        """The share of the mesh that found a matching surface."""
        return float(self.fit.matched.mean())

    @property
    def errors_mm(self) -> Array:
        """Distances from mesh to scan along the normal, of vertices that match.

        Returns
        -------
        Array
            (n_matched,) mm.
        """
        return np.asarray(np.abs(self.fit.off_mm[self.fit.matched]), dtype=np.float64)


def worn_template(template: Template, neutral: Scan, markers: Markers | None = None) -> Template:
    """Return the template in the shape and size of a person.

    neutral: a scan of the person at rest. Raises ScanError for a scan that the template does not
    fit.
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
    """Raise ScanError if too little of the mesh is in the scan, or it is too far off."""
    if scan.matched < _LEAST_MATCHED:
        raise ScanError(f"only {scan.matched:.0%} of the face is in the scan")
    error_mm = float(np.median(scan.errors_mm))
    if error_mm > _MOST_ERROR_MM:
        raise ScanError(f"the face fitted is {error_mm:.1f} mm off the scan")


class Registration:
    """Registers scans one after the other, each from the displacement of the one before."""

    def __init__(self, template: Template) -> None:
        """Prepare to register scans.

        template: in the shape of the person, see `worn_template`.
        """
        self._template = template
        self._fit = SurfaceFit(template)
        self.begin()

    def begin(self) -> None:
        """Begin a new take: its first scan is fitted from the face at rest."""
        self._moved: Array | None = None

    def register(self, scan: Scan, markers: Markers | None = None) -> RegisteredScan:
        """Return a scan registered to the mesh.

        Raises ScanError if no face is found in it, or too little of one.
        """
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
