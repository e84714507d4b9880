import numpy as np
import pytest

from firmware_bridge.clock import ManualClock
from firmware_bridge.dynamixel.wire.codec import StatusError
from firmware_bridge.errors import PortError
from firmware_bridge.joints import SERVO_LIMIT_MARGIN_DEG, Joint
from firmware_bridge.simulator.bus import SimulatedBus

JAW = Joint("jaw", 1, min_deg=-2.0, max_deg=25.0, max_speed_deg_s=300.0)
LIP = Joint("lip", 2, min_deg=-30.0, max_deg=40.0, max_speed_deg_s=400.0)


@pytest.fixture
def clock():
    return ManualClock()


@pytest.fixture
def bus(clock):
    with SimulatedBus([JAW, LIP], clock, top_speed_deg_s=100.0) as bus:
        yield bus


def hold_all(bus):
    for index in range(len(bus.read().positions_deg)):
        assert bus.enable_torque(index) == ""


def test_servos_run_to_their_goals_at_top_speed_and_stop_there(bus, clock):
    hold_all(bus)
    bus.write_positions(np.array([10.0, -20.0]))

    clock.advance(0.05)
    np.testing.assert_allclose(bus.read().positions_deg, [5.0, -5.0])

    clock.advance(0.1)
    np.testing.assert_allclose(bus.read().positions_deg, [10.0, -15.0])

    clock.advance(10.0)
    np.testing.assert_array_equal(bus.read().positions_deg, [10.0, -20.0])


def test_how_often_the_bus_is_read_does_not_change_the_motion():
    def final_deg(n_reads):
        clock = ManualClock()
        with SimulatedBus([JAW, LIP], clock, top_speed_deg_s=100.0) as bus:
            hold_all(bus)
            bus.write_positions(np.array([20.0, -20.0]))
            for _ in range(n_reads):
                clock.advance(0.125 / n_reads)
                bus.read()
            return bus.read().positions_deg

    np.testing.assert_allclose(final_deg(n_reads=50), final_deg(n_reads=1))


def test_a_limp_servo_takes_goals_but_stays(bus, clock):
    bus.write_positions(np.array([10.0, 10.0]))
    clock.advance(1.0)
    readings = bus.read()

    np.testing.assert_array_equal(readings.positions_deg, [0.0, 0.0])
    np.testing.assert_array_equal(readings.goals_deg, [10.0, 10.0])
    assert not readings.torque.any()


def test_torque_off_in_mid_motion_keeps_the_position(bus, clock):
    hold_all(bus)
    bus.write_positions(np.array([20.0, 20.0]))
    clock.advance(0.1)
    bus.disable_all()
    clock.advance(5.0)

    np.testing.assert_allclose(bus.read().positions_deg, [10.0, 10.0])


def test_torque_comes_on_where_the_servo_stands_whatever_goal_it_remembers(bus, clock):
    bus.write_positions(np.array([20.0, 20.0]))
    hold_all(bus)
    clock.advance(5.0)

    np.testing.assert_array_equal(bus.read().positions_deg, [0.0, 0.0])
    assert (bus.read().torque == 1).all()


@pytest.mark.parametrize("goal_deg", [25.0 + SERVO_LIMIT_MARGIN_DEG + 0.01, -7.01, np.nan, np.inf])
def test_a_goal_outside_the_servos_range_is_refused_by_that_servo_alone(bus, goal_deg):
    bus.write_positions(np.array([10.0, 10.0]))
    bus.write_positions(np.array([goal_deg, 12.0]))
    readings = bus.read()

    np.testing.assert_array_equal(readings.goals_deg, [10.0, 12.0])
    np.testing.assert_array_equal(readings.errors, [StatusError.DATA_LIMIT, 0])

    bus.write_positions(np.array([25.0 + SERVO_LIMIT_MARGIN_DEG, 12.0]))

    np.testing.assert_array_equal(bus.read().errors, [0, 0])


def test_positions_of_the_wrong_shape_are_a_programming_error(bus):
    with pytest.raises(ValueError, match=r"expected positions of shape \(2,\), got \(1,\)"):
        bus.write_positions(np.array([1.0]))


def test_limp_joints_give_to_a_hand_and_held_ones_do_not(bus):
    bus.push_by_hand(np.array([5.0, 6.0]))
    np.testing.assert_array_equal(bus.read().positions_deg, [5.0, 6.0])

    hold_all(bus)
    bus.push_by_hand(np.array([9.0, 9.0]))
    np.testing.assert_array_equal(bus.read().positions_deg, [5.0, 6.0])


def test_history_keeps_the_newest_writes_with_time_goals_and_positions(clock):
    with SimulatedBus([JAW], clock, top_speed_deg_s=100.0, n_remembered=3) as bus:
        hold_all(bus)
        for goal_deg in range(5):
            bus.write_positions(np.array([float(goal_deg)]))
            clock.advance(1.0)

    assert [motion.time_s for motion in bus.history] == [2.0, 3.0, 4.0]
    assert [motion.goals_deg[0] for motion in bus.history] == [2.0, 3.0, 4.0]
    assert [motion.positions_deg[0] for motion in bus.history] == [1.0, 2.0, 3.0]


def test_what_was_read_does_not_change_afterwards(bus, clock):
    hold_all(bus)
    before = bus.read()
    bus.write_positions(np.array([20.0, 20.0]))
    clock.advance(1.0)
    bus.read()

    np.testing.assert_array_equal(before.positions_deg, [0.0, 0.0])
    np.testing.assert_array_equal(before.goals_deg, [0.0, 0.0])


def test_the_bus_works_only_inside_its_with_block_and_leaves_the_servos_limp(clock):
    bus = SimulatedBus([JAW, LIP], clock)
    with pytest.raises(PortError, match="outside its `with` block"):
        bus.read()
    with bus:
        hold_all(bus)
    with bus:
        assert not bus.read().torque.any()


@pytest.mark.parametrize(
    ("min_deg", "max_deg", "max_speed_deg_s"),
    [
        (1.0, 5.0, 100.0),
        (-5.0, -1.0, 100.0),
        (5.0, -5.0, 100.0),
        (float("nan"), 5.0, 100.0),
        (-5.0, float("inf"), 100.0),
        (-5.0, 5.0, 0.0),
        (-5.0, 5.0, float("nan")),
    ],
)
def test_a_joint_needs_its_neutral_inside_its_limits_and_a_speed(min_deg, max_deg, max_speed_deg_s):
    with pytest.raises(ValueError, match="joint 'jaw'"):
        Joint("jaw", 1, min_deg, max_deg, max_speed_deg_s)
