"""The sentences: what they hold of English, counted by the aligner's own pronunciations."""

from collections import Counter
from functools import cache
from itertools import pairwise

import pytest
from lipservo_lab.corpus.transcribed import read_transcribed
from lipservo_lab.recording.sentence_list import SentenceError, read_sentences, shipped_sentences
from pocketsphinx import Decoder

from lipsync.phonemes import PHONEMES, SILENCE
from lipsync.recognition.alignment import words_of

FEWEST_TIMES = 8
N_FREQUENT = 300


@pytest.fixture(scope="module")
def phones_of():
    """The phones of a text between two silences; words that the dictionary lacks are left out."""
    dictionary = Decoder(lm=None, loglevel="FATAL")

    @cache
    def phones(word):
        return tuple((dictionary.lookup_word(word) or "").split())

    def of_text(text):
        return [SILENCE, *(phone for word in words_of(text) for phone in phones(word)), SILENCE]

    return of_text


def test_sixty_sentences_hold_every_phoneme_several_times(phones_of):
    sentences = shipped_sentences()
    assert len(sentences) == 60
    assert len({sentence.text for sentence in sentences}) == 60
    counts = Counter(phone for s in sentences for phone in phones_of(s.text))
    assert set(counts) == set(PHONEMES)
    assert min(counts.values()) >= FEWEST_TIMES


def test_they_hold_most_of_what_follows_what_in_english(corpus_dir, phones_of):
    """Against the transcripts of LibriSpeech test-clean."""
    read = read_transcribed(corpus_dir / "librispeech")
    english = Counter(pair for u in read for pair in pairwise(phones_of(u.text)))
    ours = {pair for s in shipped_sentences() for pair in pairwise(phones_of(s.text))}
    frequent = [pair for pair, _ in english.most_common(N_FREQUENT)]
    assert sum(pair in ours for pair in frequent) / N_FREQUENT >= 0.96
    assert sum(english[pair] for pair in ours) / english.total() >= 0.91


def test_sentences_of_ones_own_are_numbered_as_they_stand(tmp_path):
    path = tmp_path / "mine.txt"
    path.write_text("# of mine\n\n  Good   morning.\nGood night.\n")
    assert [(s.name, s.text) for s in read_sentences(path)] == [
        ("s001", "Good morning."),
        ("s002", "Good night."),
    ]


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (b"", "holds no sentence"),
        (b"Hello.\n...\n", "line 2: holds no words"),
        (b"\xff\xfe\x00", "cannot be read as text"),
        (b"word " * 41, "line 1: 41 words; 40 at most"),
    ],
)
def test_a_list_that_cannot_be_read_is_refused(tmp_path, content, complaint):
    path = tmp_path / "mine.txt"
    path.write_bytes(content)
    with pytest.raises(SentenceError, match=complaint):
        read_sentences(path)
