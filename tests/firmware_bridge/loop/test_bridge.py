import math

import numpy as np
import pytest

from firmware_bridge.clock import ManualClock, ticks
from firmware_bridge.errors import ServoError
from firmware_bridge.gate.ramp import StaleLevel
from firmware_bridge.joints import Joint
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.face_table import FaceState
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.simulator.bus import SimulatedBus
from firmware_bridge.stopping import StopLevel

JAW = Joint("jaw", 1, min_deg=-2.0, max_deg=25.0, max_speed_deg_s=300.0)
LIP = Joint("lip", 2, min_deg=-30.0, max_deg=40.0, max_speed_deg_s=400.0)
RATE_HZ = 100.0


class Face:
    """A simulated face with a bridge, driven tick by tick."""

    def __init__(self, start_deg=(0.0, 0.0)):
        self.clock = ManualClock()
        self.bus = SimulatedBus([JAW, LIP], self.clock, start_deg=np.array(start_deg))
        self.channel = MemoryTargetChannel()
        self.bridge = Bridge(self.bus, [JAW, LIP], self.channel, BridgeSettings(RATE_HZ))
        self._grid = ticks(self.clock, RATE_HZ)

    def tick(self, wanted_deg=None):
        """One tick; `wanted_deg`, if any, arrives just before it and is due at it."""
        time_s, late = next(self._grid)
        if wanted_deg is not None:
            self.channel.publish(ServoTargets(time_s, np.array(wanted_deg, dtype=np.float64)))
        return self.bridge.tick(time_s, late)

    def ticks(self, n, wanted_deg=None):
        return [self.tick(wanted_deg) for _ in range(n)]

    def end(self, level=StopLevel.SOFT):
        """Stop, and tick until it has come to its end."""
        self.bridge.stop(level)
        while self.bridge.state is not FaceState.ENDED:
            self.tick()


@pytest.fixture
def face():
    face = Face()
    with face.bus:
        yield face


def test_targets_reach_the_servos(face):
    face.bridge.start()
    report = face.ticks(30, [20.0, -10.0])[-1]

    np.testing.assert_allclose(report.sent_deg, [20.0, -10.0])
    np.testing.assert_allclose(face.bus.read().positions_deg, [20.0, -10.0])
    assert report.stale is StaleLevel.FRESH
    assert report.target_age_s == 0.0


def test_before_arming_the_face_is_limp_and_nothing_is_sent(face):
    reports = face.ticks(10, [20.0, 20.0])

    assert not any(report.torque_on for report in reports)
    assert face.bus.history == ()
    assert not face.bus.read().torque.any()


def test_arming_moves_nothing_whatever_goal_the_servos_remember():
    face = Face(start_deg=(12.0, -7.0))
    with face.bus:
        face.bus.write_positions(np.array([25.0, 40.0]))
        face.bridge.start()
        face.clock.advance(10.0)
        readings = face.bus.read()

    np.testing.assert_array_equal(readings.positions_deg, [12.0, -7.0])
    assert (readings.torque == 1).all()


def test_a_joint_pushed_a_little_out_of_range_is_held_there_and_led_back():
    face = Face(start_deg=(28.0, 0.0))
    with face.bus:
        face.bridge.start()
        sent_deg = [report.sent_deg[0] for report in face.ticks(3, [25.0, 0.0])]

    np.testing.assert_allclose(sent_deg, [28.0, 25.0, 25.0])


def test_a_servo_that_refuses_to_hold_its_place_is_named_and_all_stay_limp():
    face = Face(start_deg=(90.0, 0.0))
    with face.bus:
        with pytest.raises(ServoError, match=r"'jaw' \(id 1\) stands at 90.0 deg.*-7\.\.30 deg"):
            face.bridge.start()

        assert not face.bus.read().torque.any()
        assert not face.tick([0.0, 0.0]).torque_on


def test_a_servo_without_an_answer_is_named():
    face = Face(start_deg=(0.0, math.nan))
    with face.bus, pytest.raises(ServoError, match=r"'lip' \(id 2\) does not answer"):
        face.bridge.start()


def test_goals_are_limited_in_range_and_speed_and_the_report_says_so(face):
    face.bridge.start()
    face.tick([0.0, 0.0])
    report = face.tick([30.0, 2.0])

    np.testing.assert_allclose(report.wanted_deg, [30.0, 2.0])
    np.testing.assert_allclose(report.sent_deg, [3.0, 2.0])
    np.testing.assert_array_equal(report.range_hits, [True, False])
    np.testing.assert_array_equal(report.rate_hits, [True, False])


def test_invalid_targets_are_counted_and_change_nothing(face):
    face.bridge.start()
    face.ticks(10, [10.0, 10.0])
    report = face.tick([math.nan, 0.0])

    np.testing.assert_allclose(report.sent_deg, [10.0, 10.0])
    assert face.bridge.as_dict()["n_rejected_targets"] == 1


def test_a_silent_speech_side_leads_to_hold_then_neutral_then_limp(face):
    face.bridge.start()
    face.ticks(50, [20.0, -20.0])
    reports = face.ticks(600)
    jaw_deg = np.array([report.sent_deg[0] for report in reports])
    level = np.array([report.stale for report in reports])
    torque_on = np.array([report.torque_on for report in reports])

    np.testing.assert_allclose(jaw_deg[:9], 20.0)
    assert np.all(np.diff(jaw_deg[10:99]) < 0.0)
    np.testing.assert_array_equal(jaw_deg[100:], 0.0)
    assert [int((level == step).sum()) for step in (1, 2)] == pytest.approx([89, 400], abs=2)
    assert torque_on[:498].all()
    assert not torque_on[501:].any()
    assert not face.bus.read().torque.any()


def test_easing_to_neutral_in_a_silence_never_hits_the_speed_limit(face):
    face.bridge.start()
    face.ticks(50, [25.0, -30.0])
    before = face.bridge.as_dict()["rate_hits_total"]
    face.ticks(600)

    assert face.bridge.as_dict()["rate_hits_total"] == before


def test_a_limp_face_wakes_without_a_jump_when_speech_returns(face):
    face.bridge.start()
    face.ticks(10, [20.0, 20.0])
    face.ticks(700)
    reports = face.ticks(20, [20.0, 20.0])
    jaw_deg = np.array([0.0, *(report.sent_deg[0] for report in reports)])

    assert reports[0].torque_on
    assert np.diff(jaw_deg).max() <= 3.0 + 1e-9
    assert jaw_deg[-1] == 20.0
    assert face.bridge.counts.n_armed == 2


def test_a_servo_that_cannot_hold_stays_limp_while_the_others_wake_and_is_named(face):
    face.bridge.start()
    face.tick([0.0, 0.0])
    face.ticks(600)
    face.bus.push_by_hand(np.array([0.0, 90.0]))
    face.ticks(3, [0.0, 0.0])

    assert face.bus.read().torque.tolist() == [True, False]
    assert "servo 'lip' (id 2) stands at 90.0 deg" in face.bridge.troubles[0]

    face.bus.push_by_hand(np.array([0.0, 30.0]))
    face.ticks(60, [0.0, 0.0])

    assert (face.bus.read().torque == 1).all()
    assert face.bridge.troubles == ()


def test_waiting_for_the_first_target_holds_the_place_then_eases_and_is_not_called_stale():
    face = Face(start_deg=(10.0, 0.0))
    with face.bus:
        face.bridge.start()
        reports = face.ticks(110)

        assert reports[9].sent_deg[0] == 10.0
        assert reports[-1].sent_deg[0] == 0.0
        assert face.bridge.counts.n_stale == 0


def test_targets_from_before_arming_do_not_move_the_face(face):
    face.bridge.start()
    face.ticks(10, [20.0, 20.0])
    face.end(StopLevel.LIMP)
    face.bridge.await_start()
    face.clock.advance(60.0)
    face.bridge.start()
    present_deg = face.bus.read().positions_deg
    report = face.tick()

    np.testing.assert_allclose(report.wanted_deg, present_deg)


def test_late_ticks_are_reported_and_counted(face):
    face.bridge.start()
    face.tick()
    face.clock.advance(0.055)
    report = face.tick()

    assert report.late == 4
    assert face.bridge.counts.n_late == 4
    assert face.bridge.counts.n_ticks == 2


def test_at_the_end_the_face_eases_to_neutral_in_half_a_second_and_goes_limp(face):
    face.bridge.start()
    face.ticks(50, [20.0, -20.0])
    start_s = face.clock.now()
    n_before = len(face.bus.history)
    face.end()
    motion = face.bus.history[n_before - 1 :]
    goals_deg = np.array([sample.goals_deg for sample in motion])

    assert face.clock.now() - start_s == pytest.approx(0.5, abs=0.04)
    np.testing.assert_array_equal(goals_deg[-1], [0.0, 0.0])
    assert np.abs(np.diff(goals_deg, axis=0)).max() <= 1.5 * 20.0 / 0.5 / RATE_HZ + 1e-9
    assert not face.bus.read().torque.any()
    assert face.bridge.stop_report().text() == (
        "stopped; the face is at rest and limp: confirmed by 2 servos"
    )


@pytest.mark.parametrize(("speed_deg_s", "seconds"), [(40.0, 0.75), (16.0, 1.875), (2.0, 2.0)])
def test_a_slow_joint_gets_the_time_it_needs_but_never_more_than_two_seconds(speed_deg_s, seconds):
    slow = Joint("slow", 1, min_deg=-20.0, max_deg=20.0, max_speed_deg_s=speed_deg_s)
    clock = ManualClock()
    with SimulatedBus([slow], clock, start_deg=np.array([20.0])) as bus:
        bridge = Bridge(bus, [slow], MemoryTargetChannel(), BridgeSettings(RATE_HZ))
        bridge.start()
        bridge.stop(StopLevel.SOFT)
        for time_s, late in ticks(clock, RATE_HZ):
            bridge.tick(time_s, late)
            if bridge.state is FaceState.ENDED:
                break

        assert clock.now() == pytest.approx(seconds, abs=0.04)
        assert not bus.read().torque.any()


def test_limp_during_the_way_to_rest_lets_go_at_once(face):
    face.bridge.start()
    face.ticks(50, [20.0, 20.0])
    face.bridge.stop(StopLevel.SOFT)
    face.ticks(5)
    face.bridge.stop(StopLevel.LIMP)

    assert not face.bus.read().torque.any()


@pytest.mark.parametrize("level", [StopLevel.SOFT, StopLevel.LIMP])
def test_a_stop_holds_whatever_speech_goes_on_to_say(face, level):
    face.bridge.start()
    face.ticks(10, [20.0, 20.0])
    face.bridge.stop(level)
    face.ticks(1000, [20.0, -20.0])

    assert not face.bus.read().torque.any()
    assert face.bridge.state is FaceState.ENDED

    face.bridge.await_start()
    face.bridge.start()

    assert face.tick([20.0, 20.0]).torque_on


def test_a_frozen_face_stays_where_it_is_held_and_listens_to_nobody(face):
    face.bridge.start()
    face.ticks(10, [20.0, 20.0])
    stood_deg = face.bus.read().positions_deg
    face.bridge.stop(StopLevel.FREEZE)
    face.ticks(1000, [-2.0, -30.0])

    np.testing.assert_array_equal(face.bus.read().positions_deg, stood_deg)
    assert (face.bus.read().torque == 1).all()
    assert face.tick().torque_on

    face.end()

    assert not face.bus.read().torque.any()


def test_a_dry_run_never_switches_torque_on(face):
    bridge = Bridge(face.bus, [JAW, LIP], face.channel, BridgeSettings(RATE_HZ, dry_run=True))
    face.bridge = bridge
    bridge.start()
    face.ticks(700, [20.0, 20.0])
    face.ticks(100)
    face.end()

    assert face.bus.history == ()
    assert bridge.stop_report().text() == "dry run over; no torque was switched on"
