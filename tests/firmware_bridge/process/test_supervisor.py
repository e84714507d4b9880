"""What the supervisor decides, step by step: processes and clock are played, servos simulated."""

import json
import signal

import pytest
from simulated_supervisor import ROUND_S, SupervisedFace

from firmware_bridge.process.child import RestartDelay
from firmware_bridge.process.lifeline import (
    Began,
    Failed,
    NotStarted,
    Ready,
    Stopped,
    Switched,
)
from firmware_bridge.process.stop_record import StopRecord
from firmware_bridge.stopping import StopLevel, StopReport, StopRequest


def test_a_bridge_that_gives_heartbeats_is_left_alone(face):
    face.play(20.0)

    assert face.bridge.signals == []
    assert face.torque == [1, 1, 1]


def test_a_hung_bridge_is_killed_after_a_second_its_servos_let_go_and_a_new_one_started(
    face, caplog
):
    face.bridge.beats = False
    face.play(0.9)
    assert face.bridge.signals == []
    face.play(0.3)
    assert face.bridge.signals == [signal.SIGKILL]
    face.bridge.beats = True
    face.play(1.0)

    assert face.torque == [0, 0, 0]
    assert len(face.bridge.starts) == 2
    assert "bridge hangs: no heartbeat from it; it is killed" in caplog.messages


def test_a_starting_bridge_may_be_silent_for_half_a_minute(starting_face):
    face = starting_face
    face.bridge.beats = False
    face.play(29.8)
    assert face.bridge.signals == []
    face.play(0.4)
    assert face.bridge.signals == [signal.SIGKILL]


def test_a_bridge_that_is_started_again_may_be_silent_for_as_long_as_the_first(face):
    face.play(100.0)
    face.bridge.status, face.bridge.beats = -9, False
    face.play(25.0)

    assert len(face.bridge.starts) == 2
    assert face.bridge.signals == []


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

    assert face.play(1.0) is None
    status = ask_waits(face)
    assert (status["state"], status["can_start"], status["torque_on"]) == ("stopped", True, False)
    assert status["stop_report"]["confirmed"] == ["jaw", "left", "right"]
    assert face.torque == [0, 0, 0]
    assert len(face.bridge.starts) == 1


def ask_waits(face):
    """What is answered while no bridge runs."""
    client = face.ask_to_stop("status")
    face.play()
    answer = client.recv(10_000)
    client.close()
    return json.loads(answer)


def test_a_stop_that_the_disk_does_not_keep_is_told_of_once(tmp_path):
    (tmp_path / "file").write_text("")
    record = StopRecord(tmp_path / "file" / "tom.json")
    face = SupervisedFace(tmp_path / "face.sock", record)
    with face.control:
        face.play()
        face.bridge.said.append(Stopped(StopLevel.LIMP))
        face.play()
        assert record.problem_after(5.0)
        face.play(2.0)

    assert face.told_kept == [record.problem]


def test_a_port_that_stays_away_is_told_of_once(face, caplog):
    face.unplugged = True
    face.bridge.status = -9
    face.play(10.0)

    assert sum("torque cannot be switched off yet" in line for line in caplog.messages) == 1


def test_a_stop_while_no_bridge_runs_is_answered_held_and_reported(face):
    face.unplugged = True
    face.bridge.status = -9
    face.play(5.0)
    client = face.ask_to_stop("soft")
    face.play(30.0)
    face.unplugged = False
    assert face.play(1.0) is None

    assert b'"accepted": "soft"' in client.recv(10_000)
    end = json.loads(client.recv(10_000))
    assert (end["confirmed"], end["waits"]) == (["jaw", "left", "right"], True)
    assert len(face.bridge.starts) == 1
    client.close()


def test_a_stop_while_the_bridge_starts_kills_it_before_it_arms(starting_face):
    face = starting_face
    face.bridge.beats = False
    face.play()
    client = face.ask_to_stop("limp end")
    face.play(2.0)

    assert face.bridge.signals == [signal.SIGKILL]
    assert face.exit_status == 0
    assert face.torque == [0, 0, 0]
    client.close()


@pytest.fixture
def stopped_face(face):
    """A person has stopped it, and its servos have confirmed."""
    face.bridge.said.append(Stopped(StopLevel.SOFT, requested_by="process 7 of user 1000"))
    face.play()
    for servo in face.servos.chain.servos:
        servo["torque_enable"] = 0
    face.bridge.status = 0
    face.play()
    return face


def order(face, word):
    """What is answered to one word; then three rounds."""
    client = face.ask_to_stop(word)
    face.play()
    answer = json.loads(client.recv(10_000))
    client.close()
    return answer


def test_a_stopped_face_waits_limp_while_speech_lives_until_a_person_starts_it(stopped_face):
    face = stopped_face
    assert face.play(600.0) is None
    status = ask_waits(face)
    assert (status["stopped"], status["stopped_by"]) == ("soft", "process 7 of user 1000")
    assert face.speech.signals == []
    assert len(face.bridge.starts) == 1

    assert order(face, "start")["accepted"] == "start"
    assert face.bridge.starts == [[], []]
    assert face.supervisor.status()["stopped"] is None


def test_a_start_by_a_person_tries_every_servo_again_but_those_that_a_person_switched_off(face):
    face.bridge.said += [Failed(1, "jammed"), Switched(0, on=False), Switched(2, on=False)]
    face.bridge.said.append(Stopped(StopLevel.LIMP))
    face.bridge.status = -9
    face.play(1.0)

    assert order(face, "servo right on") == {"servo": "right", "asked": "on"}
    assert face.torque == [0, 0, 0]
    assert order(face, "start")["accepted"] == "start"
    assert face.bridge.starts[-1] == ["--switched-off", "0"]


def test_a_start_is_refused_while_the_face_stops_and_while_it_starts(face):
    face.unplugged = True
    face.bridge.said.append(Stopped(StopLevel.LIMP))
    face.bridge.status = 3
    face.play()
    assert "is stopping" in order(face, "start")["error"]
    face.unplugged = False
    face.play(1.0)
    face.bridge.beats = False  # the next one starts and serves nobody yet

    assert "accepted" in order(face, "start")
    assert "started already" in order(face, "start")["error"]


@pytest.mark.parametrize("word", ["servo left off", "servo left on"])
def test_no_servo_is_switched_while_a_bridge_starts_that_would_not_know_of_it(starting_face, word):
    face = starting_face
    face.bridge.beats = False
    face.play()

    assert order(face, word)["error"] == "the bridge is being started: ask again in a moment"
    assert face.bridge.starts == [[]]


def test_a_servo_switched_off_between_two_bridges_stays_off(face):
    face.bridge.status = -9
    face.play(0.05)

    assert order(face, "servo left off") == {"servo": "left", "asked": "off"}
    face.play(1.0)
    assert face.bridge.starts[-1] == ["--switched-off", "1"]


def test_of_a_start_and_a_stop_that_come_at_once_the_stop_is_obeyed(stopped_face):
    face = stopped_face
    clients = [face.ask_to_stop("start"), face.ask_to_stop("soft")]
    face.play(1.0)

    assert len(face.bridge.starts) == 1
    assert ask_waits(face)["state"] == "stopped"
    for client in clients:
        client.close()


def test_of_two_starts_that_come_at_once_the_log_says_why_one_is_not_obeyed(stopped_face, caplog):
    caplog.set_level("INFO")
    clients = [stopped_face.ask_to_stop("start") for _ in range(2)]
    stopped_face.play(0.1)

    assert len(stopped_face.bridge.starts) == 2
    _, not_obeyed = [each for each in caplog.messages if "start requested" in each]
    assert not_obeyed.endswith("not obeyed, the face is being started already")
    for client in clients:
        client.close()


def test_a_stop_while_a_stopped_face_starts_lets_go_and_waits_again(stopped_face):
    face = stopped_face
    face.bridge.beats = False
    order(face, "start")
    face.hold()
    client = face.ask_to_stop("limp")
    face.play(2.0)

    assert face.torque == [0, 0, 0]
    assert ask_waits(face)["can_start"] is True
    client.close()


def test_a_stopped_face_whose_start_fails_says_why_and_can_be_started_again(stopped_face):
    face = stopped_face
    order(face, "start")
    face.bridge.said.append(NotStarted("'jaw' (id 1) does not answer"))
    face.bridge.status = 1
    assert face.play(1.0) is None

    status = ask_waits(face)
    assert "'jaw' (id 1) does not answer" in status["troubles"][0]
    assert "accepted" in order(face, "start")
    face.bridge.said.append(Ready())
    face.play()
    assert face.supervisor.status()["troubles"] == []


def test_a_port_that_came_back_before_a_start_is_no_trouble_of_the_face_that_was_started(face):
    face.servos.chain.servos[1].deaf_until_s = float("inf")
    face.bridge.said.append(Stopped(StopLevel.LIMP))
    face.bridge.status = -9
    face.play(6.0)
    face.unplugged = True
    face.play(12.0)
    assert face.supervisor.status()["troubles"] == ["/dev/x: no such port"]
    assert "accepted" in order(face, "start")
    face.unplugged = False
    face.bridge.said.append(Ready())
    face.play()

    assert face.supervisor.status()["troubles"] == []


def test_servos_that_did_not_confirm_a_stop_are_let_go_again_until_they_do(face):
    face.servos.chain.servos[1].deaf_until_s = face.clock.now() + 20.0
    face.bridge.said.append(Stopped(StopLevel.LIMP))
    face.bridge.status = -9
    face.play(0.5)
    assert face.supervisor.due_s(face.clock.now()) <= face.clock.now() + 0.1
    face.play(5.5)
    assert list(ask_waits(face)["stop_report"]["unconfirmed"]) == ["left"]
    assert ask_waits(face)["torque_on"] is None
    assert face.supervisor.due_s(face.clock.now()) <= face.clock.now() + 10.0, (
        "they are not forgotten"
    )
    face.play(25.0)

    assert ask_waits(face)["stop_report"]["unconfirmed"] == {}
    assert face.torque == [0, 0, 0]


@pytest.mark.parametrize("word", ["soft end", "limp end"])
def test_the_end_of_a_stopped_face_ends_its_process(stopped_face, word):
    client = stopped_face.ask_to_stop(word)
    report = stopped_face.play(1.0)

    assert report == StopReport(("jaw", "left", "right"))
    assert stopped_face.exit_status == 0
    assert stopped_face.speech.signals == [signal.SIGTERM]
    client.close()


def test_a_signal_ends_a_stopped_face(stopped_face):
    stopped_face.n_signals = 1

    assert stopped_face.play(1.0).complete
    assert stopped_face.exit_status == 0


def test_a_stop_of_before_holds_in_the_next_process_until_a_person_starts_it(tmp_path):
    """systemd starts the face again: nothing is armed."""
    record = tmp_path / "stops" / "face.json"
    before = StopRecord(record)
    before.stop(StopRequest(StopLevel.SOFT, "process 7 of user 1000"))
    before.close()
    face = SupervisedFace(tmp_path / "face.sock", StopRecord(record))
    with face.control:
        assert face.play(5.0) is None
        status = ask_waits(face)
        assert (status["state"], status["can_start"]) == ("stopped", True)
        assert "process 7 of user 1000" in status["stopped_by"]
        assert (face.bridge.starts, face.torque) == ([], [0, 0, 0])
        order(face, "start")
        assert len(face.bridge.starts) == 1


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
    assert face.bridge.starts == [[], ["--stopped", "freeze", "--stopped-by", ""]]


def test_freezing_while_no_bridge_runs_starts_one_that_holds(face):
    face.unplugged = True
    face.bridge.status = -9
    face.play(1.0)
    face.ask_to_stop("freeze").close()
    face.play(1.0)

    assert face.torque == [1, 1, 1]
    assert face.bridge.starts[-1][:2] == ["--stopped", "freeze"]


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


def test_speech_that_dies_while_the_face_waits_is_there_again_for_its_start(stopped_face):
    stopped_face.speech.status = -9
    stopped_face.play(1.0)

    assert len(stopped_face.speech.starts) == 2


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


def test_a_stop_after_a_start_that_failed_is_kept_like_any_other(tmp_path):
    """The start had forgotten the stop before it."""
    record = StopRecord(tmp_path / "face.json")
    face = SupervisedFace(tmp_path / "face.sock", record)
    with face.control:
        face.play()
        face.bridge.said += [Ready(), Stopped(StopLevel.SOFT, requested_by="a test")]
        face.play()
        face.bridge.status = 0
        face.play(1.0)
        assert "accepted" in order(face, "start")
        assert record.stopped is None
        face.bridge.said.append(NotStarted("'jaw' (id 1) does not answer"))
        face.bridge.status = 1
        face.play(1.0)
        assert "accepted" in order(face, "soft")
        face.n_signals = 1
        face.play(1.0)
        record.close()

    assert json.loads((tmp_path / "face.json").read_text())["stopped"] == "limp"
