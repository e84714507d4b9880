"""Hobby servos: what a face may say of one, and degrees as pulses."""

import numpy as np
import pytest
from pydantic import ValidationError

from firmware_bridge.pulse_servos import PulseScale, PulseServo

JAW = {
    "channel": 3, "positive": "opens", "min_deg": -2.0, "max_deg": 25.0,
    "max_speed_deg_s": 300.0, "us_per_deg": -11.0, "neutral_us": 1400.0,
}  # fmt: skip


def test_degrees_become_pulses_and_pulses_degrees():
    scale = PulseScale([PulseServo(**JAW), PulseServo(**JAW | {"us_per_deg": 10.0})])

    np.testing.assert_allclose(scale.pulses_us(np.array([10.0, 10.0])), [1290.0, 1500.0])
    np.testing.assert_allclose(scale.joints_deg(np.array([1290.0, 1500.0])), [10.0, 10.0])
    np.testing.assert_allclose(scale.max_us_s, [3300.0, 3000.0])
    assert (PulseServo(**JAW).address, PulseServo.address_key) == (3, "channel")


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"us_per_deg": 0.0}, "to reverse the joint"),
        ({"min_us": 1130.0}, "max_deg 25 deg needs a pulse of 1125 us, outside min_us..max_us"),
        ({"max_us": 3000.0}, "outside 400..2600"),
        ({"sign": -1}, "a negative us_per_deg"),
        ({"id": 3}, "Extra inputs"),
    ],
)
def test_what_no_servo_can_do_is_refused_in_words(wrong, says):
    with pytest.raises(ValidationError, match=says):
        PulseServo(**JAW | wrong)
