"""Robots drawn from a seed."""

import numpy as np
from small_model import small_model

from calibration.simulated.face import POSITIVE_DIRECTIONS
from calibration.simulated.robot import draw_robot

SERVOS = tuple(POSITIVE_DIRECTIONS)
MODEL = small_model()
REST_MM = MODEL.markers_mm(MODEL.rest[None])[0]
DRAW = draw_robot(REST_MM, SERVOS, 101)


def test_seeds_draw_different_robots_and_the_same_seed_the_same():
    other, same = (draw_robot(REST_MM, SERVOS, seed) for seed in (102, 101))
    assert np.array_equal(DRAW.face.pulls, same.face.pulls)
    assert not np.allclose(DRAW.face.pulls, other.face.pulls, atol=0.05)
    assert not np.allclose(DRAW.backlash_deg, other.backlash_deg, atol=0.05)
