"""What Edge, Hilton and Jackson print of their recordings and modes, beside ours."""

import numpy as np
import pytest
from lipservo_lab.corpus.grid import read_grid
from lipservo_lab.evaluation.motion.edge_tables import edge_tables, shares_held
from lipservo_lab.learning.motion.face_training import train
from small_corpus import write_corpus


def test_shares_are_of_the_variance_and_reach_one():
    # Variances 9, 4 and 0 along any three directions.
    spread = np.array([[3.0, 0, 0], [-3.0, 0, 0], [0, 2.0, 0], [0, -2.0, 0]])
    turned = spread @ np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    np.testing.assert_allclose(shares_held(turned), [9 / 13, 1.0, 1.0], atol=1e-12)


def test_our_recordings_and_modes_stand_beside_theirs(tmp_path):
    corpus = read_grid(write_corpus(tmp_path / "c", 3)).labelled()
    tables = edge_tables(train(corpus), corpus.utterances)
    recordings = {row["figure"]: row for row in tables["edge_recordings"]}
    assert (recordings["sentences"]["printed"], recordings["sentences"]["ours"]) == (103, 3)
    seconds = sum(len(u.markers_mm) / u.frame_rate_hz for u in corpus.utterances)
    assert recordings["minutes"]["ours"] == pytest.approx(seconds / 60.0)
    assert [r["printed"] for r in tables["edge_modes"][:10]] == [None] * 9 + [0.95]
    # The made-up face opens its jaw more than anything: that is the first mode.
    first, second = tables["edge_meaning"]
    assert abs(first["gap"]) > max(0.5, abs(second["gap"]))
    # One number a frame cannot follow a jaw that turns as well as the model's components do.
    blend, components = (row["rms_mm"] for row in tables["edge_jaw"])
    assert components < blend
