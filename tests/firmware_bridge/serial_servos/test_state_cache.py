"""What was handed out of a bus stays as it was, though nothing is copied."""

import numpy as np
import pytest
from dynamixel_chain import MemoryFace, enable_all, run

from firmware_bridge.known_torque import Torque
from firmware_bridge.serial_servos.state_cache import ServoStateCache


@pytest.mark.parametrize(
    ("name", "shown", "value"),
    [
        ("tripped", "watchdog_tripped", True),
        ("hardware", "hardware_errors", 0x20),
        ("voltage_v", "voltage_v", 4.9),
    ],
)
def test_a_change_is_seen_in_the_next_health_and_not_in_the_one_before(name, shown, value):
    cache = ServoStateCache([1, 2, 3], 4095.0, [70.0] * 3, 0.0)
    before = cache.health(1.0, np.zeros(3))
    cache.set_one(name, 1, value)
    after = cache.health(2.0, np.zeros(3))

    assert getattr(before, shown)[1] != value
    assert getattr(after, shown)[1] == value
    np.testing.assert_array_equal(getattr(after, shown)[[0, 2]], getattr(before, shown)[[0, 2]])


def test_torque_that_changes_is_seen_in_the_next_health_and_not_in_the_one_before():
    cache = ServoStateCache([1, 2, 3], 4095.0, [70.0] * 3, 0.0)
    before = cache.health(1.0, np.zeros(3))
    cache.torque.note(1, 1.5, on=True)

    assert before.torque.tolist() == [Torque.UNKNOWN] * 3
    assert cache.health(2.0, np.zeros(3)).torque.tolist() == [2, Torque.ON, 2]


def test_what_is_handed_out_cannot_be_written():
    cache = ServoStateCache([1, 2, 3], 4095.0, [70.0] * 3, 0.0)
    handed_out = cache.health(0.0, np.zeros(3))

    for array in (handed_out.torque, handed_out.hardware_errors, handed_out.temperature_degc):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


def test_feedback_of_one_tick_does_not_change_in_the_next():
    face = MemoryFace(3)
    with face.bus:
        enable_all(face)
        first = run(face, 0.02, np.zeros(3))[0]
        kept = [first.positions_deg.copy(), first.effort.copy(), first.age_s.copy()]
        run(face, 1.0, [20.0, -20.0, 10.0])

    for array, copy in zip((first.positions_deg, first.effort, first.age_s), kept, strict=True):
        np.testing.assert_array_equal(array, copy)
