"""Heartbeats, what must not be lost with them, and logs that stop nobody."""

import logging
import os
import time

from hypothesis import given
from hypothesis import strategies as st

from firmware_bridge.process.lifeline import (
    Began,
    Failed,
    Lifeline,
    NotStarted,
    Ready,
    Started,
    Stopped,
    Switched,
    lifeline_pair,
)
from firmware_bridge.process.log_lines import LogLines, LogWriter
from firmware_bridge.stopping import StopLevel

TIMEOUT_S = 60.0


def test_beats_are_counted_by_their_time_and_the_rest_is_heard_in_its_order():
    now_s = [10.0]
    end, watch = lifeline_pair()
    line = Lifeline(end, lambda: now_s[0])
    assert watch.beat_s is None
    for _ in range(1_000):
        now_s[0] += 0.01
        line.beat()
    told = [
        Began(1.5),
        Ready(),
        Failed(3, "überlastet"),
        Switched(7, on=False),
        Switched(300, on=True),
        Stopped(StopLevel.FREEZE, ends=True, requested_by="a test"),
        Started(),
        NotStarted("no answer"),
    ]
    for message in told:
        line.tell(message)
    said = []
    while new := watch.read():
        said += new

    assert said == told
    assert 20.0 - 0.05 <= watch.beat_s <= 20.0
    line.close()
    watch.close()


def test_a_supervisor_that_does_not_read_loses_beats_and_never_a_stop():
    now_s = [0.0]
    end, watch = lifeline_pair()
    line = Lifeline(end, lambda: now_s[0])
    for _ in range(5_000):  # more than the socket holds
        now_s[0] += 0.1
        line.beat()
    line.tell(Stopped(StopLevel.LIMP))
    said = []
    for _ in range(100):
        now_s[0] += 0.1
        line.beat()
        said += watch.read()

    assert said == [Stopped(StopLevel.LIMP)]
    assert watch.beat_s > 500.0
    line.close()
    watch.close()


def test_both_ends_notice_that_the_other_is_gone():
    end, watch = lifeline_pair()
    line = Lifeline(end)
    watch.close()
    line.beat()
    assert line.closed
    line.close()

    end, watch = lifeline_pair()
    end.close()
    assert watch.read() == []
    assert watch.closed
    watch.close()


@given(st.lists(st.binary(min_size=1, max_size=40), max_size=20))
def test_what_no_lifeline_says_is_left_out(messages):
    end, watch = lifeline_pair()
    for message in messages:
        end.send(message)
    end.send(b'["Ready"]')

    assert watch.read()[-1:] == [Ready()]
    end.close()
    watch.close()


def line_of(text):
    return logging.makeLogRecord({"msg": text})


def write_all(descriptor, text):
    data = text.encode()
    while data:
        data = data[os.write(descriptor, data) :]


def test_a_log_that_nobody_reads_stops_nobody_and_says_what_was_lost():
    """As Ctrl-S in a terminal, or a full pipe."""
    reading, writing = os.pipe()
    log = LogLines(LogWriter(start="face: ", write=lambda text: write_all(writing, f"{text}\n")))
    for n in range(20_000):  # far more than a pipe and the queue hold
        log.handle(line_of(f"line {n} of a log\nthat nobody reads"))
    began_s = time.monotonic()
    log.close(timeout_s=0.0)
    read = b""
    while b"were lost" not in read:
        assert time.monotonic() - began_s < TIMEOUT_S
        read += os.read(reading, 65_536)
        log.handle(line_of("more"))

    assert read.startswith(b"face: ")
    assert b"line 0 of a log that nobody reads\n" in read[:100]
    log.close(TIMEOUT_S)
    os.close(reading)
    os.close(writing)


def test_a_reason_of_any_length_arrives_cut_off():
    end, watch = lifeline_pair()
    line = Lifeline(end)
    line.tell(Failed(1, "ü" * 100_000))

    assert watch.read() == [Failed(1, "ü" * 400)]
    line.close()
    watch.close()


def test_a_child_sees_before_its_first_beat_that_its_supervisor_has_died():
    end, watch = lifeline_pair()
    line = Lifeline(end)
    assert not line.is_cut()

    watch.close()

    assert line.is_cut()
    line.close()
