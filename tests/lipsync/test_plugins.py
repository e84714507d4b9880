"""Recognisers and synthesisers by their names: built in, of a distribution that is installed."""

import importlib
import sys

import pytest

from lipservo.runtime.motion_options import MotionOptions
from lipservo.settings.settings import parse_face
from lipservo.settings.strict_yaml import SettingsError
from lipsync.errors import UserError
from lipsync.plugins import RECOGNIZERS, SYNTHESIZERS, PluginError
from lipsync.recognition.recognizers import make_recognizer
from lipsync.text_to_speech.synthesizers import synthesizer_for

MODULE = """
from lipsync.phonemes import RecognizerKind
from lipsync.recognition.energy_recognizer import EnergyRecognizer

def damaged(weights, latency_s):
    raise OSError("its model is damaged")

LOUD = RecognizerKind(lambda weights, latency_s: EnergyRecognizer(), 0.3)
DAMAGED = RecognizerKind(damaged)

class Robotic:
    longest_text = 400
"""
ENTRY_POINTS = """
[lipservo.recognizers]
loud = loud_ears:LOUD
damaged = loud_ears:DAMAGED
strange = loud_ears:Robotic
gone = no_such_module:KIND
network = no_such_module:KIND

[lipservo.voices]
robotic = loud_ears:Robotic
"""
FACE = """
name: tom
rate_hz: 50
bus: {kind: simulated}
servos:
  jaw: {id: 1, model: XL330-M288, positive: opens, min_deg: -2, max_deg: 25, max_speed_deg_s: 300}
"""


@pytest.fixture
def installed(monkeypatch, tmp_path):
    """Another distribution, as pip would have unpacked it."""
    about = tmp_path / "loud_ears-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: loud-ears\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(ENTRY_POINTS)
    (tmp_path / "loud_ears.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    importlib.invalidate_caches()
    yield
    sys.modules.pop("loud_ears", None)


@pytest.mark.usefixtures("installed")
def test_a_recogniser_of_another_package_begins_a_ladder_above_all_of_ours():
    recognizer = make_recognizer("loud")

    assert (recognizer.level, recognizer.reasons) == ("loud", ())
    assert recognizer.latency_s == 0.3
    assert MotionOptions(engine="loud").engine == "loud"
    assert RECOGNIZERS.names() == ["network", "energy", "damaged", "gone", "loud", "strange"]
    assert make_recognizer().level == "network"


@pytest.mark.usefixtures("installed")
def test_a_recogniser_that_cannot_be_made_is_left_for_the_network():
    recognizer = make_recognizer("damaged")

    assert recognizer.level == "network"
    assert recognizer.reasons == ("damaged: its model is damaged",)


@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("gone", "recogniser gone: no_such_module:KIND cannot be loaded: No module named"),
        ("strange", "recogniser strange: the package of this name is no recogniser"),
    ],
)
def test_a_package_that_is_broken_is_refused_by_its_name(name, said):
    with pytest.raises(PluginError) as error:
        make_recognizer(name)
    assert str(error.value).startswith(said)


@pytest.mark.usefixtures("installed")
def test_a_face_names_the_synthesiser_of_another_package():
    face = parse_face(f"{FACE}sound: {{synthesizer: robotic}}\n", "face.yaml")

    assert type(synthesizer_for(face.sound.synthesizer)).__name__ == "Robotic"
    names = SYNTHESIZERS.names()
    assert names[:3] == ["espeak", "piper", "command"]
    assert "robotic" in names[3:]


def test_an_unknown_name_says_what_there_is_and_what_to_install():
    with pytest.raises(UserError) as error:
        synthesizer_for("hal")
    names = ", ".join(SYNTHESIZERS.names())
    assert str(error.value) == (
        f"synthesiser 'hal' is not known here; use one of {names}, or install the package that "
        "provides it (entry point lipservo.voices)"
    )
    with pytest.raises(SettingsError, match=r"motion\.engine: recogniser 'hal' is not known"):
        parse_face(f"{FACE}motion: {{engine: hal}}\n", "face.yaml")
