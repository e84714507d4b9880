import pytest

from lipservo.dashboard.pages.page_facts import GROUPS, group_of, page_facts
from lipservo.settings.settings import load_shipped_face
from lipsync.phonemes import PHONEMES, SILENCE


def luminance(colour):
    """Relative luminance: WCAG 2.2, https://www.w3.org/TR/WCAG22/#dfn-relative-luminance ."""
    parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def test_limits_are_those_of_the_yaml_and_of_the_servo_s_model():
    jaw = page_facts("face_head")["servos"]["jaw"]

    assert (jaw["least_deg"], jaw["most_deg"], jaw["positive"]) == (-2, 25, "opens")
    # https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/ : temperature 70, voltage 3.5 to 7.0 V
    assert jaw["hottest_degc"] == 70
    assert (jaw["least_v"], jaw["most_v"]) == pytest.approx((3.5, 7.0))


def test_every_servo_has_its_part_of_the_drawing():
    facts = page_facts("face_head")

    assert list(facts["rig"]) == list(load_shipped_face("face_head").servos)


@pytest.mark.parametrize("config", [None, "no_such_face", "/no/such/face.yaml"])
def test_a_face_whose_yaml_cannot_be_read_has_no_limits(config):
    facts = page_facts(config)

    assert facts["servos"] == {}
    assert facts["rig"] == {}


def test_every_phoneme_but_silence_has_a_colour():
    told = {name: group_of(name) for name in PHONEMES if name != SILENCE}

    assert told["M"] == "closed"
    assert told["UW"] == "round"
    assert set(told.values()) == set(GROUPS)


@pytest.mark.parametrize("group", GROUPS)
def test_letters_can_be_read_on_their_colour(group):
    _, fill, ink, _ = GROUPS[group]
    dark, light = sorted([luminance(fill), luminance(ink)])

    assert (light + 0.05) / (dark + 0.05) >= 4.5
