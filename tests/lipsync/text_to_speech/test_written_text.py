"""Texts are cut into sentences, and nothing of them is lost."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lipsync.text_to_speech.synthesis import pieces, readable


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("Hello there. How are you?  Fine!", ["Hello there.", "How are you?", "Fine!"]),
        (
            "Dr. B. Bo of the U.S. met Mr. X, z.B. Bob.",
            ["Dr. B. Bo of the U.S. met Mr. X, z.B. Bob."],
        ),
        ("Ask Bob. Yes.", ["Ask Bob.", "Yes."]),
        ('He said "No." Then he left.', ['He said "No."', "Then he left."]),
        ("3.14 is pi... nearly", ["3.14 is pi...", "nearly"]),
        ("one\n\ntwo", ["one", "two"]),
        ("你好。再见！", ["你好。", "再见！"]),
        (" \n ", []),
        ("", []),
    ],
)
def test_a_text_is_cut_where_sentences_end(text, expected):
    assert list(pieces(text, 400)) == expected


def test_a_long_sentence_is_cut_at_a_comma_then_at_a_space_then_anywhere():
    assert list(pieces("one two, three four", 12)) == ["one two,", "three four"]
    assert list(pieces("one two three four", 10)) == ["one two", "three four"]
    assert list(pieces("a" * 25, 10)) == ["a" * 10, "a" * 10, "a" * 5]


@given(text=st.text(alphabet="ab.,!? \n\u3002", max_size=300), longest=st.integers(1, 40))
def test_pieces_are_short_and_hold_all_but_white_space(text, longest):
    found = list(pieces(text, longest))

    assert all(0 < len(piece) <= longest + 1 for piece in found)
    assert "".join("".join(found).split()) == "".join(text.split())


@given(text=st.text(max_size=60))
def test_what_is_no_text_becomes_a_space_and_positions_stay(text):
    written = readable(text + "\x00\x1b\ud800")
    assert len(written) == len(text) + 3
    assert written.endswith("   ")
    written.encode("utf-8")
