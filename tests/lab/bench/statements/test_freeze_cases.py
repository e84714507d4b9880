"""Freezes: which are tried, and the judge of what is answered to them."""

import time
from types import SimpleNamespace

import pytest
from lipservo_lab.bench.statements.freeze_cases import (
    FreezeCase,
    FreezeOutcome,
    Frozen,
    freeze_batches,
    freeze_cases,
    freeze_figures,
    judge_freeze,
    play_freezes,
)
from lipservo_lab.bench.stops.faces_on_buses import BUSES
from lipservo_lab.bench.stops.logged_device import LoggedDevice, Moment

CASES = list(freeze_cases())
CASE = FreezeCase("dynamixel", Frozen.STARTING, 0.0)


def judged(answer, *records):
    """Return the outcome of a freeze that was answered 10 s ago, by a log of two servos.

    records: (seconds after the answer, torque of each servo from then on).
    """
    answered_s = time.monotonic() - 10.0
    log = [Moment(answered_s + at_s, on) for at_s, on in records]
    device = SimpleNamespace(
        during=lambda since_s, until_s: LoggedDevice.during(
            SimpleNamespace(records=log), since_s, until_s
        ),
        travelled_deg=lambda _since_s: LoggedDevice.travelled_deg(
            SimpleNamespace(shafts=[], truth=SimpleNamespace(on=(False, False))), 0.0
        ),
    )
    settings = SimpleNamespace(servos={"jaw": None, "lip": None})
    face = SimpleNamespace(robot=SimpleNamespace(device=device, settings=settings))
    outcome = FreezeOutcome(CASE, answer=answer)
    judge_freeze(face, outcome, answered_s - 0.01, answered_s)
    return outcome


def test_every_state_is_frozen_on_every_bus_sixty_times_at_least():
    assert len(CASES) == len(set(CASES)) >= 60
    assert {(case.bus, case.state) for case in CASES} == {(b, s) for b in BUSES for s in Frozen}
    batches = freeze_batches(CASES)
    assert sorted(map(str, CASES)) == sorted(str(case) for batch in batches for case in batch)


def test_an_answer_that_is_so_is_kept():
    answer = {"accepted": "freeze", "holds": ["jaw"], "limp": ["lip"], "unknown": []}

    assert judged(answer, (-5.0, (True, False))).kept


def test_a_servo_armed_after_the_answer_is_seen_and_the_answer_untrue():
    answer = {"accepted": "freeze", "holds": ["jaw"], "limp": ["lip"], "unknown": []}
    outcome = judged(answer, (-5.0, (True, False)), (0.5, (True, True)))

    assert (outcome.armed, len(outcome.untrue)) == (1, 1)
    assert freeze_figures([outcome])["untrue_answers"] == 1


@pytest.mark.parametrize(
    ("holds", "limp"), [(["jaw", "lip"], []), ([], ["jaw", "lip"]), (["jaw"], []), ([], ["lip"])]
)
def test_an_answer_that_is_not_so_or_leaves_a_servo_out_is_untrue(holds, limp):
    answer = {"accepted": "freeze", "holds": holds, "limp": limp, "unknown": []}

    assert judged(answer, (-5.0, (True, False))).untrue


def test_what_the_answer_does_not_know_is_not_untrue_and_is_counted():
    answer = {"accepted": "freeze", "holds": [], "limp": [], "unknown": ["jaw", "lip"]}
    outcome = judged(answer, (-5.0, (True, False)))

    assert outcome.kept
    assert outcome.n_unknown == 2


def test_a_freeze_that_is_accepted_of_a_limp_face_without_a_word_is_untrue():
    assert judged({"accepted": "freeze"}, (-5.0, (False, False))).untrue


@pytest.mark.slow
def test_a_driven_face_of_real_processes_is_frozen():
    (outcome,) = play_freezes([FreezeCase("feetech", Frozen.DRIVEN, 0.0)])

    assert outcome.kept, str(outcome)
