"""How far the servos of a head turn for an expression, by the shipped face's own YAML."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lipservo.runtime.speech.expression import ExpressionClaims, expression_servos
from lipservo.runtime.speech.layers import Claim, Layer
from lipservo.settings.settings import load_shipped_face
from lipsync.face.frame import Expression

HEAD = load_shipped_face("face_head")
NAMES = list(HEAD.servos)
PERIOD_S = 0.01


def settled_deg(expression):
    """Where each servo is once it has arrived, by name."""
    claims = ExpressionClaims(expression_servos(HEAD), PERIOD_S)
    for _ in range(200):
        (claim,) = claims.claims(expression, Layer.EXPRESSION)
    named = (NAMES[index] for index in claim.servos)
    return dict(zip(named, claim.positions_deg.tolist(), strict=True))


def test_the_head_looks_up_by_nodding_down_less_and_shuts_its_eyes_by_the_one_servo_of_its_lids():
    shown = settled_deg(
        Expression(
            neck_pitch_deg=10.0, neck_yaw_deg=20.0, eye_yaw_deg=-5.0, lid_left=1, lid_right=1
        )
    )
    assert shown == {
        "neck_yaw": 20.0,
        "neck_pitch": -10.0,
        "neck_roll": 0.0,
        "eyes_yaw": -5.0,
        "eyes_pitch": 0.0,
        "lids": -45.0,
    }


angles = st.floats(-1e3, 1e3)


@given(angles, angles, angles, angles, angles, st.floats(-9, 9))
def test_no_servo_is_asked_beyond_its_range_or_faster_than_it_goes(p, y, r, eye_p, eye_y, lid):
    claims = ExpressionClaims(expression_servos(HEAD), PERIOD_S)
    wild = Expression(p, y, r, eye_p, eye_y, lid, lid)
    before_deg = np.zeros(6)
    for expression in [wild] * 40 + [Expression()] * 40:
        (claim,) = claims.claims(expression, Layer.EXPRESSION)
        for index, now_deg, was_deg in zip(
            claim.servos, claim.positions_deg, before_deg, strict=True
        ):
            servo = HEAD.servos[NAMES[index]]
            assert servo.min_deg <= now_deg <= servo.max_deg
            assert abs(now_deg - was_deg) <= servo.max_speed_deg_s * PERIOD_S + 1e-9
        before_deg = claim.positions_deg


def test_a_smile_raises_and_widens_the_corners_from_where_the_lips_have_them():
    claims = ExpressionClaims(expression_servos(HEAD), PERIOD_S)
    mouth = [NAMES.index(name) for name in HEAD.mouth_servos]
    lips = Claim(Layer.LIPS, np.array(mouth), np.full(len(mouth), 3.0))

    kept, smiling = claims.mouth(Expression(smile=0.5), lips)
    shown = {NAMES[n]: d for n, d in zip(smiling.servos, smiling.positions_deg, strict=True)}
    assert shown == {
        "corner_left_out": 7.5,
        "corner_left_up": 11.0,
        "corner_right_out": 7.5,
        "corner_right_up": 11.0,
    }
    assert smiling.layer is Layer.EXPRESSION
    assert sorted([*kept.servos, *smiling.servos]) == sorted(mouth)
    assert claims.mouth(Expression(smile=0.0), lips) == [lips]


@pytest.mark.parametrize("name", ["face_sim", "face_four", "face_jaw"])
def test_a_face_that_is_only_a_mouth_has_nothing_to_show(name):
    claims = ExpressionClaims(expression_servos(load_shipped_face(name)), PERIOD_S)
    assert claims.claims(Expression(neck_yaw_deg=10.0), Layer.IDLE) == []
