import json

import numpy as np
import pytest
from expression_tracks import write_tracks
from lipservo_lab.learning.learned_expression.expression_model import load_expression
from lipservo_lab.learning.learned_expression.learned_expression import LearnedExpression
from typer.testing import CliRunner

from lipservo.cli import app
from lipsync.expression.cue import ExpressionCue


def invoke(*arguments):
    return CliRunner().invoke(app, ["learn", "expression", *map(str, arguments)])


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    """Ten recordings, four of them held out."""
    folder = write_tracks(tmp_path_factory.mktemp("tracks"), 10, 8.0)
    held_out = [f"t{number:02d}" for number in range(4)]
    (folder / "splits.json").write_text(json.dumps({"random_test": held_out}))
    return folder


def test_a_head_that_follows_its_voice_is_learned_and_measured(corpus, tmp_path):
    output = tmp_path / "head.npz"
    done = invoke(corpus, "-o", output, "--json", "--quiet")
    figures = json.loads(done.stdout)
    held_out = figures["held_out"]

    assert done.exit_code == 0
    assert (figures["recordings"], held_out["recordings"]) == (6, 4)
    assert held_out["canonical_r_real"] > held_out["canonical_r_real_shuffled"] + 0.1
    assert held_out["canonical_r"] > held_out["canonical_r_shuffled"]
    assert held_out["psd_distance_db"] < 10.0
    assert 5.0 < held_out["blink_per_min"] < 60.0
    shown = LearnedExpression(load_expression(output), np.random.default_rng(0)).step(
        ExpressionCue(0.01)
    )
    assert shown.neck_pitch_deg is not None
    assert shown.lid_left is not None


def test_mistakes_are_told_before_anything_is_written(corpus, tmp_path):
    output = tmp_path / "head.npz"
    other = tmp_path / "other.txt"
    other.write_text("mine")

    assert "no such folder" in str(invoke(tmp_path / "none", "-o", output).exception)
    assert "no NAME.csv" in str(invoke(tmp_path, "-o", output).exception)
    assert "learned expression" in str(invoke(corpus, "-o", other).exception)
    assert other.read_text() == "mine"
    assert not output.exists()
