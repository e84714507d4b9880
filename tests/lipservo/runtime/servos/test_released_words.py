"""What commands and pages say of servos that cannot confirm that they were let go."""

from pathlib import Path

import pytest
from hobby_bus import PULSES, WORDS

from firmware_bridge.capabilities import IN_MEMORY, mixed_capabilities
from firmware_bridge.process.control_client import RunningFace
from firmware_bridge.stopping import StopLevel
from lipservo.commands.run.status_words import state_words
from lipservo.dashboard.servo_remedies import listed_servos
from lipservo.runtime.servos import letting_go
from lipservo.runtime.servos.letting_go import Outcome, _merge_into, stop_faces

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


def test_the_problem_of_one_bus_is_said_of_it_alone_beside_what_servos_of_the_other_confirmed():
    outcome = Outcome("face")
    _merge_into(outcome, Outcome("a", problem="no servo answers there"), "lips")
    left = {"id 2": "does not answer"}
    _merge_into(outcome, Outcome("b", confirmed=["id 1"], unconfirmed=left), "neck")

    assert outcome.text() == (
        "face: lips: no servo answers there; else confirmed by 1 servos, "
        "NOT by neck id 2: does not answer"
    )


@pytest.mark.parametrize(
    ("unkilled", "words"),
    [
        ([], "was killed, and none of its ports was found: `lipservo limp --port PORT`"),
        ([7], "processes [7] cannot be killed; switch the servos' power off"),
    ],
)
def test_a_hung_face_none_of_whose_ports_is_found_is_not_called_limp(monkeypatch, unkilled, words):
    def hang(*_given, **_named):
        raise TimeoutError

    for name, found in {
        "stop_and_wait": hang, "send_stop": lambda *_a, **_k: None,
        "holders_of_socket": lambda _path: [7], "with_children": list,
        "is_ours": lambda _pid: True, "ports_held_by": lambda _pid: [],
        "end_hung": lambda _pids: unkilled,
    }.items():  # fmt: skip
        monkeypatch.setattr(letting_go, name, found)

    (outcome,) = stop_faces([RunningFace("tim", 7, Path("/none/tim-7.sock"))], StopLevel.LIMP)

    assert not outcome.is_confirmed
    assert outcome.text() == f"tim: {words}"


def test_a_hung_face_is_ended_with_its_children_that_have_other_names(monkeypatch):
    """The command lines of its voice's process and of a pin's guard do not say `lipservo`."""

    def hang(*_given, **_named):
        raise TimeoutError

    ended = []
    for name, found in {
        "stop_and_wait": hang, "send_stop": lambda *_a, **_k: None,
        "holders_of_socket": lambda _path: [7], "with_children": lambda _pids: [7, 8],
        "is_ours": lambda pid: pid == 7, "ports_held_by": lambda _pid: [],
        "end_hung": lambda pids: ended.extend(pids) or [],
    }.items():  # fmt: skip
        monkeypatch.setattr(letting_go, name, found)

    stop_faces([RunningFace("tim", 7, Path("/none/tim-7.sock"))], StopLevel.LIMP)

    assert ended == [7, 8]
