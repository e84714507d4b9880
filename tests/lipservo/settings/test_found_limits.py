"""Limits that a person has found, as they come into a face YAML."""

import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_bridge.joints import JointPulse
from lipservo.settings.edited_yaml import ChangedMeanwhileError
from lipservo.settings.found_limits import (
    own_yaml,
    pulse_values,
    range_values,
    what_next,
    with_pulse_limit,
    with_ranges,
)
from lipservo.settings.settings import load_face
from lipservo.settings.strict_yaml import SettingsError
from lipsync.errors import UserError

FACE = """\
# My first mouth.
name: skeleton
rate_hz: 50
calibration: mine.calibration.yaml

bus: {kind: maestro, model: micro6}

servos:
  jaw:
    channel: 0
    positive: opens
    min_deg: -9             # found by hand
    max_deg: 9
    max_speed_deg_s: 300
    us_per_deg: 10.0        # of most
    neutral_us: 1500        # closed
    min_us: 1400
    max_us: 1600
  lip: {channel: 1, positive: raises, min_deg: -9, max_deg: 9, max_speed_deg_s: 300,
        us_per_deg: -10}  # the other way round
"""


@pytest.fixture
def path(tmp_path):
    made = tmp_path / "face.yaml"
    made.write_text(FACE)
    return made


def test_only_the_numbers_that_were_found_change(path):
    with_pulse_limit(path, "jaw", "max", 1723.4).write()

    expected = FACE.replace("max_us: 1600", "max_us: 1723").replace(
        "max_deg: 9\n    max_speed", "max_deg: 22.3\n    max_speed"
    )
    assert path.read_text() == expected.replace("min_deg: -9 ", "min_deg: -10 ")


def test_a_servo_that_turns_the_other_way_round_gets_its_degrees_so(path):
    with_pulse_limit(path, "lip", "min", 1350.0).write()

    lip = load_face(path).servos["lip"]
    assert (lip.min_us, lip.max_us, lip.neutral_us) == (1350.0, 2000.0, 1500.0)
    assert (lip.min_deg, lip.max_deg) == (-50.0, 15.0)
    assert path.read_text().count("# the other way round") == 1


def test_neutral_moves_the_degrees_of_both_ends(path):
    with_pulse_limit(path, "jaw", "neutral", 1420.0).write()

    jaw = load_face(path).servos["jaw"]
    assert (jaw.min_deg, jaw.max_deg) == (-2.0, 18.0)


@pytest.mark.parametrize(
    ("servo", "limit", "pulse_us", "words"),
    [
        ("jaw", "min", 1510.0, "would put neutral outside the limits"),
        ("jaw", "max", 1490.0, "set neutral first"),
        ("jaw", "neutral", 1700.0, "set min or max first"),
        ("jaw", "min", 499.0, "outside 500..2500"),
        ("jaw", "max", 2501.0, "outside 500..2500"),
        ("jaw", "max", float("nan"), "outside 500..2500"),
        ("tongue", "min", 1400.0, "no hobby servo is called 'tongue'"),
    ],
)
def test_what_cannot_be_a_limit_is_refused_and_nothing_is_written(
    path, servo, limit, pulse_us, words
):
    with pytest.raises(SettingsError, match=words):
        with_pulse_limit(path, servo, limit, pulse_us)
    assert path.read_text() == FACE


def test_a_yaml_that_was_edited_meanwhile_stays_as_it_was_edited(path):
    edit = with_pulse_limit(path, "jaw", "max", 1700.0)
    path.write_text(FACE.replace("skeleton", "bones"))

    with pytest.raises(ChangedMeanwhileError, match=r"face\.yaml: was changed meanwhile"):
        edit.write()
    assert "max_us: 1600" in path.read_text()
    path.unlink()
    with pytest.raises(UserError, match="cannot be read"):
        edit.write()


def test_of_programs_that_write_at_once_none_loses_what_another_wrote(path):
    """Each tries until its own number is there; all numbers are there in the end."""
    wanted = {("jaw", "min"): 1300.0, ("jaw", "max"): 1700.0,
              ("lip", "min"): 1200.0, ("lip", "max"): 1800.0}  # fmt: skip

    def write(servo, limit, pulse_us):
        for _ in range(100):
            try:
                return with_pulse_limit(path, servo, limit, pulse_us).write()
            except ChangedMeanwhileError:
                continue
        raise AssertionError("never its turn")

    threads = [threading.Thread(target=write, args=(*key, us)) for key, us in wanted.items()]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()

    servos = load_face(path).servos
    assert {key: getattr(servos[key[0]], f"{key[1]}_us") for key in wanted} == wanted


def test_whoever_sets_a_limit_is_told_what_it_needs(path):
    assert what_next(with_pulse_limit(path, "jaw", "max", 1700.0)) == (
        "counts from the next start; mine.calibration.yaml was made for other limits: "
        "calibrate again"
    )
    path.write_text(FACE.replace("calibration: ", "# "))
    assert what_next(with_pulse_limit(path, "jaw", "max", 1700.0)) == "counts from the next start"


@given(
    st.sampled_from(["min", "max", "neutral"]),
    st.floats(400.0, 2600.0),
    st.floats(1.0, 100.0),
    st.booleans(),
)
def test_whatever_is_set_the_joint_reaches_no_pulse_outside(limit, pulse_us, scale, is_reversed):
    pulse = JointPulse(1500.0, -scale if is_reversed else scale, 1300.0, 1650.0)
    try:
        found = pulse_values(pulse, limit, pulse_us)
    except SettingsError:
        return
    assert found["min_us"] <= found["neutral_us"] <= found["max_us"]
    assert found["min_deg"] <= 0.0 <= found["max_deg"]
    for end in ("min_deg", "max_deg"):
        us = found["neutral_us"] + pulse.us_per_deg * found[end]
        assert found["min_us"] - 1e-6 <= us <= found["max_us"] + 1e-6


@pytest.mark.parametrize(
    ("least_deg", "most_deg", "min_deg", "max_deg"),
    [(-12.34, 27.5, -10.3, 25.5), (0, 27, 0, 25), (-1, 27, 0, 25), (-20, -0.3, -18, 0)],
)
def test_a_joint_turned_by_hand_gets_limits_two_degrees_inside_or_where_it_rests(
    least_deg, most_deg, min_deg, max_deg
):
    assert range_values(least_deg, most_deg) == {"min_deg": min_deg, "max_deg": max_deg}


def test_a_range_that_is_none_or_without_neutral_is_refused():
    for ends_deg in ((0.0, 3.0), (float("nan"), float("nan"))):
        with pytest.raises(UserError, match="was not turned"):
            range_values(*ends_deg)
    with pytest.raises(UserError, match="its neutral, 0, must lie between"):
        range_values(5.0, 30.0)


def test_ranges_of_several_joints_are_written_together(path):
    found = {"jaw": range_values(-8.0, 11.0), "lip": range_values(-7.0, 9.0)}
    with_ranges(path, found).write()

    servos = load_face(path).servos
    assert [(each.min_deg, each.max_deg) for each in servos.values()] == [(-6.0, 9.0), (-5.0, 7.0)]


def test_a_shipped_face_is_nobodys_to_write():
    with pytest.raises(UserError, match="face_jaw_maestro is shipped with lipservo"):
        own_yaml("face_jaw_maestro")
