import json

from fake_sound_card import install_sound_card
from typer.testing import CliRunner

from lipservo.cli import app


def test_devices_are_listed_with_their_defaults_and_for_programs(monkeypatch):
    install_sound_card(monkeypatch)
    done = CliRunner().invoke(app, ["devices"])
    assert done.stdout.splitlines() == [
        "microphones",
        "*   1  USB mic: - (hw:2,0), 48000 Hz",
        "    2  array, 48000 Hz",
        "loudspeakers",
        "*   0  USB speaker: - (hw:1,0), 48000 Hz",
        "    3  HDMI, 48000 Hz",
    ]
    told = json.loads(CliRunner().invoke(app, ["devices", "--json"]).stdout)
    assert [each["name"] for each in told["inputs"]] == ["USB mic: - (hw:2,0)", "array"]
    assert [each["name"] for each in told["outputs"]] == ["USB speaker: - (hw:1,0)", "HDMI"]


def test_a_computer_without_sound_is_told_so(monkeypatch):
    install_sound_card(monkeypatch, devices=[])
    done = CliRunner().invoke(app, ["devices"])
    assert (done.stdout, done.exit_code) == ("", 0)
    assert done.stderr == "no microphone found\nno loudspeaker found\n"
