"""What arousal does to the mouth's size."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lipsync.expression.live_expression import mouth_gain


@pytest.mark.parametrize(
    ("arousal", "gain"), [(0.0, 1.0), (0.5, 1.1), (1.0, 1.2), (-0.5, 0.9), (-1.0, 0.85)]
)
def test_a_mouth_opens_wider_when_excited(arousal, gain):
    assert mouth_gain(arousal) == pytest.approx(gain)


@given(st.floats(allow_nan=True, allow_infinity=True))
def test_no_arousal_takes_it_beyond_its_limits(arousal):
    assert 0.85 <= mouth_gain(arousal) <= 1.2
    if math.isnan(arousal):
        assert mouth_gain(arousal) == 1.0
