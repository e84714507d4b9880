import math

import numpy as np
import pytest

from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets, TargetTrack


def targets(time_s, *positions_deg):
    return ServoTargets(time_s, np.array(positions_deg, dtype=np.float64))


def track_of(*records):
    track = TargetTrack(n_servos=1)
    track.push(records)
    return track


def test_drain_hands_over_every_record_once_oldest_first():
    channel = MemoryTargetChannel()
    first, second = targets(0.0, 1.0), targets(0.01, 2.0)
    channel.publish(first)
    channel.publish(second)

    assert channel.drain() == [first, second]
    assert channel.drain() == []


def test_a_full_channel_drops_the_oldest_and_counts_it():
    channel = MemoryTargetChannel(capacity=3)
    for n in range(5):
        channel.publish(targets(float(n), 0.0))

    assert [record.time_s for record in channel.drain()] == [2.0, 3.0, 4.0]
    assert channel.n_dropped == 2


def test_before_the_first_target_is_due_there_is_nothing():
    assert track_of().at(0.0) == (None, math.inf)
    assert track_of(targets(1.0, 5.0)).at(0.999) == (None, math.inf)


@pytest.mark.parametrize(
    ("time_s", "position_deg", "age_s"),
    [
        (1.00, 10.0, 0.0),
        (1.05, 15.0, 0.05),
        (1.10, 20.0, 0.0),  # the newest target itself
        (1.12, 22.0, 0.02),  # along the last slope, 100 deg/s
        (1.15, 25.0, 0.05),  # as far as extrapolation goes
        (1.16, 25.0, 0.06),  # held
        (9.10, 25.0, 8.0),
    ],
)
def test_positions_run_in_lines_then_50_ms_on_and_then_hold(time_s, position_deg, age_s):
    found_deg, found_age_s = track_of(targets(1.0, 10.0), targets(1.1, 20.0)).at(time_s)

    np.testing.assert_allclose(found_deg, [position_deg])
    assert found_age_s == pytest.approx(age_s)


def test_a_single_target_is_held():
    position_deg, age_s = track_of(targets(1.0, 10.0)).at(1.03)

    np.testing.assert_array_equal(position_deg, [10.0])
    assert age_s == pytest.approx(0.03)


@pytest.mark.parametrize(
    "invalid",
    [
        targets(1.05, math.nan),
        targets(1.05, math.inf),
        targets(1.05, 1.0, 2.0),
        targets(1.05),
        targets(math.nan, 1.0),
        targets(math.inf, 1.0),
    ],
)
def test_records_that_are_invalid_are_left_out_and_counted(invalid):
    track = track_of(targets(1.0, 10.0), invalid, targets(1.1, 20.0))

    np.testing.assert_allclose(track.at(1.05)[0], [15.0])
    assert track.n_rejected == 1


def test_a_sender_that_goes_back_in_time_replaces_what_it_said_about_later():
    track = track_of(targets(1.0, 0.0), targets(1.1, 10.0), targets(1.2, 20.0), targets(1.1, -5.0))

    np.testing.assert_allclose(track.at(1.05)[0], [-2.5])
    np.testing.assert_allclose(track.at(1.1)[0], [-5.0])
    np.testing.assert_allclose(track.at(1.2)[0], [-7.5])  # 50 ms along the new slope


def test_two_targets_for_nearly_the_same_moment_do_not_make_a_steep_slope():
    track = track_of(targets(1.0, 0.0), targets(1.1, 0.0), targets(1.1 + 1e-9, 1.0))

    np.testing.assert_allclose(track.at(1.12)[0], [1.2])


def test_targets_dated_into_the_far_future_do_not_count_as_fresh():
    track = track_of(targets(1.0, 0.0), targets(1.7e9, 10.0))

    position_deg, age_s = track.at(3.0)

    np.testing.assert_allclose(position_deg, [0.0], atol=1e-6)
    assert age_s == pytest.approx(2.0)


def test_only_the_newest_records_are_kept():
    track = TargetTrack(n_servos=1, n_kept=2)
    track.push([targets(1.0, 1.0), targets(2.0, 2.0), targets(3.0, 3.0)])

    assert track.at(1.5) == (None, math.inf)
    np.testing.assert_allclose(track.at(2.5)[0], [2.5])
