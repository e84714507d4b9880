"""What pages conclude from a status, a frame and the word kept: pure functions of their modules."""

import pytest

#: What is on the page, by what is known: a status, a frame and how old it is, and the word kept.
STOPPED = {"state": "stopped", "stopped": "soft", "can_start": True}
UNPLUGGED = {"state": "driven", "plugged": False}
DRIVEN = {"state": "driven", "stopped": None, "can_start": False}
WORD = {"report": {"confirmed": ["jaw"], "unconfirmed": {}, "at_rest": False}, "atMs": None}
RELEASED = {
    "report": {
        "confirmed": [], "unconfirmed": {}, "at_rest": True,
        "released": ["jaw"], "released_words": "pulses off",
    },
    "atMs": None,
}  # fmt: skip
#: Of a face of two buses: one confirms, hobby servos at the other cannot.
BOTH = {
    "report": {
        "confirmed": ["yaw"], "at_rest": True, "released": ["jaw"], "released_words": "pulses off",
    },
    "atMs": None,
}  # fmt: skip
TORQUE = {"servosGone": False, "torqueOn": True, "state": "driven"}
GONE = {"servosGone": True, "torqueOn": False, "state": None}


@pytest.mark.parametrize(
    ("status", "frame", "age_ms", "word", "word_ms", "expected"),
    [
        (DRIVEN, TORQUE, 30, None, 9000, "moving"),
        (STOPPED, GONE, 30, None, 9000, "stopped"),
        (STOPPED, GONE, 30, WORD, 9000, "stopped"),
        (STOPPED, None, 9000, WORD, 9000, "stopped"),
        (STOPPED, TORQUE, 30, WORD, 9000, "moving"),  # frames are newer than a status
        (DRIVEN, TORQUE, 30, WORD, 100, "stopped"),  # both are of before the confirmation
        (STOPPED, {**TORQUE, "state": "stopped"}, 30, WORD, 9000, "stopped"),
        (None, GONE, 30, WORD, 9000, "gone"),
        (None, GONE, 30, None, 9000, "moving"),
        (DRIVEN, TORQUE, 9000, WORD, 9000, "gone"),
        (DRIVEN, TORQUE, 9000, None, 9000, "moving"),
        ({**DRIVEN, "state": "ended"}, GONE, 30, WORD, 9000, "gone"),
        ({**DRIVEN, "state": "stopped"}, GONE, 30, None, 9000, "moving"),  # it has not begun
    ],
)
def test_what_the_page_shows(module_page, status, frame, age_ms, word, word_ms, expected):
    seen = {
        "status": status, "frame": frame, "ageMs": age_ms, "word": word, "wordMs": word_ms,
        "isStarting": False,
    }  # fmt: skip
    script = "async (seen) => (await import('/static/stopped.js')).phaseOf(seen)"
    assert module_page.evaluate(script, seen) == expected


@pytest.mark.parametrize(
    ("status", "frame", "phase", "word", "expected"),
    [
        ({**DRIVEN, "servos": {"jaw": "driven"}}, TORQUE, "moving", None, ["running", "good"]),
        # A status of before a start says nothing of servos that are driven by now.
        ({**STOPPED, "servos": {"jaw": "waiting"}}, TORQUE, "moving", None, ["running", "good"]),
        (STOPPED, GONE, "stopped", WORD, ["stopped: limp", "quiet"]),
        (STOPPED, GONE, "stopped", None, ["stopped, not confirmed", "warn"]),
        (STOPPED, GONE, "stopped", RELEASED, ["stopped: pulses off", "warn"]),
        (STOPPED, GONE, "stopped", BOTH, ["stopped: pulses off", "warn"]),
        (DRIVEN, GONE, "moving", None, ["servo side gone", "bad"]),
        (UNPLUGGED, TORQUE, "moving", None, ["port gone: look at the plug", "bad"]),
    ],
)  # fmt: skip
def test_the_state_in_the_head(module_page, status, frame, phase, word, expected):
    seen = {
        "status": status, "frame": frame, "ageMs": 30, "phase": phase, "word": word,
        "lastState": "driven", "refusal": None,
    }  # fmt: skip
    script = "async (seen) => (await import('/static/watchdog.js')).headWords(seen)"
    assert module_page.evaluate(script, seen) == expected


HANDS = "Keep your hands away. Switch the servos' supply off, or run `lipservo limp`."
LOOSE = {"jaw": "is deaf", "lip_left": "is deaf", "lids": "hot"}


@pytest.mark.parametrize(
    ("report", "tone", "text"),
    [
        (
            {"confirmed": ["jaw"], "at_rest": True},
            "good",
            "Stopped. At rest and limp, confirmed by 1 servo.",
        ),
        ({"confirmed": ["jaw", "lids"]}, "good", "Stopped. Limp, confirmed by 2 servos."),
        (
            BOTH["report"],
            "warn",
            "Stopped. Pulses off; only 1 of 2 servos can confirm it. Keep your hands away.",
        ),
        ({"dry_run": True}, "good", "Stopped. Dry run, no torque was switched on."),
        (
            {"confirmed": []},
            "warn",
            "Stopped. No servo has confirmed that it is limp: keep your hands away.",
        ),
        (
            {"confirmed": ["brow"], "unconfirmed": LOOSE},
            "bad",
            "Stopped, but NOT confirmed to be limp: jaw, lip left (is deaf); lids (hot). " + HANDS,
        ),
    ],
)
def test_what_servos_confirmed_in_words(module_page, report, tone, text):
    script = "async (r) => (await import('/static/stop.js')).confirmed({ report: r, atMs: null })"
    assert module_page.evaluate(script, report) == [tone, text]
