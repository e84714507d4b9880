"""Plain words for every bit that a servo may set."""

import pytest

from firmware_bridge.health import HardwareError
from lipservo.dashboard.servo_remedies import error_words, told_servos


@pytest.mark.parametrize("error", list(HardwareError))
def test_every_hardware_error_has_a_meaning_and_a_remedy(error):
    (words,) = error_words(int(error))
    assert words["error"] == error.name.lower().replace("_", " ")
    assert words["meaning"]
    assert words["remedy"]


def test_several_and_unknown_bits():
    assert [each["error"] for each in error_words(0x24)] == ["overheating", "overload"]
    assert [each["error"] for each in error_words(0x82)] == ["0x82"]
    assert error_words(0) == error_words(None) == []


def test_a_face_that_does_not_answer_has_servos_of_which_nothing_is_known():
    status = {
        "servos": {"jaw": "driven"},
        "health": [{"name": "jaw", "servo_id": 11, "temperature_degc": 40.0, "load": 0.1}],
    }
    (fresh,) = told_servos(status, is_fresh=True)
    (old,) = told_servos(status, is_fresh=False)

    assert (fresh["state"], fresh["answers"], fresh["load"]) == ("driven", True, 0.1)
    assert (old["state"], old["answers"], old["load"]) == ("unknown", False, None)
    assert told_servos(None, is_fresh=True) == []
