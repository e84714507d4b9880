"""`lipservo calibrate` as it is typed, on servos behind a terminal and on files."""

import csv
import json
import threading
import time
from importlib import resources

import numpy as np
import pytest
from lipservo_lab.learning.motion.trained_model import load_trained_model
from typer.testing import CliRunner

from calibration.files.calibration_file import load_calibration
from calibration.simulated.face import marker_positions_mm, simulated_face
from calibration.simulated.robot import SimulatedRobot, draw_robot
from lipservo.cli import app
from lipservo.runtime.servos.sim_process import simulated_port
from lipsync.markers import MARKERS_47

MODEL = load_trained_model()
REST_MM = MODEL.markers_mm(MODEL.rest[None])[0]
LIPS = ("outer_lip_61", "outer_lip_291", "inner_lip_13", "inner_lip_14", "outer_lip_17")
QUICK = ("--poses", "6", "--speed", "400", "--no-lags")


def command(*arguments, **options):
    return CliRunner().invoke(app, [str(a) for a in arguments], **options)


def calibrate(*arguments, **options):
    return command("calibrate", *arguments, **options)


@pytest.fixture(autouse=True)
def fewer_frames(monkeypatch):
    """What is claimed of errors is measured elsewhere."""
    monkeypatch.setattr("calibration.fit.measured.MAX_FITTED", 60)
    monkeypatch.setattr("calibration.fit.measured.MAX_HELD_OUT", 20)


@pytest.fixture(scope="module")
def port():
    with simulated_port(["--config", "face_jaw", "--on-time"]) as port:
        yield port


class OtherProgram(threading.Thread):
    """A tracker that knows nothing but pose.json: it looks at a jaw and adds lines to a CSV."""

    def __init__(self, path):
        super().__init__(daemon=True)
        self.path, self.told = path, path.with_name(path.name + ".pose.json")
        self.face = simulated_face(REST_MM, ["jaw"])
        self.poses = []
        self.stop = False

    def run(self):
        while not self.stop:
            time.sleep(0.02)
            try:
                stands = json.loads(self.told.read_text())
            except (OSError, ValueError):
                continue
            if stands["pose"] not in self.poses:
                self.poses.append(stands["pose"])
                self.record(stands)

    def record(self, stands):
        seen = marker_positions_mm(self.face, np.array([[stands["servos_deg"]["jaw"]]]))[0]
        with self.path.open("a", newline="") as file:
            writer = csv.writer(file)
            if not file.tell():
                writer.writerow(["pose", "marker", "x_mm", "y_mm", "z_mm"])
            for name in LIPS:
                place = seen[MARKERS_47.names.index(name)].round(3)
                writer.writerow([stands["pose"], name, *place])


@pytest.mark.slow
def test_servos_are_moved_and_another_program_records_the_markers(port, tmp_path):
    markers, out = tmp_path / "markers.csv", tmp_path / "jaw.yaml"
    other = OtherProgram(markers)
    other.start()
    done = calibrate(
        "measure", "--config", "face_jaw", "--port", port, "--tracker", markers, *QUICK,
        "-o", out, "--keep", tmp_path / "kept.jsonl",
    )  # fmt: skip
    other.stop = True
    assert done.exit_code == 0, done.output
    # Neutral, the plan with its closing steps and repeats, and ten to grade by.
    assert other.poses == list(range(len(other.poses)))
    assert len(other.poses) > 40
    assert not other.told.exists()
    kept = [json.loads(line) for line in (tmp_path / "kept.jsonl").read_text().splitlines()]
    for pose in kept:  # encoders, in steps of 360 / 4096, not what was asked for
        assert pose["reached_deg"][0] == pytest.approx(pose["goals_deg"][0], abs=0.5)
        ticks = pose["reached_deg"][0] * 4096 / 360
        assert ticks == pytest.approx(round(ticks), abs=0.01)
    calibration = load_calibration(out)
    assert calibration.origin.method == "measured"
    (memory,) = calibration.origin.servo_memories
    assert (memory.homing_offset, memory.drive_mode) == (0, 0)
    wide = MODEL.animphos.samples[MODEL.animphos.of_phoneme("AA"), 2]
    assert np.median([calibration.positions_deg(c)[0] for c in wide]) > 4.0
    again = calibrate(
        "measure", "--config", "face_jaw", "--port", port, "--tracker", markers, *QUICK,
        "-o", out, "--keep", tmp_path / "kept.jsonl",
    )  # fmt: skip
    assert again.exit_code == 0, again.output  # nothing is asked for twice: nobody records now
    assert load_calibration(out).origin.method == "measured"


def test_a_calibration_of_servos_that_were_set_up_anew_is_refused(port, tmp_path):
    out = tmp_path / "jaw.calibration.yaml"
    done = calibrate("guided", "--config", "face_jaw", "--port", port, "--no-lags",
                   "-o", out, input="\n" * 14)  # fmt: skip
    assert done.exit_code == 0, done.output
    face = tmp_path / "jaw.yaml"
    text = (resources.files("lipservo.config") / "face_jaw.yaml").read_text()
    face.write_text(text.replace("face_jaw.calibration.yaml", out.name))
    lines = [line for line in out.read_text().splitlines() if not line.startswith("checksum")]
    changed = "\n".join(lines).replace("max_position_limit: ", "max_position_limit: 1")
    out.write_text(changed)
    done = command("run", "--config", face, "--port", port, "--quiet")
    assert done.exit_code == 1
    assert "servo 'jaw' has max position limit" in str(done.exception)
    assert "run `lipservo setup-servos`, or calibrate anew" in str(done.exception)


def test_arrow_keys_move_real_servos_and_enter_keeps_the_pose(port, tmp_path):
    """Closed; then three degrees of jaw for open, by an arrow and a letter; then the others."""
    out, keep = tmp_path / "c.yaml", tmp_path / "poses.json"
    done = calibrate(
        "guided", "--config", "face_jaw", "--port", port, "--no-lags",
        "--speed", "400", "-o", out, "--keep", keep, input="\n" + "\x1b[C\x1b[Cd\n" + "a\n" * 12,
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    assert "from 14 poses made by eye" in done.stdout
    made = json.loads(keep.read_text())
    assert made["closed"] == {"jaw": 0.0}
    assert made["open"] == {"jaw": 3.0}
    assert made["wide"] == {"jaw": 2.0}
    assert load_calibration(out).origin.method == "guided"


def test_the_end_of_a_script_keeps_what_was_made(tmp_path):
    keep = tmp_path / "poses.json"
    done = calibrate("guided", "--config", "face_jaw", "-o", tmp_path / "c.yaml",
                   "--keep", keep, input="\n\n")  # fmt: skip
    assert done.exit_code == 1
    assert "2 poses are too few; 10 are needed" in str(done.exception)
    assert list(json.loads(keep.read_text())) == ["closed", "open"]
    assert not (tmp_path / "c.yaml").exists()


def write_plan(tmp_path, config="face_jaw", poses=15):
    plan = tmp_path / "plan.csv"
    done = calibrate("plan", plan, "--config", config, "--poses", poses)
    assert done.exit_code == 0, done.output
    return plan


def looks(plan, servos, seed=100):
    """Every pose of a plan on a robot drawn from a seed, reached from the side that it names."""
    robot = SimulatedRobot(draw_robot(REST_MM, servos, seed))
    with plan.open() as file:
        for row in csv.DictReader(file):
            goal, side = (
                np.array([float(row[f"{s}_{k}"]) for s in servos]) for k in ("deg", "from")
            )
            robot.move(goal - 3.0 * side)
            robot.move(goal)
            yield int(row["pose"]), robot.measure()


def write_markers(plan, path, servos, names=MARKERS_47.names):
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["pose", "marker", "x_mm", "y_mm", "z_mm"])
        for pose, seen in looks(plan, servos):
            for name in names:
                writer.writerow([pose, name, *seen[MARKERS_47.names.index(name)].round(2)])
    return path


def test_pictures_of_coloured_dots_become_a_calibration(tmp_path):
    """Blue dots of a drawn jaw, seen from the front at 4 pixels a millimetre."""
    cv2 = pytest.importorskip("cv2", reason="dots need OpenCV, the extra `dots`")
    plan, folder = write_plan(tmp_path), tmp_path / "pictures"
    folder.mkdir()
    names = (*LIPS, "chin_199", "outer_lip_0")
    rows = [MARKERS_47.names.index(name) for name in names]

    def pixels(seen):
        return np.column_stack([200 + 4 * seen[rows, 0], 200 - 4 * (seen[rows, 1] + 95)])

    first = pixels(REST_MM)
    with (folder / "dots.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["marker", "column_px", "row_px", "mm_per_px"])
        writer.writerows(
            [name, *place.round(), 0.25] for name, place in zip(names, first, strict=True)
        )
    for pose, seen in looks(plan, ["jaw"]):
        picture = np.full((480, 400, 3), (120, 150, 200), dtype=np.uint8)
        for x, y in pixels(seen):
            centre = (round(16 * x), round(16 * y))
            cv2.circle(picture, centre, 4 * 16, (200, 60, 20), -1, cv2.LINE_AA, 4)
        cv2.imwrite(str(folder / f"pose_{pose}.png"), picture)
    out = tmp_path / "c.yaml"
    done = calibrate("fit", "--config", "face_jaw", "--plan", plan, "--markers", folder,
                   "-o", out, "--json")  # fmt: skip
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert said["gap_correlation"] > 0.95
    assert set(said["each_marker_rms_mm"]) == set(names)


def test_c3d_files_become_a_calibration(tmp_path):
    ezc3d = pytest.importorskip("ezc3d", reason="C3D needs ezc3d, the extra `mocap`")
    plan, folder = write_plan(tmp_path), tmp_path / "recorded"
    folder.mkdir()
    for pose, seen in looks(plan, ["jaw"]):
        file = ezc3d.c3d()
        file["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
        file["parameters"]["POINT"]["RATE"]["value"] = [100.0]
        file["parameters"]["POINT"]["LABELS"]["value"] = list(MARKERS_47.names)
        data = np.ones((4, 47, 1))
        data[:3, :, 0] = seen[:, [0, 2, 1]].T * np.array([[1.0], [-1.0], [1.0]])  # z up
        file["data"]["points"] = data
        file.write(str(folder / f"pose_{pose}.c3d"))
    done = calibrate("fit", "--config", "face_jaw", "--plan", plan, "--markers", folder,
                   "--axes", "x z -y", "-o", tmp_path / "c.yaml", "--json")  # fmt: skip
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["gap_correlation"] > 0.95


@pytest.mark.slow
def test_a_plan_is_refined_where_speech_will_be_and_a_picture_drawn(tmp_path):
    pytest.importorskip("matplotlib", reason="pictures need matplotlib, the extra `plots`")
    servos = ["jaw", "corner_left_out", "corner_right_out", "lip_protrusion"]
    plan, longer = write_plan(tmp_path, "face_four", 24), tmp_path / "longer.csv"
    markers = write_markers(plan, tmp_path / "m.csv", servos, LIPS)
    done = calibrate("plan", longer, "--config", "face_four", "--refine", plan,
                   "--markers", markers, "--poses", "24", "--json")  # fmt: skip
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["poses"] == 24 + 10 + 6
    assert longer.read_text().startswith(plan.read_text().rstrip()[:200])
    write_markers(longer, markers, servos, LIPS)
    done = calibrate("fit", "--config", "face_four", "--plan", longer, "--markers", markers,
                   "-o", tmp_path / "c.yaml")  # fmt: skip
    assert done.exit_code == 0, done.output
    assert "farthest off:" in done.stdout
    assert "max_current_ma: 294" in done.stdout
    assert calibrate("show", tmp_path / "c.yaml", "--plots", tmp_path / "plots").exit_code == 0
    assert (tmp_path / "plots" / "coverage.png").read_bytes()[:4] == b"\x89PNG"


def test_a_skeleton_has_a_jaw_and_no_lips(tmp_path):
    """Markers on the chin alone: the angle is the jaw blend, full range for the widest."""
    plan = write_plan(tmp_path, poses=20)
    names = ("chin_199", "jaw_152", "jaw_176", "jaw_400")
    markers = write_markers(plan, tmp_path / "m.csv", ["jaw"], names)
    out = tmp_path / "c.yaml"
    done = calibrate("fit", "--config", "face_jaw", "--plan", plan, "--markers", markers,
                   "-o", out, "--json")  # fmt: skip
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert said["method"] == "jaw alone"
    assert said["jaw_correlation"] > 0.99
    assert said["marker_rms_mm"] < 0.6
    calibration = load_calibration(out)
    frames = MODEL.animphos.samples[::5].reshape(-1, MODEL.n_components)
    degrees = [calibration.positions_deg(frame)[0] for frame in frames]
    assert np.quantile(degrees, 0.98) == pytest.approx(0.9 * 25.0, rel=0.15)
    assert abs(calibration.positions_deg(MODEL.rest)[0]) < 0.5
    few = write_markers(plan, tmp_path / "few.csv", ["jaw"], names[:2])
    done = calibrate("fit", "--config", "face_jaw", "--plan", plan, "--markers", few, "-o", out)
    assert done.exit_code == 1
    assert "only 2 markers are on the jaw, 3 are needed" in str(done.exception)
