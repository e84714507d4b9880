import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lipservo_lab.learning.learned_expression.pose_mixture import (
    factor_of,
    solve_lower,
    solve_upper,
)


@given(st.lists(st.floats(-3.0, 3.0), min_size=12, max_size=12))
def test_it_is_numpy_s_factor_and_solution(numbers):
    root = np.array(numbers[:9]).reshape(3, 3)
    matrix = root @ root.T + np.eye(3)
    b = np.array(numbers[9:])
    factor = factor_of(matrix.tolist())
    theirs = np.linalg.cholesky(matrix)

    assert factor == pytest.approx(theirs[np.tril_indices(3)])
    x = solve_upper(factor, solve_lower(factor, b.tolist()))
    assert matrix @ x == pytest.approx(b, abs=1e-9)


def test_a_matrix_that_is_not_positive_definite_has_none():
    with pytest.raises(ValueError, match=r"math|nonnegative"):
        factor_of([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
