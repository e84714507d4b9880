"""`lipservo bench readability` as its callers see it."""

import json
import shutil
from pathlib import Path

import pytest
from lipservo_lab.bench.motion_figures import BenchError
from lipservo_lab.bench.readability.readability_figures import (
    headline,
    reading_question,
    reading_rows,
    with_line_methods,
)
from lipservo_lab.bench.readability.reading_models import given_models, requested_parts
from lipservo_lab.bench.readability.soft_table import soft_table
from lipservo_lab.corpus.grid import read_grid
from lipservo_lab.corpus.utterance import CorpusError
from lipservo_lab.evaluation.motion.offline_methods import OfflineModels
from lipservo_lab.learning.motion.face_training import train
from lipservo_lab.learning.motion.trained_model import load_trained_model, save_model
from lipservo_lab.learning.offline.offline_training import train_offline
from lipservo_lab.learning.offline.state_training import Recipe
from small_corpus import write_corpus
from typer.testing import CliRunner

from lipservo.cli import app
from lipsync.textgrid import read_tiers, write_tiers

#: The first slot's word says which phone begins the sentence, the second's which one ends it.
FIRST, SECOND = ("bee", "ah", "tea", "ooh"), ("one", "two")
#: Sentences with "ooh" are every fourth.
TEST, LEARNED = ["s0", "s1", "s4", "s5"], {"s2", "s6"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    path = write_corpus(tmp_path_factory.mktemp("readability") / "c", 16)
    for number in range(16):
        label = path / "labels" / f"s{number}.TextGrid"
        tiers = read_tiers(label)
        words = ((FIRST[number % 4], 0.4, 0.7), (SECOND[number % 2], 0.7, 1.0))
        write_tiers(label, {**tiers, "words": words})
    splits = {"folds": [], "random_test": TEST, "new_words": {"A": ["ooh"]}}
    (path / "splits.json").write_text(json.dumps(splits))
    return path


@pytest.fixture(scope="module")
def models(folder, tmp_path_factory) -> Path:
    """One model for all parts: it has learned no sentence of any test."""
    path = tmp_path_factory.mktemp("models")
    save_model(train(read_grid(folder).keep(LEARNED)), path / "known.npz")
    for name in ("a", "words"):
        shutil.copy(path / "known.npz", path / f"{name}.npz")
    return path


def bench(*arguments: object) -> dict:
    typed = ["bench", "readability", *map(str, arguments), "--no-robot", "-q"]
    done = CliRunner().invoke(app, [*typed, "--json"])
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


@pytest.mark.slow
def test_every_method_look_ahead_and_reader_has_a_row_and_the_headline_is_that_of_100_ms(
    folder, models, tmp_path
):
    found = bench("--corpus", folder, "--models", models, "--plots", tmp_path / "p")
    keys = {"recorded_known", "known_true", "known_recognized"}
    keys |= {"recorded_new_a", "new_a_true", "new_a_recognized"}
    assert keys < set(found)
    assert found["default_strategy"] == "animpho"
    rows = found["results"]
    # Two splits, two readers; recorded, and three methods at three look-aheads with both phonemes.
    assert len(rows) == 2 * 2 * (1 + 3 * 3 * 2)
    for row in rows:
        assert set(row) >= {"score", "score_95", "shares", "whole_sentences", "gain", "sentences"}
        assert row["sentences"] == 4
        assert set(row["shares"]) == ({"slot 1", "slot 2"} if row["split"] == "known" else {"ooh"})
    (ours,) = (
        row["score"]
        for row in rows
        if (row["split"], row["strategy"], row["phonemes"]) == ("known", "animpho", "true")
        and (row["lookahead_ms"], row["reader"]) == (100, "components")
    )
    assert found["known_true"] == ours
    # Paired: a score and its difference are drawn on the same sentences.
    (without,) = (
        row["score"]
        for row in rows
        if (row["split"], row["strategy"], row["phonemes"]) == ("known", "expected", "true")
        and (row["lookahead_ms"], row["reader"]) == (100, "components")
    )
    differences = [row["less_expected"] for row in rows if row["strategy"] == "animpho"]
    assert ours - without in differences
    assert None not in differences
    assert abs(found["gap_r_true"]) <= 1.0  # of two sentences: no more can be said
    assert (tmp_path / "p" / "readability.png").is_file()


def test_the_table_of_other_weights_has_a_figure_for_each_bar(folder, models):
    corpus = read_grid(folder).labelled()
    trained = load_trained_model(models / "known.npz")
    rows = soft_table(
        corpus,
        requested_parts(folder, corpus, None),
        lambda _part: trained,
        "default",
        lambda _what, items: items,
    )
    measured = {row["figure"]: row["measured"] for row in rows}
    assert {name for name, value in measured.items() if value is None} <= {
        *("new_b_recognized", "closure_hits", "labiodental_hits", "gap_steps_per_s"),
        "heard_closure_hits",
    }
    assert 0.0 <= measured["known_recognized"] <= 1.0
    assert all(row["bar"][:2] in (">=", "<=") for row in rows)


def test_words_may_be_named_and_are_trained_without_where_no_model_is_given(folder):
    asked = ["--words", "ooh", "--strategy", "mean-face", "--phonemes", "true"]
    found = bench("--corpus", folder, *asked, "--lookahead-ms", "0")
    assert [(r["split"], r["strategy"], r["reader"]) for r in found["results"]] == [
        ("new_words", strategy, reader)
        for strategy in ("recorded", "mean-face")
        for reader in ("components", "lips")
    ]
    assert set(found) == {
        *("recorded_new_words", "results", "skipped"),
        *("default_strategy", "machine", "seconds"),
    }


def test_words_left_out_are_one_row_of_all_folds_and_kept_models_are_read_again(
    folder, tmp_path, monkeypatch
):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    asked = ["--leave-words-out", "--limit", "2", "--strategy", "animpho,expected"]
    asked += ["--phonemes", "true", "--lookahead-ms", "100"]
    found = bench("--corpus", folder, *asked)
    rows = {(row["strategy"], row["reader"]): row for row in found["results"]}
    assert list(rows) == [
        (strategy, reader)
        for strategy in ("recorded", "animpho", "expected")
        for reader in ("components", "lips")
    ]
    for row in rows.values():
        assert (row["split"], row["sentences"]) == ("left_out", 2 * len(FIRST + SECOND))
        assert set(row["shares"]) == {*FIRST, *SECOND}
        assert row["score"] == pytest.approx(sum(row["shares"].values()) / 6)
        assert row["score_95"][0] <= row["score"] <= row["score_95"][1]
    ours, without = (rows[name, "lips"] for name in ("animpho", "expected"))
    assert ours["less_expected"] == pytest.approx(ours["score"] - without["score"])
    assert found["left_out_true"] == rows["animpho", "components"]["score"]
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.npz")}
    assert len(kept) == 6
    assert bench("--corpus", folder, *asked)["results"] == found["results"]
    assert set(tmp_path.rglob("*.npz")) == set(kept)


def test_words_left_out_are_read_of_no_given_model(folder, models):
    typed = ["--corpus", str(folder), "--models", str(models), "--leave-words-out"]
    done = CliRunner().invoke(app, ["bench", "readability", *typed])
    assert done.exit_code == 2
    assert "leave out --words and --models" in " ".join(done.output.split())


def test_what_the_robot_shows_is_in_the_headline_as_the_reader_of_lips_reads_it():
    row = {"split": "known", "phonemes": "recognized", "strategy": "animpho"}
    row |= {"lookahead_ms": 100, "face": "face_sim"}
    rows = [row | {"reader": r, "score": s} for r, s in (("components", 0.1), ("lips", 0.2))]
    assert headline(rows) == {"robot_known_recognized": 0.2}


def test_methods_of_render_are_read_too(folder, models):
    corpus = read_grid(folder).labelled()
    parts = requested_parts(folder, corpus, None)
    asked = reading_question("heard,mean-face,model-based", "200", "true", robot=False)
    recipe = Recipe(n_components=3, n_states=10)

    ready = with_line_methods(
        asked,
        lambda: OfflineModels(
            lambda model: train_offline(corpus.keep(set(model.training_sentences)), model, recipe)
        ),
    )
    rows = reading_rows(
        corpus, parts, given_models(models, parts), ready, lambda _, items: items, print
    )

    assert [row["strategy"] for row in rows if row["reader"] == "lips"] == 2 * [
        "recorded", "mean-face", "model-based", "heard"
    ]  # fmt: skip


def test_what_cannot_be_asked_says_why(folder, models):
    with pytest.raises(BenchError, match="unknown strategy 'x'"):
        reading_question("expected,x", "100", "true", robot=False)
    with pytest.raises(BenchError, match="0 to 1000 ms"):
        reading_question("heard", "5000", "true", robot=False)
    with pytest.raises(BenchError, match="--phonemes heard: use one of"):
        reading_question("expected", "100", "true,heard", robot=False)
    corpus = read_grid(folder)
    with pytest.raises(BenchError, match="--words names no word"):
        requested_parts(folder, corpus, " , ")
    with pytest.raises(CorpusError, match="every labelled sentence holds one of these words"):
        requested_parts(folder, corpus, "one,two")
    parts = requested_parts(folder, corpus, "tea")
    with pytest.raises(BenchError, match=r"words.npz: was trained on 2 of the sentences .*\(s2"):
        given_models(models, parts)
