"""What is known of a face from tick to tick, and when a side of it counts as gone."""

import os

import pytest
from watched_face import LAYOUT

from lipservo.dashboard.live_frames import GONE_S, BoardReader
from lipservo.runtime.status.live_board import LiveBoard


@pytest.fixture
def board():
    with LiveBoard.create(LAYOUT) as made:
        yield made


@pytest.fixture
def reader(board):
    fd = os.open(f"/proc/self/fd/{board.fileno()}", os.O_RDONLY)
    made = BoardReader(LiveBoard.watch(fd))
    yield made
    made.close()


def test_before_anything_was_written_both_sides_are_gone(reader):
    snapshot = reader.read(1, 0.0, 100.0)
    assert (snapshot.servos, snapshot.speech) == (None, None)
    assert snapshot.servos_gone
    assert snapshot.speech_gone


def test_each_side_is_gone_by_itself_and_comes_back(board, reader):
    board.write_servos(time_s=100.0)
    board.write_speech(time_s=100.0)
    assert not reader.read(1, 0.0, 100.1).servos_gone

    board.write_servos(time_s=100.1 + GONE_S)
    snapshot = reader.read(2, 0.0, 100.2 + GONE_S)
    assert (snapshot.servos_gone, snapshot.speech_gone) == (False, True)
    assert snapshot.speech["time_s"] == 100.0  # what it said last is there all the same

    board.write_speech(time_s=101.0)
    assert not reader.read(3, 0.0, 101.1).speech_gone


def test_what_lay_there_before_the_first_look_may_be_old(board, reader):
    board.write_servos(time_s=50.0)
    board.write_speech(time_s=99.9)
    snapshot = reader.read(1, 0.0, 100.0)
    assert (snapshot.servos_gone, snapshot.speech_gone) == (True, False)


def test_peaks_are_those_since_the_moment_before(board, reader):
    board.write_speech([1.0], time_s=100.0)
    assert reader.read(1, 0.0, 100.0).peaks == b""
    for peak in (0.2, 0.4):
        board.write_speech([peak], time_s=100.0)
    assert reader.read(2, 0.0, 100.0).peaks == bytes([51, 102])
    assert reader.read(3, 0.0, 100.0).peaks == b""
    board.write_speech([0.0, 1.0] * 8, time_s=100.0)
    assert reader.read(4, 0.0, 100.0).peaks == bytes([0, 255] * 4)
