"""`bench line` counts questions, values and wrong values by disturbance."""

import json

from lipservo_lab.campaigns import line_campaign
from lipservo_lab.campaigns.line_campaign import DISTURBANCES, Answered
from typer.testing import CliRunner

from lipservo.cli import app


def bench_line(n_questions):
    done = CliRunner().invoke(
        app, ["bench", "line", "--questions", str(n_questions), "--json", "--quiet"]
    )
    return done.exit_code, json.loads(done.stdout)


def test_every_disturbance_is_counted():
    status, figures = bench_line(10)

    assert status == 0
    assert [figures[name]["questions"] for name in DISTURBANCES] == [10] * len(DISTURBANCES)
    assert all(figures[name]["values"] > 0 for name in DISTURBANCES)
    assert all(figures[name]["wrong_values"] == 0 for name in DISTURBANCES)


def test_wrong_values_are_said_by_the_exit_status(monkeypatch):
    monkeypatch.setattr(line_campaign, "ask_many", lambda *_: Answered(n_values=5, n_wrong=1))
    status, figures = bench_line(10)

    assert status == 1
    assert figures["late"]["wrong_values"] == 1
