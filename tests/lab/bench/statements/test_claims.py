"""The judge of statements: what is said is held against the servos' own log, and nothing slips."""

import re

import pytest
from lipservo_lab.bench.statements.claims import Judge, Rule, Statement, Verdict, nothing, template
from lipservo_lab.bench.statements.rules import RULES
from lipservo_lab.bench.stops.logged_device import LoggedDevice, Moment

from firmware_bridge.joints import Joint

JOINTS = [Joint("jaw", 11, -2.0, 25.0, 300.0), Joint("lip", 12, -30.0, 30.0, 300.0)]
OFF, ON, HALF = (False, False), (True, True), (True, False)


class Log:
    """The log of two servos: limp, from 10 s on both on, from 20 s on the jaw alone."""

    records = (
        Moment(0.0, OFF, (0.0, 0.0)),
        Moment(10.0, ON, (1500.0, 1600.0)),
        Moment(20.0, HALF, (1500.0, 0.0)),
    )
    during = LoggedDevice.during


def tally(text, at_s, about=None, rules=RULES):
    judge = Judge(rules, Log(), JOINTS, "a face")
    return judge.judge([Statement(text, at_s, at_s + 0.01, about or {})])


def verdict(text, at_s, about=None):
    (found,) = tally(text, at_s, about).verdicts
    return found


@pytest.mark.parametrize(
    ("text", "true_s", "untrue_s"),
    [
        ("status torque_on: true", 12.0, 5.0),
        ("status torque_on: false", 5.0, 12.0),
        ("status health.lip.torque_on: false", 25.0, 12.0),
        ("status health.lip.state: driven", 12.0, 25.0),
        ("status servos.jaw: off", 5.0, 25.0),
        ("status stop_report.confirmed: lip", 25.0, 12.0),
        ("status pulses.lip.sent_us: 1610.0", 12.0, 5.0),
        ("status troubles: servo 'lip' (id 12) lost its torque; not again", 25.0, 12.0),
        ("answer to freeze holds: jaw", 25.0, 5.0),
        ("answer to freeze limp: lip", 25.0, 12.0),
        ("outcome confirmed: id 12", 25.0, 12.0),
        ("says bridge: every servo is driven again", 12.0, 25.0),
        ("says bridge: stopped; the face is at rest and limp: confirmed by 2 servos", 5.0, 25.0),
        ("says a_face: held where it is: 1 servo holds; lip limp", 25.0, 12.0),
        ("says a_face: nothing is held; 2 servos limp", 5.0, 25.0),
        ("says a face: driven, 2 of 2 servos hold", 12.0, 25.0),
        ("says a face  process 7  /dev/x  silent, 0 of 2 servos hold", 5.0, 12.0),
        ("says a face: driven, 0 of 2 servos hold, not known of 1", 25.0, 12.0),
        ("says a face  process 7  /dev/x  driven, 1 of 2 servos hold, not known of 1", 12.0, 5.0),
        ("outcome torque.lip.on: true", 12.0, 25.0),
        (
            "says bridge: servo 'lip' (id 12) holds already: its torque was on before the start",
            12.0,
            5.0,
        ),
        ("says ok   lip: channel 1, no pulses; 900 to 2100 us, 0.49 deg a step", 5.0, 12.0),
        ("exit stop --limp: 0", 5.0, 12.0),
        ("exit stop --freeze: 0", 25.0, 5.0),
        ("exit servo lip off: 0", 25.0, 12.0),
        ("exit start: 0", 12.0, 25.0),
    ],
)
def test_a_claim_is_true_where_the_log_says_so_and_untrue_where_not(text, true_s, untrue_s):
    assert verdict(text, true_s) is Verdict.TRUE
    assert verdict(text, untrue_s) is Verdict.UNTRUE


@pytest.mark.parametrize(
    "text",
    ["status torque_on: null", "status health.jaw.torque_on: null", "answer to x unknown: jaw"],
)
@pytest.mark.parametrize("at_s", [5.0, 12.0, 25.0])
def test_what_is_said_to_be_unknown_is_never_untrue_and_is_counted(text, at_s):
    found = tally(text, at_s)

    assert found.verdicts == {Verdict.UNKNOWN: 1}
    assert found.figures["unknown_share"] == 1.0


def test_a_claim_may_be_as_old_as_a_servo_is_asked_in_its_turn_and_no_older():
    assert verdict("status torque_on: false", 10.2) is Verdict.TRUE
    assert verdict("status torque_on: false", 10.4) is Verdict.UNTRUE


def test_a_sentence_that_no_rule_knows_is_unjudged_and_listed():
    found = tally("says all is well with the servos", 12.0)

    assert found.verdicts == {Verdict.UNJUDGED: 1}
    assert "all is well" in found.lines[0]


def test_a_stopped_face_may_hold_only_where_it_says_that_it_is_not_known():
    unconfirmed = {"torque_on": False, "stop_report": {"unconfirmed": {"jaw": "does not answer"}}}

    assert verdict("status state: stopped", 25.0, {"torque_on": False}) is Verdict.UNTRUE
    assert verdict("status state: stopped", 25.0, {"torque_on": None}) is Verdict.UNKNOWN
    assert verdict("status state: stopped", 25.0, unconfirmed) is Verdict.TRUE


def test_each_of_several_troubles_in_a_line_is_judged():
    line = (
        "says bridge: servo 'jaw' (id 11) has lost its torque; "
        "servo 'lip' (id 12) does not answer; check its power and cable; "
        "the servo loop missed 31% of its last ticks (computer busy, or bus slow?)"
    )

    assert tally(line, 25.0).verdicts == {
        Verdict.UNTRUE: 1,
        Verdict.UNKNOWN: 1,
        Verdict.SILENT: 1,
    }


def test_a_servo_that_never_got_a_pulse_was_not_sent_anywhere():
    said = "says lip was sent to 0.0 deg (1500 us)"

    assert verdict(said, 8.0, {"began_s": 1.0}) is Verdict.UNTRUE
    assert verdict(said, 19.0, {"began_s": 1.0}) is Verdict.TRUE


def test_statements_that_say_nothing_of_torque_do_not_count():
    rules = (Rule(re.compile("status n_ticks: .*"), nothing),)
    judge = Judge(rules, Log(), JOINTS, "a face")
    found = judge.judge([Statement(f"status n_ticks: {n}", 1.0, 1.0) for n in range(3)])

    assert found.figures["statements"] == 0
    assert found.figures["says_nothing"] == 3


def test_templates_have_no_numbers_names_or_places():
    first = template("says servo 'jaw' (id 11) at /tmp/a/port: 3.5 s, jaw, lip", ["jaw", "lip"])

    assert first == "says servo 'NAME' (id N) at PATH: N s, NAMES"
    assert template("exit stop: 1", ["jaw"]) == "exit stop: 1"
