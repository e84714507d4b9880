"""`bench motion --offline`: the methods of `render` beside the live ones."""

import json

import pytest
from small_corpus import write_corpus
from typer.testing import CliRunner

from lipservo.cli import app
from lipsync.offline.line_methods import DEFAULT_METHOD


def invoke(*arguments):
    done = CliRunner().invoke(app, [str(each) for each in arguments])
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


@pytest.mark.slow
def test_the_methods_of_render_are_scored_with_a_model_of_the_same_sentences(tmp_path):
    corpus, face = write_corpus(tmp_path / "corpus", 8), tmp_path / "face.npz"
    invoke(
        "learn", "face", corpus, "-o", face, "--phonemes", "true", "--components", 4, "--json", "-q"
    )

    answer = invoke(
        "bench", "motion", "--corpus", corpus, "--model", face, "--strategy", "catmull-rom",
        "--lookahead-ms", 100, "--offline", "--json", "--quiet",
    )  # fmt: skip

    rows = {row["strategy"]: row for row in answer["results"]}
    assert list(rows) == ["catmull-rom-means", "catmull-rom", "model-based", "heard"]
    assert all(row["frames"] == rows["heard"]["frames"] > 0 for row in rows.values())
    # The sentences are the ones that it learned: their own phones are the best examples.
    assert rows["catmull-rom"]["ratio"] < rows["catmull-rom-means"]["ratio"]
    assert answer["default_strategy"] == DEFAULT_METHOD
