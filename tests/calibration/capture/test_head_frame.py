"""A head that moved between poses is taken out by its rigid markers, and only then."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_model import small_model

from calibration.capture.capture import Capture
from calibration.capture.straight_lines import in_head_frame, on_head, straight_lines
from lipsync.markers import MARKERS_47

N_POSES = 40
MODEL = small_model()
REST_MM = MODEL.markers_mm(MODEL.rest[None])[0]
NAMES = MARKERS_47.names
RIGID = [i for i, n in enumerate(NAMES) if n.startswith(("nose", "cheek_50", "cheek_280"))]


def still_capture(noise_mm: float = 0.0) -> Capture:
    """Two joints that move every marker but the rigid ones."""
    rng = np.random.default_rng(2)
    goals_deg = rng.uniform(-20, 20, (N_POSES, 2))
    by_deg = 0.1 * rng.normal(size=(2, len(NAMES), 3))
    by_deg[:, RIGID] = 0.0
    markers_mm = REST_MM + np.einsum("ns,smk->nmk", goals_deg, by_deg)
    markers_mm = markers_mm + rng.normal(0.0, noise_mm, markers_mm.shape)
    return Capture(("a", "b"), NAMES, goals_deg, np.ones((N_POSES, 2)), markers_mm)


def turned(capture: Capture, poses, by: Rotation, shift_mm) -> Capture:
    markers_mm = capture.markers_mm.copy()
    for pose in poses:
        markers_mm[pose] = by.apply(markers_mm[pose]) + shift_mm
    return replace(capture, markers_mm=markers_mm)


def laid(capture: Capture):
    return in_head_frame(capture, straight_lines(capture))


def test_a_known_rotation_and_shift_are_taken_out_to_the_last_digit():
    """A worked example: a third of the poses turned by 8 degrees and shifted by 7 mm."""
    still = still_capture()
    by = Rotation.from_euler("yxz", [8.0, -3.0, 2.0], degrees=True)
    moved = turned(still, range(1, N_POSES, 3), by, [3.0, -6.0, 2.0])
    assert np.abs(moved.markers_mm - still.markers_mm).max() > 5.0

    found, (warning,) = laid(moved)

    assert found.markers_mm == pytest.approx(still.markers_mm, abs=1e-6)
    assert "the head or the tracker moved by" in warning
    assert "fix the tripod" in warning


def test_it_says_by_how_much():
    """10 mm in a quarter of the poses are 4.3 mm rms about the mean place."""
    moved = turned(still_capture(), range(0, N_POSES, 4), Rotation.identity(), [0.0, 6.0, 8.0])
    _, (warning,) = laid(moved)
    assert float(warning.split("moved by ")[1].split(" mm")[0]) == pytest.approx(4.3, abs=0.4)


def test_a_camera_in_the_hand_leaves_little_more_than_the_noise():
    still, moved = still_capture(), still_capture(noise_mm=0.3)
    rng = np.random.default_rng(6)
    for pose in range(N_POSES):
        by = Rotation.from_rotvec(np.deg2rad(rng.normal(0.0, 2.0, 3)))
        moved = turned(moved, [pose], by, rng.normal(0.0, 4.0, 3))
    found, _ = laid(moved)
    # All poses lie in one frame, but it need not be that of the still one.
    usual_mm, true_mm = (c.markers_mm.mean(axis=0) for c in (found, still))
    back, _ = Rotation.align_vectors(true_mm - true_mm.mean(0), usual_mm - usual_mm.mean(0))
    again_mm = np.array([back.apply(p - usual_mm.mean(0)) for p in found.markers_mm])
    off_mm = again_mm - (still.markers_mm - true_mm.mean(0))
    assert np.sqrt(np.mean(off_mm**2)) < 0.6
    assert np.sqrt(np.mean((moved.markers_mm - still.markers_mm) ** 2)) > 4.0


def test_a_mirror_image_is_never_made():
    """Three rigid points lie in a plane; only a rotation may bring them back."""
    names = ("nose_2", "nose_98", "nose_327", "chin_199", "outer_lip_0")
    rows = [NAMES.index(name) for name in names]
    still = still_capture()
    still = replace(still, marker_names=names, markers_mm=still.markers_mm[:, rows])
    by = Rotation.from_euler("y", 20.0, degrees=True)
    found, _ = laid(turned(still, range(0, N_POSES, 5), by, [0.0, 9.0, 0.0]))
    assert found.markers_mm == pytest.approx(still.markers_mm, abs=1e-5)


@pytest.mark.parametrize("noise_mm", [0.0, 0.5, 1.0])
def test_a_head_that_keeps_still_is_left_alone(noise_mm):
    capture = still_capture(noise_mm)
    found, warnings = laid(capture)
    assert found is capture
    assert warnings == ()


def test_without_a_nose_nothing_can_be_done():
    rows = [i for i, name in enumerate(NAMES) if not name.startswith("nose")]
    moved = turned(still_capture(), range(0, N_POSES, 3), Rotation.identity(), [0.0, 9.0, 0.0])
    moved = replace(
        moved, marker_names=tuple(NAMES[i] for i in rows), markers_mm=moved.markers_mm[:, rows]
    )
    assert laid(moved) == (moved, ())


def test_a_pose_with_two_rigid_markers_stays_where_it_was_seen():
    moved = turned(still_capture(), range(0, N_POSES, 4), Rotation.identity(), [0.0, 9.0, 0.0])
    moved.markers_mm[8, RIGID[2:]] = np.nan
    found, _ = laid(moved)
    assert np.array_equal(found.markers_mm[8], moved.markers_mm[8], equal_nan=True)
    assert found.markers_mm[12] == pytest.approx(still_capture().markers_mm[12], abs=1e-6)


def test_three_dots_on_a_nose_shift_the_face_and_do_not_turn_it():
    """Noisy as they are, they would turn lips that lie far below them."""
    names = ("nose_98", "nose_2", "nose_327", "inner_lip_13")
    usual_mm = np.repeat(REST_MM[None, [NAMES.index(name) for name in names]], 10, axis=0)
    noise_mm = np.random.default_rng(3).normal(0.0, 0.5, usual_mm.shape)
    laid, needed = on_head(usual_mm + noise_mm + [40.0, -12.0, 5.0], usual_mm, names)
    assert needed
    lip_mm = (laid - usual_mm)[:, 3].mean(axis=0)
    assert np.linalg.norm(lip_mm) < 0.5
    still, needed = on_head(usual_mm + noise_mm, usual_mm, names)
    assert not needed
    assert np.array_equal(still, usual_mm + noise_mm)


def test_a_head_that_turns_between_poses_is_laid_pose_by_pose():
    names = ("nose_98", "nose_2", "nose_327", "cheek_50", "cheek_280", "inner_lip_13")
    usual_mm = np.repeat(REST_MM[None, [NAMES.index(name) for name in names]], 6, axis=0)
    seen_mm = usual_mm.copy()
    for pose, angle in enumerate(np.deg2rad([-8, 5, 0, 3, 9, -4])):
        turn = [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
        seen_mm[pose] = usual_mm[pose] @ np.array(turn).T + [pose, -3.0, 20.0]
    laid, needed = on_head(seen_mm, usual_mm, names)
    assert needed
    assert laid == pytest.approx(usual_mm, abs=1e-6)
