import numpy as np
import pytest
from expression_tracks import RATE_HZ, small_model, sway
from hypothesis import given, settings
from hypothesis import strategies as st
from lipservo_lab.learning.learned_expression.pose_mixture import PoseMixture, solve_upper
from scipy.optimize import minimize

MIXTURE = small_model(3).head


def density_of(pose, before, last, prosody):
    return MIXTURE.log_density(MIXTURE.features((before, last, np.asarray(pose)), prosody))


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3),
    st.lists(st.floats(-0.3, 0.3), min_size=3, max_size=3),
    st.tuples(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0)),
)
def test_the_next_pose_is_likelier_than_the_extrapolated_one(last, moved, prosody):
    last, moved, prosody = np.array(last), np.array(moved), np.array(prosody)
    before = last - moved
    pose, _ = MIXTURE.next_pose(before, last, prosody)

    assert density_of(pose, before, last, prosody) >= (
        density_of(last + moved, before, last, prosody) - 1e-9
    )


def test_the_next_pose_is_where_a_general_optimiser_ends():
    rng = np.random.default_rng(0)
    for _ in range(10):
        last = rng.normal(0.0, 1.0, 3)
        before, prosody = last - rng.normal(0.0, 0.1, 3), rng.normal(0.0, 1.0, 2)
        pose, _ = MIXTURE.next_pose(before, last, prosody)
        found = minimize(
            lambda p, b=before, n=last, v=prosody: -density_of(p, b, n, v), 2.0 * last - before
        )

        assert pose == pytest.approx(found.x, abs=0.02)


def test_the_curvature_is_that_of_the_density():
    """Of one part it is exact: second differences of the logarithm."""
    mixture = small_model(1).head
    before, last, prosody = np.zeros(3), np.array([0.1, 0.0, -0.1]), np.array([0.5, -0.5])
    pose, factor = mixture.next_pose(before, last, prosody)

    l11, l21, l22, l31, l32, l33 = factor
    rows = ((l11,), (l21, l22), (l31, l32, l33))

    def log_density(offset):
        return mixture.log_density(mixture.features((before, last, pose + offset), prosody))

    step = 0.01
    for axis in range(3):
        offset = step * np.eye(3)[axis]
        second = (log_density(offset) - 2.0 * log_density(0.0) + log_density(-offset)) / step**2
        assert -second == pytest.approx(np.sum(np.square(rows[axis])), rel=1e-3)


def test_what_is_drawn_moves_as_much_as_what_was_learned_from():
    rng = np.random.default_rng(0)
    poses = np.stack([sway(20_000, rng, 0.85) for _ in range(3)], axis=1)
    prosody = rng.standard_normal((20_000, 2))
    speed = np.diff(poses, axis=0) * RATE_HZ
    x = np.concatenate((poses[2:], speed[1:], np.diff(speed, axis=0) * RATE_HZ, prosody[2:]), 1)
    precision = np.linalg.inv(np.cov(x.T))
    mixture = PoseMixture(np.ones(1), x.mean(axis=0)[None], precision[None], 1.0 / RATE_HZ)
    before, last, drawn = np.zeros(3), np.zeros(3), []
    for heard in rng.standard_normal((3_000, 2)):
        pose, factor = mixture.next_pose(before, last, heard)
        before, last = last, pose + np.array(solve_upper(factor, rng.standard_normal(3).tolist()))
        drawn.append(last)

    assert np.std(drawn, axis=0) == pytest.approx(np.ones(3), rel=0.2)
    moved = np.diff(drawn, axis=0).std(axis=0)
    assert moved == pytest.approx(np.diff(poses, axis=0).std(axis=0), rel=0.1)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"means": np.zeros((2, 11))}, "shape"),
        ({"weights": np.array([0.5, 0.5, np.nan])}, "no numbers"),
        ({"weights": np.array([0.5, 0.5, 0.0])}, "above 0"),
        ({"precisions": -np.stack([np.eye(11)] * 3)}, "positive definite"),
        ({"period_s": 0.0}, "above 0"),
    ],
)
def test_a_mixture_that_cannot_be_is_refused(changed, words):
    given = {
        "weights": MIXTURE.weights,
        "means": MIXTURE.means,
        "precisions": MIXTURE.precisions,
        "period_s": 0.04,
    }
    with pytest.raises(ValueError, match=words):
        PoseMixture(**{**given, **changed})
