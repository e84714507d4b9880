"""A recorded sentence as a performance, for a film beside a method."""

import numpy as np
import pytest
from places import ROOT
from typer.testing import CliRunner

from lipservo.cli import app
from lipsync.face.model import load_face
from lipsync.offline.performance import read_performance

CORPUS = ROOT.parent / "shared" / "corpus" / "grid_s1"


@pytest.mark.skipif(not CORPUS.is_dir(), reason="no recordings beside the repository")
def test_a_recorded_sentence_becomes_the_performance_of_its_face(tmp_path):
    out = tmp_path / "line.perf"
    done = CliRunner().invoke(app, ["study", "recorded", str(CORPUS), "bbaf4p", "-o", str(out)])
    assert done.exit_code == 0, done.output
    line = read_performance(out)
    assert line.method == "recorded"
    assert line.duration_s == pytest.approx(2.96)
    gaps = load_face().lip_gaps_mm(load_face().markers_mm(line.coefficients.astype(float)))
    shut = [e for e in line.phonemes if e.phoneme == "B"]
    for event in shut:
        during = slice(int(100 * event.start_s) - 4, int(100 * event.end_s) + 9)
        assert gaps[during].min() < np.median(gaps)


def test_a_sentence_that_is_not_there_is_named(tmp_path):
    if not CORPUS.is_dir():
        pytest.skip("no recordings beside the repository")
    out = tmp_path / "line.perf"
    done = CliRunner().invoke(app, ["study", "recorded", str(CORPUS), "nobody", "-o", str(out)])
    assert done.exit_code != 0
    assert "no sentence nobody" in str(done.exception or done.output)
    assert not out.exists()
