"""Photographs of a face, looked at by a tracker of pixel faces (tests/support/video)."""

import numpy as np
import pytest

av = pytest.importorskip("av", reason="photographs need PyAV, the extra `video`")

from pixel_video import PixelFace, PixelTracker, face_points, picture  # noqa: E402

from calibration.calibration import CalibrationError  # noqa: E402
from calibration.capture.face_mesh import (  # noqa: E402
    CameraTracker,
    MeshFolder,
    MeshFrame,
    NoFaceError,
    one_face,
)
from lipsync.markers import MARKERS_47  # noqa: E402

EYES_MM = 90.0
UP, LOW = MARKERS_47.names.index("inner_lip_13"), MARKERS_47.names.index("inner_lip_14")


def photograph(path, *faces):
    with av.open(str(path), "w", format="image2", options={"update": "1"}) as file:
        stream = file.add_stream("png", rate=1)
        pixels = picture(faces)
        stream.height, stream.width, stream.pix_fmt = *pixels.shape[:2], "rgb24"
        file.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")))
        file.mux(stream.encode(None))
    return path


def by_marker(readings, pose):
    return {name: place for number, name, place in readings if number == pose}


def test_gaps_of_photographs_are_in_millimetres_by_the_eye_distance(tmp_path):
    for pose, gap_mm in ((0, 0.0), (1, 4.0), (2, 10.0)):
        photograph(tmp_path / f"pose_{pose}.png", PixelFace(gap_mm))
    readings = MeshFolder(tmp_path, PixelTracker(), EYES_MM).all_readings()
    assert len(readings) == 3 * 47
    for pose, gap_mm in ((1, 4.0), (2, 10.0)):
        places = by_marker(readings, pose)
        apart = places["inner_lip_13"] - places["inner_lip_14"]
        assert apart == pytest.approx([0.0, gap_mm, 0.0], abs=0.3)


def test_how_near_where_and_how_the_camera_was_held_changes_nothing(tmp_path):
    photograph(tmp_path / "pose_0.png", PixelFace(2.0))
    photograph(tmp_path / "pose_1.png", PixelFace(6.0))
    photograph(tmp_path / "pose_2.png", PixelFace(6.0, left_px=60, width_px=120, yaw_deg=10))
    readings = MeshFolder(tmp_path, PixelTracker(), EYES_MM).all_readings()
    one, other = by_marker(readings, 1), by_marker(readings, 2)
    for name in MARKERS_47.names:
        assert other[name] == pytest.approx(one[name], abs=0.6), name


def test_the_robots_left_is_x_up_is_y_and_towards_the_camera_is_z():
    points = face_points(0.0)
    moved = points.copy()
    moved[13] += [6.0, -12.0, -3.0]  # pixels: right, up, towards the viewer
    frame = MeshFrame(points, EYES_MM)
    change_mm = (frame.markers_mm(moved) - frame.markers_mm(points))[UP]
    assert change_mm == pytest.approx([9.0, 18.0, 4.5], abs=1e-6)
    assert np.allclose(np.delete(frame.markers_mm(moved) - frame.markers_mm(points), UP, 0), 0.0)


def test_useless_photographs_are_named_all_at_once_with_what_to_do(tmp_path):
    photograph(tmp_path / "pose_1.png", PixelFace(2.0))
    photograph(tmp_path / "pose_2.png")
    photograph(tmp_path / "pose_3.png", PixelFace(2.0, 10, 70), PixelFace(2.0, 110, 70))
    (tmp_path / "pose_4.jpg").write_bytes(b"\xff\xd8not this")
    with pytest.raises(CalibrationError) as refused:
        MeshFolder(tmp_path, PixelTracker(), EYES_MM).all_readings()
    told = str(refused.value)
    assert "pose_2.png (no face is found)" in told
    assert "pose_3.png (two faces are seen" in told
    assert "pose_4.jpg (not readable as a picture)" in told
    assert "needs dots" in told
    assert "\n" not in told


def test_somebody_in_the_background_is_nobody(tmp_path):
    photograph(tmp_path / "pose_1.png", PixelFace(2.0, 10, 100), PixelFace(2.0, 150, 30))
    assert len(MeshFolder(tmp_path, PixelTracker(), EYES_MM).readings(1)) == 47


def test_a_photograph_is_taken_again_after_it_was_told(tmp_path):
    told = []
    photographs = MeshFolder(tmp_path, PixelTracker(), EYES_MM, told.append)
    assert photographs.readings(7) == []
    photograph(tmp_path / "pose_7.png")
    assert photographs.readings(7) == photographs.readings(7) == []
    assert len(told) == 1
    assert told[0].startswith("pose_7.png: no face is found; take it again")
    (tmp_path / "pose_7.png").unlink()
    photograph(tmp_path / "pose_7.png", PixelFace(3.0))
    assert len(photographs.readings(7)) == 47


def test_a_file_that_is_being_written_is_not_complained_of(tmp_path):
    told = []
    photographs = MeshFolder(tmp_path, PixelTracker(), EYES_MM, told.append)
    whole = photograph(tmp_path / "other.png", PixelFace(3.0)).read_bytes()
    (tmp_path / "other.png").unlink()
    (tmp_path / "pose_1.png").write_bytes(whole[:40])
    assert photographs.readings(1) == []
    (tmp_path / "pose_1.png").write_bytes(whole)
    assert len(photographs.readings(1)) == 47
    assert told == []


@pytest.mark.parametrize(("name", "message"), [("neutral.png", "no pose number"), ("", "no pic")])
def test_unknown_names_and_an_empty_folder_are_one_line(tmp_path, name, message):
    if name:
        photograph(tmp_path / name, PixelFace(1.0))
    with pytest.raises(CalibrationError, match=message):
        MeshFolder(tmp_path, PixelTracker(), EYES_MM).all_readings()


class Pictures:
    """What a camera sees: one picture after another, the last one again and again."""

    def __init__(self, *scenes):
        self.scenes, self.n = list(scenes), 0

    def see(self):
        self.n += 1
        faces = self.scenes.pop(0) if len(self.scenes) > 1 else self.scenes[0]
        return one_face(PixelTracker(), picture(faces))


def test_a_pose_is_the_median_of_five_pictures():
    steady, odd = [PixelFace(4.0)], [PixelFace(20.0)]
    camera = Pictures(*[[PixelFace(0.0)]] * 5, steady, odd, steady, steady, steady)
    tracker = CameraTracker(camera.see, EYES_MM, lambda _: None)
    tracker.arrived(0, np.zeros(1))
    seen_mm = tracker.measure()
    assert camera.n == 10
    assert seen_mm[UP, 1] - seen_mm[LOW, 1] == pytest.approx(4.0, abs=0.3)


def test_no_face_in_neutral_is_refused_before_anything_is_captured():
    with pytest.raises(CalibrationError, match=r"pose 0 \(neutral\): no face is found; let it"):
        CameraTracker(Pictures([]).see, EYES_MM, lambda _: None)


def test_a_pose_without_a_face_is_told_and_left_out_and_five_in_a_row_are_the_end():
    told = []
    camera = Pictures(*[[PixelFace(0.0)]] * 5, [])
    tracker = CameraTracker(camera.see, EYES_MM, told.append)
    for pose in range(4):
        tracker.arrived(pose, np.zeros(1))
        assert np.isnan(tracker.measure()).all()
    assert told[0] == "pose 1: no face is found; the pose is left out"
    tracker.arrived(4, np.zeros(1))
    with pytest.raises(CalibrationError, match="pose 5 and the four before it"):
        tracker.measure()


def test_two_faces_are_not_guessed_between():
    with pytest.raises(NoFaceError, match="two faces"):
        one_face(PixelTracker(), picture([PixelFace(1.0, 10, 70), PixelFace(1.0, 110, 70)]))
