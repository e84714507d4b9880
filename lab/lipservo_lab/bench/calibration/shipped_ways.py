"""Every way to a calibration that is shipped, on elastic robots of every number of servos.

measured: a plan, markers, a fit; guided: a person's eye; practise: as the command of that name;
port: servos simulated to the byte behind a wire, their lags as well; hobby: the same robot's servos
on a Maestro, which report no positions; dots: pictures.

Pictures of blue dots on a simulated face, one a pose, for the way by coloured dots.

Seen from the front by a camera far away: no perspective, so that what depth costs is that alone
which one camera does not see. Needs OpenCV, the extra `dots`.
"""

import csv
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calibration.calibration import Calibration, CalibrationError
from calibration.capture.capture import Robot, capture_poses
from calibration.capture.dots import NAMES_FILE, DotsFolder
from calibration.capture.marker_files import read_capture, write_plan
from calibration.fit.guided import landmark_poses
from calibration.fit.measured import fit_measured, split_frames
from calibration.fit.retargeting import RobotMouth
from calibration.mouth_servos import MouthServos
from calibration.simulated.elastic_robot import ElasticFace
from calibration.simulated.robot import SimulatedRobot
from firmware_bridge.maestro.simulator import watched_servos
from lipservo.calibrating.calibration_setup import CalibrationSetup
from lipservo.calibrating.measured_calibration import CalibrationResult, fit_capture, with_lags
from lipservo.runtime.servos.assembly import simulated_wire
from lipservo.runtime.servos.held_face import HeldFace
from lipservo.settings.settings import FaceSettings
from lipservo_lab.bench.calibration.calibration_figures import guided_by_eye
from lipservo_lab.bench.calibration.elastic_draws import N_SERVOS, draw_elastic_robot
from lipservo_lab.bench.calibration.shown_motion import NAMES, played, shown, wanted_shapes
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array
from lipsync.markers import MARKERS_47

_PX_PER_MM, _DOT_MM, _MARGIN_MM = 4.0, 2.5, 15.0
#: Drawn so much larger first: edges of dots are soft.
_FINER = 4
_BLUE, _SKIN = (200, 60, 20), (120, 150, 200)
_BLUR_PX, _NOISE = 0.8, 6.0


def write_dots_pictures(
    folder: Path, marker_names: Sequence[str], markers_mm: Array, seed: int
) -> None:
    """Draw the markers of each pose as blue dots on skin: `pose_1.png` and so on.

    `dots.csv` gets the names and pixels of the dots in the first picture.

    Parameters
    ----------
    folder : Path
        Written into.
    marker_names : Sequence[str]
        (n_markers,).
    markers_mm : Array
        (n_poses, n_markers, 3) mm; x and y are drawn.
    seed : int
        Seed of the pictures' noise.
    """
    import cv2

    flat_mm = markers_mm[..., :2]
    left_mm, bottom_mm = flat_mm.min(axis=(0, 1)) - _MARGIN_MM
    right_mm, top_mm = flat_mm.max(axis=(0, 1)) + _MARGIN_MM
    size_px = (round(_PX_PER_MM * (right_mm - left_mm)), round(_PX_PER_MM * (top_mm - bottom_mm)))
    dots_px = _PX_PER_MM * np.stack([flat_mm[..., 0] - left_mm, top_mm - flat_mm[..., 1]], 2)
    noise = np.random.default_rng([seed, 41])
    for pose, pose_px in enumerate(dots_px):
        large = np.full((size_px[1] * _FINER, size_px[0] * _FINER, 3), _SKIN, np.uint8)
        radius = round(_FINER * _PX_PER_MM * _DOT_MM / 2)
        for column, row in pose_px:
            middle = (round(_FINER * (column + 0.5)), round(_FINER * (row + 0.5)))
            cv2.circle(large, middle, radius, _BLUE, -1, cv2.LINE_AA)
        small = cv2.resize(large, size_px, interpolation=cv2.INTER_AREA).astype(np.float64)
        soft = cv2.GaussianBlur(small, (0, 0), _BLUR_PX)
        picture = np.clip(soft + noise.normal(0.0, _NOISE, soft.shape), 0, 255).astype(np.uint8)
        cv2.imwrite(str(folder / f"pose_{pose + 1}.png"), picture)
    with (folder / NAMES_FILE).open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["marker", "column_px", "row_px", "mm_per_px"])
        for name, (column, row) in zip(marker_names, dots_px[0], strict=True):
            writer.writerow([name, round(column, 2), round(row, 2), 1.0 / _PX_PER_MM])


_N_FRAMES = 400
#: Time is simulated, but every tick of it is computed.
_PORT_SPEED_DEG_S = 120.0


@dataclass(frozen=True, slots=True)
class _Task:
    """A robot to calibrate: model: the speaker's face; face: the true robot.

    setup: what calibration knows, as from the robot's YAML. seed: of the sensor's noise.
    """

    model: FaceWithAnimPhos
    face: ElasticFace
    setup: CalibrationSetup
    seed: int

    @property
    def servos(self) -> MouthServos:
        return self.setup.servos

    def robot(self, noise_mm: float = 0.5) -> SimulatedRobot:
        return SimulatedRobot(self.face, noise_seed=self.seed, noise_mm=noise_mm)


def way_figures(
    model: FaceWithAnimPhos, seed: int, sizes: Iterable[int] = N_SERVOS
) -> dict[str, dict[str, float | str]]:
    """Calibrate a robot of each size in every way; return the true lip errors.

    Result: by way and number of servos (as text), mm rms, or the reason of the refusal.
    """
    error_of: dict[str, dict[str, float | str]] = {way: {} for way in WAYS}
    frames = split_frames(model, 0)[1][:_N_FRAMES]
    for n_servos in sizes:
        task = _task(model, seed, n_servos)
        wanted = wanted_shapes(model, task.face, task.servos, frames)
        for way, calibrate in WAYS.items():
            try:
                output_deg = played(task.face, calibrate(task), frames)
                error_of[way][str(n_servos)] = shown(task.face, output_deg, wanted).off_mm
            except CalibrationError as error:
                error_of[way][str(n_servos)] = f"refused: {error}"
    return error_of


def _task(model: FaceWithAnimPhos, seed: int, n_servos: int) -> _Task:
    """Return an elastic robot drawn by a seed, with settings of a face of `n_servos` Dynamixels."""
    draw, servos = draw_elastic_robot(model.markers_mm(model.rest[None])[0], seed, n_servos)
    servo_settings = {
        joint.name: {
            "id": 11 + n,
            "model": "XL330-M288",
            "positive": servos.positive[n],
            "min_deg": joint.min_deg,
            "max_deg": joint.max_deg,
            "max_speed_deg_s": 400.0,
        }
        for n, joint in enumerate(servos.joints)
    }
    settings = FaceSettings.model_validate(
        {"name": f"elastic {seed}", "rate_hz": 30.0, "servos": servo_settings}
    )
    setup = CalibrationSetup(settings, model, quiet=True, speed_deg_s=_PORT_SPEED_DEG_S)
    return _Task(model, ElasticFace(draw), setup, seed)


def _calibrate_measured(task: _Task) -> Calibration:
    """Calibrate a robot from markers at every pose of one plan, without grade or lags."""
    plan, robot = task.setup.procedure(task.seed).whole_range_plan(), task.robot()
    capture = capture_poses(plan, MARKERS_47.names, robot.move, robot.measure)
    return fit_measured(task.model, capture, task.servos).calibration


def _calibrate_by_eye(task: _Task) -> Calibration:
    """Return a guided calibration: a person finds the poses that look most like the speaker's."""
    frames = np.array([pose.coefficients for pose in landmark_poses(task.model)])
    wanted = wanted_shapes(task.model, task.face, task.servos, frames)
    mouth = RobotMouth(task.face.markers_mm, NAMES, task.servos.limits_deg)
    nearest_deg = mouth.nearest_deg(wanted.features)
    is_jaw = np.arange(len(task.servos.joints)) == task.face.draw.jaw
    return guided_by_eye(task.model, task.servos, nearest_deg, is_jaw, task.seed)


def _calibrate_as_practised(task: _Task) -> Calibration:
    """Calibrate a robot by the whole procedure, as `lipservo calibrate practise` does."""
    robot = task.robot()
    return _run_procedure(task, Robot(robot.move, robot.measure)).calibration


def _calibrate_at_port(task: _Task) -> Calibration:
    """Calibrate a robot over servos simulated to the byte, whose lags are measured as well."""
    robot, settings = task.robot(), task.setup.settings
    bus, clock = simulated_wire(settings)
    with HeldFace(settings, clock, bus=bus, speed_deg_s=_PORT_SPEED_DEG_S) as held:

        def move(goal_deg: Array) -> Array:
            reached_deg = held.move(goal_deg)
            robot.move(reached_deg)
            return reached_deg

        result = _run_procedure(task, Robot(move, robot.measure))
        return with_lags(task.setup, held, result).calibration


def _calibrate_hobby(task: _Task) -> Calibration:
    """Calibrate a robot with hobby servos, which report no position: goals count as positions."""
    robot, settings = task.robot(), _on_maestro(task.setup.settings)
    maestro = watched_servos(settings.wiring)
    with HeldFace(settings, maestro.clock, bus=maestro.bus, speed_deg_s=_PORT_SPEED_DEG_S) as held:

        def move(goal_deg: Array) -> Array:
            reached_deg = held.move(goal_deg)
            robot.move(maestro.shafts_deg())
            return reached_deg

        return _run_procedure(task, Robot(move, robot.measure)).calibration


def _on_maestro(settings: FaceSettings) -> FaceSettings:
    """Return the settings of the same face with hobby servos on a Maestro."""
    servos = {
        name: {
            "channel": channel,
            "positive": servo.positive,
            "min_deg": servo.min_deg,
            "max_deg": servo.max_deg,
            "max_speed_deg_s": servo.max_speed_deg_s,
            "us_per_deg": 10.0,
        }
        for channel, (name, servo) in enumerate(settings.servos.items())
    }
    return FaceSettings.model_validate(
        {
            "name": settings.name,
            "rate_hz": 50.0,
            "bus": {"kind": "maestro", "model": "mini12"},
            "servos": servos,
        }
    )


def hobby_over_positions(ways: Mapping[str, Mapping[str, float | str]]) -> float:
    """Return the error on hobby servos over that on servos with positions: the median of all sizes.

    ways: result of `way_figures`. A refused robot of hobby servos counts as infinite; sizes whose
    servos with positions were refused do not count. NaN: there are no others.
    """
    ratios = [
        _error_ratio(hobby_mm, ways["port"][size])
        for size, hobby_mm in ways["hobby"].items()
        if not isinstance(ways["port"][size], str)
    ]
    return float(np.median(ratios)) if ratios else np.nan


def _error_ratio(hobby_mm: float | str, positions_mm: float | str) -> float:
    return np.inf if isinstance(hobby_mm, str) else hobby_mm / float(positions_mm)


def _run_procedure(task: _Task, robot: Robot) -> CalibrationResult:
    """Do both parts of a capture, fit it, and grade the calibration on the robot."""
    procedure = task.setup.procedure(task.seed)
    capture = procedure.capture(MARKERS_47.names, Robot(robot.move, robot.measure))
    return fit_capture(task.setup, capture).graded_by(task.setup, robot, capture.n_planned)


def _calibrate_by_dots(task: _Task) -> Calibration:
    """Calibrate a robot from pictures with blue dots, without depth; raises CalibrationError."""
    setup = replace(task.setup, sees_forward=False)
    plan, robot = setup.procedure(task.seed).whole_range_plan(), task.robot(noise_mm=0.0)
    true_capture = capture_poses(plan, MARKERS_47.names, robot.move, robot.measure)
    with tempfile.TemporaryDirectory() as temporary:
        folder, file = Path(temporary) / "pictures", Path(temporary) / "poses.csv"
        folder.mkdir()
        write_plan(plan, file)
        write_dots_pictures(folder, MARKERS_47.names, true_capture.markers_mm, task.seed)
        capture = read_capture(file, folder, task.servos.names, read=DotsFolder(folder).readings)
    return fit_measured(task.model, capture, setup.servos).calibration


WAYS: Mapping[str, Callable[[_Task], Calibration]] = {
    "measured": _calibrate_measured,
    "guided": _calibrate_by_eye,
    "practise": _calibrate_as_practised,
    "port": _calibrate_at_port,
    "hobby": _calibrate_hobby,
    "dots": _calibrate_by_dots,
}
