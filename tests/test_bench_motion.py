"""`lipservo bench motion` as its callers see it."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
import small_corpus
from small_corpus import write_corpus
from typer.testing import CliRunner

from lipservo.cli import app
from lipservo.motion_figures import BenchError, question
from lipsync.animpho.live import LIVE_STRATEGY
from lipsync.animpho.model import save_model
from lipsync.animpho.training import train
from lipsync.corpus.grid import read_grid
from lipsync.corpus.utterance import CorpusError
from lipsync.evaluation.methods import all_methods

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


def test_without_a_model_every_method_is_cross_validated(folder):
    result = bench("--corpus", folder)
    assert result["default_strategy"] == LIVE_STRATEGY
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


def test_a_given_model_is_scored_on_the_words_asked_for(folder, model):
    whole = bench("--corpus", folder, "--model", model, "--strategy", LIVE_STRATEGY)
    words = bench(
        "--corpus", folder, "--model", model, "--strategy", LIVE_STRATEGY,
        "--words", "word", "--lookahead-ms", "50",
    )  # fmt: skip
    assert [r["lookahead_ms"] for r in words["results"]] == [50]
    assert 0 < words["results"][0]["frames"] < whole["results"][0]["frames"]


def test_recognized_phonemes_are_those_of_the_live_recogniser(folder, model):
    (row,) = bench(
        "--corpus", folder, "--model", model, "--strategy", LIVE_STRATEGY,
        "--lookahead-ms", "100", "--phonemes", "recognized",
    )["results"]  # fmt: skip
    assert row["phonemes"] == "recognized"
    assert row["sentences"] == 6


def test_pictures_are_drawn(folder, model, tmp_path):
    pytest.importorskip("matplotlib", reason="the extra `plots` is not installed")
    bench("--corpus", folder, "--model", model, "--plots", tmp_path / "p", "--lookahead-ms", "0")
    assert sorted(os.listdir(tmp_path / "p")) == ["errors.png", "lookahead.png", "trajectory.png"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("magic", "0", "true", None), "unknown strategy 'magic'; known here: cohen-massaro,"),
        ((None, "soon", "true", None), "give whole ms"),
        ((None, "2000", "true", None), "0 to 1000 ms are possible"),
        ((None, "0", "guessed", None), "unknown phonemes 'guessed'"),
        ((None, "0", "true", " , "), "names no word"),
    ],
)
def test_a_question_that_cannot_be_answered_says_why(arguments, message):
    with pytest.raises(BenchError, match=message):
        question(*arguments)


@pytest.mark.parametrize("rate_hz", [30.0, 60.0, 120.0])
def test_motion_of_any_frame_rate_trains_and_scores(tmp_path, monkeypatch, rate_hz):
    monkeypatch.setattr(small_corpus, "FRAME_RATE_HZ", rate_hz)
    corpus = read_grid(write_corpus(tmp_path / "c", 3))
    assert {u.frame_rate_hz for u in corpus.utterances} == {rate_hz}
    save_model(train(corpus.keep({"s0", "s1"})), tmp_path / "m.npz")
    result = bench("--corpus", tmp_path / "c", "--model", tmp_path / "m.npz")
    assert all(np.isfinite(r["ratio"]) for r in result["results"])


def test_a_frame_that_was_not_tracked_is_named(tmp_path):
    folder = write_corpus(tmp_path / "c", 2)
    path = folder / "landmarks" / "s1.npz"
    with np.load(path) as file:
        points = file["landmarks_64th_px"].copy()
    points[7] = 0
    np.savez(path, landmarks_64th_px=points)
    with pytest.raises(CorpusError, match=r"s1.npz: frame 7 is not tracked"):
        read_grid(folder)
    assert len(read_grid(folder, skip_bad=True).utterances) == 1
