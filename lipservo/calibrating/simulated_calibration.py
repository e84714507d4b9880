"""Calibrations without a robot: the simulated face as designed, or one drawn from a seed."""

from calibration.capture.trackers import SeenByComputation
from calibration.fit.learnt_face import fit_calibration
from calibration.fit.servo_response import identify
from calibration.simulated.robot import SimulatedRobot, draw_robot
from calibration.simulated.servos import SimulatedServos
from lipservo.calibrating.calibration_result import CalibrationResult, fit_capture
from lipservo.calibrating.calibration_setup import CalibrationSetup
from lipservo.calibrating.measured_calibration import calibrate_on_servos, capture_face
from lipservo.calibrating.servo_lags import with_lags
from lipservo.face.held_face import HeldFace
from lipservo.face.servos import simulated_wire
from lipsync.markers import MARKERS_47


def fit_simulated_face(setup: CalibrationSetup) -> CalibrationResult:
    """Nothing is measured: the simulated face, and the lags of servos simulated to the byte.

    A face with a port gets no lags here: `lipservo calibrate lags` asks its own servos.
    """
    servos = setup.servos
    fitted = CalibrationResult(
        fit_calibration(setup.model, servos.joints, servos.face_checksum, rules=servos.rules)
    )
    if not setup.lags or setup.settings.bus.kind != "simulated":
        return fitted
    bus, clock = simulated_wire(setup.settings)
    with bus, HeldFace(setup.settings, bus, clock) as face:
        return with_lags(setup, face, fitted)


def practise_in_memory(setup: CalibrationSetup, seed: int) -> CalibrationResult:
    """A simulated robot drawn from a seed, in memory and at once."""
    robot = _drawn_robot(setup, seed)
    capture = capture_face(setup, MARKERS_47.names, robot.move, robot.measure, seed=seed)
    result = fit_capture(setup, capture)
    if not setup.lags:
        return result
    joints = setup.servos.joints
    servos = SimulatedServos.drawn(len(joints), seed)
    return result.with_following(identify(servos.encoders_deg, joints, result.backlash_deg))


def practise_over_wire(setup: CalibrationSetup, seed: int) -> CalibrationResult:
    """The servos at a port, behind the skin of a robot drawn from a seed."""
    robot = _drawn_robot(setup, seed)
    tracker = SeenByComputation(MARKERS_47.names, lambda _: robot.measure())
    return calibrate_on_servos(setup, lambda _: tracker, robot.move, seed)


def _drawn_robot(setup: CalibrationSetup, seed: int) -> SimulatedRobot:
    rest_mm = setup.model.markers_mm(setup.model.rest[None])[0]
    return SimulatedRobot(draw_robot(rest_mm, setup.servos.names, seed), noise_seed=seed)
