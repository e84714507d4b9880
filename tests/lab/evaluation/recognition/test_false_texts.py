"""What `bench texts` asks, and how it counts."""

from pathlib import Path

import numpy as np
from lipservo_lab.corpus.transcribed import TranscribedUtterance
from lipservo_lab.evaluation.recognition.benchmark import text_figures, texts_of

POOL = [
    TranscribedUtterance(f"1-1-{n}", "1", text, Path())
    for n, text in enumerate(
        ["GO DO YOU HEAR", "A BIG PIE", "MY OWN DEAR SIR", "NO", "OH WELL I SAY"]
    )
]


def test_false_texts_are_anothers_of_about_the_same_length_and_halves_of_it():
    asked = texts_of(POOL[0], POOL, np.random.default_rng(0))
    assert asked["true"] == "GO DO YOU HEAR"
    assert asked["half_missing"] == "GO DO"
    assert asked["other"] in {u.text for u in POOL[1:]}
    assert asked["half_other"].startswith("GO DO")
    assert not asked["half_other"].endswith("YOU HEAR")


def test_every_text_is_not_aligned_refused_doubted_or_passed():
    kinds = ("true", "other", "half_other", "half_missing")
    scores = [dict(zip(kinds, row, strict=True)) for row in ([-0.5, -6.0, None, -2.0], [-1.6] * 4)]
    figures = text_figures(scores)
    assert figures["utterances"] == 2
    assert [figures[f"true_{n}"] for n in ("refused", "doubted", "passed")] == [0, 1, 1]
    assert [figures[f"other_{n}"] for n in ("refused", "doubted", "passed")] == [1, 1, 0]
    assert figures["half_other_not_aligned"] == 1
    assert figures["other_score_min_median_max"] == [-6.0, -3.8, -1.6]
