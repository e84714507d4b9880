import json

import numpy as np
import pytest
import soundfile
from lipservo_lab.corpus.alignment_cache import (
    CacheError,
    align_corpus,
    read_alignments,
    unfinished_of,
)
from lipservo_lab.corpus.transcribed import TranscriptError, of_speakers, read_transcribed
from places import ROOT
from speech import CLIP_LABELS_PATH, CLIP_PATH, phoneme_frames, viseme_accuracy

from lipsync.audio.file import read_speech
from lipsync.phoneme_files.reader import read_phonemes
from lipsync.recognition.alignment import (
    DOUBTFUL_SCORE,
    LEAST_SCORE,
    AlignmentError,
    align,
    goodness_of_pronunciation,
    words_of,
)
from lipsync.recognition.network import load_weights
from lipsync.text_to_speech.pronunciation import PronunciationError, pronounce
from lipsync.textgrid import read_tiers, write_tiers

CLIP_TEXT = CLIP_PATH.with_suffix(".txt").read_text()


@pytest.fixture(scope="module")
def clip():
    return soundfile.read(CLIP_PATH, dtype="float32")[0]


@pytest.fixture(scope="module")
def aligned(clip):
    return align(clip, CLIP_TEXT)


def test_phones_lie_where_the_synthetic_voice_spoke_them(aligned, clip):
    n_frames = len(clip) // 160
    truth = phoneme_frames(read_phonemes(CLIP_LABELS_PATH), n_frames)

    assert viseme_accuracy(phoneme_frames(aligned.phones, n_frames), truth) > 0.8
    assert aligned.beams == "default"


def test_words_come_in_order_and_the_phones_leave_no_gap(aligned):
    assert [word for word, _, _ in aligned.words] == words_of(CLIP_TEXT)
    for phone, following in zip(aligned.phones, aligned.phones[1:], strict=False):
        assert phone.end_s == following.start_s


def test_an_alignment_survives_a_textgrid(aligned, tmp_path):
    path = tmp_path / "clip.TextGrid"
    phones = tuple((e.phoneme, e.start_s, e.end_s) for e in aligned.phones)
    write_tiers(path, {"words": aligned.words, "phones": phones})

    assert read_tiers(path)["phones"] == phones
    assert [w for w in read_tiers(path)["words"] if w[0]] == list(aligned.words)


def test_a_word_outside_the_dictionary_is_guessed_and_named(clip):
    text = CLIP_TEXT.lower()
    first = words_of(text)[0]
    guesses = {
        "zzyx": ("HH", "AH", "L", "OW"),
        "lipservo": ("L", "IH", "P", "S", "ER", "V", "OW"),
    }
    alignment = align(clip, text.replace(first, "zzyx", 1), guesses.__getitem__)
    assert alignment.guessed == ("zzyx", "lipservo")
    assert alignment.words[0][0] == "zzyx"


def test_an_alignment_does_not_depend_on_what_was_aligned_before(clip):
    alone = align(clip, CLIP_TEXT)
    align(clip * np.float32(0.05), CLIP_TEXT)
    assert align(clip, CLIP_TEXT) == alone


@pytest.mark.parametrize(
    ("word", "phones"),
    [
        ("uncas", "AH NG K AH Z"),
        ("voyaging", "V OY AH JH IH NG"),
        ("polly's", "P AA L IY Z"),
    ],
)
def test_guessed_pronunciations_are_arpabet_without_stress(word, phones):
    pytest.importorskip("gruut", reason="gruut guesses pronunciations")
    assert pronounce(word) == tuple(phones.split())


def test_a_number_is_no_word():
    with pytest.raises(PronunciationError, match="word '12' has no letters"):
        pronounce("12")


def test_text_without_words_and_sound_without_speech_are_refused(clip):
    with pytest.raises(AlignmentError, match="has no words"):
        align(clip, " ... ")
    with pytest.raises(AlignmentError, match="does not fit the sound"):
        align(clip[:1_600], CLIP_TEXT)


def small_corpus(folder, clip):
    """Write and return a transcribed corpus of three utterances; the second one is cut off."""
    (folder / "audio").mkdir(parents=True)
    soundfile.write(folder / "audio" / "7-1-0000.flac", clip, 16_000)
    soundfile.write(folder / "audio" / "7-1-0001.flac", clip[:1_600] + 1e-3, 16_000)
    soundfile.write(folder / "audio" / "8-1-0000.flac", clip, 16_000)
    text = " ".join(words_of(CLIP_TEXT)).upper()
    names = ("7-1-0000", "7-1-0001", "8-1-0000")
    (folder / "transcripts.txt").write_text("".join(f"{name} {text}\n" for name in names))
    return read_transcribed(folder)


@pytest.mark.slow
def test_a_corpus_is_aligned_once_and_failures_are_kept(clip, aligned, tmp_path):
    utterances = small_corpus(tmp_path / "corpus", clip)
    path = tmp_path / "alignments.jsonl"
    made, again = [], []
    first = align_corpus(utterances[:2], path, progress=made.append)
    # A run that was killed while it wrote.
    unfinished_of(path).write_text('{"name": "8-1-0000", "te')
    both = align_corpus(utterances, path, n_processes=2, progress=again.append)

    assert made == ["7-1-0000", "7-1-0001"]
    assert sorted(again) == ["7-1-0000", "7-1-0001", "8-1-0000"]
    assert len(path.read_text().splitlines()) == 3
    assert both["7-1-0000"] == first["7-1-0000"]
    assert "does not fit" in both["7-1-0001"].error
    labels = both["8-1-0000"].labels(len(clip) // 160)
    assert both["8-1-0000"].score == pytest.approx(
        goodness_of_pronunciation(clip, aligned.phones), abs=1e-3
    )
    assert not unfinished_of(path).exists()
    n_said = len(both["8-1-0000"].phones)
    assert n_said == len(aligned.phones)
    assert np.count_nonzero(np.diff(labels)) + 1 <= n_said


class Killed(BaseException):
    """As if the process had ended here."""


@pytest.mark.slow
def test_a_run_that_is_killed_leaves_no_file_of_that_name_and_is_taken_up(clip, tmp_path):
    utterances = small_corpus(tmp_path / "corpus", clip)
    path = tmp_path / "alignments.jsonl"

    def kill(_name):
        raise Killed

    with pytest.raises(Killed):
        align_corpus(utterances, path, progress=kill)
    assert not path.exists()
    (first,) = read_alignments(unfinished_of(path)).values()

    made = []
    align_corpus(utterances, path, progress=made.append)

    assert made[0] == first.name
    assert [*read_alignments(path)] == [u.name for u in utterances]
    assert not unfinished_of(path).exists()


def test_a_file_of_the_users_is_not_taken_for_alignments(clip, tmp_path):
    utterances = small_corpus(tmp_path / "corpus", clip)
    path = tmp_path / "thesis.jsonl"
    path.write_bytes(b"\xff\xd8 a photograph")

    with pytest.raises(CacheError, match="is not a file of alignments"):
        align_corpus(utterances, path)
    assert path.read_bytes() == b"\xff\xd8 a photograph"


def test_the_score_tells_what_was_said_from_what_was_not(clip, aligned):
    """A voice of a synthesiser, and a text of as many sounds that pocketsphinx does align."""
    other = "the quick brown fox jumps over the lazy dog and then goes home to sleep a while"
    assert DOUBTFUL_SCORE < goodness_of_pronunciation(clip, aligned.phones) < 0.0
    assert goodness_of_pronunciation(clip, align(clip, other).phones) < LEAST_SCORE
    assert goodness_of_pronunciation(np.zeros(16_000, np.float32), ()) == 0.0


@pytest.mark.slow
def test_the_transcripts_of_librispeech_are_not_taken_for_one_anothers(corpus_dir):
    """A sentence each of four speakers who trained nothing, with its own text and another's."""
    folder = corpus_dir / "librispeech"
    speakers = frozenset({"1221", "4446", "1089", "5105"})
    utterances = of_speakers(read_transcribed(folder), speakers, 1)
    twin = load_weights(ROOT / "benchmarks" / "recognizer_held_out.npz")
    for utterance, other in zip(utterances, utterances[1:] + utterances[:1], strict=True):
        samples = read_speech(utterance.sound)
        assert (
            goodness_of_pronunciation(samples, align(samples, utterance.text).phones, twin)
            > DOUBTFUL_SCORE
        )
        try:
            foreign = align(samples, other.text)
        except AlignmentError:
            continue
        assert goodness_of_pronunciation(samples, foreign.phones, twin) < LEAST_SCORE


def test_a_damaged_alignment_file_names_its_line(tmp_path):
    path = tmp_path / "alignments.jsonl"
    path.write_text(json.dumps({"name": "a", "text": "b", "phones": 3}) + "\n")

    with pytest.raises(CacheError, match="line 1"):
        read_alignments(path)


def test_speakers_are_chosen_by_name_and_limited(clip, tmp_path):
    utterances = small_corpus(tmp_path, clip)

    assert [u.name for u in of_speakers(utterances, frozenset(), 1)] == ["7-1-0000", "8-1-0000"]
    assert [u.name for u in of_speakers(utterances, frozenset({"8"}), None)] == ["8-1-0000"]
    with pytest.raises(TranscriptError, match="no speaker 9; known: 7, 8"):
        of_speakers(utterances, frozenset({"9"}), None)


@pytest.mark.parametrize(
    ("line", "said"),
    [("7-1-0000", "no words"), ("7-1-0009 HI", "no sound"), ("", "holds no utterance")],
)
def test_a_bad_transcript_is_explained(clip, tmp_path, line, said):
    small_corpus(tmp_path, clip)
    (tmp_path / "transcripts.txt").write_text(line + "\n")
    with pytest.raises(TranscriptError, match=said):
        read_transcribed(tmp_path)
