"""Around the networks of a landmarker file: where they look, and what they say."""

import json
import os
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from lipservo_lab.video.face_track import tracked_gaps_mm
from places import ROOT
from scipy.ndimage import map_coordinates

from lipsync.video.face_detection import FaceBox, box_around, cut_out, detections
from lipsync.video.face_tracker import TrackerError, open_tracker
from lipsync.video.video_file import video_pictures

GRID_VIDEO = ROOT.parent / "shared" / "corpus" / "grid_video" / "s1"
GRID = ROOT.parent / "shared" / "corpus" / "grid_s1"


@pytest.mark.parametrize("turn_rad", [0.0, 0.3, -2.0])
def test_a_cut_out_is_what_scipy_interpolates(turn_rad):
    picture = np.random.default_rng(0).integers(0, 256, (60, 80, 3)).astype(np.uint8)
    box = FaceBox(40.0, 30.0, 34.0, turn_rad)
    seen = cut_out(picture, box, 16)
    steps = (np.arange(16) + 0.5) / 16
    across, down = np.meshgrid(steps, steps)
    inside = np.column_stack((across.ravel(), down.ravel(), np.zeros(256)))
    x, y = box.to_picture(inside)[:, :2].T - 0.5
    for colour in range(3):
        theirs = map_coordinates(
            picture[..., colour].astype(float), (y, x), order=1, mode="nearest"
        )
        np.testing.assert_allclose(seen[..., colour].ravel() * 255, theirs, atol=0.02)


def test_beyond_the_edge_the_last_pixels_go_on():
    picture = np.zeros((10, 10, 3), np.uint8)
    picture[:, -1] = 200
    seen = cut_out(picture, FaceBox(20.0, 5.0, 4.0, 0.0), 4)
    np.testing.assert_allclose(seen, 200 / 255, atol=1e-5)


def test_a_box_stands_upright_on_the_eyes():
    points = np.array([[10.0, 20.0], [50.0, 100.0]])
    box = box_around(points, np.array([10.0, 10.0]), np.array([20.0, 20.0]))
    assert box == FaceBox(30.0, 60.0, 120.0, pytest.approx(np.pi / 4))


def answers(*faces):
    """Return the detector's outputs for faces: (anchor, log odds, x, y, size in pixels) each."""
    regressors, scores = np.zeros((896, 16)), np.full(896, -20.0)
    for anchor, odds, x, y, size in faces:
        regressors[anchor, :4] = x, y, size, size
        regressors[anchor, 4:8] = -size / 4, 0, size / 4, 0
        scores[anchor] = odds
    return regressors, scores


def test_the_first_anchor_lies_in_the_middle_of_the_first_of_16_places():
    (face,) = detections(*answers((0, 3.0, 32.0, 16.0, 64.0)))
    middle = np.array([0.5 / 16 + 32 / 128, 0.5 / 16 + 16 / 128])
    np.testing.assert_allclose(face.box, [*(middle - 0.25), *(middle + 0.25)])
    assert face.score == pytest.approx(1 / (1 + np.exp(-3.0)))


def test_the_last_anchor_lies_in_the_middle_of_the_last_of_8_places():
    (face,) = detections(*answers((895, 3.0, 0.0, 0.0, 16.0)))
    np.testing.assert_allclose(face.eyes[:, 1], 7.5 / 8)


def test_overlapping_boxes_are_blended_by_score_and_others_stay_apart():
    # Anchors 0 and 1 share a place; anchor 511 is the last of the 16 x 16.
    found = detections(*answers((0, 0.1, 40, 40, 60), (1, 5.0, 44, 40, 60), (511, 2.0, 0, 0, 20)))
    assert len(found) == 2
    weights = 1 / (1 + np.exp(-np.array([0.1, 5.0])))
    x = 0.5 / 16 + weights @ [40, 44] / weights.sum() / 128
    assert found[0].box[[0, 2]].mean() == pytest.approx(x)


def test_a_doubtful_face_is_none():
    assert detections(*answers((5, -0.1, 0, 0, 30))) == ()


@pytest.mark.parametrize("content", [None, b"", b"no zip archive"])
def test_a_file_that_is_no_landmarker_is_refused(tmp_path, content):
    pytest.importorskip("ai_edge_litert", reason="needs the extra `video`")
    path = tmp_path / "face.task"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(TrackerError, match=r"face\.task: (no such file|not a face_landmarker)"):
        open_tracker(path)


def test_a_mediapipe_without_the_old_face_mesh_is_named_with_what_to_install(tmp_path, monkeypatch):
    (tmp_path / "mediapipe.py").write_text("")
    monkeypatch.delitem(sys.modules, "mediapipe", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(TrackerError, match=r"0\.10\.30 .*\(.*'solutions'\).*lipservo\[video\]"):
        open_tracker(None)


def trackers():
    """Return parameters for both trackers; one that is not installed is skipped.

    The file of networks may not be copied into this repository: LIPSERVO_LANDMARKER names it.
    """
    landmarker = os.environ.get("LIPSERVO_LANDMARKER")
    return [
        pytest.param(
            Path(landmarker) if landmarker else None,
            marks=pytest.mark.skipif(not landmarker, reason="LIPSERVO_LANDMARKER names no file"),
            id="litert",
        ),
        pytest.param(
            None,
            marks=pytest.mark.skipif(
                find_spec("mediapipe") is None, reason="mediapipe is not installed"
            ),
            id="mediapipe",
        ),
    ]


@pytest.mark.skipif(not GRID_VIDEO.is_dir(), reason="no corpus grid_video beside the checkout")
@pytest.mark.parametrize("landmarker", trackers())
def test_lips_are_where_another_tracker_saw_them(landmarker):
    tracker = open_tracker(landmarker)
    points = []
    for _, picture in video_pictures(GRID_VIDEO / "bbaf4p.mpg"):
        (face,) = tracker.faces(picture)
        points.append(face)
    ids = json.loads((GRID / "landmarks.json").read_text())["landmark_ids"]
    theirs = np.zeros((len(points), 478, 3))
    theirs[:, ids] = np.load(GRID / "landmarks" / "bbaf4p.npz")["landmarks_64th_px"] / 64
    ours_mm, theirs_mm = tracked_gaps_mm(np.array(points)), tracked_gaps_mm(theirs)
    assert np.corrcoef(ours_mm, theirs_mm)[0, 1] > 0.97
