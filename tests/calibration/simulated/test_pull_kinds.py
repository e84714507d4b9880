"""A face's own joints find their places on an elastic robot, and every place is one of a mouth."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lipservo_lab.bench.calibration.elastic_draws import OPPOSITES, draw_elastic_robot
from small_model import small_model

from calibration.simulated.elastic_family import KINDS, pulls_of
from lipservo.settings.settings import load_shipped_face

MODEL = small_model()
REST_MM = MODEL.markers_mm(MODEL.rest[None])[0]
WORDS = (*OPPOSITES, *OPPOSITES.values(), "turns", "")


def kinds(names, positive):
    return [pull.kind for pull in pulls_of(names, positive)]


def test_a_face_that_says_what_it_has_gets_just_that():
    servos = load_shipped_face("face_eight").servos
    pulls = pulls_of(list(servos), [servo.positive for servo in servos.values()])
    assert [pull.kind for pull in pulls] == [
        "jaw", "upper_l", "upper_r", "lower_l", "lower_r", "out_l", "out_r", "pucker",
    ]  # fmt: skip
    assert [pull.sign for pull in pulls] == [1, 1, 1, -1, -1, 1, 1, 1]
    assert not any(pull.is_guess for pull in pulls)


def test_two_of_a_kind_without_a_side_are_one_on_either():
    assert kinds(["a_lip_top", "b_lip_top"], ["raises", "lowers"]) == ["upper_l", "upper_r"]
    assert kinds(["m6", "m7"], ["widens", "narrows"]) == ["out_l", "out_r"]
    assert kinds(["lips_top"], ["raises"]) == ["upper"]


def test_what_nobody_says_is_guessed_and_called_so():
    pulls = pulls_of(["m1", "m2", "m3"], ["opens", "raises", "turns"])
    assert [pull.kind for pull in pulls] == ["jaw", "upper", "lower"]
    assert [pull.is_guess for pull in pulls] == [False, True, True]
    assert kinds(["a", "b"], ()) == ["upper", "lower"]
    assert kinds(["jaw", "jaw_2"], ["opens", "opens"]) == ["jaw", "lower"]


@settings(deadline=None, max_examples=60)  # machines are shared
@given(
    st.lists(
        st.tuples(st.from_regex(r"[a-z][a-z0-9_]{0,12}", fullmatch=True), st.sampled_from(WORDS)),
        min_size=1,
        max_size=14,
        unique_by=lambda joint: joint[0],
    )
)
def test_any_joints_get_places_and_at_most_one_is_the_jaw(joints):
    pulls = pulls_of([name for name, _ in joints], [word for _, word in joints])
    assert len(pulls) == len(joints)
    assert {pull.kind for pull in pulls} <= set(KINDS)
    assert [pull.kind for pull in pulls].count("jaw") <= 1
    assert {pull.sign for pull in pulls} <= {1, -1}


@pytest.mark.parametrize("seed", range(4))
def test_of_the_familys_own_joints_those_that_say_what_they_are_share_no_place(seed):
    _, servos = draw_elastic_robot(REST_MM, seed, 12)
    pulls = pulls_of(servos.names, servos.positive)
    said = [pull.kind for pull in pulls if not pull.is_guess]
    assert "jaw" in said
    assert len(set(said)) == len(said)
