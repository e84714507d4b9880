"""A mesh bent onto scans of a surface whose points are known."""

import numpy as np
import pytest
from lipservo_lab.scans.head_alignment import Pose, Template
from lipservo_lab.scans.scan import scan_of
from lipservo_lab.scans.surface_fit import Markers, SurfaceFit
from scipy.spatial import Delaunay

RNG = np.random.default_rng(5)


def relief(x, y):
    """A skin with a nose, a chin and wrinkles, 100 mm wide."""
    nose = 18.0 * np.exp(-(x**2 + (y - 15.0) ** 2) / 250.0)
    chin = 9.0 * np.exp(-(x**2 + (y + 30.0) ** 2) / 200.0)
    wrinkles = 1.5 * np.sin(x / 2.1 + y / 5.0) * np.cos(y / 2.3 - x / 7.0)
    return nose + chin + wrinkles - (x**2 + 0.5 * y**2) / 150.0


def moved(points):
    """Below the nose it goes down and forward, by 6 mm at most: along the surface, too."""
    share = np.exp(-((points[:, 1] + 30.0) ** 2 + 0.5 * points[:, 0] ** 2) / 500.0)
    return points + share[:, None] * (0.5, -6.0, 2.0)


def template():
    x, y = (
        each.ravel()
        for each in np.meshgrid(np.arange(-50.0, 51.0, 2.5), np.arange(-55.0, 56.0, 2.5))
    )
    vertices = np.stack([x, y, relief(x, y)], axis=1)
    return Template(
        vertices,
        Delaunay(vertices[:, :2]).simplices.astype(np.int64),
        np.arange(len(vertices)),
        y > 20.0,
        np.abs(y + 30.0) < 8.0,
    )


def scanned(noise_mm=0.1, n=9000):
    flat = RNG.uniform((-60.0, -65.0), (60.0, 65.0), (n, 2))
    points = moved(np.column_stack([flat, relief(*flat.T)]))
    triangles = Delaunay(points[:, :2]).simplices.astype(np.int64)
    return points + RNG.normal(0.0, noise_mm, points.shape), triangles


MESH = template()
FIT = SurfaceFit(MESH)
STILL = Pose(np.eye(3), np.zeros(3))


def test_points_come_where_the_same_points_of_the_skin_are():
    truth = moved(MESH.vertices_mm)
    asked = np.linalg.norm(truth - MESH.vertices_mm, axis=1) > 1.0

    fit = FIT.fit(scan_of(*scanned()), STILL)

    errors = np.linalg.norm(MESH.vertices_mm + fit.displacement_mm - truth, axis=1)
    before = np.linalg.norm(MESH.vertices_mm - truth, axis=1)
    assert np.median(before[asked]) > 2.0
    assert np.median(errors) < 0.3
    assert np.median(errors[asked]) < 0.4 * np.median(before[asked])
    assert np.median(np.abs(fit.off_mm[fit.matched])) < 0.1


def test_markers_hold_the_skin_where_closest_points_would_let_it_slide():
    truth = moved(MESH.vertices_mm)
    asked = np.linalg.norm(truth - MESH.vertices_mm, axis=1) > 1.0
    seen = np.flatnonzero(asked)[::12]
    scan = scan_of(*scanned())

    without, given = (
        np.linalg.norm(
            MESH.vertices_mm + FIT.fit(scan, STILL, None, m).displacement_mm - truth, axis=1
        )
        for m in (None, Markers(seen, truth[seen]))
    )

    assert np.median(given[asked]) < 0.7 * np.median(without[asked])
    assert np.median(given[asked]) < 0.3


def test_the_head_is_found_and_the_skin_comes_out_in_its_pose():
    points, triangles = scanned(noise_mm=0.0)
    c, s = np.cos(0.03), np.sin(0.03)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    shift = np.array([5.0, -3.0, 200.0])
    nearly = Pose(np.eye(3), shift)
    still = FIT.fit(scan_of(points, triangles), STILL)

    fit = FIT.fit(scan_of(points @ turn.T + shift, triangles), nearly)

    assert fit.pose.rotation == pytest.approx(turn, abs=5e-3)
    apart = np.linalg.norm(fit.displacement_mm - still.displacement_mm, axis=1)
    assert np.median(apart) < 0.2


def test_a_hole_is_bridged_and_told_as_unmatched():
    points, triangles = scanned()
    hole = np.linalg.norm(points[:, :2] - (20.0, -20.0), axis=1) < 9.0
    new = np.cumsum(~hole) - 1
    kept = triangles[~hole[triangles].any(axis=1)]
    middle = np.linalg.norm(moved(MESH.vertices_mm)[:, :2] - (20.0, -20.0), axis=1) < 2.5

    fit = FIT.fit(scan_of(points[~hole], new[kept]), STILL)

    assert not fit.matched[middle].any()
    assert fit.matched.mean() > 0.85
    assert np.isfinite(fit.displacement_mm).all()
    assert np.linalg.norm(fit.displacement_mm[middle], axis=1).max() < 6.0
