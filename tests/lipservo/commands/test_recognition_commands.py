"""`align`, `recognize`, `bench recognition` and `--engine` as their users meet them."""

import json
import os
import sys
from itertools import pairwise

import numpy as np
import pytest
import soundfile
from in_process import lipservo, refused
from places import ROOT
from speech import CLIP_PATH

from lipservo.runtime.settled_phonemes import settled_events
from lipsync.audio.file import FileSource
from lipsync.recognition import network as weights
from lipsync.recognition.alignment import words_of
from lipsync.recognition.recognizers import make_recognizer
from lipsync.textgrid import read_tiers

TWIN = ROOT / "benchmarks" / "recognizer_held_out.npz"
CLIP_TEXT = CLIP_PATH.with_suffix(".txt").read_text()


def test_recognize_tells_the_whole_sound_once_in_order(tmp_path):
    grid = tmp_path / "clip.TextGrid"
    done = lipservo("lines", "recognize", CLIP_PATH, "--json", "-o", grid)
    assert done.returncode == 0, done.stderr
    events = [json.loads(line) for line in done.stdout.splitlines()]
    assert events[0]["start_s"] == 0.0
    assert events[-1]["end_s"] == pytest.approx(8.615)
    assert all(a["end_s"] == b["start_s"] for a, b in pairwise(events))
    told = [(e["phoneme"], e["start_s"], e["end_s"]) for e in events]
    assert list(read_tiers(grid)["phones"]) == told


def test_a_channel_without_speech_is_told_and_the_other_is_heard(tmp_path):
    voice, rate_hz = soundfile.read(CLIP_PATH, dtype="float32")
    hiss = 0.02 * np.random.default_rng(0).standard_normal(len(voice))
    soundfile.write(tmp_path / "two.wav", np.stack([voice, hiss], axis=1), rate_hz)

    right = lipservo("lines", "recognize", tmp_path / "two.wav", "--channel", "right")
    left = lipservo("lines", "recognize", tmp_path / "two.wav", "--channel", "left")
    assert "no speech in 9 s; the mouth stays at rest: check file, --channel" in right.stderr
    assert {line.split()[-1] for line in right.stdout.splitlines()} == {"SIL"}
    assert left.stderr == ""
    assert len(left.stdout.splitlines()) > 20
    third = refused("lines", "recognize", tmp_path / "two.wav", "--channel", "3")
    assert "has 2 channels, not 3" in third


@pytest.mark.parametrize("command", ["lines recognize", "replay"])
def test_weights_that_were_asked_for_and_are_damaged_are_refused(tmp_path, command):
    damaged = tmp_path / "damaged.npz"
    damaged.write_bytes(b"no weights")
    said = refused(*command.split(), CLIP_PATH, "--weights", damaged)
    assert f"{damaged}: damaged or no weights" in said


def test_damaged_default_weights_are_made_up_for_and_it_is_logged(monkeypatch, tmp_path, caplog):
    damaged = tmp_path / "damaged.npz"
    damaged.write_bytes(b"no weights")
    monkeypatch.setitem(weights.SHIPPED, "default", str(damaged))
    events = list(settled_events(FileSource(CLIP_PATH), make_recognizer("network")))
    assert len(events) > 20
    (line,) = caplog.messages
    assert "damaged or no weights" in line


def test_phones_are_written_as_the_ending_says(tmp_path):
    path = tmp_path / "clip.json"
    done = lipservo("lines", "recognize", CLIP_PATH, "--json", "-o", path)
    assert done.returncode == 0, done.stderr
    told = [list(json.loads(line).values()) for line in done.stdout.splitlines()]
    assert json.loads(path.read_text()) == {"phones": told}
    for command, *text, name in (("recognize", "clip.txt"), ("align", "hello", "clip")):
        said = refused("lines", command, CLIP_PATH, *text, "-o", tmp_path / name)
        assert "use .TextGrid (Praat) or .json" in said
    assert os.listdir(tmp_path) == ["clip.json"]


def test_recognize_prints_columns_for_people():
    done = lipservo("lines", "recognize", CLIP_PATH, "--engine", "energy")
    assert done.returncode == 0, done.stderr
    start_s, end_s, phoneme = done.stdout.splitlines()[0].split()
    assert (float(start_s), phoneme) == (0.0, "SIL")
    assert float(end_s) > 0.0


def test_align_writes_words_and_phones(tmp_path):
    grid = tmp_path / "clip.TextGrid"
    done = lipservo("lines", "align", CLIP_PATH, CLIP_TEXT, "-o", grid, "--json")
    assert done.returncode == 0, done.stderr
    words = [label for label, _, _ in read_tiers(grid)["words"] if label]
    assert words == words_of(CLIP_TEXT)
    told = json.loads(done.stdout)
    assert told["beams"] == "default"
    assert -1.0 < told["score"] < 0.0
    assert "lipservo" in done.stderr  # its pronunciation was guessed


def test_align_refuses_a_text_that_was_not_said(tmp_path):
    """Pocketsphinx finds a way through this one."""
    other = "the quick brown fox jumps over the lazy dog and then goes home to sleep a while"
    grid = tmp_path / "clip.TextGrid"
    assert "its speech is not this text" in refused("lines", "align", CLIP_PATH, other, "-o", grid)
    assert not grid.exists()


@pytest.mark.slow
def test_align_doubts_a_text_with_a_part_that_was_not_said():
    less = CLIP_TEXT.replace("maple, fever, five", "")
    assert less != CLIP_TEXT
    done = lipservo("lines", "align", CLIP_PATH, less, "--json")
    assert done.returncode == 0, done.stderr
    assert "the text fits badly" in done.stderr
    assert -3.5 <= json.loads(done.stdout)["score"] < -1.5


@pytest.fixture
def corpus(tmp_path):
    samples = soundfile.read(CLIP_PATH, dtype="float32")[0]
    text = " ".join(words_of(CLIP_TEXT)).upper()
    (tmp_path / "audio").mkdir()
    for name in ("3-1-0000", "4-1-0000"):
        soundfile.write(tmp_path / "audio" / f"{name}.flac", samples, 16_000)
    soundfile.write(tmp_path / "audio" / "4-1-0001.flac", np.full(1_600, 1e-3), 16_000)
    names = ("3-1-0000", "4-1-0000", "4-1-0001")
    (tmp_path / "transcripts.txt").write_text("".join(f"{name} {text}\n" for name in names))
    return tmp_path


def test_align_tells_which_transcripts_of_a_folder_were_not_said(corpus):
    lines = (corpus / "transcripts.txt").read_text().splitlines()
    lines[1] = f"4-1-0000 {'BUY MY BIG BROWN PIE ' * 5}"
    (corpus / "transcripts.txt").write_text("\n".join(lines[:2]))
    done = lipservo("lines", "align-folder", corpus, "-o", corpus / "a.jsonl", "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["utterances"] == 2
    assert [*told["not_said"], *told["failed"]] == ["4-1-0000"]


@pytest.mark.slow
def test_bench_recognition_prints_every_figure_and_counts_failures(corpus):
    cache = corpus / "alignments.jsonl"
    done = lipservo("bench", "recognition", "--corpus", corpus, "--cache", cache, "--json")
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout)
    assert set(figures) >= {
        "phone_all", "phone_speech", "viseme_all", "viseme_speech",
        "closure_recall", "closure_precision", "per", "revisions_per_s", "rtf",
        "ms_per_phoneme", "utterances", "seconds", "alignment", "failed_alignments",
    }  # fmt: skip
    assert (figures["utterances"], figures["failed_alignments"]) == (2, 1)
    assert figures["alignment"] == {"default": 2, "labelled": 0, "tight_not_scored": 0}
    assert figures["seconds"] == pytest.approx(2 * 8.615)
    assert figures["viseme_all"] > 0.6
    assert len(cache.read_text().splitlines()) == 3
    assert "4-1-0001" in done.stderr
    chosen = lipservo(
        "bench", "recognition", "--corpus", corpus, "--cache", cache, "--speakers", "3",
        "--noise", "white:0", "--json",
    )  # fmt: skip
    noisy = json.loads(chosen.stdout)
    assert (noisy["utterances"], noisy["failed_alignments"]) == (1, 0)
    assert noisy["viseme_all"] < figures["viseme_all"]


@pytest.mark.slow
def test_speakers_that_trained_nothing_are_heard(corpus_dir):
    """Two women and two men, through the twin of the shipped weights that never heard them."""
    done = lipservo(
        "bench", "recognition", "--corpus", corpus_dir / "librispeech", "--limit", "1",
        "--speakers", "1221,4446,1089,5105", "--weights", TWIN, "--json",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout)
    assert figures["viseme_speech"] > 0.72
    assert figures["closure_recall"] > 0.8
    assert figures["per"] < 0.55


def test_bench_recognition_explains_its_mistakes(corpus):
    for arguments, said in (
        (("--corpus", corpus / "audio"), "transcripts.txt: no such file"),
        (("--corpus", corpus, "--speakers", "9"), "no speaker 9; known: 3, 4"),
        (("--corpus", corpus, "--noise", "grey:1"), "kinds: white"),
        (("--corpus", corpus, "--only", corpus / "none"), "no readable list of names"),
        (("--corpus", corpus, "--weights", "none.npz"), "shipped weights: default, grid"),
    ):
        assert said in refused("bench", "recognition", *arguments)


@pytest.mark.campaign
def test_bench_listening_watches_the_mouth_close(corpus):
    done = lipservo("bench", "listening", "--corpus", corpus, "--speakers", "3", "--json")
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout)
    assert figures["closing_cuts"] == 6
    assert figures["closing_begins_ms_p100"] <= 250
    assert figures["closing_complete_ms_p100"] <= 400
    assert figures["gap_120_ms_brought_to_rest"] == 0.0
    assert figures["closing_delay_ms"] == pytest.approx(205.0)


@pytest.mark.parametrize("engine", ["network", "energy"])
def test_replay_hears_without_pocketsphinx_and_names_who_listened(engine, monkeypatch):
    monkeypatch.setitem(sys.modules, "pocketsphinx", None)
    done = lipservo("replay", CLIP_PATH, "--engine", engine, "--json")
    assert done.returncode == 0, done.stderr
    summary = json.loads(done.stdout)
    assert (summary["recognizer"], summary["fallback_level"]) == (engine, 0)


@pytest.mark.slow
def test_a_run_log_becomes_a_picture(tmp_path):
    log = tmp_path / "log.jsonl"
    log.write_text(
        '{"step": 50, "loss": 2.0}\n{"step": 100, "loss": 1.5, "clean_delay7_viseme_all": 0.7}\n'
    )
    done = lipservo("learn", "plot", log, "-o", tmp_path / "log.png")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "log.png").read_bytes().startswith(b"\x89PNG")
    log.write_text('{"step": 50}\n')
    done = lipservo("learn", "plot", log, "-o", tmp_path / "log.png")
    assert done.returncode == 1
    assert "every line must hold a step and a loss" in done.stderr


@pytest.mark.parametrize(
    "arguments",
    [
        ("lines", "align", CLIP_PATH, CLIP_TEXT),
        ("lines", "render", CLIP_PATH, "--text", CLIP_TEXT, "-o", "line.perf"),
    ],
)
def test_what_needs_pocketsphinx_says_so_in_one_line(arguments, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "pocketsphinx", None)
    said = refused(*arguments)
    assert "needs pocketsphinx, which is not installed: `pip install 'lipservo[align]'`" in said
    assert os.listdir(tmp_path) == []


def test_pocketsphinx_is_no_engine_of_a_face():
    done = lipservo("replay", CLIP_PATH, "--engine", "pocketsphinx")
    assert done.returncode == 2
    assert "pocketsphinx" in done.stderr
    assert "network" in done.stderr
