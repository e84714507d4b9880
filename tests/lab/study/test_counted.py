"""Whose answers count, and whether figures find the taste that made them."""

from dataclasses import replace

import numpy as np
import pytest
from lipservo_lab.study.answers import RaterRecord, line_of, parse_answers
from lipservo_lab.study.counted import REASONS, counted, words_in, words_in_order
from lipservo_lab.study.estimates import preferred, rated, strengths, words_read
from lipservo_lab.study.rehearsal import Crew, coverage_figures, power_rows, trial_study
from lipservo_lab.study.rehearsal import simulated_study as simulated
from lipservo_lab.study.sheets import Size
from lipservo_lab.study.simulated_raters import even_taste, simulated_records

METHODS = ("recorded", "ears", "rhubarb", "still")
SIZE = Size(ratings=24, pairs=12, readings=4, sentences=12, checks=4, sheets=24)
CREW = Crew(12, 1, 1, 1, 1)


@pytest.fixture(scope="module")
def dealt():
    return trial_study(METHODS, SIZE)


@pytest.fixture(scope="module")
def found(dealt):
    return simulated(*dealt, even_taste(METHODS), CREW.characters, seed=3)


def test_lazy_and_inverted_raters_are_found_and_honest_ones_kept(found):
    assert {name.split("-")[0]: reason for name, reason in found.left_out.items()} == {
        "alike": "checks", "random": "checks", "hasty": "checks", "inverted": "inverted",
    }  # fmt: skip
    assert len(found.tables.raters) == 12
    assert len(found.all_tables.raters) == found.n_raters == 16


def test_the_taste_that_made_the_answers_is_found(found):
    taste = even_taste(METHODS)
    means = rated(found.tables, 0).own
    odds = preferred(found.tables, 0).own

    assert [f.value for f in means] == sorted((f.value for f in means), reverse=True)
    assert [f.value for f in odds] == sorted((f.value for f in odds), reverse=True)
    for method, figure in zip(METHODS, means, strict=True):
        assert figure.low < taste.mean_rating(method) < figure.high


def with_rater(dealt, change):
    """The verdict on one honest rater among eight whose record was changed."""
    study, key = dealt
    records = simulated_records(
        study, key, even_taste(METHODS), Crew(8).characters, np.random.default_rng(1)
    )
    answers = parse_answers("x", b"".join(map(line_of, records)), study.identity)
    items = study.sheets[0]
    changed = {n: change(items[n], r) for n, r in answers.raters["honest-0"].answers.items()}
    kept = {n: r for n, r in changed.items() if r is not None}
    raters = {**answers.raters, "honest-0": RaterRecord(0, kept)}
    return counted(study, key, replace(answers, raters=raters)).left_out


@pytest.mark.parametrize(
    ("reason", "change"),
    [
        (None, lambda _, r: r),
        ("alike", lambda item, r: {**r, "answer": 3} if item.kind == "rating" else r),
        ("hasty", lambda _, r: {**r, "seconds": 0.4}),
        ("unfinished", lambda item, r: r if item.kind == "reading" else None),
        ("checks", lambda item, r: {**r, "answer": 0} if item.kind == "check" else r),
        ("inverted", lambda item, r: {**r, "answer": 6 - r["answer"]}
         if item.kind == "rating" else r),
    ],
)  # fmt: skip
def test_each_rule_leaves_out_whom_it_is_meant_for(dealt, reason, change):
    assert with_rater(dealt, change) == ({} if reason is None else {"honest-0": reason})
    assert reason is None or reason in REASONS


def test_who_took_their_answers_back_is_in_no_figure(dealt):
    study, key = dealt
    records = [
        *simulated_records(
            study, key, even_taste(METHODS), Crew(3).characters, np.random.default_rng(1)
        ),
        {"kind": "leave", "rater": "honest-1"},
    ]
    answers = parse_answers("x", b"".join(map(line_of, records)), study.identity)
    result = counted(study, key, answers)

    assert result.left_out == {"honest-1": "left"}
    assert "honest-1" not in (*result.tables.raters, *result.all_tables.raters)


def test_strengths_are_those_of_a_worked_example():
    """Two methods: the log odds of 3 to 1, but for a tenth of a win each way."""
    odds = strengths(np.array([[0.0, 30.0], [10.0, 0.0]]))

    assert odds[0] - odds[1] == pytest.approx(np.log(30.1 / 10.1))
    assert odds.sum() == pytest.approx(0.0)


def test_strengths_are_those_that_scipy_finds():
    from scipy.optimize import minimize

    wins = np.random.default_rng(0).integers(0, 9, (5, 5)).astype(float)
    np.fill_diagonal(wins, 0.0)

    def cost(x):
        return ((wins + 0.1 * (1 - np.eye(5))) * np.log1p(np.exp(x[None] - x[:, None]))).sum()

    best = minimize(cost, np.zeros(5)).x
    assert strengths(wins) == pytest.approx(best - best.mean(), abs=1e-4)


def test_words_count_in_their_order_without_case_and_punctuation():
    said = ("bin", "blue", "at", "f", "two", "now")

    assert words_in("F 2") == ["f", "two"]
    assert words_in_order(words_in("Bin, blue at F two NOW."), said) == 6
    assert words_in_order(words_in("blue bin now"), said) == 2
    assert words_in_order(words_in("I read blue ... and now"), said) == 2
    assert words_in_order([], said) == 0


def test_who_guesses_reads_no_more_than_chance(dealt):
    guessing = even_taste(METHODS)
    guessing = replace(guessing, reads=dict.fromkeys(METHODS, 0.0))
    tables = simulated(*dealt, guessing, Crew(24).characters, seed=0).tables
    right, above = words_read(tables, 0)

    for figure in above.own:
        assert figure.low < 0.0 < figure.high
    assert all(figure.value > 0.05 for figure in right.own)


def test_a_single_rater_has_means_and_no_interval_and_nobody_no_figure(dealt):
    tables = simulated(*dealt, even_taste(METHODS), Crew(1).characters, seed=0).tables

    assert all(f.low is None and 1 <= f.value <= 5 for f in rated(tables, 0).own)
    nobody = simulated(*dealt, even_taste(METHODS), (), seed=0).tables
    assert all(np.isnan(figure.value) for figure in preferred(nobody, 0).own)


def test_the_mixed_model_finds_the_means_that_the_answers_have(found):
    pytest.importorskip("statsmodels", reason="statsmodels is not installed (extra study)")
    from lipservo_lab.study.mixed_model import mixed_model

    fitted, means = mixed_model(found.tables, 0), rated(found.tables, 0).own

    assert [f.value for f in fitted.own] == pytest.approx([f.value for f in means], abs=0.05)
    assert fitted.less_reference[0].low is None
    assert 0.6 < fitted.spread["moment"] < 1.0


@pytest.mark.slow
def test_intervals_hold_the_truth_about_as_often_as_they_say():
    figures = coverage_figures(12, Crew(16, 1, 1, 1, 1), Size(), range)

    assert figures["coverage"] >= 0.9
    assert figures["honest_kept"] >= 0.95
    assert figures["lazy_excluded"] >= 0.8
    assert figures["taste_found_r"] >= 0.9


def test_more_raters_see_smaller_differences():
    few, many = power_rows([3, 20], 4, replace(SIZE, pairs=0, readings=0), 4, range)

    assert sum(many["seen"].values()) > sum(few["seen"].values())
    assert many["seen"][max(many["seen"])] == 1.0
