"""A face whose ticks or whose targets come late says so; one short stall is not worth a word."""

import pytest
from driven_robot import Robot

from firmware_bridge.loop.tick_counts import TickCounts


def counted(*parts, rate_hz=100.0):
    """Ticks counted: parts of (seconds, late before each tick, is_stale)."""
    counts = TickCounts(rate_hz)
    for seconds, late, is_stale in parts:
        for _ in range(round(seconds * rate_hz / (1 + late))):
            counts.add(late, is_stale=is_stale)
    return counts


@pytest.mark.parametrize("rate_hz", [30.0, 100.0])
def test_a_loop_that_misses_every_second_tick_says_so_until_it_is_in_time_again(rate_hz):
    good, bad = (30.0, 0, False), (30.0, 1, False)

    (line,) = counted(good, bad, rate_hz=rate_hz).delays()
    assert line.startswith(("the servo loop missed 48%", "the servo loop missed 49%"))
    assert counted(good, bad, (10.0, 0, False), rate_hz=rate_hz).delays()
    assert counted(good, bad, good, rate_hz=rate_hz).delays() == ()


def test_a_stall_of_a_second_is_not_reported_and_one_of_three_is():
    for lost_s, is_reported in ((1.0, False), (3.0, True)):
        counts = counted((30.0, 0, False))
        counts.add(round(100.0 * lost_s), is_stale=False)
        assert counts.keeps_up is not is_reported
        assert counts.n_late == 100.0 * lost_s


def test_what_is_in_time_is_not_named_beside_what_is_late():
    (line,) = counted((30.0, 0, False), (5.0, 0, True)).delays()

    assert "no new motion came from speech" in line


def test_speech_that_sends_nothing_is_told_in_status_and_log_before_torque_goes():
    robot = Robot(stops=[(35.0, "soft")])
    publish, told = robot.channel.publish, {}

    def hang():
        robot.channel.publish = lambda _targets: None

    def look(name):
        return lambda: told.update({name: robot.bridge.as_dict()})

    def recover():
        robot.channel.publish = publish

    times = {2.0: hang, 2.9: look("early"), 5.0: look("late"), 9.0: look("silent"), 9.1: recover}
    robot.live(60.0, times)

    assert [told[each]["state"] for each in told] == ["driven", "driven", "silent"]
    assert told["silent"]["n_stale"] > told["late"]["n_stale"] + 100
    assert told["early"]["troubles"] == []
    (line,) = told["late"]["troubles"]
    assert "no new motion came from speech" in line
    assert sum("no new motion came from speech" in each for each in robot.log) == 1
    assert any("in time again" in each for each in robot.log)
