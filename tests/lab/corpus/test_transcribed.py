"""Corpora that bring their own labels, and lists of what to leave out of them."""

import json

import numpy as np
import pytest
import soundfile
from lipservo_lab.corpus.alignment_cache import LABELLED, align_corpus, read_alignments
from lipservo_lab.corpus.transcribed import (
    TranscriptError,
    of_names,
    read_names,
    read_transcribed,
    without_names,
)

from lipsync.textgrid import write_tiers


@pytest.fixture
def labelled(tmp_path):
    """Laid out like grid_s1: two sentences, the second without phones."""
    folder = tmp_path / "talker"
    for name in ("audio", "labels"):
        (folder / name).mkdir(parents=True)
    words = (("", 0.0, 0.1), ("bin", 0.1, 0.3), ("sp", 0.3, 0.35), ("blue", 0.35, 0.6))
    phones = (("SIL", 0.0, 0.1), ("B", 0.1, 0.15), ("IH", 0.15, 0.3), ("UW", 0.3, 0.6))
    for name, tiers in (
        ("one", {"words": words, "phones": phones}),
        ("two", {"words": words}),
    ):
        soundfile.write(folder / "audio" / f"{name}.flac", np.zeros(9_600), 16_000)
        write_tiers(folder / "labels" / f"{name}.TextGrid", tiers)
    return folder


def test_a_folder_like_grid_s1_is_one_speaker_with_words_and_labels(labelled):
    one, two = read_transcribed(labelled)

    assert (one.name, one.speaker, one.text) == ("one", "talker", "bin blue")
    assert one.labels == labelled / "labels" / "one.TextGrid"
    assert two.labels is None


def test_its_own_labels_take_the_place_of_an_alignment(labelled, tmp_path):
    cache = tmp_path / "alignments.jsonl"
    align_corpus(read_transcribed(labelled)[:1], cache)
    one = read_alignments(cache)["one"]

    assert one.beams == LABELLED
    assert one.phones == (("SIL", 0, 10), ("B", 10, 15), ("IH", 15, 30), ("UW", 30, 60))


def test_a_label_that_is_no_phone_is_that_sentences_failure(labelled):
    write_tiers(
        labelled / "labels" / "one.TextGrid",
        {"words": (("bin", 0.0, 0.2),), "phones": (("Q", 0.0, 0.2),)},
    )
    failed = align_corpus(read_transcribed(labelled)[:1], None)["one"]

    assert "phoneme 1 at 0.000 s: 'Q' is not a phoneme of ipa" in failed.error


@pytest.mark.parametrize("spoil", ["sound", "words"])
def test_a_sentence_without_sound_or_words_is_named(labelled, spoil):
    if spoil == "sound":
        (labelled / "audio" / "two.flac").unlink()
    else:
        write_tiers(labelled / "labels" / "two.TextGrid", {"phones": (("SIL", 0.0, 0.6),)})
    with pytest.raises(TranscriptError, match=r"two\.TextGrid"):
        read_transcribed(labelled)


@pytest.fixture
def librispeech(tmp_path):
    """As it is downloaded: SPEAKER/CHAPTER/ with sounds and one list of transcripts each."""
    folder = tmp_path / "LibriSpeech" / "test-clean"
    for speaker, chapter in (("84", "121123"), ("84", "121550"), ("61", "70968")):
        place = folder / speaker / chapter
        place.mkdir(parents=True)
        names = [f"{speaker}-{chapter}-{number:04d}" for number in range(2)]
        for name in names:
            soundfile.write(place / f"{name}.flac", np.zeros(1_600), 16_000)
        lines = "".join(f"{name} GO DO YOU HEAR\n" for name in names)
        (place / f"{speaker}-{chapter}.trans.txt").write_text(lines)
    return folder


@pytest.mark.parametrize("above", [0, 1])
def test_librispeech_is_read_as_it_is_downloaded(librispeech, above):
    folder = librispeech.parents[above - 1] if above else librispeech
    utterances = read_transcribed(folder)

    assert len(utterances) == 6
    assert {u.speaker for u in utterances} == {"61", "84"}
    first = utterances[0]
    assert (first.name, first.text) == ("61-70968-0000", "GO DO YOU HEAR")
    assert first.sound == librispeech / "61" / "70968" / "61-70968-0000.flac"


def test_a_sound_that_librispeech_lists_and_lacks_is_named(librispeech):
    (librispeech / "84" / "121550" / "84-121550-0001.flac").unlink()
    with pytest.raises(TranscriptError, match=r"84-121550\.trans\.txt, line 2: no sound"):
        read_transcribed(librispeech)


def test_names_are_listed_line_by_line_or_under_a_key(tmp_path):
    (tmp_path / "names.txt").write_text("one\n\ntwo\n")
    (tmp_path / "splits.json").write_text(json.dumps({"test": ["two"], "n": 3}))

    assert read_names(str(tmp_path / "names.txt")) == {"one", "two"}
    assert read_names(f"{tmp_path}/splits.json:test") == {"two"}
    for listed, said in (
        (f"{tmp_path}/none.txt", "no readable list"),
        (f"{tmp_path}/splits.json:train", "not JSON that has a list under 'train'"),
        (f"{tmp_path}/names.json:test", "no readable list"),
        (f"{tmp_path}/splits.json:n", "not a list of names"),
    ):
        with pytest.raises(TranscriptError, match=said):
            read_names(listed)


def test_what_is_left_out_must_be_there(labelled):
    utterances = read_transcribed(labelled)

    assert [u.name for u in without_names(utterances, frozenset({"one"}))] == ["two"]
    assert [u.name for u in of_names(utterances, frozenset({"one"}))] == ["one"]
    with pytest.raises(
        TranscriptError, match="1 of 2 names are not in the corpus, such as 'three'"
    ):
        without_names(utterances, frozenset({"one", "three"}))


@pytest.fixture
def pairs(tmp_path):
    """The simplest layout: a text beside each sound."""
    folder = tmp_path / "robot"
    folder.mkdir()
    for name, text in (("one", "Bin blue.\n"), ("two", "at\n  two now")):
        soundfile.write(folder / f"{name}.wav", np.zeros(9_600), 16_000)
        (folder / f"{name}.txt").write_text(text)
    return folder


def test_texts_beside_sounds_are_one_speaker(pairs):
    one, two = read_transcribed(pairs)

    assert (one.name, one.speaker, one.text) == ("one", "robot", "Bin blue.")
    assert (two.text, two.sound, two.labels) == ("at two now", pairs / "two.wav", None)


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("three.txt", b"hello", "three.txt: no sound three"),
        ("two.txt", b" \n", "two.txt: holds no words"),
        ("two.txt", b"\xff\xfe", "two.txt: cannot be read as text"),
    ],
)
def test_a_text_without_sound_or_words_is_named(pairs, name, content, told):
    (pairs / name).write_bytes(content)
    with pytest.raises(TranscriptError, match=told):
        read_transcribed(pairs)
