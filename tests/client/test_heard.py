"""Which words of a stream people heard, from the samples that were played."""

from itertools import pairwise

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from lipservo_client.heard import SpokenWords

RATE_HZ = 1_000


def spoken(n_samples, *pieces):
    words = SpokenWords(RATE_HZ, n_samples)
    for piece in pieces:
        words.add(*piece)
    return words


def text(words, n_played):
    return "".join(words.heard(n_played))


def test_a_word_counts_when_half_of_it_was_played():
    words = spoken(600, ("one ", 0), ("two ", 200), ("three", 400))

    heard = ["", "", "one ", "one ", "one two ", "one two ", "one two three"]
    assert [text(words, n) for n in (0, 99, 100, 299, 300, 499, 500)] == heard


def test_nothing_is_heard_of_a_word_that_begins_with_the_sound_before_any_is_played():
    assert text(spoken(0, ("now", 0, 0)), 0) == ""
    assert text(spoken(10, ("now",)), 0) == ""


def test_a_text_without_times_shares_the_sound_by_its_letters():
    words = spoken(1_000, ("aa bb cc dd ee",))

    assert text(words, 500) == "aa bb cc"
    assert text(words, 1_000) == "aa bb cc dd ee"


def test_deltas_that_are_cut_within_a_word_are_one_text():
    words = spoken(1_000, ("Good mor",), ("ning, a",), ("ll",))

    assert words.heard(700) == ("Good mor", "ning,", "")
    assert text(words, 700) == "Good morning,"


def test_sentences_share_each_the_sound_between_their_own_places():
    words = spoken(2_000, ("one two", 0, 400), ("three four", 1_000, 2_000))

    heard = ["one two", "one two", "one twothree", "one twothree four"]
    assert [text(words, n) for n in (350, 900, 1_300, 1_900)] == heard


def test_characters_of_a_script_without_spaces_count_one_by_one():
    assert text(spoken(500, ("今日は元気。",)), 280) == "今日は"


def test_a_text_ahead_of_its_sound_is_not_squeezed_into_what_has_come():
    """15 characters a second: of 150 characters ten seconds are to come."""
    words = spoken(1_000, ("abcd " * 30,))

    assert words.part(0, 1_000, is_complete=False).split() == ["abcd"] * 3


def test_a_pause_behind_a_word_does_not_make_it_longer():
    assert text(spoken(9_000, ("yes", 0), ("no", 8_000)), 1_000) == "yes"


def test_what_is_timed_beyond_the_end_of_the_sound_was_not_heard():
    assert text(spoken(100, ("one ", 0), ("two", 5_000)), 100) == "one "


def test_times_that_run_backwards_lose_no_word_of_what_was_heard():
    assert spoken(900, ("b ", 500), ("a ", 100), ("c", 600)).heard(900) == ("b ", "a ", "c")


PIECES = st.tuples(
    st.text(alphabet="ab 今", max_size=8),
    st.none() | st.integers(0, 2_000),
    st.none() | st.integers(0, 2_000),
)


@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(PIECES, max_size=6), st.integers(0, 2_000), st.lists(st.integers(0, 2_500)))
def test_whoever_hears_more_has_heard_no_word_less(pieces, n_samples, moments):
    words = spoken(n_samples, *pieces)
    moments.sort()
    heard = [words.heard(n) for n in moments]

    for earlier, later in pairwise(heard):
        assert all(b.startswith(a) for a, b in zip(earlier, later, strict=True))
    for n, each in zip(moments, heard, strict=True):
        assert each == tuple(words.part(number, n) for number in range(len(pieces)))
        assert all(piece[0].startswith(part) for piece, part in zip(pieces, each, strict=True))
