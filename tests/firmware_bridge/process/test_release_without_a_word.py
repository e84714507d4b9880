"""Servos that cannot say that they were let go: what is done by force, and what is said of it."""

import logging
import threading
import time

import pytest
from hobby_bus import PULSES, WORDS, PulsePort
from simulated_supervisor import SupervisedFace

from firmware_bridge.errors import PortError
from firmware_bridge.process.lifeline import Ready
from firmware_bridge.process.torque_release import FaceRelease, TorqueRelease, release_port
from firmware_bridge.stopping import ExitStatus, StopLevel


@pytest.fixture
def face(tmp_path):
    face = SupervisedFace(tmp_path / "face.sock", capabilities=PULSES)
    with face.control:
        face.play()
        face.bridge.said.append(Ready())
        face.play()
        yield face


def untrue(text):
    return "limp" in text.replace("`lipservo limp`", "") or "torque off confirmed" in text


def test_a_bridge_that_ended_as_asked_is_not_said_to_be_confirmed(face):
    client = face.ask_to_stop("soft end")
    face.play()
    face.bridge.status = ExitStatus.ENDED_WELL
    report = face.play(2.0)
    client.close()

    assert (report.confirmed, report.released) == ((), ("jaw", "left", "right"))
    assert face.exit_status == ExitStatus.ENDED_WELL
    assert not untrue(report.text())


def test_a_bridge_that_died_has_its_servos_told_once_and_is_started_again(face, caplog):
    caplog.set_level(logging.INFO)
    face.bridge.status = 1
    face.play(2.0)

    assert len(face.bridge.starts) == 2
    assert any(WORDS in line for line in caplog.messages)
    assert not any(untrue(line) for line in caplog.messages)


def test_a_stopped_face_does_not_claim_to_know_its_torque(face):
    client = face.ask_to_stop(StopLevel.LIMP.value)
    face.play()
    face.bridge.status = ExitStatus.ENDED_WELL
    face.play(1.0)
    told = face.supervisor.status()
    client.close()

    assert told["state"] == "stopped"
    assert told["torque_on"] is None
    assert told["stop_report"]["released_words"] == WORDS


def test_a_port_is_let_go_without_asking_anybody():
    port = PulsePort(there=[2])
    found = release_port(lambda: port, [5])

    assert (found.confirmed, found.released, found.unconfirmed) == ([], [2, 5], {})
    assert not port.is_open


def test_a_port_that_stays_away_is_told_with_its_reason():
    def absent():
        raise PortError("/dev/x: no such port")

    with pytest.raises(PortError, match="/dev/x: no such port"):
        release_port(absent, timeout_s=0.1)
    release = TorqueRelease(absent, [1])
    assert not release.step()
    assert release.unconfirmed == {1: "did not answer"}


def stepped(release):
    """As a supervisor does it: only when there is something to do."""
    give_up_s = time.monotonic() + 30.0
    while time.monotonic() < give_up_s:
        if time.monotonic() >= release.next_s and release.step():
            return True
        time.sleep(0.001)
    return False


def test_several_ports_are_let_go_by_the_names_of_their_servos():
    lips, neck = PulsePort(), PulsePort()
    release = FaceRelease(
        [
            (TorqueRelease(lambda: lips, [0, 1]), {0: "jaw", 1: "lip"}),
            (TorqueRelease(lambda: neck, [0]), {0: "yaw"}),
        ]
    )

    assert stepped(release)
    assert sorted(release.let_go) == ["jaw", "lip", "yaw"]
    assert (release.unconfirmed, release.port_error) == ({}, "")
    release.close()


def test_a_port_that_hangs_or_is_gone_keeps_no_other_from_being_let_go():
    may_go, neck = threading.Event(), PulsePort()

    def hanging():
        may_go.wait(30.0)
        raise PortError("/dev/x: no such port")

    release = FaceRelease(
        [
            (TorqueRelease(hanging, [0]), {0: "jaw"}),
            (TorqueRelease(lambda: neck, [0]), {0: "yaw"}),
        ]
    )
    while release.let_go != ["yaw"]:
        assert not release.step()
    assert release.unconfirmed == {"jaw": "did not answer"}
    may_go.set()
    while not release.port_error:
        assert not release.step()
    assert release.unconfirmed == {"jaw": "/dev/x: no such port"}
    release.close()
    assert not neck.is_open
