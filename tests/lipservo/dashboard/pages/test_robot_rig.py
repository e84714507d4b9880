"""What a servo moves in the drawing: from part, name and `positive`, and from nothing else."""

import pytest

from lipservo.dashboard.pages.page_facts import RigServo, robot_rig
from lipservo.settings.settings import ServoSettings, load_shipped_face, shipped_faces


def servo(positive, part="mouth"):
    return ServoSettings(
        positive=positive, part=part, min_deg=-10, max_deg=10, max_speed_deg_s=100,
    )  # fmt: skip


def rig_of(name, positive, part="mouth"):
    return robot_rig({name: servo(positive, part)})[name]


@pytest.mark.parametrize("face", shipped_faces())
def test_every_servo_of_a_shipped_face_moves_something_of_its_own(face):
    rig = robot_rig(load_shipped_face(face).servos)

    moved = [(found.channel, found.side) for found in rig.values()]
    assert None not in [channel for channel, _ in moved]
    assert len(set(moved)) == len(moved)


def test_the_words_for_a_positive_angle_decide_the_direction():
    assert rig_of("jaw", "opens") == RigServo("jaw", "both", 1)
    assert rig_of("jaw", "closes") == RigServo("jaw", "both", -1)
    # The shipped neck nods down where it is positive, the drawing's pitch is upwards.
    assert rig_of("neck_pitch", "nods down", "neck") == RigServo("neck_pitch", "both", -1)
    assert rig_of("pan", "turns right", "neck") == RigServo("neck_yaw", "both", -1)
    assert rig_of("lids", "opens wider", "lids") == RigServo("lid", "both", 1)


def test_left_and_right_are_told_by_the_name():
    assert rig_of("upper_lip_left", "raises").side == "left"
    assert rig_of("brow_r", "raises", "brows") == RigServo("brow", "right", 1)
    assert rig_of("left_right_lip_lower", "lowers").side == "both"


@pytest.mark.parametrize(
    ("name", "positive", "part"),
    [
        ("tongue", "protrudes", "mouth"),
        ("jaw", "counts", "mouth"),
        ("jaw", "opens and closes", "mouth"),
        ("neck_yaw", "forward", "neck"),
        ("jaw", "opens", "neck"),
    ],
)
def test_what_nobody_can_tell_is_a_dial(name, positive, part):
    assert rig_of(name, positive, part).channel is None


def test_names_and_words_of_other_builders_are_understood():
    assert rig_of("mandible", "closes") == RigServo("jaw", "both", -1)
    assert rig_of("bottom_lip_r", "raises") == RigServo("lower_lip", "right", -1)
    assert rig_of("cheek_l", "widens") == RigServo("corner_out", "left", 1)
    assert rig_of("m2", "raises").channel is None


def test_between_a_left_and_a_right_lip_the_middle_one_is_a_dial():
    lips = ("lip_upper_left", "lip_upper_middle", "lip_upper_right")
    rig = robot_rig({name: servo("raises") for name in lips})

    assert [found.channel for found in rig.values()] == ["upper_lip", None, "upper_lip"]


def test_of_two_servos_that_would_move_the_same_the_second_is_a_dial():
    rig = robot_rig({"jaw": servo("opens"), "jaw_2": servo("opens")})

    assert [found.channel for found in rig.values()] == ["jaw", None]
