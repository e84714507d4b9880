"""Words that change something: all or none, one line where refused, kept in their sequence."""

import threading
from contextlib import contextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_bridge.process.commands import CommandQueue, Setting, command_answer
from firmware_bridge.process.control_client import (
    arm_jog,
    ask,
    change_settings,
    end_jog,
    jog_servo,
    switch_servo,
)
from firmware_bridge.process.control_socket import LONGEST_WORD, ControlSocket
from firmware_bridge.stopping import ArmJog, EndJog, JogTo, ServoOrder, ServoSwitch

PATIENCE_S = 60.0
SETTINGS = {"strength": Setting(1.0, 0.0, 1.5), "smoothness": Setting(0.0, 0.0, 1.0)}


@contextmanager
def served(path, commands):
    """A face that answers; what was ordered is in the list."""
    ordered, over = [], threading.Event()
    with ControlSocket(path, {"name": "tom"}, commands) as control:

        def loop():
            while not over.wait(0.001):
                control.poll()
                control.answer(dict)
                ordered.extend(control.take_orders())

        thread = threading.Thread(target=loop)
        thread.start()
        try:
            yield ordered
        finally:
            over.set()
            thread.join()


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"strength": 0.5, "smoothness": 2.0}, "smoothness is 2; allowed: 0 to 1"),
        ({"strength": 0.5, "x": 1.0}, "'x': no such setting; there are: strength"),
        ({"strength": float("nan"), "smoothness": 1.0}, "strength is nan; allowed"),
        ({"strength": 0.5, "two words": 1.0}, "'two words': no such setting"),
        ({f"name_{n}": 0.1234567890123456 for n in range(80)}, "too many settings at once"),
    ],
)
def test_several_settings_are_changed_together_or_not_at_all(tmp_path, values, said):
    changes = []
    commands = CommandQueue(SETTINGS, on_change=changes.append)
    with served(tmp_path / "face.sock", commands):
        refused = change_settings(tmp_path / "face.sock", values)
        assert set(refused) == {"error"}
        assert refused["error"].startswith(said)
        assert (commands.take_changes(), changes) == ({}, [])
        both = {"strength": 0.25, "smoothness": 1.0}
        taken = change_settings(tmp_path / "face.sock", both)
        one = change_settings(tmp_path / "face.sock", {"strength": 0.5})

    assert taken == {"set": both, "name": "tom"}
    assert one == {"set": {"strength": 0.5}, "name": "tom"}
    assert changes == [both, {"strength": 0.5}]
    assert commands.values == {"strength": 0.5, "smoothness": 1.0}


@pytest.mark.parametrize(
    "word",
    ["set", "set strength", "set strength 1 smoothness", "set strength 1 strength 0.5"],
)
def test_half_a_pair_and_a_name_twice_change_nothing(word):
    commands = CommandQueue(SETTINGS)

    assert set(command_answer(word, commands, str)) == {"error"}
    assert commands.take_changes() == {}


def test_a_word_that_is_cut_off_is_refused_as_its_last_number_may_be_another(tmp_path):
    commands = CommandQueue(SETTINGS)
    word = "set strength 0." + "0" * (LONGEST_WORD - 16) + "12"
    assert len(word) == LONGEST_WORD + 1
    with served(tmp_path / "face.sock", commands):
        assert "longer than" in ask(tmp_path / "face.sock", word, PATIENCE_S)["error"]
        assert "error" not in ask(tmp_path / "face.sock", word[:-1], PATIENCE_S)


def test_orders_come_out_as_they_were_asked_and_say_who_asked(tmp_path):
    commands, path = CommandQueue(), tmp_path / "face.sock"
    commands.attend(lambda _order: "")
    with served(path, commands) as ordered:
        answers = [
            switch_servo(path, "jaw", ServoSwitch.OFF),
            switch_servo(path, "jaw", ServoSwitch.REBOOT),
            arm_jog(path),
            jog_servo(path, "lip", -3.5),
            end_jog(path),
            switch_servo(path, "no jaw", ServoSwitch.OFF),
            jog_servo(path, "x" * 5000, 1.0),
        ]

    name = {"name": "tom"}
    assert answers[:5] == [
        {"servo": "jaw", "asked": "off", **name},
        {"servo": "jaw", "asked": "reboot", **name},
        {"jog": "arm", **name},
        {"jog": "lip", "position_deg": -3.5, **name},
        {"jog": "end", **name},
    ]
    assert [set(answer) for answer in answers[5:]] == [{"error"}] * 2
    switches, rest = ordered[:2], ordered[2:]
    assert [(each.name, each.switch) for each in switches] == [("jaw", "off"), ("jaw", "reboot")]
    assert all(each.requested_by.startswith("process ") for each in switches)
    assert rest == [ArmJog(), JogTo("lip", -3.5), EndJog()]


def test_without_anybody_who_drives_the_servos_orders_are_refused():
    """A supervisor whose bridge is down."""
    commands = CommandQueue()

    for word in ("servo jaw off", "servo jaw on", "jog arm", "jog jaw 3", "jog end"):
        assert command_answer(word, commands, str) == {
            "error": "no bridge drives the servos just now; ask again"
        }
    assert commands.take_orders() == []


def test_what_is_refused_is_not_kept_and_there_is_room_for_a_few_orders_only():
    commands = CommandQueue()
    commands.attend(lambda order: "no" if order == ArmJog() else "")

    assert command_answer("jog arm", commands, str) == {"error": "no"}
    answers = [command_answer("jog jaw 1", commands, str) for _ in range(1000)]
    assert "too many" in answers[-1]["error"]
    assert 0 < len(commands.take_orders()) < 100
    assert command_answer("jog jaw 1", commands, str) == {"jog": "jaw", "position_deg": 1.0}


def test_words_of_others_are_left_to_them():
    assert command_answer("status", CommandQueue(), str) is None
    assert command_answer("setting strength 1", CommandQueue(), str) is None


@given(st.text("ab of.15-e\té\0", min_size=1, max_size=30).filter(str.strip))
def test_whatever_is_said_never_raises(text):
    commands = CommandQueue(SETTINGS)
    commands.attend(lambda _order: "")
    for first in ("", "set ", "servo ", "jog "):
        answer = command_answer(first + text, commands, str)
        assert answer is None or "\n" not in str(answer.get("error", ""))
    for order in commands.take_orders():
        assert isinstance(order, (ArmJog, EndJog, JogTo, ServoOrder))
