"""`lipservo bench motion` as its callers see it."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from lipservo_lab.bench.motion_figures import BenchError, question
from lipservo_lab.corpus.grid import read_grid
from lipservo_lab.evaluation.motion.as_printed import AS_PRINTED
from lipservo_lab.evaluation.motion.methods import Heard, all_methods
from lipservo_lab.learning.motion.face_training import train
from lipservo_lab.learning.motion.trained_model import save_model
from small_corpus import RIGID, write_corpus, write_sentence
from typer.testing import CliRunner

from lipservo.cli import app
from lipsync.markers import MARKERS_47
from lipsync.motion.live_synthesizer import LIVE_STRATEGY
from lipsync.phonemes import PhonemeEvent

#: The fields that a row must have.
ROW = {
    *("strategy", "lookahead_ms", "split", "phonemes", "rmse_mm", "rmse_lips_mm", "ratio"),
    *("gap_r", "closure_hits", "acceleration_ratio", "miss_rate", "ms_per_phoneme_p95"),
    *("sentences", "frames"),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    path = write_corpus(tmp_path_factory.mktemp("bench") / "c", 6)
    splits = {"folds": [["s0", "s1"], ["s2", "s3"]], "new_words": {}}
    (path / "splits.json").write_text(json.dumps(splits))
    return path


@pytest.fixture(scope="module")
def model(folder, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("model") / "m.npz"
    save_model(train(read_grid(folder).keep({"s4", "s5"})), path)
    return path


def bench(*arguments: object) -> dict:
    done = CliRunner().invoke(app, ["bench", "motion", *map(str, arguments), "--json", "-q"])
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


@pytest.mark.slow
def test_without_a_model_every_method_is_cross_validated(folder):
    result = bench("--corpus", folder)
    assert result["default_strategy"] == "animpho"
    rows = result["results"]
    assert {r["strategy"] for r in rows} == set(all_methods())
    assert {r["lookahead_ms"] for r in rows} == {0, 100, 200}
    for row in rows:
        assert set(row) >= ROW
        assert row["split"] == "random"
        assert row["sentences"] == 4
    reference = [r["ratio"] for r in rows if r["strategy"] == "cohen-massaro"]
    assert reference == pytest.approx([1.0] * 3)
    assert all(
        (r["miss_rate"] is None) == (r["strategy"] not in ("naive", "priority")) for r in rows
    )


@pytest.mark.slow
def test_the_papers_tables_stand_beside_the_printed_numbers_(folder, model):
    done = CliRunner().invoke(
        app, ["bench", "figures", "--corpus", str(folder), "--model", str(model), "--json", "-q"]
    )
    assert done.exit_code == 0, done.output
    paper = json.loads(done.stdout)
    assert set(paper) > {"table_2", "figure_6", "animphos", "edge_modes"}
    assert all(0.0 < share < 1.0 for share in paper["animphos"][0].values())
    assert [row["printed_case_2"] for row in paper["table_2"]] == [1.081, 1.151, 1.063]
    cases = {
        f"{strategy}_{case}"
        for strategy in ("priority", LIVE_STRATEGY, AS_PRINTED)
        for case in ("case_1", "case_2")
    }
    assert cases < set(paper["table_2"][0])
    assert all(0.0 <= row[AS_PRINTED] <= 1.0 for row in paper["figure_6"])


@pytest.mark.slow
def test_self_correction_is_measured_and_everything_is_printed(folder, model, tmp_path):
    """A folder with minimal pairs: two sentences that differ in their first phoneme alone."""
    long = tmp_path / "long"
    shutil.copytree(folder, long)
    rng = np.random.default_rng(0)
    face = rng.normal(0.0, 30.0, (len(RIGID) + len(MARKERS_47.names), 3))
    for number, first in enumerate("BTBT"):
        middle = [(first, 0.1), *[("AA", 0.1), ("UW", 0.1)] * 3]
        phones = [("SIL", 0.4), ("AA", 0.1), *middle, ("SIL", 0.4)]
        write_sentence(long, f"t{number}", face, phones, rng)
    arguments = ("--corpus", long, "--model", model, "--strategy", LIVE_STRATEGY)
    rows = bench(*arguments, "--lookahead-ms", "0,100")["recovery"]
    assert [(r["case"], r["strategy"], r["lookahead_ms"]) for r in rows] == [
        ("another true phoneme", "recorded", None),
        *(
            (case, LIVE_STRATEGY, ms)
            for ms in (0, 100)
            for case in ("another true phoneme", "never corrected", "corrected after 95 ms")
        ),
    ]
    assert all(len(r["left"]) == 5 for r in rows if r["left"])
    assert rows[2]["left"][0] == 1.0
    assert rows[2]["counted"] == 4
    done = CliRunner().invoke(app, ["bench", "motion", *map(str, arguments), "-q"])
    assert done.exit_code == 0, done.output
    assert "never corrected" in done.stdout
    assert "gap r" in done.stdout
    assert max(map(len, done.stdout.splitlines())) <= 80


def test_a_given_model_is_scored_on_the_words_asked_for(folder, model):
    whole = bench("--corpus", folder, "--model", model, "--strategy", LIVE_STRATEGY)
    words = bench(
        "--corpus", folder, "--model", model, "--strategy", LIVE_STRATEGY,
        "--words", "word", "--lookahead-ms", "50",
    )  # fmt: skip
    assert [r["lookahead_ms"] for r in words["results"]] == [50]
    assert 0 < words["results"][0]["frames"] < whole["results"][0]["frames"]


def said(phonemes: str) -> tuple[PhonemeEvent, ...]:
    """Phonemes of 0.2 s each, one after the other."""
    return tuple(
        PhonemeEvent(phoneme, 0.2 * n, 0.2 * (n + 1)) for n, phoneme in enumerate(phonemes.split())
    )


def test_misses_and_times_are_those_of_the_phonemes_that_were_heard(folder, model, monkeypatch):
    """No B follows a B in the corpus: who hears nothing else misses every one but the first."""
    heard = Heard(said("SIL B B B SIL"), (), 0.095)
    monkeypatch.setattr("lipservo_lab.bench.motion_figures.recognize_file", lambda *_: heard)
    for phonemes, missed in (("true", 0.0), ("recognized", 1.0)):
        (row,) = bench(
            "--corpus", folder, "--model", model, "--lookahead-ms", "0",
            "--phonemes", phonemes, "--strategy", "priority",
        )["results"]  # fmt: skip
        assert row["miss_rate"] == missed
        assert row["timed_sentences"] == 6
        assert row["ms_per_frame_p95"] > 0.0


def test_the_miss_rate_of_a_split_is_that_of_all_its_folds(folder, monkeypatch):
    """In the first fold two of two phonemes are missed, in the second two of six."""
    by_fold = {"s0": "B B", "s1": "B B", "s2": "B AA T UW", "s3": "B AA T UW"}
    monkeypatch.setattr(
        "lipservo_lab.bench.motion_figures.recognize_file",
        lambda _, recording, _text: Heard(said(f"SIL {by_fold[recording.stem]} SIL"), (), 0.095),
    )
    (row,) = bench(
        "--corpus", folder, "--strategy", "priority", "--lookahead-ms", "0",
        "--phonemes", "recognized",
    )["results"]  # fmt: skip
    assert row["miss_rate"] == pytest.approx(4 / 8)


def test_equation_5_as_printed_can_be_asked_for_and_moves_otherwise(folder, model):
    arguments = ("--corpus", folder, "--model", model, "--strategy", "priority")
    ours = bench(*arguments, "--lookahead-ms", "0")
    printed = bench(*arguments, "--lookahead-ms", "0", "--published-derivatives")
    assert (ours["published_derivatives"], printed["published_derivatives"]) == (False, True)
    assert ours["results"][0]["rmse_mm"] != printed["results"][0]["rmse_mm"]
    assert ours["results"][0]["miss_rate"] == printed["results"][0]["miss_rate"]


def test_words_that_every_sentence_holds_leave_nothing_to_train_on_and_it_says_so(folder):
    done = CliRunner().invoke(app, ["bench", "motion", "--corpus", str(folder), "--words", "word"])
    assert done.exit_code == 1
    assert "every labelled sentence holds 'word', so none is left to train on" in str(
        done.exception
    )


def test_recognized_phonemes_are_those_of_the_live_recogniser(folder, model):
    (row,) = bench(
        "--corpus", folder, "--model", model, "--strategy", LIVE_STRATEGY,
        "--lookahead-ms", "100", "--phonemes", "recognized",
    )["results"]  # fmt: skip
    assert row["phonemes"] == "recognized"
    assert row["sentences"] == 6


@pytest.mark.slow
def test_pictures_are_drawn(folder, model, tmp_path):
    pytest.importorskip("matplotlib", reason="the extra `plots` is not installed")
    drawn = ("--corpus", folder, "--model", model, "--plots", tmp_path / "p")
    bench(*drawn, "--strategy", LIVE_STRATEGY, "--lookahead-ms", "0")
    assert sorted(os.listdir(tmp_path / "p")) == [
        "mouths.png",
        "recovery.png",
        "trajectory.png",
    ]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("magic", "0", "true", None), "unknown strategy 'magic'; use one of cohen-massaro,"),
        ((None, "soon", "true", None), "give whole ms"),
        ((None, "2000", "true", None), "0 to 1000 ms are possible"),
        ((None, "0", "guessed", None), "--phonemes guessed: use one of"),
        ((None, "0", "true", " , "), "names no word"),
    ],
)
def test_a_question_that_cannot_be_answered_says_why(arguments, message):
    with pytest.raises(BenchError, match=message):
        question(*arguments)
