"""A person at a terminal: keys move one joint, also a little beyond its limits; fingers turn it."""

import numpy as np
import pytest

from firmware_bridge.clock import ManualClock
from firmware_bridge.stopping import JogPulse
from lipservo.runtime.servos.hand_driven import KeyedJoint, drive_by_hand
from lipservo.runtime.servos.limp_servos import LimpPose, TurnedRange
from lipservo.settings.settings import load_shipped_face

MAESTRO = load_shipped_face("face_jaw_maestro")  # 1450 to 1800 us, neutral 1500


def typed(settings, joint, *keys):
    """What came of each key, pressed a second apart, and the pulses or degrees sent after each."""
    hand, told, sent = KeyedJoint(settings, joint), [], []
    waiting, clock = list(keys), ManualClock()
    due_s = 2.0

    def act(bridge, time_s):
        nonlocal due_s
        hand.renew(bridge, time_s)
        if time_s < due_s:
            return True
        due_s = time_s + 1.0
        pulses = bridge.pulses()
        sent.append(pulses[joint]["sent_us"] if pulses else None)
        if not waiting:
            return False
        told.append(hand.press(waiting.pop(0), bridge, time_s))
        return True

    report, _ = drive_by_hand(settings, "x", clock, act)
    assert report.complete
    return hand, told, sent


def test_keys_lead_a_hobby_servo_in_microseconds():
    hand, told, sent = typed(MAESTRO, "jaw", "+", "+", ".", "-", "0", "x")

    assert told == ["", "", "", "", "", None]
    assert sent == [1500.0, 1510.0, 1520.0, 1522.0, 1512.0, 1500.0, 1500.0]
    assert hand.shown == "jaw 1500 us (0.0 deg)"


def test_beyond_its_limits_a_person_must_say_so_first():
    keys = ["-"] * 6 + ["y", "-", "-"]
    hand, told, sent = typed(MAESTRO, "jaw", *keys)

    assert told == [""] * 5 + ["press y to go beyond its limits", "", "", ""]
    assert sent[-1] == pytest.approx(1430.0)
    assert hand.place == 1430.0


def test_a_joint_beyond_its_limits_goes_back_when_no_key_comes():
    _, _, sent = typed(MAESTRO, "jaw", *["-"] * 6, "y", "-", *["x"] * 6)

    assert min(sent) == pytest.approx(1440.0)
    assert sent[-1] == pytest.approx(1500.0)


def test_a_servo_with_an_encoder_is_led_in_degrees_within_its_limits():
    face = load_shipped_face("face_jaw")
    hand, told, _ = typed(face, "jaw", "+", "+", ",", *["-"] * 4)

    assert told[:6] == [""] * 6
    assert "allowed: -2 to 25 deg" in told[-1]
    assert hand.shown == "jaw -1.1 deg"


def test_it_can_be_watched_and_ordered_as_any_face():
    seen = []

    def act(bridge, time_s):
        seen.append(bridge.refusal(JogPulse("jaw", 1500.0)))
        return time_s < 0.2

    drive_by_hand(MAESTRO, "x", ManualClock(), act)
    assert set(seen) == {"jogging is not armed: say `jog arm` first"}


def test_the_ends_of_a_turned_joint_are_those_that_its_encoder_said():
    turned = TurnedRange(("jaw", "lip", "brow"))
    for jaw_deg, lip_deg in ((0.0, 2.0), (12.5, np.nan), (-3.0, 2.5)):
        silent = {"lip": "does not answer"} if np.isnan(lip_deg) else {}
        places_deg = np.array([jaw_deg, lip_deg, 40.0])
        turned.note(LimpPose(places_deg, {"brow": "holds: its torque is on"} | silent))

    assert turned.ends()["jaw"] == (-3.0, 12.5)
    assert turned.ends()["lip"] == (2.0, 2.5)
    assert turned.lines() == [
        "jaw: -3.0 deg, turned from -3.0 to 12.5",
        "lip: 2.5 deg, turned from 2.0 to 2.5",
        "brow: holds: its torque is on",
    ]
    turned.begin()
    assert np.isnan(turned.ends()["jaw"]).all()
