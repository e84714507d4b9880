"""Which devices a request's sound means."""

import pytest
from fake_sound_card import device, install_sound_card
from places import ROOT

from lipservo.runtime.run_request import RunRequest, Sound
from lipservo.runtime.sound import entered_sound


@pytest.mark.parametrize(("named", "opened"), [("default", "USB Audio"), ("Built-in", "Built-in")])
def test_the_default_microphone_is_the_one_of_the_faces_yaml(tmp_path, monkeypatch, named, opened):
    cards = [device(0, "Built-in", n_inputs=1), device(1, "USB Audio", n_inputs=1)]
    install_sound_card(monkeypatch, cards)
    config = tmp_path / "face.yaml"
    text = (ROOT / "config" / "face_jaw.yaml").read_text("utf-8")
    config.write_text(text + "\nsound:\n  input: USB Audio\n")
    with entered_sound(RunRequest(str(config), Sound("microphone", named))) as source:
        assert source.name == opened
