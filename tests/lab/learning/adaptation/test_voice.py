"""A voice is split into what is learned and what is graded, and refused where it is none."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lipservo_lab.corpus.alignment_cache import AlignedUtterance, align_utterance
from lipservo_lab.corpus.transcribed import TranscribedUtterance
from lipservo_lab.learning.adaptation.voice import (
    LEAST_HELD_OUT_S,
    Sentence,
    VoiceError,
    check_length,
    only_speaker,
    split_sentences,
    why_left_out,
)
from lipservo_lab.learning.recognition.augmentation import LabelledSamples
from speech import CLIP_LABELS_PATH, CLIP_PATH

from lipsync.audio.file import read_speech


def sentence(number, text, duration_s, *, is_reference=True):
    nothing = LabelledSamples(np.zeros(0, np.float32), np.zeros(0, np.int64))
    return Sentence(f"s{number}", text, nothing, duration_s, is_reference)


def test_every_fifth_text_is_held_out():
    learned, held_out = split_sentences([sentence(n, f"text {n}", 6.0) for n in range(30)])

    assert [each.name for each in held_out] == ["s4", "s9", "s14", "s19", "s24", "s29"]
    assert len(learned) == 24


def test_short_texts_are_held_out_until_they_last_twenty_seconds():
    held_out = split_sentences([sentence(n, f"text {n}", 2.0) for n in range(40)])[1]

    assert sum(each.duration_s for each in held_out) == pytest.approx(LEAST_HELD_OUT_S, abs=2.0)


@given(
    st.lists(
        st.tuples(st.integers(0, 30), st.sampled_from([1.0, 3.0, 9.0]), st.booleans()),
        min_size=1,
        max_size=60,
    )
)
def test_what_is_graded_was_never_learned_even_where_texts_return(drawn):
    given_sentences = [
        sentence(n, (str.upper, str.lower)[n % 2](f"text  {text}"), duration_s, is_reference=known)
        for n, (text, duration_s, known) in enumerate(drawn)
    ]
    try:
        learned, held_out = split_sentences(given_sentences)
    except VoiceError:  # too few different texts
        return
    assert not {s.text.lower() for s in learned} & {s.text.lower() for s in held_out}
    assert all(s.is_reference for s in held_out)
    assert sum(s.duration_s for s in held_out) >= LEAST_HELD_OUT_S - 1e-6


def test_ten_seconds_are_too_few():
    with pytest.raises(VoiceError, match="needs at least 2 minutes of speech, has 10 s"):
        check_length(10.2)
    check_length(120.0)


def test_of_several_speakers_one_is_named(tmp_path):
    both = tuple(TranscribedUtterance(n, n, "text", tmp_path) for n in ("ann", "bob"))

    assert only_speaker(both, "bob") == both[1:]
    with pytest.raises(VoiceError, match="2 speakers; choose one with --speaker: ann, bob"):
        only_speaker(both, None)
    with pytest.raises(VoiceError, match="no speaker eve; known: ann, bob"):
        only_speaker(both, "eve")


def test_labels_are_listened_to_as_alignments_are():
    clip = TranscribedUtterance("clip", "robot", "hello", CLIP_PATH, CLIP_LABELS_PATH)
    samples, aligned = read_speech(CLIP_PATH), align_utterance(clip)

    assert why_left_out(aligned, samples) == ""
    assert "not what is said: its text scores -" in why_left_out(aligned, samples[::-1].copy())
    failed = AlignedUtterance("clip", "hello", error="the text does not fit the sound")
    assert why_left_out(failed, samples) == "the text does not fit the sound"
