"""Every way to a calibration that is shipped, on elastic robots of every number of servos.

measured: a plan, markers, a fit, by files; guided: a person's eye; practise: as the command of that
name; port: servos simulated to the byte behind a wire, their lags as well; dots: pictures.
"""

import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from calibration.calibration import Calibration, CalibrationError
from calibration.capture.capture import Robot, capture_poses
from calibration.capture.dots_folder import DotsFolder
from calibration.capture.marker_files import read_capture, write_plan
from calibration.fit.guided import CLOSED, fit_guided, landmark_poses
from calibration.fit.measured import fit_measured, split_frames
from calibration.mouth_servos import MouthServos
from calibration.run.inverse import nearest_poses_deg
from calibration.simulated.elastic_family import N_SERVOS, draw_elastic_robot
from calibration.simulated.elastic_robot import ElasticFace, ElasticRobot
from lipservo.calibrating.calibration_result import CalibrationResult, fit_capture
from lipservo.calibrating.calibration_setup import CalibrationSetup
from lipservo.calibrating.servo_lags import with_lags
from lipservo.face.held_face import HeldFace
from lipservo.face.servos import simulated_wire
from lipservo.settings.settings import FaceSettings, ServoSettings
from lipservo_lab.bench.calibration.dots_pictures import write_dots_pictures
from lipservo_lab.bench.calibration.shown_motion import played, shown
from lipservo_lab.bench.calibration.wanted_shapes import NAMES, wanted_shapes
from lipservo_lab.bench.calibration_figures import PERSON_DEG, PERSON_JAW_DEG
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array
from lipsync.markers import MARKERS_47

_N_FRAMES = 400
#: Time is simulated, but every tick of it is computed.
_PORT_SPEED_DEG_S = 120.0


@dataclass(frozen=True, slots=True)
class _Task:
    """A robot to calibrate. setup: its face as a YAML would say it."""

    model: FaceWithAnimPhos
    face: ElasticFace
    setup: CalibrationSetup
    seed: int

    @property
    def servos(self) -> MouthServos:
        return self.setup.servos

    def robot(self, noise_mm: float = 0.5) -> ElasticRobot:
        return ElasticRobot(self.face, noise_seed=self.seed, noise_mm=noise_mm)


def way_figures(
    model: FaceWithAnimPhos, seed: int, sizes: Iterable[int] = N_SERVOS
) -> dict[str, dict[str, float | str]]:
    """For each way and number of servos the true lip error, mm rms, or why it was refused."""
    found: dict[str, dict[str, float | str]] = {way: {} for way in WAYS}
    frames = split_frames(model, 0)[1][:_N_FRAMES]
    for n_servos in sizes:
        task = _task(model, seed, n_servos)
        wanted = wanted_shapes(model, task.face, task.servos, frames)
        for way, calibrate in WAYS.items():
            try:
                output_deg = played(task.face, calibrate(task), frames)
                found[way][str(n_servos)] = shown(task.face, output_deg, wanted).off_mm
            except CalibrationError as error:
                found[way][str(n_servos)] = f"refused: {error}"
    return found


def _task(model: FaceWithAnimPhos, seed: int, n_servos: int) -> _Task:
    draw, servos = draw_elastic_robot(model.markers_mm(model.rest[None])[0], seed, n_servos)
    settings = FaceSettings(
        name=f"elastic {seed}",
        rate_hz=30,
        servos={
            joint.name: ServoSettings(
                id=11 + n,
                model="XL330-M288",
                positive=servos.positive[n],
                min_deg=joint.min_deg,
                max_deg=joint.max_deg,
                max_speed_deg_s=400,
            )
            for n, joint in enumerate(servos.joints)
        },
    )
    setup = CalibrationSetup(settings, model, quiet=True, speed_deg_s=_PORT_SPEED_DEG_S)
    return _Task(model, ElasticFace(draw), setup, seed)


def _measured(task: _Task) -> Calibration:
    plan, robot = task.setup.procedure(task.seed).whole_range_plan(), task.robot()
    capture = capture_poses(plan, MARKERS_47.names, robot.move, robot.measure)
    return fit_measured(task.model, capture, task.servos).calibration


def _guided(task: _Task) -> Calibration:
    """The person finds the pose that looks most like the speaker's, and is off by a few keys."""
    poses = landmark_poses(task.model)
    frames = np.array([pose.coefficients for pose in poses])
    wanted = wanted_shapes(task.model, task.face, task.servos, frames)
    of, limits = NAMES.shape_features, task.servos.limits_deg
    best_deg = nearest_poses_deg(task.face.markers_mm, wanted.features, of, limits)
    is_jaw = np.arange(len(task.servos.joints)) == task.face.draw.jaw
    off_deg = np.where(is_jaw, PERSON_JAW_DEG, PERSON_DEG)
    noise = np.random.default_rng([task.seed, 2]).normal(size=best_deg.shape)
    made_deg = np.clip(np.rint(best_deg + off_deg * noise), *limits)
    made_deg[[pose.name == CLOSED for pose in poses]] = best_deg[0]  # lips are felt to touch
    made = {pose.name: degrees for pose, degrees in zip(poses, made_deg, strict=True)}
    return fit_guided(task.model, task.servos, made)


def _practise(task: _Task) -> Calibration:
    robot = task.robot()
    return _whole_procedure(task, Robot(robot.move, robot.measure)).calibration


def _port(task: _Task) -> Calibration:
    robot, settings = task.robot(), task.setup.settings
    bus, clock = simulated_wire(settings)
    with bus, HeldFace(settings, bus, clock, speed_deg_s=_PORT_SPEED_DEG_S) as held:

        def move(goal_deg: Array) -> Array:
            reached_deg = held.move(goal_deg)
            robot.move(reached_deg)
            return reached_deg

        result = _whole_procedure(task, Robot(move, robot.measure))
        return with_lags(task.setup, held, result).calibration


def _whole_procedure(task: _Task, on: Robot) -> CalibrationResult:
    """Both parts of the capture, the fit, and the grade."""
    procedure = task.setup.procedure(task.seed)
    capture = procedure.capture(MARKERS_47.names, on.move, on.measure)
    return fit_capture(task.setup, capture).graded_by(task.setup, on)


def _dots(task: _Task) -> Calibration:
    setup = replace(task.setup, sees_forward=False)
    plan, robot = setup.procedure(task.seed).whole_range_plan(), task.robot(noise_mm=0.0)
    seen = capture_poses(plan, MARKERS_47.names, robot.move, robot.measure)
    with tempfile.TemporaryDirectory() as name:
        folder, file = Path(name) / "pictures", Path(name) / "poses.csv"
        folder.mkdir()
        write_plan(plan, file)
        write_dots_pictures(folder, MARKERS_47.names, seen.markers_mm, task.seed)
        capture = read_capture(
            file, folder, task.servos.names, read=DotsFolder(folder).all_readings
        )
    return fit_measured(task.model, capture, setup.servos).calibration


WAYS: Mapping[str, Callable[[_Task], Calibration]] = {
    "measured": _measured,
    "guided": _guided,
    "practise": _practise,
    "port": _port,
    "dots": _dots,
}
