"""`servo` as a person types it, beside a face that plays in this process."""

import json

import pytest
from playing_face import invoke, listening, playing, status

from firmware_bridge.loop.servo_group import ServoGroup
from lipservo.commands.run import servo

pytestmark = pytest.mark.usefixtures("own_folder")


def test_a_servo_is_switched_off_and_on_and_restarted_and_the_status_tells_it():
    with playing():
        early = invoke("servo", "jaw", "reboot")
        off = invoke("servo", "jaw", "off")
        told = status()
        rebooted = invoke("servo", "jaw", "reboot", "--json")
        on = invoke("servo", "jaw", "on")
        after = status()
        unknown = invoke("servo", "nose", "off")

    assert early.exit_code == 1
    assert "is driven; switch it off first" in early.stderr
    assert (off.exit_code, on.exit_code, rebooted.exit_code) == (0, 0, 0)
    assert "servo jaw is off" in off.stdout
    assert told["servos"] == {"jaw": "off"}
    of_servos = [each for each in told["troubles"] if each.startswith("servo")]
    assert of_servos == ["servo 'jaw' (id 11) switched off by a person"]
    assert told["torque_on"] is False
    (answer,) = json.loads(rebooted.stdout)["faces"]
    assert (answer["servo"], answer["asked"], answer["state"]) == ("jaw", "reboot", "off")
    assert after["servos"] == {"jaw": "driven"}
    (health,) = after["health"]
    assert (health["name"], health["state"], health["n_reboots"]) == ("jaw", "driven", 1)
    assert health["current_ma"] == 0.0
    assert after["jogged"] == []
    assert "no such servo; there are: jaw" in unknown.stderr


def test_in_a_dry_run_it_is_refused():
    with playing(dry_run=True):
        done = invoke("servo", "jaw", "off")

    assert done.exit_code == 1
    assert "dry run: servos are only read" in done.stderr


def test_a_restart_that_the_face_has_not_counted_is_not_told_as_done(monkeypatch):
    """The order is accepted and does nothing: a servo that is off stays off."""
    monkeypatch.setattr(servo, "_PATIENCE_S", 0.5)
    with playing():
        assert invoke("servo", "jaw", "off").exit_code == 0
        monkeypatch.setattr(ServoGroup, "reboot", lambda *_: None)
        done = invoke("servo", "jaw", "reboot")

    assert done.exit_code == 1
    assert "servo jaw has not restarted" in done.stderr


def test_a_servo_of_a_stopped_face_that_is_switched_off_is_said_to_stay_off():
    """No bridge runs: what is known of it is in the report of the stop."""
    report = {"confirmed": ["jaw"]}
    told = {"state": "stopped", "stopped": "soft", "servos": {}, "stop_report": report}
    with listening("tim", status=told):
        done = invoke("servo", "jaw", "off")

    assert done.exit_code == 0, done.output
    assert "servo jaw stays off when the face is started" in done.stdout
