"""Every word once unseen by the model that moves the mouth in it."""

import json
from dataclasses import replace

import pytest
from lipservo_lab.bench.left_out_words import KeptModels, left_out_figures, word_folds
from lipservo_lab.corpus.grid import read_grid
from lipservo_lab.corpus.utterance import Corpus, CorpusError, Word
from lipservo_lab.evaluation.motion.methods import LiveMethod, SplineMethod
from lipservo_lab.evaluation.motion.motion_scores import true_phonemes
from small_corpus import write_corpus
from small_model import small_model
from typer.testing import CliRunner

from lipservo.cli import app

TEXTS = ("red", "blue", "green")


@pytest.fixture(scope="module")
def corpus(tmp_path_factory) -> Corpus:
    """Return a corpus of six sentences of one word each; three words in turn."""
    found = read_grid(write_corpus(tmp_path_factory.mktemp("corpus") / "c", 6)).labelled()
    utterances = tuple(
        replace(u, words=(Word(TEXTS[n % 3], u.words[0].start_s, u.words[-1].end_s),))
        for n, u in enumerate(found.utterances)
    )
    return replace(found, utterances=utterances)


def test_every_word_is_left_out_once_with_all_sentences_that_hold_it(corpus):
    folds = word_folds(corpus)
    assert sorted(word for part in folds for word in part.words) == sorted(TEXTS)
    for part in folds:
        said = {u.name for u in corpus.utterances if u.words[0].text in part.words}
        assert part.test == said
        assert not part.train & said


@pytest.mark.parametrize(
    ("words_of", "n", "told"),
    [
        (lambda u: (*u.words, Word("and", 0.1, 0.2)), 6, "every labelled sentence holds one of"),
        (lambda u: u.words, 1, "1 different words; leaving one out needs 2"),
        (
            lambda u: (replace(u.words[0], start_s=9.0, end_s=9.5),), 6,
            "no phone of speech lies in any word",
        ),
    ],
)  # fmt: skip
def test_words_that_cannot_be_left_out_are_refused(corpus, words_of, n, told):
    changed = tuple(replace(u, words=words_of(u)) for u in corpus.utterances[:n])
    with pytest.raises(CorpusError, match=told):
        word_folds(replace(corpus, utterances=changed))


def test_a_model_is_learned_once_and_kept_until_its_sentences_change(corpus, tmp_path):
    learned = []

    def learn(part):
        learned.append(part)
        return small_model()

    part = word_folds(corpus)[0]
    for _ in range(2):
        KeptModels(tmp_path, corpus, {}, learn).of(part)
    assert len(learned) == 1
    moved = replace(corpus.utterances[0], markers_mm=corpus.utterances[0].markers_mm + 1.0)
    others = replace(corpus, utterances=(moved, *corpus.utterances[1:]))
    for part in word_folds(others):
        KeptModels(tmp_path, others, {}, learn).of(part)
    assert len(learned) > 1
    next(tmp_path.glob("*.npz")).write_bytes(b"damaged")
    n_before = len(learned)
    for part in (*word_folds(corpus), *word_folds(others)):
        KeptModels(tmp_path, corpus, {}, learn).of(part)
    assert len(learned) > n_before


def test_a_word_without_a_frame_of_speech_is_left_out_of_the_rows(corpus):
    """As a word in silence, or one shorter than a recorded frame."""
    first = corpus.utterances[0]
    silent = replace(first, words=(Word("hush", 0.1, 0.2), *first.words))
    rows = left_out_figures(
        replace(corpus, utterances=(silent, *corpus.utterances[1:])), lambda _: small_model(),
        [LiveMethod()], (100,), true_phonemes, 2, lambda _, items: items,
    )  # fmt: skip
    assert rows["all"][0]["frames"] > 0


def test_a_second_method_is_compared_in_the_same_words(corpus):
    """One that sees the whole sentence: the look-ahead is the first method's alone."""
    rows = left_out_figures(
        corpus, lambda _: small_model(), [LiveMethod(), SplineMethod()], (0, 200), true_phonemes,
        2, lambda _, items: items,
    )  # fmt: skip
    assert {row["lookahead_ms"] for row in rows["classes"]} == {200}
    assert rows["words"] == []  # none has 300 frames
    of = {(row["strategy"], row["lookahead_ms"]): row for row in rows["all"]}
    assert of["catmull-rom", 0] | {"lookahead_ms": 200} == of["catmull-rom", 200]
    assert [row["lookahead_ms"] for row in rows["differences"]] == [0, 200]
    for row in rows["differences"]:
        assert (row["strategy"], row["less"]) == ("catmull-rom", "expected")
        ours, live = (of[row[key], row["lookahead_ms"]] for key in ("strategy", "less"))
        for name in ("ratio", "gap_r"):
            assert row[name] == pytest.approx(ours[name] - live[name], abs=2e-4)
            assert row[f"{name}_95"][0] <= row[name] <= row[f"{name}_95"][1]


@pytest.mark.slow
def test_a_scripted_line_is_scored_beside_the_live_one(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    folder = write_corpus(tmp_path / "c", 12)
    for n, path in enumerate(sorted((folder / "labels").iterdir())):
        path.write_text(path.read_text().replace('"word"', f'"{TEXTS[n % 3]}"'))
    done = CliRunner().invoke(
        app,
        ["bench", "motion", "--corpus", str(folder), "--leave-words-out", "--offline",
         "--lookahead-ms", "200", "--limit", "1", "--json", "-q"],
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    answer = json.loads(done.stdout)
    assert [row["strategy"] for row in answer["all"]] == [answer["strategy"], "heard"]
    (row,) = answer["differences"]
    assert (row["strategy"], row["less"]) == ("heard", answer["strategy"])
