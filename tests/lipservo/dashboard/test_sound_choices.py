"""What a face speaks with is chosen in its own YAML; a shipped face is copied first."""

import pytest
import yaml
from lipservo_client.protocol import FaceError
from places import ROOT

from lipservo.dashboard.face_files import choose_sound, copy_shipped, sound_choices
from lipservo.settings.settings import load_face


def test_a_shipped_face_is_copied_once_and_the_copy_is_a_face(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    assert copy_shipped("face_sim")["file"] == str(tmp_path / "my_face_sim.yaml")
    assert (tmp_path / "my_face_sim.yaml").read_bytes() == (
        ROOT / "config" / "face_sim.yaml"
    ).read_bytes()
    with pytest.raises(FaceError, match="already exists"):
        copy_shipped("face_sim")
    with pytest.raises(FaceError, match="already your own"):
        copy_shipped("my_face_sim.yaml")


@pytest.mark.parametrize("name", ["USB Audio: - (hw:1,0)", "no", "7", "a # b", "ALC257 Analog"])
def test_a_device_is_written_so_that_yaml_reads_its_name_back(name, tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_bytes((ROOT / "config" / "face_sim.yaml").read_bytes())
    choose_sound(str(path), {"output": name, "volume": 0.5, "language": "no"})

    sound = load_face(path).sound
    assert (sound.output, sound.volume, sound.language) == (name, 0.5, "no")
    assert yaml.safe_load(path.read_text())["sound"]["output"] == name


def test_what_is_shipped_or_out_of_bounds_is_not_written(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_bytes((ROOT / "config" / "face_sim.yaml").read_bytes())
    before = path.read_bytes()
    with pytest.raises(FaceError, match="shipped with lipservo"):
        choose_sound("face_sim", {"volume": 0.5})
    with pytest.raises(FaceError, match="not known here"):
        choose_sound(str(path), {"synthesizer": "nobody"})
    assert path.read_bytes() == before


def test_choices_are_what_the_computer_has():
    told = sound_choices("face_sim")

    assert "espeak" in told["synthesizers"]
    assert told["chosen"]["volume"] == 1.0
    assert told["is_shipped"]
    assert all(isinstance(each, str) for each in told["outputs"])
