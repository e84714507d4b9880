"""Where the head is, and what is no face, or not the way up that was said."""

import numpy as np
import pytest
import trimesh
from lipservo_lab.scans.head_alignment import (
    Pose,
    check_face,
    find_pose,
    rigid_motion,
    shipped_template,
)
from lipservo_lab.scans.scan import ScanError, scan_of
from scipy.spatial.transform import Rotation

TEMPLATE = shipped_template()
FACE = TEMPLATE.vertices_mm


def test_a_pose_leads_there_and_back_and_follows_a_face_that_was_moved():
    turn = Rotation.from_euler("xyz", (10, -20, 5), degrees=True).as_matrix()
    pose = Pose(turn, np.array([1.0, 2.0, 3.0]), 1.1)
    other = Rotation.from_euler("z", 4, degrees=True).as_matrix()
    shift = np.array([0.5, -1.0, 2.0])

    assert pose.on_face(pose.in_scan(FACE)) == pytest.approx(FACE)
    followed = pose.after(other, shift)
    assert followed.in_scan(FACE @ other.T + shift) == pytest.approx(pose.in_scan(FACE))


def test_a_rigid_motion_is_found_and_never_a_mirror_image():
    turn = Rotation.from_euler("xyz", (30, 40, 50), degrees=True).as_matrix()

    rotation, shift = rigid_motion(FACE, FACE @ turn.T + (1.0, 2.0, 3.0))
    mirrored, _ = rigid_motion(FACE, FACE * (-1.0, 1.0, 1.0))

    assert rotation == pytest.approx(turn)
    assert shift == pytest.approx((1.0, 2.0, 3.0))
    assert np.linalg.det(mirrored) == pytest.approx(1.0)


def test_a_turned_and_larger_head_is_found():
    turn = Rotation.from_euler("xyz", (8, -10, 5), degrees=True).as_matrix()
    scan = scan_of(1.1 * FACE @ turn.T + (40.0, -25.0, 300.0), TEMPLATE.triangles)

    pose = find_pose(FACE, scan, scaled=True)

    off_mm = np.linalg.norm(
        pose.in_scan(FACE) - (1.1 * FACE @ turn.T + (40.0, -25.0, 300.0)), axis=1
    )
    assert np.median(off_mm) < 2.5
    assert pose.scale == pytest.approx(1.1, abs=0.03)


@pytest.mark.parametrize(
    ("turn", "told"),
    [
        (np.diag([-1.0, 1.0, 1.0]), "mirrored.*--axes=-x,y,z"),
        (np.diag([-1.0, -1.0, 1.0]), "upside down.*--axes=-x,-y,z"),
        (np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]), "other axes.*--axes=x,z,-y"),
    ],
)
def test_other_axes_are_told_with_the_option_to_give(turn, told):
    noisy = FACE + np.random.default_rng(0).normal(0.0, 0.2, FACE.shape)
    scan = scan_of(noisy @ turn.T, TEMPLATE.triangles)

    with pytest.raises(ScanError, match=told):
        check_face(FACE, scan, np.eye(3), "s.ply")


def test_a_face_passes_and_a_box_does_not():
    box = trimesh.creation.box((150.0, 200.0, 90.0))

    check_face(FACE, scan_of(FACE * (1.05, 0.97, 1.02), TEMPLATE.triangles), np.eye(3), "s.ply")
    with pytest.raises(ScanError, match="no face, or much beside it"):
        check_face(FACE, scan_of(box.vertices, box.faces), np.eye(3), "s.ply")
