"""What a joint moves is read from its name and its word, and from nothing else."""

import pytest

from calibration.joint_motion import JointMotion, joint_motion


@pytest.mark.parametrize(
    ("name", "positive", "channel", "side", "sign"),
    [
        ("jaw", "opens", "jaw", "both", 1),
        ("mandible", "closes", "jaw", "both", -1),
        ("upper_lip_left", "raises", "upper_lip", "left", 1),
        ("top_lip_r", "lowers", "upper_lip", "right", -1),
        ("bottom_lip_l", "raises", "lower_lip", "left", -1),
        ("lip_up_mid", "raises", None, None, None),
        ("lip_lower_mid", "lowers", "lower_lip", "middle", 1),
        ("corner_right_up", "raises", "corner_up", "right", 1),
        ("cheek_l", "narrows", "corner_out", "left", -1),
        ("smile", "widens", "corner_out", "both", 1),
        ("kiss", "retracts", "protrusion", "both", -1),
        # Only a jaw opens and only corners widen, whatever they are called.
        ("hinge", "opens", "jaw", "both", 1),
        ("m7", "narrows", "corner_out", "both", -1),
        ("m2", "raises", None, None, None),
        ("tongue", "protrudes", None, None, None),
        ("jaw", "opens and closes", None, None, None),
        ("jaw", "", None, None, None),
    ],
)
def test_name_and_word_say_what_moves(name, positive, channel, side, sign):
    expected = None if channel is None else JointMotion(channel, side, sign)
    assert joint_motion(name, positive) == expected
