import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_bridge.bus import all_set, any_set


@given(st.lists(st.booleans(), min_size=1, max_size=30))
def test_flags_are_looked_at_as_any_and_all_do(flags):
    array = np.array(flags)

    assert any_set(array) == any(flags)
    assert all_set(array) == all(flags)


@pytest.mark.parametrize("value", [1, 255, np.uint8(0x80), -1, 256, 1e-300, np.nan, np.inf])
def test_whatever_is_not_zero_is_set(value):
    values = np.array([0, 0, value], dtype=np.asarray(value).dtype)

    assert any_set(values)
    assert not any_set(np.zeros_like(values))
