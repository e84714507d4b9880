"""What a bridge tells its supervisor arrives whole, in its order, and before the next heartbeat."""

import json
import os
import socket

import pytest

from firmware_bridge.process.lifeline import (
    Began,
    Failed,
    Lifeline,
    LifelineWatch,
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
    line.tell(Stopped(level, ends, "process 7 of user 0"))

    assert watch.read() == [Stopped(level, ends, "process 7 of user 0")]
    assert watch.read() == []


@pytest.mark.parametrize(
    "message",
    [
        Started(),
        NotStarted("Kiefer: überlastet"),
        Failed(0, ""),
        Failed(65_535, "jammed"),
        Switched(0, on=True),
        Switched(3, on=False),
        Began(-1.25),
        Ready(),
        Stopped(StopLevel.LIMP),
    ],
)
def test_every_word_is_understood_as_it_was_said(pair, message):
    line, watch, _ = pair
    line.tell(message)

    assert watch.read() == [message]


def test_a_reason_of_any_length_is_cut_and_what_it_is_about_is_not(pair):
    line, watch, _ = pair
    line.tell(Stopped(StopLevel.LIMP, False, "\N{NULL}" * 5000))
    line.tell(NotStarted("\N{ROBOT FACE}" * 5000))
    line.tell(Failed(3, "z" * 5000))
    stopped, not_started, failed = watch.read()

    assert (stopped.level, stopped.requested_by) == (StopLevel.LIMP, "\N{NULL}" * 400)
    assert not_started.reason == "\N{ROBOT FACE}" * 400
    assert (failed.index, failed.reason) == (3, "z" * 400)


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
        end.send(json.dumps(["Beat", time_s]).encode())
    assert watch.read() == []
    assert watch.beat_s == 9.0
    end.close()
    watch.close()


@pytest.mark.parametrize(
    "broken",
    [b"\xff", b"{", b"[]", b"{}", b"7", b'["Beat"]', b'["Beat", "x"]', b'["Stopped"]',
     b'["Stopped", "sideways"]', b'["Failed"]', b'["Message", 1]', b'[["Ready"]]'],
)  # fmt: skip
def test_words_that_are_none_are_left_out_and_end_nothing(broken):
    end, watch = lifeline_pair()
    end.send(broken)
    Lifeline(end).tell(Ready())

    assert watch.read() == [Ready()]
    assert watch.beat_s is None
    assert not watch.closed
    end.close()
    watch.close()


def test_what_had_no_room_is_told_once_in_its_order_before_the_next_heartbeat(pair):
    line, watch, now_s = pair
    for _ in range(1000):  # more than the socket and the queue hold
        line.tell(Failed(1, "full"))
    line.tell(Ready())
    line.tell(Stopped(StopLevel.FREEZE))
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
        line.tell(Failed(index, "jammed"))
    line.tell(Stopped(StopLevel.LIMP))
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
    line.tell(Stopped(StopLevel.LIMP))
    line.close()

    assert watch.read() == [Stopped(StopLevel.LIMP)]
    assert watch.closed
    watch.close()


def test_a_child_that_died_before_it_read_what_it_was_sent_is_gone_all_the_same():
    child, supervisor = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    supervisor.send(b"never read")
    child.close()
    watch = LifelineWatch(supervisor)

    assert watch.read() == []
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
    line.tell(Ready())

    assert not os.get_inheritable(fd)
    assert watch.read() == [Ready()]
    line.close()
    end.close()
    watch.close()
