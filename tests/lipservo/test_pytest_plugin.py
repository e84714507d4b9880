"""The fixture that other people's tests use, in a pytest of its own."""

import subprocess
import sys

import pytest
import yaml
from places import ROOT

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


@pytest.fixture
def run(tmp_path):
    """What a pytest of its own prints of a test; it has the plug-in of lipservo and no other.

    Not by pytest's own `pytester`: that empties `sys.modules` and fills it again, and a thread of
    another test that imports at that moment loads NumPy twice.
    """

    def run(test, face=None):
        (tmp_path / "test_own.py").write_text(test)
        if face is not None:
            (tmp_path / "conftest.py").write_text(OWN.replace("FACE", face))
        command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-p", "no:xdist"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        return done.stdout

    return run


def test_a_test_speaks_through_a_face_and_gets_what_its_servos_were_sent(run):
    assert "1 passed" in run(SPEAKS.replace("N_SERVOS", "10"))


PLAYS = """
def test_plays(simulated_face):
    simulated_face.play(bytes(2 * 4800), 24000)
    places = simulated_face.encoders_deg()
    assert len(places) == 10 and abs(places["jaw"]) < 30
    assert set(simulated_face.stop()["confirmed"]) == set(places)
    assert simulated_face.end()
"""


def test_a_test_plays_a_sound_reads_encoders_and_stops(run):
    assert "1 passed" in run(PLAYS)


OWN = """
import pytest

@pytest.fixture
def simulated_face_config():
    return "FACE"
"""


def test_a_face_that_there_is_not_is_named(run):
    printed = run(SPEAKS.replace("N_SERVOS", "10"), "no_such_face")

    assert "1 error" in printed
    assert "no_such_face" in printed


def test_servos_at_a_port_are_simulated_and_the_port_is_left_alone(run, tmp_path):
    face = yaml.safe_load((ROOT / "config" / "face_jaw_maestro.yaml").read_text())
    face["bus"]["port"] = "/dev/ttyACM0"
    own = tmp_path / "own.yaml"
    own.write_text(yaml.safe_dump(face))

    assert "1 passed" in run(SPEAKS.replace("N_SERVOS", "1"), str(own))


BOTH = """
def test_both(shared_simulated_face, simulated_face):
    own = simulated_face.encoders_deg()
    simulated_face.end()
    assert shared_simulated_face.encoders_deg().keys() == own.keys()
"""


def test_the_encoders_of_a_shared_face_are_its_own_beside_another_face(run):
    assert "1 passed" in run(BOTH)
