"""Where `measure` and `fit` get their markers from, and what they say before anything moves."""

import json
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from places import ROOT
from typer.testing import CliRunner

pytest.importorskip("av", reason="photographs need PyAV, the extra `video`")

from pixel_video import PixelFace, PixelTracker, picture, write_video

from calibration.capture.marker_files import read_readings
from calibration.simulated.face import marker_positions_mm, simulated_face
from firmware_bridge.clock import MonotonicClock
from lipservo.calibrating.calibration_setup import CalibrationSetup
from lipservo.calibrating.camera import AvCamera, CameraFeed
from lipservo.calibrating.face_source import (
    MeshOptions,
    is_mesh_folder,
    is_seen_from_the_front,
    next_picture,
    tracker_source,
)
from lipservo.cli import app
from lipservo.settings.settings import load_shipped_face, parse_face
from lipsync.animpho.units import load_face_with_animphos
from lipsync.errors import UserError
from lipsync.output_file import write_whole

MESH = MeshOptions(PixelTracker, 90.0)


@pytest.fixture(scope="module")
def setup():
    return CalibrationSetup(load_shipped_face("face_four"), load_face_with_animphos(None))


def test_a_folder_is_of_photographs_dots_or_c3d_by_what_it_holds(tmp_path):
    typed_nothing = MeshOptions(PixelTracker)
    assert not is_mesh_folder(tmp_path, typed_nothing)
    assert is_mesh_folder(tmp_path, MESH)
    (tmp_path / "pose_1.jpg").touch()
    assert is_mesh_folder(tmp_path, typed_nothing)
    (tmp_path / "pose_1.c3d").touch()
    assert not is_mesh_folder(tmp_path, MESH)
    (tmp_path / "pose_1.c3d").unlink()
    (tmp_path / "dots.csv").touch()
    assert not is_mesh_folder(tmp_path, MESH)
    assert is_seen_from_the_front(tmp_path, MESH)
    assert not is_seen_from_the_front(tmp_path / "markers.csv", MESH)


def test_a_joint_that_protrudes_is_not_judged_by_what_nobody_sees(setup):

    words = dict(zip(setup.servos.names, setup.servos.positive, strict=True))
    assert words["lip_protrusion"] == "protrudes"
    flat = replace(setup, sees_forward=False).servos
    assert dict(zip(flat.names, flat.positive, strict=True)) == words | {"lip_protrusion": ""}


def test_the_scale_is_of_the_option_or_of_the_face_and_asked_for_otherwise(setup, tmp_path):
    (tmp_path / "pose_0.jpg").touch()
    bare = MeshOptions(PixelTracker)
    with pytest.raises(UserError, match=r"--eye-distance-mm, .* or write `eye_distance_mm:`"):
        tracker_source(setup, str(tmp_path), "x y z", bare).__enter__()
    text = (ROOT / "config" / "face_four.yaml").read_text()
    own = parse_face(text + "eye_distance_mm: 62\n", "four.yaml")
    assert own.eye_distance_mm == 62.0
    assert own.checksum == setup.settings.checksum

    with tracker_source(replace(setup, settings=own), str(tmp_path), "x y z", bare):
        pass


class Held:
    """A face that is held without servos: time passes."""

    def hold(self, seconds):
        time.sleep(seconds)

    def hold_while(self, ask):
        return ask()


def test_files_of_markers_are_read_while_servos_go_on_holding(setup, tmp_path, monkeypatch):
    """Reading all files takes longer than servos may go without a goal."""

    def read(*arguments):
        assert threading.current_thread() is not threading.main_thread()
        return read_readings(*arguments)

    class HeldInAThread(Held):
        def hold_while(self, ask):
            with ThreadPoolExecutor(1) as pool:
                return pool.submit(ask).result()

    monkeypatch.setattr("lipservo.calibrating.face_source.read_readings", read)
    monkeypatch.setattr("calibration.capture.trackers.read_readings", read)
    path = tmp_path / "markers.csv"
    path.write_text("pose,marker,x_mm,y_mm,z_mm\n0,nose,1,2,3\n1,nose,4,5,6\n")
    with tracker_source(setup, str(path), "x y z", MeshOptions(PixelTracker)) as make:
        tracker = make(HeldInAThread())
        tracker.arrived(0, np.zeros(4))
        assert tracker.measure().tolist() == [[4.0, 5.0, 6.0]]


def test_photographs_are_waited_for_one_a_pose(setup, tmp_path):
    cv2 = pytest.importorskip("cv2", reason="a photograph is written by OpenCV, the extra `dots`")
    over = threading.Event()

    def phone():
        done = set()
        while not over.is_set():
            time.sleep(0.01)
            try:
                pose = json.loads((tmp_path / "pose.json").read_text())["pose"]
            except (OSError, ValueError):
                continue
            if pose not in done:
                done.add(pose)
                pixels = picture([PixelFace(2.0 * pose)])[..., ::-1]
                write_whole(
                    tmp_path / f"pose_{pose}.png", cv2.imencode(".png", pixels)[1].tobytes()
                )

    thread = threading.Thread(target=phone)
    thread.start()
    try:
        with tracker_source(setup, str(tmp_path), "x y z", MESH) as make:
            tracker = make(Held())
            tracker.arrived(2, np.zeros(4))
            seen_mm = tracker.measure()
    finally:
        over.set()
        thread.join()
    names = tracker.marker_names
    apart_mm = seen_mm[names.index("inner_lip_13")] - seen_mm[names.index("inner_lip_14")]
    assert apart_mm[1] == pytest.approx(6.0, abs=0.5)


def test_a_camera_gives_a_picture_that_is_taken_after_it_was_asked(tmp_path):
    scenes = [picture([PixelFace(gap)]) for gap in np.linspace(0.0, 20.0, 50)]
    path = write_video(tmp_path / "c.mkv", scenes, np.arange(50) * 0.04, None)
    with CameraFeed(AvCamera(str(path))) as feed:
        first = PixelTracker().faces(next_picture(feed, MonotonicClock()))[0]
        second = PixelTracker().faces(next_picture(feed, MonotonicClock()))[0]
    assert second[14, 1] - second[13, 1] > first[14, 1] - first[13, 1]


def test_a_camera_that_is_not_there_is_told_before_a_servo_moves(setup):
    with (
        pytest.raises(UserError, match=r"camera '/dev/none' cannot be opened"),
        tracker_source(setup, "camera", "x y z", MeshOptions(PixelTracker, 90.0, "/dev/none")),
    ):
        pass


def test_a_calibration_is_fitted_to_photographs(setup, tmp_path, monkeypatch):
    """Faces of a tracker that sees in each file what a simulated robot does in that pose."""
    from calibration.capture.marker_files import read_plan
    from lipsync.markers import MARKERS_47

    monkeypatch.setattr("calibration.fit.measured.MAX_FITTED", 60)
    monkeypatch.setattr("calibration.fit.measured.MAX_HELD_OUT", 20)
    plan, folder = tmp_path / "plan.csv", tmp_path / "photographs"
    folder.mkdir()
    run = CliRunner().invoke
    made = run(app, ["calibrate", "plan", str(plan), "--config", "face_four", "--poses", "24"])
    assert made.exit_code == 0, made.output
    model = setup.model
    goals_deg = read_plan(plan, setup.servos.names).goals_deg
    robot = simulated_face(model.markers_mm(model.rest[None])[0], setup.servos.names)
    markers_mm = marker_positions_mm(robot, goals_deg)
    noise = np.random.default_rng(0)
    others_mm = np.random.default_rng(1).normal(0.0, 40.0, (478, 3))
    others_mm[33], others_mm[263] = (-45.0, 40.0, -30.0), (45.0, 40.0, -30.0)
    cv2 = pytest.importorskip("cv2", reason="a photograph is written by OpenCV, the extra `dots`")
    for pose in range(len(goals_deg)):
        number = np.full((8, 8, 3), pose, np.uint8)
        cv2.imwrite(str(folder / f"pose_{pose + 1}.png"), number)

    class Network:
        name = "a network"

        def faces(self, pixels):
            points = others_mm.copy()
            seen = markers_mm[int(pixels[0, 0, 0])]
            points[list(MARKERS_47.landmarks)] = seen + noise.normal(0.0, 0.2, seen.shape)
            return (points * [2.0, -2.0, -2.0] + [300.0, 300.0, 0.0],)

    monkeypatch.setattr("lipsync.video.face_tracker.open_tracker", lambda _: Network())
    output = tmp_path / "four.calibration.yaml"
    done = run(
        app,
        ["calibrate", "fit", "--config", "face_four", "--plan", str(plan), "--markers",
         str(folder), "--eye-distance-mm", "90", "-o", str(output), "--json"],
    )  # fmt: skip
    assert done.exit_code == 0, done.output + str(done.exception)
    told = json.loads(done.stdout.splitlines()[-1])
    assert told["method"] == "measured"
    assert told["left_out_pose_rms_mm"] < 0.6
    assert "how far lips stand forward is a network's estimate" in done.stderr
