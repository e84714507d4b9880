"""What the supervisor decides, step by step: processes and clock are played, servos simulated."""

import json
import signal

import pytest
from simulated_supervisor import ROUND_S

from firmware_bridge.process.lifeline import Began, Failed, Stopped, Switched
from firmware_bridge.process.restarted_child import RestartDelay
from firmware_bridge.stopping import StopLevel, StopReport


def test_a_bridge_that_gives_heartbeats_is_left_alone(face):
    face.play(20.0)

    assert face.bridge.signals == []
    assert face.torque == [1, 1, 1]


def test_a_hung_bridge_is_killed_after_a_second_its_servos_let_go_and_a_new_one_started(face):
    face.bridge.beats = False
    face.play(0.9)
    assert face.bridge.signals == []
    face.play(0.3)
    assert face.bridge.signals == [signal.SIGKILL]
    face.bridge.beats = True
    face.play(1.0)

    assert face.torque == [0, 0, 0]
    assert len(face.bridge.starts) == 2
    assert any("hangs" in line for line in face.said)


def test_a_starting_bridge_may_be_silent_for_half_a_minute(starting_face):
    face = starting_face
    face.bridge.beats = False
    face.play(29.8)
    assert face.bridge.signals == []
    face.play(0.4)
    assert face.bridge.signals == [signal.SIGKILL]


def test_a_supervisor_that_was_stopped_itself_blames_nobody(face):
    """Both were stopped for a minute, as by `kill -STOP`; the bridge beats again a moment later."""
    face.bridge.beats = False
    face.clock.advance(60.0)
    face.play(0.9)
    face.bridge.beats = True
    face.play(2.0)

    assert face.bridge.signals == []


def test_a_dead_bridge_is_limp_within_a_round_and_restarts_wait_longer_each_time(face):
    face.bridge.status = -11
    face.play(ROUND_S)
    for _ in range(30):  # steps without time: nothing here waits
        face.supervisor.step(face.clock.now())
    assert face.torque == [0, 0, 0]

    delay = RestartDelay()
    assert [round(delay.after(1.0), 1) for _ in range(6)] == [0.2, 0.4, 0.8, 1.6, 3.2, 5.0]
    assert delay.after(11.0) == 0.2  # it had started well


@pytest.mark.parametrize("level", [StopLevel.SOFT, StopLevel.LIMP])
def test_a_stop_outlives_the_bridge_that_heard_it_and_the_plug(face, level):
    """Issue: stopped while unplugged, the bridge died, was started, and held torque again."""
    face.unplugged = True
    face.bridge.said.append(Stopped(level))
    face.bridge.status = 1
    assert face.play(600.0) is None
    assert ask_waits(face)["stopped"] == level.value
    face.unplugged = False
    report = face.play(1.0)

    assert face.exit_status == 0
    assert report == StopReport(("jaw", "left", "right"))
    assert face.torque == [0, 0, 0]
    assert len(face.bridge.starts) == 1


def ask_waits(face):
    """What is answered while no bridge runs."""
    client = face.ask_to_stop("status")
    face.play()
    answer = client.recv(10_000)
    client.close()
    return json.loads(answer)


def test_a_stop_while_no_bridge_runs_is_answered_held_and_reported(face):
    face.unplugged = True
    face.bridge.status = -9
    face.play(5.0)
    client = face.ask_to_stop("soft")
    face.play(30.0)
    face.unplugged = False
    report = face.play(1.0)
    face.control.report_end(report.as_dict())

    assert b'"accepted": "soft"' in client.recv(10_000)
    assert b'"confirmed": ["jaw", "left", "right"]' in client.recv(10_000)
    assert face.exit_status == 0
    assert len(face.bridge.starts) == 1
    client.close()


def test_a_stop_while_the_bridge_starts_kills_it_before_it_arms(starting_face):
    face = starting_face
    face.bridge.beats = False
    face.play()
    client = face.ask_to_stop("limp")
    face.play(2.0)

    assert face.bridge.signals == [signal.SIGKILL]
    assert face.exit_status == 0
    assert face.torque == [0, 0, 0]
    client.close()


def test_who_was_let_in_before_the_bridge_served_is_sent_to_the_bridge(starting_face):
    """Found by CI: a question fell between the two, and its asker waited as long as he could."""
    face = starting_face
    face.bridge.beats = False
    face.play()
    client = face.connect()
    face.play()
    face.bridge.beats = True
    face.play()

    client.settimeout(1.0)
    assert client.recv(10_000) == b""
    client.close()


def test_a_frozen_face_stays_held_when_its_bridge_dies_and_the_next_one_knows(face):
    face.bridge.said.append(Stopped(StopLevel.FREEZE))
    face.bridge.status = -9
    face.play(1.0)

    assert face.torque == [1, 1, 1]
    assert face.bridge.starts == [[], ["--stopped", "freeze"]]


def test_freezing_while_no_bridge_runs_starts_one_that_holds(face):
    face.unplugged = True
    face.bridge.status = -9
    face.play(1.0)
    face.ask_to_stop("freeze").close()
    face.play(1.0)

    assert face.torque == [1, 1, 1]
    assert face.bridge.starts[-1] == ["--stopped", "freeze"]


def test_servos_given_up_for_good_are_told_to_the_next_bridge(face):
    face.bridge.said.append(Failed(2, "does not follow: jammed = stuck"))
    face.bridge.status = -9
    face.play(1.0)

    assert face.bridge.starts[-1] == ["--failed", "2=does not follow: jammed = stuck"]


def test_servos_that_a_person_switched_off_are_told_to_every_bridge_until_they_are_on_again(face):
    face.bridge.said += [Switched(2, on=False), Switched(0, on=False), Failed(1, "jammed")]
    face.bridge.status = -9
    face.play(1.0)
    face.bridge.status = -9
    face.play(1.0)
    assert face.bridge.starts[-2] == face.bridge.starts[-1]
    assert face.bridge.starts[-1][-4:] == ["--switched-off", "0", "--switched-off", "2"]

    face.bridge.said += [Switched(2, on=True), Switched(1, on=True)]
    face.bridge.status = -9
    face.play(2.0)
    assert face.bridge.starts[-1] == ["--switched-off", "0"]


def test_speech_that_dies_goes_on_where_its_sound_is_and_one_that_hangs_is_killed(face):
    face.speech.said.append(Began(12.25))
    face.speech.status = -9
    face.play(1.0)
    assert face.speech.starts == [[], ["--zero-s", "12.25"]]
    face.speech.beats = False
    face.play(2.9)
    assert face.speech.signals == []
    face.play(1.0)

    assert face.speech.signals == [signal.SIGKILL]
    assert face.bridge.signals == []
