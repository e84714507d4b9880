"""A fresh calibration with what it was fitted from, before it is saved."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.calibration import Calibration, Following, ServoMemory
from calibration.capture.capture import Capture, Robot
from calibration.fit.correspondence import LIPS_NEEDED
from calibration.fit.jaw_fit import fit_jaw, jaw_agreement, jaw_markers
from calibration.fit.measured import MeasuredFit, fit_measured
from calibration.fit.procedure import take_grade
from lipservo.calibrating.calibration_setup import CalibrationSetup, today
from lipsync.arrays import Array

#: What one camera from the front does not see.
PROTRUSION = "protrusion"


@dataclass(frozen=True, slots=True)
class CalibrationResult:
    """fit: None where nothing was measured, or a jaw alone."""

    calibration: Calibration
    fit: MeasuredFit | None = None
    warnings: tuple[str, ...] = ()

    @property
    def backlash_deg(self) -> Array:
        """(n_servos,), 0 where nothing is known."""
        return backlash_of(self.calibration)

    def graded_by(self, setup: CalibrationSetup, on: Robot) -> "CalibrationResult":
        """The same with a grade, measured at ten poses of speech; a jaw alone gets none."""
        if self.fit is None:
            return self
        fit = take_grade(self.fit, setup.servos, self.fit.face.marker_names, on)
        found = fit.calibration
        calibration = replace(self.calibration, grade=found.grade, coverage=found.coverage)
        return CalibrationResult(calibration, fit, fit.warnings)

    def seen_by(self, setup: CalibrationSetup) -> "CalibrationResult":
        """The same; its file says what was not measured."""
        if setup.sees_forward:
            return self
        origin = replace(self.calibration.origin, not_measured=PROTRUSION)
        return replace(self, calibration=replace(self.calibration, origin=origin))

    def with_following(self, following: Following) -> "CalibrationResult":
        """The same, with lags."""
        return replace(self, calibration=replace(self.calibration, following=following))

    def with_memories(self, memories: Sequence[ServoMemory | None]) -> "CalibrationResult":
        """The same with what the servos hold in themselves, where all of them said so."""
        known = tuple(memory for memory in memories if memory is not None)
        if len(known) != len(self.calibration.servo_names):
            return self
        origin = replace(self.calibration.origin, servo_memories=known)
        return replace(self, calibration=replace(self.calibration, origin=origin))


def backlash_of(calibration: Calibration) -> Array:
    """(n_servos,) degrees, 0 where the calibration knows none."""
    if calibration.following is None:
        return np.zeros(len(calibration.servo_names))
    return calibration.following.backlash_deg


def fit_capture(setup: CalibrationSetup, capture: Capture) -> CalibrationResult:
    """A capture of this face, from wherever, to its calibration.

    One servo and no lips among the markers: the jaw alone.
    """
    servos = setup.servos
    lips = LIPS_NEEDED & set(capture.marker_names)
    if len(servos.joints) == 1 and jaw_markers(capture.marker_names) and not lips:
        jaw, warnings = fit_jaw(setup.model, capture, servos, date=today(), accept=setup.accept)
        return CalibrationResult(jaw, None, warnings).seen_by(setup)
    fit = fit_measured(setup.model, capture, servos, date=today(), accept=setup.accept)
    return CalibrationResult(fit.calibration, fit, fit.warnings).seen_by(setup)


def jaw_check(setup: CalibrationSetup, calibration: Calibration) -> float | None:
    """Correlation of the joint that opens with the speaker's jaw; None without such a joint."""
    positive = setup.servos.positive
    if "opens" not in positive:
        return None
    return jaw_agreement(setup.model, calibration, positive.index("opens"))
