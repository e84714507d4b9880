"""A photograph that speaks: worn head, lips that meet, triangles that do not turn over."""

import json
from functools import cache

import numpy as np
import pytest

pytest.importorskip("cv2", reason="films need OpenCV, the extra `film`")

from places import ROOT

from lipservo.display.lip_contact import areas_px2
from lipservo.display.photo_display import PhotoDisplay
from lipservo.display.photo_face import HAND_POINTS, PhotoError, photo_face
from lipservo.display.photo_file import framed
from lipservo.display.raster import covered
from lipservo.display.shipped_faces import TWIN_SIZE, twin_face, twin_landmarks
from lipsync.face.frame import Expression, Frame
from lipsync.face.model import load_face
from lipsync.markers import INNER_LIP

SIZE = (320, 240)
FACE = load_face()
SPREAD = np.sqrt(np.diag(FACE.covariance))


@cache
def twin():
    return PhotoDisplay(twin_face(FACE, SIZE))


def blank(size=TWIN_SIZE):
    return np.full((size[1], size[0], 3), 128, dtype=np.uint8)


def opened(share):
    """The model's first component opens the jaw."""
    coefficients = FACE.rest.copy()
    coefficients[0] -= share * SPREAD[0]
    return Frame(0.0, coefficients)


def gap_px(display, frame):
    moved, _ = display.warp.moved(frame)
    upper, lower = (moved[display.warp.vertex_of(INNER_LIP[at])] for at in (5, 15))
    return float(lower[1] - upper[1])


def test_pixels_under_a_triangle_are_those_whose_middle_lies_in_it():
    corners = np.array([[[1.0, 1.0], [9.0, 2.0], [4.0, 8.5]]])
    found = covered(corners, 10, 10)
    seen = set(zip(found.rows.tolist(), found.columns.tolist(), strict=True))
    a, b, c = corners[0]
    sides = [(a, b), (b, c), (c, a)]
    inside = {
        (y, x)
        for y in range(10)
        for x in range(10)
        if all((q - p)[0] * (y - p[1]) - (q - p)[1] * (x - p[0]) >= 0 for p, q in sides)
    }
    assert seen == inside


def test_what_is_between_corners_is_linear_at_every_pixel():
    corners = np.array([[[0.0, 0.0], [12.0, 1.0], [3.0, 11.0]]])
    values = corners * (2.0, -1.0) + (5.0, 7.0)
    found = covered(corners, 16, 16)
    wanted = np.stack([2.0 * found.columns + 5.0, 7.0 - found.rows])
    np.testing.assert_allclose(found.interpolated(corners, values), wanted, atol=1e-4)


def test_a_photograph_in_its_own_pose_is_the_photograph():
    display = twin()
    drawn = display.draw(Frame(0.0, display.own)).astype(int)
    away = np.abs(drawn - twin_face(FACE, SIZE).picture.astype(int))
    assert away.max() <= 40
    assert np.percentile(away, 99.5) <= 4


def test_the_wider_the_model_opens_the_darker_is_the_mouth():
    display = twin()
    gaps = [gap_px(display, opened(share)) for share in (0.0, 1.0, 2.0, 2.6)]
    assert gaps == sorted(gaps)
    assert gaps[0] < 1.0 < 6.0 < gaps[-1]
    moved, _ = display.warp.moved(opened(2.6))
    x, y = (
        moved[[display.warp.vertex_of(13), display.warp.vertex_of(14)]]
        .mean(axis=0)
        .round()
        .astype(int)
    )
    closed, open_ = display.draw(opened(0.0)), display.draw(opened(2.6))
    assert open_[y, x].mean() < closed[y, x].mean() - 40


def test_a_raised_tongue_is_seen_in_an_open_mouth_and_not_in_a_shut_one():
    tongue = Expression(tongue_alveolar=1.0)
    for frame, is_seen in ((opened(1.5), True), (Frame(0.0, FACE.rest), False)):
        without = twin().draw(frame).astype(int)
        change = twin().draw(Frame(0.0, frame.coefficients, tongue)) - without
        # It is redder than the dark of the mouth.
        assert (change[..., 0].sum() > change[..., 2].sum()) == change.any() == is_seen


def test_lips_that_overlap_in_the_model_meet_in_the_photograph():
    pressed = opened(-1.5)
    assert FACE.lip_gaps_mm(FACE.markers_mm(pressed.coefficients[None])).max() > 1.0
    assert gap_px(twin(), pressed) == pytest.approx(0.0, abs=0.35)


def test_no_triangle_turns_over_in_any_likely_mouth():
    display = twin()
    mesh = display.warp.mesh
    before = np.sign(areas_px2(mesh.rest_px, mesh.triangles))
    mouths = np.random.default_rng(4).multivariate_normal(np.zeros(8), FACE.covariance, 60)
    for each in mouths:
        moved, _ = display.warp.moved(Frame(0.0, each))
        assert (np.sign(areas_px2(moved, mesh.triangles)) == before).all()


def test_the_background_stays_and_the_head_turns_before_it():
    display = twin()
    still = display.draw(Frame(0.0, display.own))
    turned = display.draw(Frame(0.0, display.own, Expression(neck_yaw_deg=9.0)))
    assert (turned[:5] == still[:5]).all()
    assert (turned[:, :5] == still[:, :5]).all()
    nose = display.warp.vertex_of(1)
    moved, _ = display.warp.moved(Frame(0.0, display.own, Expression(neck_yaw_deg=9.0)))
    # Its own left is the picture's right.
    assert moved[nose, 0] > display.warp.mesh.rest_px[nose, 0] + 5.0


def test_a_lid_that_shuts_comes_down_to_the_lower_one():
    display = twin()
    upper, lower = (display.warp.vertex_of(each) for each in (159, 145))
    shut, _ = display.warp.moved(Frame(0.0, display.own, Expression(lid_right=1.0)))
    open_px = display.warp.mesh.rest_px[lower, 1] - display.warp.mesh.rest_px[upper, 1]
    assert shut[lower, 1] - shut[upper, 1] < 0.35 * open_px


def test_twenty_points_set_by_hand_are_enough_and_are_met():
    known = twin_landmarks()
    by_hand = {number: known[number][:2] for number in HAND_POINTS.values()}
    display = PhotoDisplay(photo_face(blank(), by_hand, FACE))
    for number, place in by_hand.items():
        at = display.warp.mesh.rest_px[display.warp.vertex_of(number)]
        np.testing.assert_allclose(at, place, atol=0.01)
    others = [n for n in range(468) if n not in by_hand and display.warp.vertex_of(n) >= 0]
    away = [
        np.linalg.norm(display.warp.mesh.rest_px[display.warp.vertex_of(n)] - known[n][:2])
        for n in others
    ]
    assert np.median(away) < 8.0  # of a face 380 pixels wide


def test_an_open_mouth_is_known_to_be_open_and_can_be_shut():
    landmarks = {n: place.copy() for n, place in twin_landmarks().items()}
    for at in range(11, 20):
        landmarks[INNER_LIP[at]][1] += 22.0 * np.sin(np.pi * (at - 10) / 10)
    display = PhotoDisplay(photo_face(*framed(blank(), landmarks, SIZE), FACE))
    assert FACE.lip_gap_mm(display.own) > 5.0
    assert gap_px(display, Frame(0.0, display.own)) > 5.0
    assert gap_px(display, Frame(0.0, FACE.rest)) < 1.0


@pytest.mark.parametrize(
    ("turn_deg", "px_per_mm", "says"),
    [(55.0, 2.5, "turned aside by 5"), (0.0, 0.2, "pixels wide")],
)
def test_a_profile_and_a_face_too_small_are_refused_in_one_line(turn_deg, px_per_mm, says):
    from lipsync.twin.head_surface import load_mean_face

    angle = np.radians(turn_deg)
    turn = np.array(
        [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    )
    places = load_mean_face().vertices_mm[:468] @ turn.T * px_per_mm
    landmarks = dict(enumerate(places * (1.0, -1.0, -1.0) + (480.0, 300.0, 0.0)))
    with pytest.raises(PhotoError, match=says) as refused:
        photo_face(blank(), landmarks, FACE)
    assert "\n" not in str(refused.value)


def test_a_filmed_talker_speaks_from_the_landmarks_of_the_corpus():
    corpus = ROOT.parent / "shared" / "corpus"
    clip = corpus / "grid_video" / "s1" / "bbbf9a.mpg"
    if not clip.is_file():
        pytest.skip(f"{clip} is not there")
    pytest.importorskip("av", reason="video needs PyAV, the extra `film`")
    from lipsync.video.video_file import video_pictures

    _, picture = next(video_pictures(clip))
    numbers = json.loads((corpus / "grid_s1" / "landmarks.json").read_text())["landmark_ids"]
    with np.load(corpus / "grid_s1" / "landmarks" / "bbbf9a.npz") as file:
        places = file["landmarks_64th_px"][0] / 64.0 - (0.5, 0.5, 0.0)
    landmarks = dict(zip(numbers, places, strict=True))
    display = PhotoDisplay(photo_face(*framed(picture, landmarks, SIZE), FACE))
    still, open_ = (display.draw(opened(share)) for share in (0.0, 2.0))
    moved = np.abs(still.astype(int) - open_).sum(axis=2) > 60
    rows = np.flatnonzero(moved.any(axis=1))
    mouth = display.warp.mesh.rest_px[display.warp.vertex_of(13), 1]
    assert abs(np.median(np.nonzero(moved)[0]) - mouth) < 25
    assert rows.min() > mouth - 40


def test_the_shipped_picture_lies_where_its_landmarks_say():
    # The pupils are the darkest places of the eyes.
    picture = twin_face(FACE, TWIN_SIZE).picture.mean(axis=2)
    known = twin_landmarks()
    for corner, other in ((33, 133), (362, 263)):
        x, y = ((known[corner] + known[other])[:2] / 2).round().astype(int)
        eye = picture[y - 14 : y + 14, x - 20 : x + 20]
        assert eye.min() < 40 < picture[y + 40 : y + 60, x - 20 : x + 20].min()
