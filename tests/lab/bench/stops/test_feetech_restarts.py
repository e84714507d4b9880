"""The measure of how fast a Feetech servo goes after a restart."""

from lipservo_lab.bench.stops.feetech_restarts import (
    MOST_OVER,
    RESTARTS_S,
    Restart,
    over_bound,
    restarts,
)


def test_restarts_last_from_a_hundredth_to_half_a_second():
    assert {each.lasts_s for each in restarts()} == set(RESTARTS_S)
    assert (min(RESTARTS_S), max(RESTARTS_S)) == (0.01, 0.5)


def test_a_servo_that_was_away_for_half_a_second_comes_back_at_its_soft_start():
    over = over_bound(Restart("STS3215", at_s=4.1, lasts_s=0.5, stiff=False))

    assert 0.5 < over < MOST_OVER
