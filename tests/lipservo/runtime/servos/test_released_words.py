"""What commands and pages say of servos that cannot confirm that they were let go."""

from hobby_bus import PULSES, WORDS

from firmware_bridge.capabilities import IN_MEMORY, mixed_capabilities
from lipservo.commands.run.status_words import state_words
from lipservo.dashboard.servo_remedies import listed_servos
from lipservo.runtime.servos.letting_go import Outcome

REPORT = {
    "complete": True, "at_rest": True, "dry_run": False, "confirmed": [], "unconfirmed": {},
    "released": ["jaw", "lip"], "released_words": WORDS,
}  # fmt: skip
STATUS = {
    "state": "stopped", "stopped": "soft", "stopped_by": "stop (1, root)", "stop_report": REPORT,
    "can_start": True, "servos": {"jaw": "waiting", "lip": "waiting"},
    "capabilities": PULSES.as_dict(),
    "health": [{"name": name, "servo_id": 1, "state": "driven", "temperature_degc": None,
                "load": None, "voltage_v": None, "torque_on": False} for name in ("jaw", "lip")],
}  # fmt: skip


def test_a_stop_says_the_words_of_the_bus():
    outcome = Outcome("face", released=["jaw", "lip"], released_words=WORDS)

    assert outcome.is_confirmed
    assert outcome.text() == f"face: {WORDS} (2 servos)"
    assert outcome.as_dict()["released"] == ["jaw", "lip"]
    assert "released" not in Outcome("face", confirmed=["jaw"]).as_dict()


def test_status_says_them_too():
    assert state_words(STATUS) == f"stopped by stop (1, root): {WORDS}; `lipservo start` drives it"


def test_the_page_calls_such_a_servo_neither_limp_nor_silent():
    for one in listed_servos(STATUS, is_fresh=True):
        assert one["state"] == "released"
        assert one["trouble"]["meaning"] == WORDS
        assert one["heard"]
        assert one["temperature_degc"] is None


def test_a_servo_that_was_never_heard_is_told_from_one_that_measures_nothing():
    measuring = {**STATUS, "capabilities": {"heat": True}}

    assert [one["heard"] for one in listed_servos(measuring, is_fresh=True)] == [False, False]


def test_on_two_buses_each_servo_is_judged_by_what_its_own_can_report():
    can = mixed_capabilities({"lips": PULSES, "neck": IN_MEMORY}, ["neck", "lips"])
    told = listed_servos({**STATUS, "capabilities": can.as_dict()}, is_fresh=True)

    assert [(one["name"], one["heard"]) for one in told] == [("jaw", False), ("lip", True)]


def test_a_stop_of_two_buses_says_what_was_confirmed_and_what_cannot_be():
    outcome = Outcome("face", confirmed=["yaw"], released=["jaw", "lip"], released_words=WORDS)
    report = {**REPORT, "confirmed": ["yaw"]}

    assert outcome.text() == f"face: {WORDS} (2 servos); confirmed by 1 servos"
    assert f"{WORDS}; limp, confirmed by 1 servos;" in state_words(
        {**STATUS, "stop_report": report}
    )
