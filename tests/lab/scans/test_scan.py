"""Reading a scan: meshes and points alone, whichever way their triangles wind; damage."""

import numpy as np
import pytest
import trimesh
from lipservo_lab.scans.scan import (
    ScanError,
    ScanFrame,
    read_scan,
    scan_frame,
    scan_of,
    vertex_normals,
)


def dome(n=60, radius_mm=80.0):
    """The front of a sphere, z towards the viewer: points and triangles."""
    x, y = (each.ravel() for each in np.meshgrid(*[np.linspace(-50.0, 50.0, n)] * 2))
    points = np.stack([x, y, np.sqrt(radius_mm**2 - x**2 - y**2)], axis=1)
    at = np.arange(n * n).reshape(n, n)[:-1, :-1].ravel()
    triangles = np.vstack(
        [np.stack([at, at + 1, at + n], axis=1), np.stack([at + 1, at + n + 1, at + n], axis=1)]
    )
    return points, triangles


@pytest.mark.parametrize("ending", ["ply", "obj"])
def test_a_mesh_is_read_with_normals_out_of_the_face(tmp_path, ending):
    points, triangles = dome()
    trimesh.Trimesh(points, triangles[:, ::-1], process=False).export(tmp_path / f"s.{ending}")

    scan = read_scan(tmp_path / f"s.{ending}", ScanFrame())

    outwards = scan.points_mm / np.linalg.norm(scan.points_mm, axis=1, keepdims=True)
    assert ((scan.normals * outwards).sum(axis=1) > 0.97).all()
    assert scan.spacing_mm == pytest.approx(100.0 / 59, rel=0.3)


def test_points_without_triangles_get_their_normals_from_their_neighbours(tmp_path):
    points, _ = dome()
    trimesh.PointCloud(points).export(tmp_path / "s.ply")

    scan = read_scan(tmp_path / "s.ply", ScanFrame())

    outwards = points / 80.0
    assert len(scan.points_mm) == len(points)
    assert np.median((scan.normals * outwards).sum(axis=1)) > 0.999


def test_units_and_axes_become_those_of_a_face(tmp_path):
    points, triangles = dome()
    lying = np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=1) / 1000.0
    trimesh.Trimesh(lying, triangles, process=False).export(tmp_path / "s.ply")

    scan = read_scan(tmp_path / "s.ply", scan_frame("m", "x,z,-y"))

    assert np.sort(scan.points_mm, axis=0) == pytest.approx(np.sort(points, axis=0), abs=1e-2)


def test_a_coarse_mesh_gets_points_on_its_triangles():
    points, triangles = dome(n=24)

    scan = scan_of(points, triangles)

    assert len(scan.points_mm) > 4 * len(points) - 200
    assert np.linalg.norm(scan.points_mm, axis=1).max() <= 80.0 + 1e-9


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"", "empty file"),
        (b"ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nend_header\n1\n", "damaged"),
        (b"\x00\x01 not a mesh at all", "damaged"),
    ],
)
def test_a_damaged_file_is_one_line(tmp_path, content, told):
    path = tmp_path / "s.ply"
    path.write_bytes(content)

    with pytest.raises(ScanError, match=told) as raised:
        read_scan(path, ScanFrame())

    assert str(path) in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_cut_file_and_a_few_points_are_refused(tmp_path):
    points, triangles = dome()
    whole = trimesh.Trimesh(points, triangles, process=False).export(file_type="ply")
    (tmp_path / "cut.ply").write_bytes(whole[: len(whole) // 2])
    trimesh.PointCloud(points[:99]).export(tmp_path / "few.ply")

    with pytest.raises(ScanError, match="cut"):
        read_scan(tmp_path / "cut.ply", ScanFrame())
    with pytest.raises(ScanError, match="99 points"):
        read_scan(tmp_path / "few.ply", ScanFrame())


def test_normals_are_those_of_trimesh():
    points, triangles = dome()

    normals = vertex_normals(points, triangles)

    theirs = trimesh.Trimesh(points, triangles, process=False)
    assert ((normals * theirs.vertex_normals).sum(axis=1) > 0.999).all()
