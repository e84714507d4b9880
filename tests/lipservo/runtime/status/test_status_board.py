"""What processes of one face write for one another is read whole, or not at all."""

import mmap
import os

from hypothesis import given
from hypothesis import strategies as st
from speaking_status import SPEECH

from lipservo.runtime.status.status_board import StatusBoard


def test_what_one_process_writes_the_other_reads():
    with StatusBoard.create() as ours, StatusBoard.adopt(os.dup(ours.fileno())) as theirs:
        assert (theirs.settings(), theirs.speech()) == ({}, None)
        ours.add_settings({"strength": 0.5, "smoothness": 0.25})
        theirs.write_speech(SPEECH)

        assert theirs.settings() == {"strength": 0.5, "smoothness": 0.25}
        told = ours.describe({"name": "tom", "state": "driven"})
    assert (told["name"], told["sound"], told["fallback_level"]) == ("tom", "talk.wav", 1)


def test_whoever_comes_later_finds_what_was_set():
    with StatusBoard.create() as ours:
        ours.add_settings({"strength": 0.5})
        with StatusBoard.adopt(os.dup(ours.fileno())) as late:
            assert late.settings() == {"strength": 0.5}


@given(st.integers(0, 100), st.integers(0, 255))
def test_a_note_that_is_half_written_is_not_believed(place, value):
    """Another process may look at any moment of a writing, and a killed writer leaves a part."""
    with StatusBoard.create() as ours, StatusBoard.adopt(os.dup(ours.fileno())) as theirs:
        ours.add_settings({"strength": 0.5})
        before = theirs.settings()
        ours.add_settings({"strength": 0.25})
        with mmap.mmap(ours.fileno(), 200) as memory:
            memory[place] = value
        after = theirs.settings()

    assert before == {"strength": 0.5}
    assert after in (before, {"strength": 0.25})


def test_a_note_that_is_too_long_leaves_the_last_one():
    with StatusBoard.create() as board:
        board.add_settings({"strength": 0.5})
        board.add_settings({"x" * 20_000: 1.0})
        assert board.settings() == {"strength": 0.5}
