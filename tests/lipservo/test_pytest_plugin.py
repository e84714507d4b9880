"""The fixture that other people's tests use, in a pytest of its own."""

import pytest
import yaml
from places import ROOT

pytest_plugins = "pytester"

SPEAKS = """
import math, os, struct

def test_speaks(simulated_face):
    tone = struct.pack("<12000h", *(int(9000 * math.sin(i / 9)) for i in range(12000)))
    with simulated_face.connect() as face, face.stream(24000, playback="client") as speech:
        speech.write(tone)
        speech.report_played(0.5)
    ticks = simulated_face.end()
    assert len(ticks) > 5 and len(ticks[0]["sent_deg"]) == N_SERVOS
    assert os.listdir(os.environ["LIPSERVO_RUNTIME"])
"""


@pytest.fixture(autouse=True)
def alone(pytester, monkeypatch):
    """The plug-in of the installed wheel and no other."""
    monkeypatch.setenv("PYTEST_ADDOPTS", "-p no:cacheprovider -p no:xdist")
    return pytester


def test_a_test_speaks_through_a_face_and_gets_what_its_servos_were_sent(alone):
    alone.makepyfile(SPEAKS.replace("N_SERVOS", "10"))

    alone.runpytest_subprocess().assert_outcomes(passed=1)


PLAYS = """
def test_plays(simulated_face):
    simulated_face.play(bytes(2 * 4800), 24000)
    places = simulated_face.encoders_deg()
    assert len(places) == 10 and abs(places["jaw"]) < 30
    assert set(simulated_face.stop()["confirmed"]) == set(places)
    assert simulated_face.end()
"""


def test_a_test_plays_a_sound_reads_encoders_and_stops(alone):
    alone.makepyfile(PLAYS)

    alone.runpytest_subprocess().assert_outcomes(passed=1)


OWN = """
import pytest

@pytest.fixture
def simulated_face_config():
    return "FACE"
"""


def test_a_face_that_there_is_not_is_named(alone):
    alone.makeconftest(OWN.replace("FACE", "no_such_face"))
    alone.makepyfile(SPEAKS.replace("N_SERVOS", "10"))

    outcome = alone.runpytest_subprocess()
    outcome.assert_outcomes(errors=1)
    outcome.stdout.fnmatch_lines(["*no_such_face*"])


def test_servos_at_a_port_are_simulated_and_the_port_is_left_alone(alone):
    face = yaml.safe_load((ROOT / "config" / "face_jaw_maestro.yaml").read_text())
    face["bus"]["port"] = "/dev/ttyACM0"
    own = alone.path / "own.yaml"
    own.write_text(yaml.safe_dump(face))
    alone.makeconftest(OWN.replace("FACE", str(own)))
    alone.makepyfile(SPEAKS.replace("N_SERVOS", "1"))

    alone.runpytest_subprocess().assert_outcomes(passed=1)


BOTH = """
def test_both(shared_simulated_face, simulated_face):
    own = simulated_face.encoders_deg()
    simulated_face.end()
    assert shared_simulated_face.encoders_deg().keys() == own.keys()
"""


def test_the_encoders_of_a_shared_face_are_its_own_beside_another_face(alone):
    alone.makepyfile(BOTH)

    alone.runpytest_subprocess().assert_outcomes(passed=1)
