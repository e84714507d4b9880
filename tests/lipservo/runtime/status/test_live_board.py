"""The memory in which a face tells what it does: whoever watches sees whole ticks only."""

import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lipservo.runtime.status.live_board import BoardLayout, LiveBoard, expression_values
from lipsync.face.frame import Expression

LAYOUT = BoardLayout(
    name="tom",
    config="face_four",
    servos=("jaw", "neck"),
    states=("stopped", "driven"),
    phonemes=("SIL", "AA"),
    n_components=3,
    rate_hz=30.0,
)


def watched(board):
    """The same memory, to read only."""
    return LiveBoard.watch(os.open(f"/proc/self/fd/{board.fileno()}", os.O_RDONLY))


def tick(board, n):
    board.write_servos(time_s=float(n), goal_deg=[n, -n], encoder_deg=[np.nan, n], state=1)


def test_a_watcher_reads_what_was_written():
    with LiveBoard.create(LAYOUT) as board, watched(board) as watcher:
        tick(board, 3)
        board.write_speech(
            [0.5, 2.0],
            time_s=1.0,
            sound_s=0.7,
            phoneme=1,
            coefficients=[1.0, 2.0, 3.0],
            expression=expression_values(Expression(neck_yaw_deg=5.0)),
        )
        ((_, servos),) = watcher.servos_since(0)
        ((_, speech),) = watcher.speech_since(0)

        assert watcher.layout == LAYOUT
        assert servos["goal_deg"].tolist() == [3.0, -3.0]
        assert np.isnan(servos["encoder_deg"][0])
        assert speech["peaks"][: speech["n_peaks"]].tolist() == [128, 255]
        assert speech["coefficients"].tolist() == [1.0, 2.0, 3.0]
        named = dict(zip(Expression.__dataclass_fields__, speech["expression"], strict=True))
        assert named.pop("neck_yaw_deg") == 5.0
        assert np.isnan(list(named.values())).all()


def test_a_watcher_reads_on_where_it_left_off():
    with LiveBoard.create(LAYOUT) as board, watched(board) as watcher:
        tick(board, 1)
        ((number, _),) = watcher.servos_since(0)
        tick(board, 2)
        tick(board, 3)

        assert [record["time_s"] for _, record in watcher.servos_since(number)] == [2.0, 3.0]


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 200), st.integers(1, 50))
def test_a_slow_watcher_has_the_newest_ticks_in_their_order(n_before, n_after):
    with LiveBoard.create(LAYOUT) as board, watched(board) as watcher:
        for n in range(n_before + n_after):
            tick(board, n)
        read = [record["time_s"] for _, record in watcher.servos_since(n_before)]

        assert read == list(range(n_before, n_before + n_after))


def test_a_process_that_takes_over_goes_on_with_the_numbers():
    with LiveBoard.create(LAYOUT) as board, watched(board) as watcher:
        for n in range(70):
            tick(board, n)
        (number, _) = watcher.servos_since(0)[-1]
        with LiveBoard.adopt(os.dup(board.fileno())) as successor:
            tick(successor, 70)

        assert [record["time_s"] for _, record in watcher.servos_since(number)] == [70.0]


def test_a_tick_that_is_being_written_is_not_believed():
    with LiveBoard.create(LAYOUT) as board, watched(board) as watcher:
        tick(board, 1)
        tick(board, 2)
        torn = os.pread(board.fileno(), os.fstat(board.fileno()).st_size, 0)
        place = torn.index(np.array([2.0, -2.0], dtype="<f4").tobytes())
        os.pwrite(board.fileno(), b"\x01", place)

        assert [record["time_s"] for _, record in watcher.servos_since(0)] == [1.0]


def test_what_is_no_board_is_refused():
    empty = os.memfd_create("empty")
    os.ftruncate(empty, 100_000)
    with pytest.raises(ValueError, match="not a live board"):
        LiveBoard.watch(empty)
    os.close(empty)
