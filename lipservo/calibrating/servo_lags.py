"""`lipservo calibrate lags`, and the last part of `measure`: how late each servo follows."""

from dataclasses import replace

from calibration.calibration import Calibration, Following, check_calibration, check_servo_memories
from calibration.fit.servo_response import identify
from lipservo.calibrating.calibration_result import CalibrationResult, backlash_of
from lipservo.calibrating.calibration_setup import CalibrationSetup, held_servos, progress_bar
from lipservo.face.held_face import HeldFace
from lipservo.face.servos import servo_memories, simulated_wire


def with_lags(
    setup: CalibrationSetup, face: HeldFace, result: CalibrationResult
) -> CalibrationResult:
    """The same, with the lags of servos that are held."""
    return result.with_following(_measured_following(setup, face, result.calibration))


def measure_lags(setup: CalibrationSetup, calibration: Calibration) -> Calibration:
    """The same map with the lags, speeds and bandwidths that this face's servos have now.

    Backlash stays as it was: it comes from the markers. Raises CalibrationError for a calibration
    of another face or model, or of servos that were set up anew since.
    """
    names = setup.servos.names
    check_calibration(calibration, setup.model, names, setup.settings.checksum)
    if setup.settings.bus.kind == "simulated":
        bus, clock = simulated_wire(setup.settings)
        with bus, HeldFace(setup.settings, bus, clock) as face:
            following = _measured_following(setup, face, calibration)
    else:
        check_servo_memories(calibration, servo_memories(setup.settings))
        with held_servos(setup) as face:
            following = _measured_following(setup, face, calibration)
    return replace(calibration, following=following)


def _measured_following(
    setup: CalibrationSetup, face: HeldFace, calibration: Calibration
) -> Following:
    joints = setup.servos.joints
    with progress_bar(setup, "chirps", len(joints)) as done:
        return identify(
            face.drive, joints, backlash_of(calibration), rate_hz=face.rate_hz, progress=done
        )
