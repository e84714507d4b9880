"""Settings into a face's YAML: whole or not at all, comments and all else as they were."""

import pytest
import yaml
from lipservo_client.protocol import FaceError

from lipservo.dashboard.face_files import own_yaml, saved_settings, with_settings
from lipservo.settings.edited_yaml import ChangedMeanwhileError
from lipservo.settings.settings import load_face

PLAIN = """\
# my own face
name: tom   # after my uncle
rate_hz: 100.0
servos:
  jaw:   {id: 11, model: XL330-M288, positive: "opens", min_deg: -2.0, max_deg: 25.0,
          max_speed_deg_s: 300}
  # the neck is next
  neck: {id: 0x0C, model: XL330-M288, positive: left, min_deg: -40, max_deg: 40,
         max_speed_deg_s: 9e1}
prevent:
- joints: {jaw: 1.0}
  above: 3
  because: 'it would bite'
"""
WITH_MOTION = PLAIN + "motion:\n  strength: 1.25  # she mumbles\n  weights: 'grid'\n"


@pytest.fixture
def path(tmp_path):
    made = tmp_path / "tom.yaml"
    made.write_text(WITH_MOTION)
    return made


def refused(code, do, *arguments):
    with pytest.raises(FaceError) as raised:
        do(*arguments)
    assert raised.value.code == code
    return str(raised.value)


def comments(text):
    return [line.partition("#")[2] for line in text.splitlines() if "#" in line]


@pytest.mark.parametrize("text", [PLAIN, WITH_MOTION, PLAIN + "motion: {strength: 1.0}\n"])
def test_the_setting_is_there_and_all_else_is_as_it_was(path, text):
    path.write_text(text)
    before = load_face(path)

    with_settings(path, {"strength": 0.5, "smoothness": 0.25}).write()

    after = load_face(path)
    assert (after.motion.strength, after.motion.smoothness) == (0.5, 0.25)
    assert after.motion.weights == before.motion.weights
    assert after.model_dump(exclude={"motion"}) == before.model_dump(exclude={"motion"})
    assert comments(path.read_text()) == comments(text)
    assert saved_settings(str(path))["strength"] == 0.5
    # What another reader of YAML makes of it.
    assert yaml.safe_load(path.read_text())["motion"]["strength"] == 0.5


@pytest.mark.parametrize(
    "values", [{"strength": 9.0}, {"strength": 1.0, "smoothness": -1.0}, {"speed": 1.0}]
)
def test_what_the_face_would_not_take_is_not_written(path, values):
    assert "tom.yaml" in refused("refused", with_settings, path, values)
    assert path.read_text() == WITH_MOTION


def test_a_file_that_was_changed_meanwhile_stays(path):
    new = with_settings(path, {"strength": 0.5})
    path.write_text(PLAIN)
    with pytest.raises(ChangedMeanwhileError, match="was changed meanwhile; try again"):
        new.write()
    assert path.read_text() == PLAIN


def test_an_anchor_is_no_obstacle(path):
    text = WITH_MOTION.replace("motion:\n", "motion: &all\n")
    path.write_text(text)
    with_settings(path, {"strength": 0.5}).write()
    assert load_face(path).motion.strength == 0.5


@pytest.mark.parametrize("text", ["", "[]", "a: [", "name: tom\nname: tim\n", "\t", "motion: 3\n"])
def test_a_file_that_is_no_face_stays(path, text):
    path.write_text(text)
    refused("refused", with_settings, path, {"strength": 0.5})
    assert path.read_text() == text


def test_a_shipped_face_is_not_ours_to_write():
    assert "new-face" in refused("refused", own_yaml, "face_sim")
    refused("refused", own_yaml, None)


def test_a_file_that_is_gone(tmp_path):
    refused("not_saved", with_settings, tmp_path / "gone.yaml", {"strength": 0.5})
