"""Who is scored trains nothing, and what they are scored by stays what it was."""

import re
from pathlib import Path
from runpy import run_path

import pytest
from lipservo_lab.corpus.alignment_cache import AlignedUtterance, CacheError, align_utterance
from lipservo_lab.corpus.scored_alignments import alignment_hash, fix_alignments, read_hashes
from lipservo_lab.corpus.transcribed import read_speakers, read_transcribed

ROOT = Path(__file__).parents[3]
SPEAKERS = ROOT / "benchmarks" / "speakers"
CORPORA = ROOT.parent / "shared" / "corpus"
SCORED = tuple(
    f"{corpus}_scored{part}.csv"
    for corpus, part in (
        ("librispeech", ""),
        ("speechocean762", ""),
        ("speechocean762", "_new"),
        ("picovoice_commands", ""),
    )
)


def speakers(name):
    return read_speakers(SPEAKERS / name)


def scored():
    return {speaker: groups for name in SCORED for speaker, groups in speakers(name).items()}


def test_half_of_the_scored_are_women_or_children():
    assert [len(speakers(name)) for name in SCORED] == [8, 20, 12, 11]
    for name in SCORED:
        groups = speakers(name).values()
        assert 2 * sum("f" in group or "child" in group for group in groups) >= len(groups)


def test_no_scored_talker_chooses_among_weights():
    assert not scored().keys() & speakers("validation.csv").keys()


def test_the_training_learns_from_nobody_who_is_scored_or_validates():
    plan = run_path(str(ROOT / "benchmarks" / "train_ears.py"))
    assert {f"{name}.csv" for name in plan["HELD"]} == {*SCORED, "validation.csv"}


def test_an_alignment_that_differs_by_a_frame_has_moved_and_stays_fixed_as_it_was(tmp_path):
    path = tmp_path / "hashes.txt"
    kept = AlignedUtterance("a-1", "HI", "default", (("HH", 0, 5), ("AY", 5, 20)))
    failed = AlignedUtterance("a-2", "HO", error="no way through")
    later = AlignedUtterance("a-1", "HI", "default", (("HH", 0, 6), ("AY", 6, 20)))
    new = AlignedUtterance("b-1", "HI", "default", (("HH", 0, 9),))

    assert fix_alignments(path, [failed, kept]) == []
    assert fix_alignments(path, [kept, failed]) == []
    assert fix_alignments(path, [later, new]) == ["a-1"]
    assert fix_alignments(path, [AlignedUtterance("a-2", "HO", "default")]) == ["a-2"]
    assert fix_alignments(path, [kept, failed, new]) == []
    assert list(read_hashes(path)) == ["a-1", "a-2", "b-1"]


def test_a_file_of_something_else_is_refused_in_one_line(tmp_path):
    (tmp_path / "hashes.txt").write_text("three words here\n")
    with pytest.raises(CacheError, match="expected a name and a hash on each line"):
        read_hashes(tmp_path / "hashes.txt")


def test_every_utterance_of_scored_talkers_alone_is_fixed():
    hashes = read_hashes(SPEAKERS / "scored_alignments.txt")

    assert {name.split("-")[0] for name in hashes} == scored().keys()
    assert len(hashes) == 1214
    assert all(digest == "-" or re.fullmatch("[0-9a-f]{16}", digest) for digest in hashes.values())


@pytest.mark.skipif(not CORPORA.is_dir(), reason="no corpora")
def test_the_fixed_are_the_utterances_of_the_corpora():
    corpora = (CORPORA / name for name in ("librispeech", "speechocean762", "picovoice_commands"))
    spoken = {
        u.name for corpus in corpora for u in read_transcribed(corpus) if u.speaker in scored()
    }

    assert read_hashes(SPEAKERS / "scored_alignments.txt").keys() == spoken


@pytest.mark.skipif(not CORPORA.is_dir(), reason="no corpora")
def test_alignments_of_the_scored_are_what_they_were():
    """One utterance of each corpus; all of them: `bench recognition --yardstick`."""
    pytest.importorskip("pocketsphinx")
    hashes = read_hashes(SPEAKERS / "scored_alignments.txt")
    for corpus in ("librispeech", "speechocean762", "picovoice_commands"):
        fixed = [u for u in read_transcribed(CORPORA / corpus) if hashes.get(u.name, "-") != "-"]
        for utterance in sorted(fixed, key=lambda u: u.sound.stat().st_size)[:1]:
            assert alignment_hash(align_utterance(utterance)) == hashes[utterance.name]
