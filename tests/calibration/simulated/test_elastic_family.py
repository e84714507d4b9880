"""Robots by seed: the same again, others otherwise, and as many servos as a mouth may have."""

from dataclasses import replace

import numpy as np
import pytest
from lipservo_lab.bench.calibration.elastic_draws import N_SERVOS, draw_elastic_robot
from small_model import small_model

from calibration.mouth_servos import JointRange, MouthServos
from calibration.simulated.elastic_family import elastic_robot_of
from calibration.simulated.elastic_robot import ElasticDraw, ElasticFace
from lipsync.markers import MARKERS_47

MODEL = small_model()
REST_MM = MODEL.markers_mm(MODEL.rest[None])[0]


def test_the_same_seed_gives_the_same_robot():
    (one, servos), (again, the_same) = (draw_elastic_robot(REST_MM, 7) for _ in range(2))
    assert servos == the_same
    assert one.four_bar == again.four_bar
    assert len(one.rods) == len(again.rods)
    for name in ("axis_mm", "zero_deg", "play_deg", "drift_deg"):
        assert np.array_equal(getattr(one, name), getattr(again, name)), name
    pose_deg = np.full((1, len(one.signs)), 7.0)
    seen_mm, again_mm = (ElasticFace(draw).markers_mm(pose_deg) for draw in (one, again))
    assert np.array_equal(seen_mm, again_mm)


def test_other_seeds_give_other_robots_with_other_numbers_of_servos():
    drawn = [draw_elastic_robot(REST_MM, seed) for seed in (13, 8, 0, 15, 1, 22)]
    assert tuple(len(draw.signs) for draw, _ in drawn) == N_SERVOS == (1, 4, 6, 8, 10, 12)
    assert len({draw.four_bar.crank_mm for draw, _ in drawn}) == len(drawn)
    assert len({draw.skin.dots_mm[0, 0] for draw, _ in drawn}) == len(drawn)
    assert len({servos.face_checksum for _, servos in drawn}) == len(drawn)


@pytest.mark.parametrize("n_servos", [1, 4, 6, 8, 10, 12])
def test_a_number_of_servos_may_be_asked_for(n_servos):
    draw, servos = draw_elastic_robot(REST_MM, 3, n_servos)
    assert len(set(servos.names)) == n_servos
    assert draw.servo_names == servos.names
    assert {len(each) for each in (draw.signs, draw.zero_deg, draw.play_deg, draw.drift_deg)} == {
        n_servos
    }
    assert all(joint.min_deg < 0.0 < joint.max_deg for joint in servos.joints)
    pulling = {rod.joint for rod in draw.rods}
    assert pulling == set(range(n_servos)) - {draw.jaw}
    assert servos.positive[draw.jaw] == "opens"
    assert (draw.play_deg >= 0.8).all()
    assert (draw.play_deg <= 1.2).all()


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_positive_angle_does_what_the_face_yaml_says(seed):
    """Of each joint on its own, where it goes most; lips part or corners widen or lips come out."""
    draw, servos = draw_elastic_robot(REST_MM, seed, 12)
    _do_what_they_say(draw, servos)


def test_servos_are_mounted_either_way_and_a_mirrored_one_does_the_opposite():
    drawn = [draw_elastic_robot(REST_MM, seed, 12) for seed in range(8)]
    mirrored = np.concatenate([draw.signs for draw, _ in drawn]) < 0.0
    assert 0.15 < mirrored.mean() < 0.45
    words = {word for _, servos in drawn for word in servos.positive}
    assert {"raises", "lowers", "widens", "narrows", "opens", "closes"} <= words
    for draw, servos in drawn:
        straight = ElasticFace(replace(draw, signs=np.ones(12)))
        pose_deg = np.random.default_rng(1).uniform(*servos.limits_deg, (3, 12))
        assert np.array_equal(
            ElasticFace(draw).markers_mm(pose_deg), straight.markers_mm(draw.signs * pose_deg)
        )


def test_a_face_of_ones_own_is_built_as_its_yaml_says():
    names = ("kiefer_hinge", "lip_top_left", "lip_top_right", "lip_bottom", "cheek_r", "cheek_l")
    words = ("closes", "raises", "lowers", "raises", "widens", "narrows")
    joints = tuple(JointRange(name, -12.0, 12.0) for name in names)
    servos = MouthServos(joints, "own", (), words)
    draw = elastic_robot_of(REST_MM, servos, 5)
    assert draw.servo_names == names
    assert draw.signs.tolist() == [-1, 1, -1, -1, 1, -1]
    assert draw.jaw == 0
    _do_what_they_say(draw, servos)


@pytest.mark.parametrize("limits_deg", [(-3.0, 24.0), (-5.0, 70.0), (-60.0, 2.0)])
def test_a_jaw_of_any_range_turns_through_all_of_it(limits_deg):
    word = "opens" if limits_deg[1] > 10.0 else "closes"
    servos = MouthServos((JointRange("jaw", *limits_deg),), "own", (), (word,))
    for seed in range(5):
        draw = elastic_robot_of(REST_MM, servos, seed)
        turned_deg = draw.four_bar.jaw_deg(draw.signs[0] * np.linspace(*limits_deg, 50))
        assert (np.diff(draw.signs[0] * turned_deg) > 0.05).all(), seed


def test_a_mouth_of_lips_alone_has_no_jaw():
    joints = (JointRange("top_lip", -30.0, 30.0), JointRange("bottom_lip", -30.0, 30.0))
    servos = MouthServos(joints, "lips", (), ("raises", "lowers"))
    draw = elastic_robot_of(REST_MM, servos, 0)
    assert draw.jaw == -1
    _do_what_they_say(draw, servos)


def _do_what_they_say(draw: ElasticDraw, servos: MouthServos) -> None:
    n = len(draw.signs)
    face = ElasticFace(draw)
    # The jaw is open: lips that touch would stop each other.
    open_deg = np.zeros((1, n))
    if draw.jaw >= 0:
        open_deg[0, draw.jaw] = 10.0 * draw.signs[draw.jaw]
    moved_mm = face.markers_mm(open_deg + 10.0 * np.eye(n)) - face.markers_mm(open_deg)
    lips = list(MARKERS_47.lips)
    for joint, word in enumerate(servos.positive):
        moved = moved_mm[joint, lips]
        most = moved[np.linalg.norm(moved, axis=1).argmax()]
        side = np.sign(REST_MM[lips][np.linalg.norm(moved, axis=1).argmax(), 0])
        goes_mm = {
            "opens": -most[1],
            "closes": most[1],
            "raises": most[1],
            "lowers": -most[1],
            "widens": side * most[0],
            "narrows": -side * most[0],
            "protrudes": most[2],
            "retracts": -most[2],
        }[word]
        assert np.linalg.norm(most) > 0.2
        assert goes_mm > 0.6 * np.linalg.norm(most), (servos.names[joint], word)
