"""How a supervised face ends: signals, lost ports, silent servos, exit status, systemd."""

import signal

import pytest
from simulated_supervisor import SupervisedFace

from firmware_bridge.process.lifeline import Ready, Stopped
from firmware_bridge.process.stop_record import StopRecord
from firmware_bridge.stopping import StopLevel, StopRequest


def test_a_failed_critical_servo_ends_the_face_limp_with_status_4(face):
    face.bridge.status = 4
    face.play(1.0)

    assert face.exit_status == 4
    assert face.torque == [0, 0, 0]
    assert len(face.bridge.starts) == 1


@pytest.mark.parametrize(
    ("status", "unplugged"), [(1, False), (1, True), (-9, True)], ids=["YAML", "port", "killed"]
)
def test_a_bridge_that_fails_at_its_first_start_ends_the_face(starting_face, status, unplugged):
    face = starting_face
    face.unplugged = unplugged
    face.play()
    face.bridge.status = status
    if unplugged:
        assert face.play(25.0) is None, "its servos may hold, and the port come back"
    report = face.play(10.0)

    assert face.exit_status == 1
    assert bool(report.unconfirmed) == unplugged


def test_a_bridge_that_took_long_to_load_and_then_failed_has_not_run_well(starting_face):
    face = starting_face
    face.unplugged = True
    face.bridge.beats = False
    face.play(20.0)
    face.bridge.status = 1

    face.play(5.0)

    assert face.exit_status == 1


def test_a_bridge_that_beat_for_long_but_never_drove_its_servos_has_not_run_well(starting_face):
    """On a busy machine refusing servos may take longer than any start should."""
    face = starting_face
    face.play(20.0)
    face.bridge.status = 1

    face.play(5.0)

    assert face.exit_status == 1
    assert len(face.bridge.starts) == 1


def test_the_first_signal_asks_both_the_second_again(face):
    face.n_signals = 1
    face.play()
    assert face.bridge.signals == [signal.SIGTERM]
    assert face.speech.signals == [signal.SIGTERM]
    face.n_signals = 2
    face.play()
    assert face.bridge.signals == [signal.SIGTERM, signal.SIGTERM]
    face.bridge.status = 0

    face.play(1.0)

    assert face.exit_status == 0


def test_a_bridge_that_does_not_end_is_killed_after_five_seconds_and_let_go_by_force(face):
    face.n_signals = 1
    face.play(4.9)
    assert signal.SIGKILL not in face.bridge.signals
    face.play(2.0)

    assert signal.SIGKILL in face.bridge.signals
    assert face.exit_status == 0
    assert face.torque == [0, 0, 0]


@pytest.mark.parametrize(("n_signals", "seconds"), [(1, 31.0), (2, 31.0), (3, 1.0)])
def test_the_end_by_signal_waits_for_a_lost_port_but_not_for_ever(face, n_signals, seconds):
    face.unplugged = True
    face.n_signals = 1
    face.bridge.status = 3
    assert face.play(0.5) is None
    face.n_signals = n_signals
    report = face.play(seconds)

    assert face.exit_status == 3
    assert report.unconfirmed == dict.fromkeys(["jaw", "left", "right"], "/dev/x: no such port")


def test_two_signals_with_the_plug_out_let_go_once_it_is_back_in(face):
    face.unplugged = True
    face.n_signals = 2
    face.bridge.status = 3
    assert face.play(3.0) is None

    face.unplugged = False

    assert face.play(3.0).complete
    assert face.exit_status == 0
    assert face.torque == [0, 0, 0]


def test_a_silent_servo_is_named_and_the_status_says_it(face):
    face.servos.chain.servos[1].deaf_until_s = float("inf")
    face.bridge.said.append(Stopped(StopLevel.LIMP, ends=True))
    face.bridge.status = -9
    report = face.play(20.0)

    assert face.exit_status == 3
    assert report.confirmed == ("jaw", "right")
    assert report.unconfirmed == {"left": "did not answer"}


@pytest.mark.parametrize("way", ["stop --end", "a signal"])
def test_a_stop_that_ends_the_daemon_outlives_it_and_a_signal_does_not(tmp_path, way):
    """systemd may start it again at once: what a person stopped then waits for a person."""
    path = tmp_path / "stops" / "face.json"
    record = StopRecord(path)
    face = SupervisedFace(tmp_path / "face.sock", record)
    with face.control:
        face.play()
        face.bridge.said.append(Ready())
        face.play()
        if way == "a signal":
            face.n_signals = 1
        else:
            face.bridge.said.append(Stopped(StopLevel.SOFT, True, "process 7 of user 1000"))
        face.play()
        face.bridge.status = 0
        assert face.play(5.0).complete
        record.close()
    left = StopRecord(path).stopped

    assert face.exit_status == 0
    expected = StopRequest(StopLevel.LIMP, "process 7 of user 1000")
    assert left == (expected if way == "stop --end" else None)


def test_a_freeze_on_the_way_to_the_end_is_held_until_the_next_signal(face):
    face.n_signals = 1
    face.play(1.0)
    face.bridge.said.append(Stopped(StopLevel.FREEZE, False, "a person"))

    assert face.play(10.0) is None
    assert signal.SIGKILL not in face.bridge.signals
    assert face.torque == [1, 1, 1]
    face.n_signals = 2
    face.play(4.9)
    assert signal.SIGKILL not in face.bridge.signals
    face.bridge.status = 0
    face.play(1.0)
    assert face.exit_status == 0
