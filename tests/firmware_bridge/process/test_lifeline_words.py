"""What a bridge tells its supervisor arrives whole, in its order, and before the next heartbeat."""

import os
import struct

import pytest

from firmware_bridge.process.lifeline import (
    Began,
    Failed,
    Lifeline,
    NotStarted,
    Ready,
    Started,
    Stopped,
    Switched,
    inherited_lifeline,
    lifeline_pair,
)
from firmware_bridge.stopping import StopLevel


@pytest.fixture
def pair():
    """A child's end with a clock that is set by hand, and the supervisor's end."""
    now_s = [10.0]
    end, watch = lifeline_pair()
    line = Lifeline(end, lambda: now_s[0])
    yield line, watch, now_s
    line.close()
    watch.close()


@pytest.mark.parametrize("level", list(StopLevel))
@pytest.mark.parametrize("ends", [False, True])
def test_a_stop_arrives_with_who_asked_and_whether_the_process_ends(pair, level, ends):
    line, watch, _ = pair
    line.stopped(level, ends=ends, requested_by="process 7 of user 0")

    assert watch.read() == [Stopped(level, ends, "process 7 of user 0")]
    assert watch.read() == []


def test_every_word_is_understood_as_it_was_said(pair):
    line, watch, _ = pair
    line.started()
    line.not_started("jaw has had no pulse yet")
    line.failed(0, "")
    line.failed(65_535, "jammed")
    line.switched(0, on=True)
    line.began(-1.25)
    line.ready()

    assert watch.read() == [
        Started(),
        NotStarted("jaw has had no pulse yet"),
        Failed(0, ""),
        Failed(65_535, "jammed"),
        Switched(0, True),
        Began(-1.25),
        Ready(),
    ]


def test_a_reason_of_any_length_is_cut_and_what_it_is_about_is_not(pair):
    line, watch, _ = pair
    line.stopped(StopLevel.LIMP, requested_by="x" * 5000)
    line.not_started("y" * 5000)
    line.failed(3, "z" * 5000)
    stopped, not_started, failed = watch.read()

    assert (stopped.level, failed.index) == (StopLevel.LIMP, 3)
    assert stopped.requested_by == "x" * 395  # 400 bytes with the level before them
    assert (not_started.reason, failed.reason) == ("y" * 400, "z" * 400)


@pytest.mark.parametrize(("later_s", "beats"), [(0.0, False), (0.049, False), (0.051, True)])
def test_a_heart_beats_every_twentieth_of_a_second_and_no_more_often(pair, later_s, beats):
    line, watch, now_s = pair
    line.beat()
    watch.read()
    now_s[0] += later_s
    line.beat()
    watch.read()

    assert watch.beat_s == (10.0 + later_s if beats else 10.0)


def test_the_newest_heartbeat_counts_in_whatever_order_they_come():
    end, watch = lifeline_pair()
    for time_s in (5.0, 9.0, 7.0):
        end.send(b"B" + struct.pack("<d", time_s))
    assert watch.read() == []
    assert watch.beat_s == 9.0

    for broken in (b"B", b"B1234", b"B" + bytes(9)):
        end.send(broken)
    assert watch.read() == []
    assert watch.beat_s == 9.0
    end.close()
    watch.close()


def test_what_had_no_room_is_told_once_in_its_order_before_the_next_heartbeat(pair):
    line, watch, now_s = pair
    for _ in range(1000):  # more than the socket and the queue hold
        line.failed(1, "full")
    line.ready()
    line.stopped(StopLevel.FREEZE)
    told = []
    while new := watch.read():
        told += new
    assert Ready() not in told
    now_s[0] += 1.0
    line.beat()
    told = watch.read()

    assert told[-2:] == [Ready(), Stopped(StopLevel.FREEZE)]
    assert set(told[:-2]) <= {Failed(1, "full")}
    assert watch.beat_s == 11.0
    now_s[0] += 1.0
    line.beat()
    assert watch.read() == []


def test_a_stop_outlives_any_number_of_failures_that_nobody_reads(pair):
    line, watch, now_s = pair
    for index in range(5000):
        line.failed(index, "jammed")
    line.stopped(StopLevel.LIMP)
    told = []
    for _ in range(100):
        told += watch.read()
        now_s[0] += 1.0
        line.beat()

    assert told[-1] == Stopped(StopLevel.LIMP)
    assert [each.index for each in told[:-1]] == sorted(each.index for each in told[:-1])


def test_what_a_child_said_before_it_died_is_heard_before_its_death():
    end, watch = lifeline_pair()
    line = Lifeline(end.detach())
    line.stopped(StopLevel.LIMP)
    line.close()

    assert watch.read() == [Stopped(StopLevel.LIMP)]
    assert watch.closed
    watch.close()


def test_nobody_waits_for_who_does_not_speak(pair):
    line, watch, _ = pair

    assert watch.read() == []
    assert watch.beat_s is None
    assert not watch.closed
    assert not line.closed
    assert watch.fileno() >= 0


def test_a_child_of_the_child_does_not_inherit_the_lifeline():
    end, watch = lifeline_pair()
    fd = os.dup(end.fileno())
    os.set_inheritable(fd, True)
    line = inherited_lifeline(fd)
    line.ready()

    assert not os.get_inheritable(fd)
    assert watch.read() == [Ready()]
    line.close()
    end.close()
    watch.close()
