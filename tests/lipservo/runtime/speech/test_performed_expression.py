"""Head and eyes of a performance beside the live ones."""

from dataclasses import asdict

import numpy as np
import pytest

from lipservo.runtime.speech.expression import PerformedExpression
from lipsync.expression.cue import CUE_PERIOD_S
from lipsync.face.frame import NO_EXPRESSION, Expression

LIVE = Expression(-3.0, 8.0, 1.0, 2.0, -5.0, 0.1, 0.1, 0.2, 0.7, 0.0, 0.0, 0.0)
STORED = Expression(
    neck_pitch_deg=6.0, neck_yaw_deg=-12.0, eye_yaw_deg=9.0, lid_left=1.0, lid_right=1.0
)
#: As fast as each may go: a saccade's 300, a blink's 15 a second; the rest slower.
FASTEST_PER_S = {"neck": 60.0, "eye": 300.0, "lid": 15.0, "brow": 5.0, "smile": 0.0, "lip": 0.0,
                 "tongue": 0.0}  # fmt: skip


def shown(performed, seconds, stored, amount=1.0):
    steps = range(round(seconds / CUE_PERIOD_S))
    return [performed.step(LIVE, stored, amount) for _ in steps]


def test_what_is_stored_is_shown_the_rest_is_live_and_nothing_jumps():
    performed = PerformedExpression()
    before = shown(performed, 2.0, NO_EXPRESSION)
    during = shown(performed, 1.5, STORED)
    after = shown(performed, 1.5, NO_EXPRESSION)

    assert before[-1] == after[-1] == LIVE
    reached = during[-1]
    assert (reached.neck_yaw_deg, reached.eye_yaw_deg) == (pytest.approx(-12.0), pytest.approx(9.0))
    assert reached.lid_left == pytest.approx(1.0)
    assert (reached.neck_roll_deg, reached.brow, reached.smile) == (1.0, 0.2, 0.7)
    # Lids are not left shut by a performance that is cut off in a blink.
    assert after[10].lid_left == pytest.approx(0.1)
    rows = [asdict(each) for each in (before[-1], *during, *after)]
    for name in rows[0]:
        speed = np.abs(np.diff([row[name] for row in rows])).max() / CUE_PERIOD_S
        assert speed <= FASTEST_PER_S[name.split("_")[0]], name


def test_a_face_that_is_to_be_still_is():
    performed = PerformedExpression()
    shown(performed, 2.0, NO_EXPRESSION)

    assert shown(performed, 1.0, STORED, amount=0.0)[-1] == LIVE


def test_half_as_lively_moves_half_as_far_and_blinks_as_ever():
    performed = PerformedExpression()
    shown(performed, 2.0, NO_EXPRESSION, amount=0.5)

    reached = shown(performed, 1.5, STORED, amount=0.5)[-1]

    assert reached.neck_yaw_deg == pytest.approx(-6.0)
    assert reached.lid_left == pytest.approx(1.0)
