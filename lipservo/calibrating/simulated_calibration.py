"""Calibrations without a robot: the simulated face as designed, or one drawn from a seed."""

from calibration.calibration import CalibrationError
from calibration.capture.capture import Robot
from calibration.capture.trackers import SeenByComputation
from calibration.fit.learnt_face import fit_calibration
from calibration.fit.servo_response import identify
from calibration.simulated.elastic_robot import ElasticRobot
from calibration.simulated.practice_robot import family_of, guessed_joints, practice_robot
from calibration.simulated.robot import SimulatedRobot
from calibration.simulated.robot_family import RobotFamily
from calibration.simulated.servos import SimulatedServos
from lipservo.calibrating.calibration_result import CalibrationResult, fit_capture
from lipservo.calibrating.calibration_setup import CalibrationSetup
from lipservo.calibrating.measured_calibration import calibrate_on_servos, capture_face
from lipservo.calibrating.servo_lags import with_lags
from lipservo.face.held_face import HeldFace
from lipservo.face.servos import simulated_wire
from lipservo.terminal.output import MESSAGES
from lipsync.markers import MARKERS_47


def fit_simulated_face(setup: CalibrationSetup) -> CalibrationResult:
    """Nothing is measured: the simulated face, and the lags of servos simulated to the byte.

    A face with a port gets no lags here: `lipservo calibrate lags` asks its own servos.
    """
    servos = setup.servos
    if family_of(servos) is RobotFamily.ELASTIC:
        raise CalibrationError(
            f"the simulated face has no such servos as {', '.join(servos.names)}; `lipservo "
            "calibrate practise SEED` calibrates a simulated robot with joints of any names"
        )
    fitted = CalibrationResult(
        fit_calibration(setup.model, servos.joints, servos.face_checksum, rules=servos.rules)
    )
    if not setup.lags or setup.settings.bus.kind != "simulated":
        return fitted
    bus, clock = simulated_wire(setup.settings)
    with bus, HeldFace(setup.settings, bus, clock) as face:
        return with_lags(setup, face, fitted)


def practise_in_memory(
    setup: CalibrationSetup, seed: int, family: RobotFamily | None = None
) -> CalibrationResult:
    """A simulated robot drawn from a seed, in memory and at once. family: as `practice_robot`."""
    robot = _drawn_robot(setup, seed, family)
    on = Robot(robot.move, robot.measure)
    capture = capture_face(setup, MARKERS_47.names, on, seed=seed)
    result = fit_capture(setup, capture).graded_by(setup, on)
    if not setup.lags:
        return result
    joints = setup.servos.joints
    servos = SimulatedServos.drawn(len(joints), seed)
    return result.with_following(identify(servos.encoders_deg, joints, result.backlash_deg))


def practise_over_wire(
    setup: CalibrationSetup, seed: int, family: RobotFamily | None = None
) -> CalibrationResult:
    """The servos at a port, behind the skin of a robot drawn from a seed."""
    robot = _drawn_robot(setup, seed, family)
    tracker = SeenByComputation(MARKERS_47.names, lambda _: robot.measure())
    return calibrate_on_servos(setup, lambda _: tracker, robot.move, seed)


def _drawn_robot(
    setup: CalibrationSetup, seed: int, family: RobotFamily | None
) -> SimulatedRobot | ElasticRobot:
    rest_mm = setup.model.markers_mm(setup.model.rest[None])[0]
    robot = practice_robot(rest_mm, setup.servos, seed, family)
    guessed = guessed_joints(setup.servos, family)
    if guessed:
        MESSAGES.print(
            f"what moves at {', '.join(guessed)} is guessed: neither the name nor the word of "
            "`positive` in the face's YAML says it",
            soft_wrap=True,
            highlight=False,
        )
    return robot
