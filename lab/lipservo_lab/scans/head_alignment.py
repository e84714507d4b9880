"""Find the head in a scan: rigid alignment by iterated closest points (trimesh).

Edge, Hilton and Jackson remove drift of the head in this way. trimesh implements the form of Besl
and McKay ("A method for registration of 3-D shapes", IEEE PAMI 14(2), 1992), point to point; the
remaining motion is removed by the upper face while the surface is fitted.

`Template`: the mesh that scans are registered to: the shipped face, or one in the shape of a
person.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import permutations, product
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from lipservo_lab.scans.scan import Scan, ScanError, axes_text
from lipsync.arrays import Array, Indices
from lipsync.markers import INNER_LIP, INNER_LIP_GROUP, OUTER_LIP, OUTER_LIP_GROUP, PointLayout
from lipsync.twin.head_surface import N_SKIN, MeanFace, load_mean_face

#: Vertices above this height move little in speech; they define the pose of the head.
_UPPER_FACE_MM = -20.0
#: The first 468 vertices are those of the 478-point mesh, with its numbers; this is added to the
#: numbers of the others, so that they are no landmark's.
_OTHERS_FROM = 1000
#: How far the mesh reaches behind the rim of the face, in rings.
_RIM = 0.5
#: Distance from a lip point within which a vertex counts as `lips`: about a lip's height.
_LIPS_MM = 6.0


@dataclass(frozen=True, slots=True)
class Template:
    """The mesh that scans are registered to, at rest.

    vertices_mm: (n, 3); triangles: (m, 3), outward; landmarks: (n,), a number for each vertex.
    still, lips: (n,), whether a vertex is in the upper face, and on or near the lips.
    """

    vertices_mm: Array
    triangles: Indices
    landmarks: Indices
    still: np.ndarray
    lips: np.ndarray

    @property
    def layout(self) -> PointLayout:
        """The layout of all vertices, with the lips in their groups."""
        known = {*OUTER_LIP, *INNER_LIP}
        skin = tuple(int(n) for n in self.landmarks if int(n) not in known)
        groups = ((OUTER_LIP_GROUP, OUTER_LIP), (INNER_LIP_GROUP, INNER_LIP), ("skin", skin))
        return PointLayout(f"scans-{len(self.landmarks)}", groups, (13, 14))

    def rows_of(self, landmarks: tuple[int, ...]) -> Indices:
        """Return the vertices with these landmark numbers; KeyError for one that no vertex has."""
        row_of = {int(number): row for row, number in enumerate(self.landmarks)}
        return np.array([row_of[number] for number in landmarks], dtype=np.int64)


def shipped_template(mean: MeanFace | None = None) -> Template:
    """Return the face of the digital twin up to its rim as a template: 7,134 vertices.

    mean: the mean face; None: the shipped one.
    """
    mean = mean or load_mean_face()
    is_inside = mean.behind <= _RIM
    chosen = np.flatnonzero(is_inside)
    new_index = np.full(len(is_inside), -1)
    new_index[chosen] = np.arange(len(chosen))
    triangles = new_index[mean.triangles]
    triangles = triangles[(triangles >= 0).all(axis=1)]
    vertices_mm = mean.vertices_mm[chosen]
    landmarks = np.where(chosen < N_SKIN, chosen, chosen + _OTHERS_FROM)
    lip_points = vertices_mm[np.isin(landmarks, [*OUTER_LIP, *INNER_LIP])]
    lip_distance_mm = np.linalg.norm(vertices_mm[:, None] - lip_points[None], axis=2).min(axis=1)
    return Template(
        vertices_mm,
        np.asarray(triangles, dtype=np.int64),
        landmarks.astype(np.int64),
        vertices_mm[:, 1] > _UPPER_FACE_MM,
        lip_distance_mm < _LIPS_MM,
    )


_ROUNDS, _FIRST_ROUNDS = 30, 12
#: Points of the face that are aligned with the scan: in the final alignment, and in trials of axes.
_SAMPLE, _FIRST_SAMPLE = 1200, 350
#: A scan may lack parts of the face: only this share of the points, the nearest, counts.
_BELIEVED_SHARE = 0.7
#: Largest rms of the distances that count, mm; faces of other people are within about 3.
_FARTHEST_MM = 5.0
#: With a smaller rms it is a face the right way up; else all axes are tried.
_CERTAIN_MM = 1.5
#: Other axes are suggested if their misfit is at most this share: a face is nearly its own mirror
#: image.
_CLEARLY_BETTER = 0.75
_MOST_TARGETS, _FIRST_TARGETS = 40_000, 3_000
#: Alignments with another scale did not find the head.
_SCALES = (0.6, 1.6)


@dataclass(frozen=True, slots=True)
class Pose:
    """The pose of a face in a scan: face point p is at `scale * rotation @ p + shift_mm`.

    rotation: (3, 3); shift_mm: (3,). scale is 1 except for a new person.
    """

    rotation: Array
    shift_mm: Array
    scale: float = 1.0

    def in_scan(self, face_mm: Array) -> Array:
        """Return where points of the face are in the scan.

        Parameters
        ----------
        face_mm : Array
            (n, 3) on the face.

        Returns
        -------
        Array
            (n, 3) mm in the scan.
        """
        return np.asarray(self.scale * face_mm @ self.rotation.T + self.shift_mm)

    def on_face(self, scan_mm: Array) -> Array:
        """Return where points of the scan are on the face.

        Parameters
        ----------
        scan_mm : Array
            (n, 3), points in the coordinates of the scan.

        Returns
        -------
        Array
            (n, 3) mm.
        """
        return np.asarray((scan_mm - self.shift_mm) @ self.rotation / self.scale)

    def after(self, rotation: Array, shift_mm: Array) -> "Pose":
        """Return the pose of the face after it was moved by p -> rotation @ p + shift_mm.

        With the new pose, points of the moved face are at the same places in the scan as before.

        Parameters
        ----------
        rotation : Array
            (3, 3).
        shift_mm : Array
            (3,).

        Returns
        -------
        Pose
            The new pose.
        """
        turned = self.rotation @ rotation.T
        return Pose(turned, self.shift_mm - self.scale * turned @ shift_mm, self.scale)


def rigid_motion(points: Array, onto: Array) -> tuple[Array, Array]:
    """Return the rotation and shift that bring points nearest to others, by least squares.

    By Umeyama's method, without scale.

    Parameters
    ----------
    points, onto : Array
        (n, 3).

    Returns
    -------
    tuple[Array, Array]
        Rotation (3, 3) and shift (3,): onto ~ rotation @ p + shift.
    """
    centre, target = points.mean(axis=0), onto.mean(axis=0)
    u, _, vt = np.linalg.svd((onto - target).T @ (points - centre))
    u[:, 2] *= np.sign(np.linalg.det(u @ vt))
    rotation = u @ vt
    return rotation, target - rotation @ centre


def find_pose(
    face_mm: Array, scan: Scan, start: Pose | None = None, *, scaled: bool = False
) -> Pose:
    """Return the pose of a face in a scan, by ICP.

    Parameters
    ----------
    face_mm : Array
        (n, 3), points of the face.
    scan : Scan
        The scan.
    start : Pose | None
        First guess; None: the middles of both coincide.
    scaled : bool
        Whether the size is fitted too, for another person's face.

    Returns
    -------
    Pose
        The pose.
    """
    targets = scan.points_mm[:: max(1, len(scan.points_mm) // _MOST_TARGETS)]
    start = start or Pose(np.eye(3), _middle(targets) - _middle(face_mm))
    return _icp(_sample(face_mm, _SAMPLE), targets, start, _ROUNDS, scaled=scaled)


def misfit_mm(face_mm: Array, scan: Scan, pose: Pose) -> float:
    """Return the rms distance of the nearer 70 % of the face's points from the scan.

    Parameters
    ----------
    face_mm : Array
        (n, 3), points of the face.
    scan : Scan
        The scan.
    pose : Pose
        Of the face in the scan.

    Returns
    -------
    float
        mm.
    """
    distances, _ = cKDTree(scan.points_mm).query(pose.in_scan(_sample(face_mm, _SAMPLE)))
    nearest = np.sort(distances)[: round(_BELIEVED_SHARE * len(distances))]
    return float(np.sqrt((nearest**2).mean()))


def check_face(face_mm: Array, scan: Scan, axes: Array, name: str) -> None:
    """Refuse a scan that is not of a face, upside down, mirrored, or along other axes.

    Parameters
    ----------
    face_mm : Array
        (n, 3), a face for comparison.
    scan : Scan
        The scan.
    axes : Array
        (3, 3), the axes by which the scan was read; the advice is relative to them.
    name : str
        Name of the scan, for the error.

    Raises
    ------
    ScanError
        With the option to give.
    """
    # Usual axes: as given, mirrored, upside down, both. The other 44 are only tried without a good
    # fit.
    usual = [np.diag(signs) for signs in ((1.0, 1, 1), (-1.0, 1, 1), (-1.0, -1, 1), (1.0, -1, 1))]
    misfit_of = _misfits(face_mm, scan, usual)
    if misfit_of.get(tuple(np.eye(3).ravel().tolist()), np.inf) > _CERTAIN_MM:
        misfit_of |= _misfits(face_mm, scan, _all_turns())
    as_given = misfit_of.get(tuple(np.eye(3).ravel().tolist()), np.inf)
    best = np.array(
        min(misfit_of, key=misfit_of.__getitem__, default=tuple(np.eye(3).ravel().tolist()))
    ).reshape(3, 3)
    least_mm = min(misfit_of.values(), default=np.inf)
    if least_mm > _FARTHEST_MM:
        raise ScanError(
            f"{name}: no face, or much beside it: {least_mm:.1f} mm off the mean face at best; cut "
            "the scan to the face"
        )
    if as_given > _FARTHEST_MM or least_mm < _CLEARLY_BETTER * as_given:
        raise ScanError(
            f"{name}: {_fault(best)}: {as_given:.1f} mm off, {least_mm:.1f} mm along other axes; "
            f"give --axes={axes_text(best @ axes)}"
        )


def _all_turns() -> list[Array]:
    """Return all 48 ways to name and sign three axes, (3, 3) each."""
    return [
        np.eye(3)[list(order)] * np.array(signs)[:, None]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]


def _misfits(face_mm: Array, scan: Scan, turns: Sequence[Array]) -> dict[tuple[float, ...], float]:
    """Return how far a face is off a scan that is turned, mm, by turn.

    turns: (3, 3) each. Turns for which the fitted size is implausible are left out.
    """
    fits: dict[tuple[float, ...], float] = {}
    sample = _sample(face_mm, _FIRST_SAMPLE)
    few_points = scan.points_mm[:: max(1, len(scan.points_mm) // _FIRST_TARGETS)]
    for turn in turns:
        turned = Scan(few_points @ turn.T, scan.normals, 0.0)
        start = Pose(np.eye(3), _middle(turned.points_mm) - _middle(sample))
        pose = _icp(sample, turned.points_mm, start, _FIRST_ROUNDS, scaled=True)
        if _SCALES[0] < pose.scale < _SCALES[1]:
            fits[tuple(turn.ravel().tolist())] = misfit_mm(sample, turned, pose) / pose.scale
    return fits


def _fault(turn: Array) -> str:
    """Return in words what is wrong with a scan that fits after this turn (3, 3)."""
    if np.array_equal(turn, np.diag([-1.0, 1.0, 1.0])):
        return "mirrored"
    if np.array_equal(turn, np.diag([-1.0, -1.0, 1.0])):
        return "upside down"
    return "along other axes" + (", and mirrored" if np.linalg.det(turn) < 0 else "")


def _icp(sample: Array, targets: Array, start: Pose, n_rounds: int, *, scaled: bool) -> Pose:
    """Return the pose that aligns points of a face (n, 3) with those of a scan (m, 3), by ICP.

    start: first guess. scaled: whether the size is fitted too; else it stays 1.
    """
    from trimesh.registration import icp

    align: Callable[..., tuple[Array, Array, float]] = icp
    first: Any = np.eye(4)
    first[:3, :3], first[:3, 3] = start.scale * start.rotation, start.shift_mm
    matrix, _, _ = align(
        sample, targets, initial=first, threshold=1e-5, max_iterations=n_rounds,
        scale=scaled, reflection=False,
    )  # fmt: skip
    scale = float(np.cbrt(np.linalg.det(matrix[:3, :3])))
    return Pose(matrix[:3, :3] / scale, matrix[:3, 3].copy(), scale)


def _sample(points: Array, n: int) -> Array:
    """Return about n points, evenly by their order."""
    return points[:: max(1, len(points) // n)]


def _middle(points: Array) -> Array:
    """Return the middle of the box around all points but outliers, (3,).

    Not their mean, since scans are denser in some parts than in others.
    """
    low, high = np.percentile(points, (2, 98), axis=0)
    return np.asarray((low + high) / 2)
