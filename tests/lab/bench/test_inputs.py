"""`bench inputs`: a few of each kind, and that a reader that is wrong is caught."""

import time

import pytest
from lipservo_lab.bench.inputs import odd_input
from lipservo_lab.bench.inputs.input_figures import KINDS, input_figures
from lipservo_lab.bench.inputs.odd_input import REFUSED, OddInput, verdict

from lipsync.errors import UserError


def refuses():
    raise UserError("no such thing; give another")


def breaks():
    raise KeyError("a fault")


def test_a_few_of_each_kind_are_read_right():
    figures = input_figures(3, 1, lambda *_: None)

    assert figures["wrong"] == {}
    assert figures["inputs"] == 3 * len(KINDS)
    assert 84 * len(KINDS) >= 2_000


@pytest.mark.parametrize(
    ("odd", "expected"),
    [
        (OddInput("a", lambda: ([("HH", 0.1)], ()), [("HH", 0.1)]), "right"),
        (OddInput("a", lambda: ([("HH", 0.2)], ()), [("HH", 0.1)]), "silently_wrong"),
        (OddInput("a", lambda: ([], ()), REFUSED), "silently_wrong"),
        (OddInput("a", lambda: ([], ["cut off"]), REFUSED), "silently_wrong"),
        (OddInput("a", lambda: ([], ["cut off"]), REFUSED, may_refuse=True), "right"),
        (OddInput("a", lambda: (1.0, ()), 1.0, reported=True), "silently_wrong"),
        (OddInput("a", refuses, REFUSED), "right"),
        (OddInput("a", refuses, 1.0), "refused_wrongly"),
        (OddInput("a", breaks, REFUSED), "traceback"),
    ],
)
def test_what_becomes_of_an_input_is_judged_by_what_is_right(odd, expected):
    assert verdict(odd)[0] == expected


def test_a_reader_that_does_not_come_back_hangs(monkeypatch):
    monkeypatch.setattr(odd_input, "LONGEST_S", 0.05)

    assert verdict(OddInput("a", lambda: (time.sleep(30), ()), REFUSED))[0] == "hang"
