"""What is known of torque comes from evidence alone, and is forgotten where evidence is lost."""

import itertools

import numpy as np
import pytest

from firmware_bridge.errors import PortError, PortGone, ServoError
from firmware_bridge.known_torque import KnownTorque, Torque, unknown_when_lost

JAW, LIP, YAW = range(3)


def known(*states, at_s=1.0):
    torque = KnownTorque(len(states))
    for index, on in enumerate(states):
        if on is not None:
            torque.note(index, at_s, on=on)
    return torque


def test_before_any_evidence_nothing_is_known():
    torque = KnownTorque(2)

    assert torque.as_json() == [None, None]
    assert torque.states.tolist() == [Torque.UNKNOWN, Torque.UNKNOWN]
    assert torque.records(5.0) == [{"on": None, "age_s": None}] * 2


def test_what_a_servo_confirmed_is_known_of_it_alone_and_since_when():
    torque = KnownTorque(3)
    torque.note(JAW, 5.0, on=True)
    torque.note(LIP, 6.0, on=False)

    assert torque.as_json() == [True, False, None]
    assert torque.at_s.tolist() == [5.0, 6.0, -np.inf]
    torque.note(JAW, 7.0, on=True)
    assert torque.at_s[JAW] == 7.0


@pytest.mark.parametrize(
    ("forgotten", "left"),
    [(None, [None, None, None]), ([LIP], [True, None, True]), ([], [True, False, True])],
)
def test_what_may_have_changed_is_not_known_any_more(forgotten, left):
    torque = known(True, False, True)
    torque.forget(forgotten)

    assert torque.as_json() == left


@pytest.mark.parametrize("states", list(itertools.product([True, False, None], repeat=2)))
def test_a_face_holds_lies_limp_or_nobody_knows(states):
    """One that is on suffices; that all are off has to be known of all."""
    torque = known(*states)

    assert torque.any_on is (True if True in states else None if None in states else False)
    assert torque.all_on == (states == (True, True))


def test_what_is_known_is_told_with_the_age_of_its_evidence():
    torque = known(False, True)
    torque.note(LIP, 3.0, on=False)
    torque.forget([JAW])

    assert torque.records(3.5)[LIP] == {"on": False, "age_s": 0.5}
    assert torque.records(3.5)[JAW] == {"on": None, "age_s": 2.5}
    assert torque.records(2.9)[LIP]["age_s"] == 0.0, "a tick is planned before what it hears"


@pytest.mark.parametrize("change", ["note", "forget", "forget all", "take"])
def test_what_was_handed_out_does_not_change_and_cannot_be_changed(change):
    torque = known(True, True)
    handed_out = torque.states
    if change == "note":
        torque.note(JAW, 2.0, on=False)
    elif change == "forget":
        torque.forget([JAW])
    elif change == "forget all":
        torque.forget()
    else:
        torque.take(np.array([JAW]), known(False))

    assert handed_out.tolist() == [Torque.ON, Torque.ON]
    assert torque.as_json()[0] is not True
    for states in (handed_out, torque.states):
        with pytest.raises(ValueError, match="read-only"):
            states[0] = Torque.OFF


def test_a_face_of_several_buses_knows_of_each_servo_what_its_bus_knows():
    torque = known(True, True, True)
    torque.take(np.array([YAW, JAW]), known(False, None, at_s=4.0))

    assert torque.as_json() == [None, True, False]
    assert torque.at_s.tolist() == [-np.inf, 1.0, 4.0]


@unknown_when_lost
class Bus:
    """A bus whose every method ends in an error."""

    def __init__(self, error):
        self.torque, self.error = known(True, False), error

    def _fail(self, *_):
        raise self.error

    write_positions = read = feedback = look_after = obstacle = enable_torque = _fail
    keep_torque = disable_torque = disable_all = reboot = reopen = _fail


METHODS = [name for name in vars(Bus) if not name.startswith("_")]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("error", [PortError("?"), PortGone("?")])
def test_with_the_port_all_that_was_known_is_gone(method, error):
    bus = Bus(error)
    with pytest.raises(type(error)):
        getattr(bus, method)()

    assert bus.torque.as_json() == [None, None]


@pytest.mark.parametrize("method", METHODS)
def test_an_error_that_is_not_the_ports_changes_nothing_that_is_known(method):
    bus = Bus(ServoError("?"))
    with pytest.raises(ServoError):
        getattr(bus, method)()

    assert bus.torque.as_json() == [True, False]
