"""Scans of one person, one after the other, onto one mesh."""

from dataclasses import dataclass, replace

import numpy as np

from lipservo_lab.scans.head_alignment import find_pose, misfit_mm
from lipservo_lab.scans.scan import Scan, ScanError
from lipservo_lab.scans.surface_fit import STRANGER_LEVELS, Fit, Markers, SurfaceFit
from lipservo_lab.scans.template import Template
from lipsync.arrays import Array

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
        """(n_vertices, 3): where the same points are in the scan, head motion and all."""
        return self.fit.pose.in_scan(self.points_mm)

    @property
    def matched(self) -> float:
        """Share of the mesh that found its surface."""
        return float(self.fit.matched.mean())

    @property
    def errors_mm(self) -> Array:
        """(n_matched,), distances along the normal."""
        return np.asarray(np.abs(self.fit.off_mm[self.fit.matched]), dtype=np.float64)


def worn_template(template: Template, neutral: Scan, markers: Markers | None = None) -> Template:
    """The template in the shape and size of the person of a neutral scan; names stay.

    Raises ScanError for a scan that the template does not fit.
    """
    pose = find_pose(template.vertices_mm, neutral, scaled=True)
    if not _SCALES[0] < pose.scale < _SCALES[1]:
        raise ScanError(f"the neutral scan: a face of {pose.scale:.2f} times the usual size")
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
        raise ScanError(f"the mesh is {error_mm:.1f} mm off the scan")


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
            raise ScanError(f"no face found: {lost_mm:.1f} mm off")
        fit = self._fit.fit(scan, pose, moved, markers)
        registered = RegisteredScan(rest + fit.displacement_mm, fit)
        check_registered(registered)
        self._moved = fit.displacement_mm
        return registered
