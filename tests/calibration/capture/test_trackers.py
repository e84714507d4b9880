"""C3D files and coloured dots; skipped without their libraries (extras `mocap` and `dots`)."""

import numpy as np
import pytest

from calibration.calibration import CalibrationError
from calibration.capture.capture import plan_poses
from calibration.capture.dots import dots_mm, find_dots, name_dots
from calibration.capture.marker_files import read_c3d, read_c3d_folder, read_capture, write_plan
from calibration.mouth_servos import JointRange


def write_c3d(
    path, points, labels=("inner_lip_13", "inner_lip_14"), unit="mm", residuals=None, **parameters
):
    """points: (n_points, 3, n_frames); residuals: (n_points, n_frames); parameters: of POINT."""
    ezc3d = pytest.importorskip("ezc3d", reason="C3D needs ezc3d, the extra `mocap`")
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["UNITS"]["value"] = [unit]
    file["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    file["parameters"]["POINT"]["LABELS"]["value"] = list(labels)
    data = np.ones((4, len(points), points.shape[2]))
    data[:3] = points.transpose(1, 0, 2)
    file["data"]["points"] = data
    if residuals is not None:
        file["data"]["meta_points"]["residuals"] = residuals[None]
    for name, texts in parameters.items():
        file.add_parameter("POINT", name, texts)
    file.write(str(path))
    return path


def test_of_the_frames_of_a_c3d_file_the_median_counts_in_millimetres(tmp_path):
    points = np.random.default_rng(0).normal(size=(2, 3, 20)).astype(np.float32)
    points[1, :, 5] = np.nan
    found = read_c3d(write_c3d(tmp_path / "pose_1.c3d", points, unit="m"))
    assert found["inner_lip_13"] == pytest.approx(1000 * np.median(points[0], axis=1), rel=1e-4)
    second = 1000 * np.nanmedian(points[1], axis=1)
    assert found["inner_lip_14"] == pytest.approx(second, rel=1e-4)


LIPS_MM = np.array([[[1.0] * 9, [2.0] * 9, [3.0] * 9], [[4.0] * 9, [5.0] * 9, [6.0] * 9]])


def test_places_that_a_system_has_lost_are_no_places(tmp_path):
    """Written as 0, 0, 0 in most frames, or with a negative residual."""
    lost = LIPS_MM.copy()
    lost[0, :, :6] = 0.0
    lost[1, :, :6] = 99.0
    residuals = np.zeros((2, 9))
    residuals[1, :6] = -1.0

    found = read_c3d(write_c3d(tmp_path / "pose_1.c3d", lost, residuals=residuals))
    assert found["inner_lip_13"] == pytest.approx([1.0, 2.0, 3.0])
    assert found["inner_lip_14"] == pytest.approx([4.0, 5.0, 6.0])
    never = read_c3d(write_c3d(tmp_path / "pose_2.c3d", np.zeros((2, 3, 9))))
    assert all(np.isnan(place).all() for place in never.values())


def test_more_than_255_points_are_all_read(tmp_path):
    points = np.arange(1.0, 301.0)[:, None, None] * np.ones((300, 3, 4))
    labels = [f"p{n}" for n in range(300)]
    path = write_c3d(tmp_path / "pose_1.c3d", points, labels[:255], LABELS2=labels[255:])

    found = read_c3d(path)
    assert list(found) == labels
    assert found["p299"] == pytest.approx([300.0] * 3)


@pytest.mark.parametrize("kind", ["ANGLES", "FORCES", "MOMENTS"])
def test_angles_and_forces_beside_the_points_are_no_markers(tmp_path, kind):
    path = write_c3d(tmp_path / "pose_1.c3d", LIPS_MM, **{kind: ["inner_lip_14"]})

    assert list(read_c3d(path)) == ["inner_lip_13"]


@pytest.mark.parametrize(
    ("labels", "unit", "told"),
    [
        (("lip", "lip"), "mm", "several points share a label: 'lip'"),
        (("a", "b"), "", r"unit '' \(POINT:UNITS\) is not known; export it again"),
        (("a", "b"), "inch", "unit 'inch'"),
    ],
)
def test_what_cannot_be_told_apart_or_has_no_unit_is_refused(tmp_path, labels, unit, told):
    with pytest.raises(CalibrationError, match=told):
        read_c3d(write_c3d(tmp_path / "pose_1.c3d", LIPS_MM, labels, unit))


def test_points_without_a_label_are_left_out(tmp_path):
    assert list(read_c3d(write_c3d(tmp_path / "pose_1.c3d", LIPS_MM, ("lip", "")))) == ["lip"]


def test_a_folder_of_c3d_files_becomes_a_capture(tmp_path):
    plan_path, folder = tmp_path / "plan.csv", tmp_path / "recorded"
    folder.mkdir()
    write_plan(plan_poses([JointRange("jaw", -2.0, 25.0)], 8), plan_path)
    for pose in range(1, 9):
        points = np.zeros((2, 3, 4)) + np.array([1.0, 2.0, 3.0 * pose])[None, :, None]
        write_c3d(folder / f"pose_{pose:03d}.c3d", points)
    capture = read_capture(plan_path, folder, ("jaw",), axes="x z -y")
    assert capture.marker_names == ("inner_lip_13", "inner_lip_14")
    assert capture.markers_mm[4, 0] == pytest.approx([1.0, 15.0, -2.0])


@pytest.mark.parametrize("axes", ["x y", "x y y", "left up forward"])
def test_axes_that_make_no_space_are_refused(tmp_path, axes):
    with pytest.raises(CalibrationError, match="must be three different ones"):
        read_c3d_folder(tmp_path, axes)


def test_an_empty_folder_and_a_file_without_a_number_are_named(tmp_path):
    with pytest.raises(CalibrationError, match=r"no \.c3d file"):
        read_c3d_folder(tmp_path)
    (tmp_path / "face.c3d").write_bytes(b"")
    with pytest.raises(CalibrationError, match="its name has no pose number"):
        read_c3d_folder(tmp_path)


def test_a_file_that_is_no_c3d_is_one_clear_line(tmp_path):
    pytest.importorskip("ezc3d", reason="C3D needs ezc3d, the extra `mocap`")
    (tmp_path / "pose_1.c3d").write_bytes(b"not this")
    with pytest.raises(CalibrationError, match="not readable as C3D"):
        read_c3d(tmp_path / "pose_1.c3d")


def rendered_face(path, dots_px, background=(120, 150, 200)):
    """Blue dots of 5 pixels radius, anti-aliased and noisy, on skin, with red lips between them."""
    cv2 = pytest.importorskip("cv2", reason="dots need OpenCV, the extra `dots`")
    picture = np.full((240, 320, 3), background, dtype=np.uint8)
    cv2.ellipse(picture, (160, 120), (60, 25), 0, 0, 360, (60, 60, 190), -1, cv2.LINE_AA)
    for x, y in dots_px:
        centre = (round(16 * x), round(16 * y))
        cv2.circle(picture, centre, 5 * 16, (200, 60, 20), -1, cv2.LINE_AA, 4)
    noise = np.random.default_rng(0).normal(0, 4, picture.shape)
    cv2.imwrite(str(path), np.clip(picture + noise, 0, 255).astype(np.uint8))
    return path


def test_dots_of_a_rendered_picture_are_found_within_a_third_of_a_pixel(tmp_path):
    dots = np.random.default_rng(1).uniform(0, 1, (12, 2)) * 30 + np.array(
        [[50 + 60 * (i % 4), 40 + 60 * (i // 4)] for i in range(12)]
    )
    found = find_dots(rendered_face(tmp_path / "p.png", dots)).middles_px
    assert len(found) == 12
    apart = np.linalg.norm(found[:, None] - dots, axis=2).min(axis=1)
    assert apart.max() < 0.34


def test_dots_keep_their_names_and_a_hidden_one_is_lost():
    expected = {"a": np.array([10.0, 10.0]), "b": np.array([20.0, 10.0]), "c": np.array([50, 50])}
    dots = np.array([[21.0, 11.0], [12.0, 10.0]])
    found = name_dots(dots, expected, furthest_px=15.0, sure_px=8.0)
    assert found["a"].tolist() == [12.0, 10.0]
    assert found["b"].tolist() == [21.0, 11.0]
    assert np.isnan(found["c"]).all()
    assert np.isnan(name_dots(np.zeros((0, 2)), expected, furthest_px=15.0, sure_px=8.0)["a"]).all()


@pytest.mark.parametrize("apart_px", [6.0, 10.0])
def test_two_dots_that_touch_are_found_as_two(tmp_path, apart_px):
    cv2 = pytest.importorskip("cv2", reason="dots need OpenCV, the extra `dots`")
    middles = np.array([[10.0, 30.0], [30.0, 30], [50.0, 30], [80.0, 30], [80.0, 30 + apart_px]])
    picture = np.full((80, 120, 3), (120, 150, 200), dtype=np.uint8)
    for x, y in middles:
        centre = (round(16 * x), round(16 * y))
        cv2.circle(picture, centre, 5 * 16, (200, 60, 20), -1, cv2.LINE_AA, 4)
    cv2.imwrite(str(tmp_path / "p.png"), picture)
    found = find_dots(tmp_path / "p.png").middles_px
    found = found[np.lexsort((found[:, 1], found[:, 0].round(-1)))]
    np.testing.assert_allclose(found, middles, atol=1.0)


def test_an_open_jaw_does_not_pass_its_dots_on_to_their_neighbours():
    """Upper lip, lower lip, chin in a column; the jaw carries the last two down by 30."""
    expected = {name: np.array([0.0, row]) for name, row in (("up", 0.0), ("low", 2), ("chin", 40))}
    dots = np.array([[0.0, 70.0], [0.0, 0.0], [0.0, 32.0]])
    found = name_dots(dots, expected, furthest_px=45.0, sure_px=10.0)
    assert [found[name][1] for name in expected] == [0.0, 32.0, 70.0]
    hidden = name_dots(dots[:2], expected, furthest_px=45.0, sure_px=10.0)
    assert np.isnan(list(hidden.values())).all()


def test_right_in_the_picture_is_the_robots_left_and_down_is_down():
    places = {"a": np.array([110.0, 60.0]), "lost": np.full(2, np.nan)}
    found = dots_mm(places, np.array([100.0, 50.0]), 0.5)
    assert found["a"].tolist() == [5.0, -5.0, 0.0]
    assert np.isnan(found["lost"]).all()


def test_a_file_that_is_no_picture_is_one_clear_line(tmp_path):
    pytest.importorskip("cv2", reason="dots need OpenCV, the extra `dots`")
    (tmp_path / "p.png").write_bytes(b"not this")
    with pytest.raises(CalibrationError, match="not readable as a picture"):
        find_dots(tmp_path / "p.png")
