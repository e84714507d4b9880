"""Plays as fits found them, and who is named."""

import numpy as np
import pytest

from calibration.fit.measured import loose_joint


@pytest.mark.parametrize(
    ("backlash_deg", "named"),
    [
        ((1.0, 0.8, 1.6, 0.9, 1.1, 0.9), None),  # a healthy elastic robot, seed 100
        ((2.4, 1.1, 0.9, 1.1, 1.1, 1.4), "a"),  # its first joint with 5 degrees
        ((1.0, 1.7, 1.9, 1.2, 1.4, 1.2), None),  # a joint that hardly moves the skin
        ((3.0, 3.1, 2.9, 3.0, 3.2, 2.8), None),  # a face of much play everywhere
        ((2.4, 2.3, 0.9, 1.0, 1.0, 0.9), None),  # which of the two?
    ],
)
def test_one_loose_joint_is_named_or_nobody(backlash_deg, named):
    lines = loose_joint(tuple("abcdef"), np.array(backlash_deg))
    assert [line.split("'")[1] for line in lines] == ([named] if named else [])
    assert loose_joint(("jaw", "lip"), np.array([5.0, 0.5])) == ()
