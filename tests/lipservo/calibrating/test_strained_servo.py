"""Which servo counts as pressing: by its model's stall current and its own cap."""

import numpy as np
import pytest
from small_model import small_model

from lipservo.calibrating.calibration_setup import CalibrationSetup
from lipservo.calibrating.measured_calibration import strained_servo
from lipservo.settings.settings import load_shipped_face


@pytest.mark.parametrize(
    ("cap_ma", "efforts", "named"),
    [
        (None, (1.0,), None),
        (300.0, (0.10,), None),
        (300.0, (0.19,), "jaw"),  # 0.19 x 1470 mA is 279
    ],
)
def test_nine_tenths_of_the_cap_are_pressing(cap_ma, efforts, named):
    """An XL330-M288 stalls at 1.47 A."""
    settings = load_shipped_face("face_jaw")
    servo = settings.servos["jaw"].model_copy(
        update={"model": "XL330-M288", "max_current_ma": cap_ma}
    )
    face = settings.model_copy(update={"servos": {"jaw": servo}})
    setup = CalibrationSetup(face, small_model())
    assert strained_servo(setup, np.array(efforts)) == named


def test_a_model_that_does_not_measure_current_is_never_pressing():
    settings = load_shipped_face("face_jaw")
    servo = settings.servos["jaw"].model_copy(update={"model": "XL430-W250"})
    setup = CalibrationSetup(settings.model_copy(update={"servos": {"jaw": servo}}), small_model())
    assert strained_servo(setup, np.array([1.0])) is None
