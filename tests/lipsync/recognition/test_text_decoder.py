"""Words that are known, followed in posteriors: a sure voice is made of the words it says."""

import numpy as np
import pytest

from lipsync.phonemes import PHONEMES
from lipsync.recognition.decoder import SMOOTH, PosteriorFormat, log_scores
from lipsync.recognition.text_decoder import MOST_WORDS, OUTSIDE_TEXT, TextDecoder, TextError
from lipsync.spoken_text import PronouncedWord

FORMAT = PosteriorFormat(PHONEMES, (2, 7, 12))
MAMA = PronouncedWord("mama", (("M", "AA", "M", "AH"),))
BIG = PronouncedWord("big", (("B", "IH", "G"),))
FISH = PronouncedWord("fish", (("F", "IH", "SH"), ("F", "AY", "SH")))
SEEK = PronouncedWord("seek", (("S", "IY", "K"),))


def posteriors_of(phones, n_frames=8, sure=0.9):
    """Return posteriors (n, 3, 40) of a voice that says each phone for `n_frames`.

    sure: probability of the right phone. Each head's rows come later by its delay.
    """
    labels = np.repeat([PHONEMES.index(phone) for phone in phones], n_frames)
    rows = np.full((len(labels), len(PHONEMES)), (1 - sure) / (len(PHONEMES) - 1), np.float32)
    rows[np.arange(len(labels)), labels] = sure
    posteriors = np.zeros((len(labels), 3, len(PHONEMES)), np.float32)
    for head, delay in enumerate(FORMAT.delays):
        posteriors[delay:, head] = rows[: len(labels) - delay]
        posteriors[:delay, head, PHONEMES.index("SIL")] = 1.0
    return posteriors


def decoded(posteriors, words, told_at=0):
    """Return the last phoneme decoded for each frame, "heard" outside the text.

    told_at: the frame before which the decoder gets the words.
    """
    decoder, settled = TextDecoder(FORMAT, 100), {}
    for frame, scores in enumerate(log_scores(posteriors, SMOOTH)):
        if frame == told_at:
            decoder.tell(words)
        path = decoder.push(scores)
        for age, index in enumerate(reversed(path)):
            settled[frame - FORMAT.delays[0] - age] = (
                "heard" if index == OUTSIDE_TEXT else PHONEMES[index]
            )
    return [settled[frame] for frame in sorted(settled) if frame >= 0]


def runs(labels):
    return [a for a, b in zip(labels, ["", *labels], strict=False) if a != b]


SILENCE = ["SIL"] * 3


def test_a_phone_that_was_misheard_is_what_the_text_says():
    heard = ["SIL", "M", "AA", "N", "AH", "B", "IH", "K", *SILENCE]
    found = runs(decoded(posteriors_of(heard, sure=0.3), [MAMA, BIG]))
    assert found == ["SIL", "M", "AA", "M", "AH", "B", "IH", "G", "SIL"]


def test_the_pronunciation_is_taken_that_is_spoken():
    found = runs(decoded(posteriors_of(["SIL", "F", "AY", "SH", *SILENCE]), [FISH]))
    assert found == ["SIL", "F", "AY", "SH", "SIL"]


def test_silence_between_two_words_is_silence():
    found = runs(
        decoded(
            posteriors_of(["SIL", "B", "IH", "G", *SILENCE, "F", "IH", "SH", *SILENCE]), [BIG, FISH]
        )
    )
    assert found == ["SIL", "B", "IH", "G", "SIL", "F", "IH", "SH", "SIL"]


def test_a_word_that_is_left_out_and_one_that_is_said_again_are_followed():
    left_out = ["SIL", "M", "AA", "M", "AH", "F", "IH", "SH", *SILENCE]
    assert runs(decoded(posteriors_of(left_out), [MAMA, BIG, FISH])) == runs(left_out)
    again = ["SIL", "B", "IH", "G", "SIL", "B", "IH", "G", "F", "IH", "SH", *SILENCE]
    assert runs(decoded(posteriors_of(again), [BIG, FISH])) == runs(again)


def test_a_voice_that_does_not_say_the_text_is_heard_and_the_text_taken_up_after_it():
    other = ["W", "ER", "L", "IY", "S", "UW", "V", "EY"]
    phones = ["SIL", "B", "IH", "G", *other, "SIL", "SIL", "F", "IH", "SH", *SILENCE]
    labels = decoded(posteriors_of(phones), [BIG, FISH])
    middle = labels[8 * 4 + 4 : 8 * 12 - 4]
    assert middle.count("heard") > 0.9 * len(middle)
    assert runs(labels)[-4:] == ["F", "IH", "SH", "SIL"]


def test_a_phoneme_that_begins_softly_is_no_silence_where_it_is_known():
    posteriors = posteriors_of(["SIL", "SIL", "B", "IH", "G", *SILENCE])
    begins = slice(16, 22)
    for head, delay in enumerate(FORMAT.delays):
        soft = slice(begins.start + delay, begins.stop + delay)
        posteriors[soft, head] = 0.002
        posteriors[soft, head, PHONEMES.index("SIL")] = 0.55
        posteriors[soft, head, PHONEMES.index("B")] = 0.35
    assert decoded(posteriors, [BIG])[begins] == ["B"] * 6


def test_where_a_pause_ends_in_other_words_than_the_text_has_they_are_heard_from_the_first_on():
    phones = ["SIL", "B", "IH", "G", *SILENCE, "W", "ER", "L", "IY", "S", "UW", "V", *SILENCE]
    labels = decoded(posteriors_of(phones, sure=0.35), [BIG, SEEK, FISH])
    assert labels[8 * 7 : 8 * 14] == ["heard"] * 56


def test_a_text_that_comes_late_is_taken_up_where_the_voice_is():
    phones = [
        "SIL",
        "M",
        "AA",
        "M",
        "AH",
        "B",
        "IH",
        "G",
        "F",
        "IH",
        "SH",
        "S",
        "IY",
        "K",
        *SILENCE,
    ]
    labels = decoded(posteriors_of(phones), [MAMA, BIG, FISH, SEEK], told_at=8 * 4)
    assert runs(labels)[-4:] == ["S", "IY", "K", "SIL"]


def test_a_word_with_a_time_is_not_looked_for_elsewhere():
    phones = ["SIL", "B", "IH", "G", *SILENCE * 4, "B", "IH", "G", *SILENCE]
    late = PronouncedWord("big", BIG.pronunciations, start_s=1.28)
    labels = decoded(posteriors_of(phones), [late])
    assert "B" not in labels[: 8 * 4]
    assert runs(labels)[-4:] == ["B", "IH", "G", "SIL"]


def test_words_without_end_are_refused_and_those_that_were_said_are_forgotten():
    decoder = TextDecoder(FORMAT, 100)
    with pytest.raises(TextError, match="words wait to be spoken, at most 2000 may"):
        decoder.tell([BIG] * (MOST_WORDS + 1))
    scores = log_scores(posteriors_of(["B", "IH", "G", *SILENCE]), SMOOTH)
    for _ in range(3):
        decoder.tell([BIG])
        for each in scores:
            decoder.push(each)
    assert decoder.place == 3


def test_words_that_are_forgotten_are_heard_and_those_told_instead_are_followed():
    phones = ["SIL", "M", "AA", "M", "AH", *SILENCE, "B", "IH", "G", *SILENCE]
    decoder, settled = TextDecoder(FORMAT, 100), {}
    decoder.tell([MAMA, FISH, SEEK, SEEK, SEEK])
    for frame, scores in enumerate(log_scores(posteriors_of(phones), SMOOTH)):
        if frame == 8 * 6:
            decoder.forget()
            assert decoder.saying[0][-1] == "mama"
            decoder.tell([BIG])
        for age, index in enumerate(reversed(decoder.push(scores))):
            settled[frame - FORMAT.delays[0] - age] = PHONEMES[index]
    assert runs([settled[frame] for frame in sorted(settled) if frame >= 0]) == runs(phones)
    assert decoder.saying == (("mama", "big"), 2)


def test_a_text_that_comes_seven_words_late_is_looked_for_around_the_voice():
    words = [MAMA, BIG, FISH, SEEK] * 3
    phones = ["SIL", *(p for word in words for p in word.pronunciations[0]), *SILENCE]
    n_late = 8 * (1 + sum(len(w.pronunciations[0]) for w in words[:7]))
    decoder, settled = TextDecoder(FORMAT, 100), {}
    for frame, scores in enumerate(log_scores(posteriors_of(phones), SMOOTH)):
        if frame == n_late:
            decoder.tell(words, behind_s=n_late / 100)
        if frame >= n_late:
            for age, index in enumerate(reversed(decoder.push(scores))):
                settled[frame - age] = "heard" if index == OUTSIDE_TEXT else PHONEMES[index]
    followed_to_the_end = [settled[frame] for frame in sorted(settled)]
    assert followed_to_the_end.count("heard") < 45
    assert runs(followed_to_the_end)[-7:] == ["F", "IH", "SH", "S", "IY", "K", "SIL"]
