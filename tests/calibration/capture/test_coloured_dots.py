"""Dots told by colour and shape in rendered pictures; skipped without OpenCV (extra `dots`)."""

import numpy as np
import pytest

from calibration.calibration import CalibrationError
from calibration.capture.dots import DotsFolder, find_dots

cv2 = pytest.importorskip("cv2", reason="dots need OpenCV, the extra `dots`")

BLUE, SKIN = (200, 60, 20), (120, 150, 200)
_BIG = 4


def rendered(path, dots, *, size=(300, 460), shapes=(), seed=0):
    """dots: (column, row, diameter, squeeze) in pixels; shapes: polygons of the same blue."""
    height, width = size
    picture = np.full((height * _BIG, width * _BIG, 3), SKIN, np.uint8)
    for polygon in shapes:
        cv2.fillPoly(picture, [np.array(polygon) * _BIG], BLUE)
    for column, row, diameter, squeeze in dots:
        middle = (round(_BIG * (column + 0.5)), round(_BIG * (row + 0.5)))
        axes = (round(_BIG * diameter / 2), round(_BIG * diameter * squeeze / 2))
        cv2.ellipse(picture, middle, axes, 0, 0, 360, BLUE, -1, cv2.LINE_AA)
    small = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA).astype(float)
    blurred = cv2.GaussianBlur(small, (0, 0), 0.8)
    noisy = blurred + np.random.default_rng(seed).normal(0.0, 8.0, small.shape)
    cv2.imwrite(str(path), np.clip(noisy, 0, 255).astype(np.uint8))
    return path


def grid(rng, diameter, spread=0.0, squeeze=1.0):
    return [
        (
            40 + 45 * (n % 9) + rng.uniform(-8, 8),
            40 + 45 * (n // 9) + rng.uniform(-8, 8),
            diameter * rng.uniform(1 - spread, 1 + spread),
            squeeze,
        )
        for n in range(45)
    ]


def missed(found, dots):
    apart = np.linalg.norm(np.array(dots)[:, None, :2] - found.middles_px, axis=2)
    return int((apart.min(axis=1) > 1.0).sum())


@pytest.mark.parametrize("diameter", [8.0, 11.0, 16.0])
@pytest.mark.parametrize("squeeze", [1.0, 0.6])
def test_painted_dots_of_uneven_size_are_one_each(tmp_path, diameter, squeeze):
    rng = np.random.default_rng(7)
    for seed in range(2):
        dots = grid(rng, diameter, spread=0.15, squeeze=squeeze)
        found = find_dots(rendered(tmp_path / "p.png", dots, seed=seed))
        assert len(found.middles_px) == 45
        assert missed(found, dots) == 0
        assert found.n_merged == 0


def test_a_shirt_a_collar_and_a_speck_of_the_same_blue_are_no_dots(tmp_path):
    dots = grid(np.random.default_rng(1), 11.0)
    shirt = [(0, 280), (200, 262), (459, 285), (459, 299), (0, 299)]
    stripe = [(5, 5), (300, 8), (300, 12), (5, 9)]
    speck = [(440, 5), (445, 5), (445, 9), (440, 9)]
    found = find_dots(rendered(tmp_path / "p.png", dots, shapes=[shirt, stripe, speck]))
    assert len(found.middles_px) == 45
    assert missed(found, dots) == 0


def test_a_large_round_badge_is_no_dot_and_makes_none_of_the_dots_small(tmp_path):
    dots = grid(np.random.default_rng(2), 9.0)[:12]
    found = find_dots(rendered(tmp_path / "p.png", [*dots, (380, 200, 80, 1.0)]))
    assert len(found.middles_px) == 12


@pytest.fixture
def folder(tmp_path):
    dots = {"inner_lip_13": (100, 100), "inner_lip_14": (100, 130), "chin_199": (100, 200)}
    rows = [f"{name},{x},{y},0.5" for name, (x, y) in dots.items()]
    (tmp_path / "dots.csv").write_text("\n".join(["marker,column_px,row_px,mm_per_px", *rows]))
    wide = [(60, 60, 11, 1.0), (150, 60, 11, 1.0)]
    for pose, lip_row in ((1, 130), (2, 108)):
        places = [(100, 100, 11, 1.0), (100, lip_row, 11, 1.0), (100, 200, 11, 1.0)]
        rendered(tmp_path / f"pose_{pose}.png", [*places, *wide], size=(240, 320))
    return tmp_path


def test_dots_that_merge_are_told_apart_and_told(folder):
    told = []
    readings = DotsFolder(folder, told.append).readings()
    places = {(pose, name): place for pose, name, place in readings}
    assert places[2, "inner_lip_13"][1] - places[2, "inner_lip_14"][1] == pytest.approx(4.0, abs=1)
    assert told == ["pose_2.png: dots that touch, separated by shape: 2"]


def test_pictures_of_different_size_are_refused(folder):
    rendered(folder / "pose_3.png", [(100, 100, 11, 1.0)], size=(320, 240))
    with pytest.raises(
        CalibrationError, match=r"pose_3\.png has 240 x 320 pixels, but pose_1\.png 320"
    ):
        DotsFolder(folder).readings()


def test_a_photograph_that_the_camera_has_turned_is_refused_by_its_size(folder):
    """EXIF orientation 6 in a JPEG: OpenCV turns it upright, and it is higher than wide."""
    picture = cv2.imread(str(folder / "pose_1.png"))
    plain = cv2.imencode(".jpg", picture)[1].tobytes()
    tag = b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0"
    header = b"\xff\xe1" + (len(tag) + 2).to_bytes(2, "big") + tag
    (folder / "pose_3.jpg").write_bytes(plain[:2] + header + plain[2:])
    with pytest.raises(CalibrationError, match="one camera that stands still"):
        DotsFolder(folder).readings()


def test_a_picture_without_dots_is_told_and_its_pose_lost(folder):
    told = []
    rendered(folder / "pose_3.png", [], size=(240, 320))
    readings = DotsFolder(folder, told.append).readings()
    assert all(np.isnan(place).all() for pose, _, place in readings if pose == 3)
    assert "pose_3.png: left out: 0 dots are seen of 3, and names would be a guess" in told


@pytest.mark.parametrize("name", ["pose_4.heic", "pose_4.HEIF", "pose_4.dng"])
def test_a_kind_of_picture_that_nobody_reads_is_named(folder, name):
    (folder / name).write_bytes(b"")
    with pytest.raises(CalibrationError, match=r"files are not read; save it as \.jpg or \.png"):
        DotsFolder(folder).readings()


def test_a_folder_without_pictures_says_what_is_expected(folder):
    for picture in folder.glob("*.png"):
        picture.unlink()
    with pytest.raises(CalibrationError, match=r"no picture in this folder; expected pose_1\.png"):
        DotsFolder(folder).readings()
