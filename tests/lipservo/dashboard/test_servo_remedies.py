"""Plain words for every bit that a servo may set."""

import pytest

from firmware_bridge.bus import HardwareError
from lipservo.dashboard.servo_remedies import error_words, listed_servos


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
    (fresh,) = listed_servos(status, is_fresh=True)
    (old,) = listed_servos(status, is_fresh=False)

    assert (fresh["state"], fresh["answers"], fresh["load"]) == ("driven", True, 0.1)
    assert (old["state"], old["answers"], old["load"]) == ("unknown", False, None)
    assert listed_servos(None, is_fresh=True) == []


def test_servos_of_a_stopped_face_are_as_they_confirmed():
    report = {"confirmed": ["lids"], "unconfirmed": {"jaw": "does not answer"}}
    status = {"state": "stopped", "stopped": "soft", "stop_report": report}

    found = {each["name"]: each for each in listed_servos(status, is_fresh=True)}

    assert {name: each["state"] for name, each in found.items()} == {
        "lids": "limp",
        "jaw": "unconfirmed",
    }
    assert "not confirmed that it is limp: does not answer" in found["jaw"]["trouble"]["meaning"]
    assert found["lids"]["trouble"] is None
    # A report of a stop that is over, and one of a face that does not answer, say nothing.
    driven = {**status, "state": "driven", "stopped": None, "servos": {"jaw": "driven"}}
    assert [each["state"] for each in listed_servos(driven, is_fresh=True)] == ["driven"]
    assert listed_servos(status, is_fresh=False) == []
