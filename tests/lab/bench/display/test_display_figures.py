"""What `bench display` measures, on a face and a film whose truth is known."""

import numpy as np
import pytest

pytest.importorskip("av", reason="films need PyAV, the extra `film`")
pytest.importorskip("cv2", reason="films need OpenCV, the extra `film`")

from lipservo_lab.bench.display.film_figures import cut_track, film_sync_ms
from lipservo_lab.bench.display.warp_figures import warp_figures

from lipservo.display.shipped_faces import TWIN_SIZE, twin_landmarks
from lipsync.face.model import load_face


def quiet(*_):
    """No progress."""


def test_a_warp_by_the_model_has_no_fold_and_its_markers_lie_where_the_model_has_them():
    face = load_face()
    mouths = np.random.default_rng(1).multivariate_normal(face.rest * 0.3, face.covariance, 4)
    faces = {"twin": (TWIN_SIZE, twin_landmarks())}
    found = warp_figures(face, faces, {"a": mouths[:2], "b": mouths[2:]}, quiet)
    assert found["folds"] == 0
    assert 0.0 < found["marker_error_px"] < 2.5
    assert found["faces"][0]["frames"] == 4


def test_sound_that_lies_beside_its_pictures_would_be_seen(monkeypatch):
    assert film_sync_ms() < 5.0
    from lipservo_lab.bench.display import film_figures

    late = film_figures.video_sound
    monkeypatch.setattr(
        film_figures,
        "video_sound",
        lambda path: type(late(path))(late(path).samples, late(path).begins_s + 0.06),
    )
    assert film_sync_ms() == pytest.approx(60.0, abs=2.0)


def test_a_track_is_cut_where_its_sentences_begin():
    points = np.arange(12.0)[:, None, None] * np.ones((1, 478, 3))
    cut = cut_track(points, {"a": np.zeros((3, 8)), "b": np.zeros((4, 8))})
    assert [cut[name][0, 0, 0] for name in ("rest", "a", "b")] == [0.0, 5.0, 8.0]
    assert [len(cut[name]) for name in ("rest", "a", "b")] == [5, 3, 4]
