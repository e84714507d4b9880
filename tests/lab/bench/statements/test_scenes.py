"""The scenes in which statements are heard, on real processes."""

import pytest
from lipservo_lab.bench.statements.campaign import judge_of, scenes
from lipservo_lab.bench.statements.heard_face import flattened, heard_face
from lipservo_lab.bench.statements.scenes import SCENES
from lipservo_lab.bench.stops.faces_on_buses import BUSES


def test_every_scene_is_played_on_every_bus():
    assert set(scenes()) == {(bus, scene) for bus in BUSES for scene in SCENES}


def test_each_value_of_an_object_is_one_statement_by_its_path():
    found = {"torque_on": None, "servos": {"jaw": "off"}, "health": [{"name": "jaw", "n": 1}]}

    assert list(flattened(found | {"holds": ["jaw", "lip"], "limp": []})) == [
        ("torque_on", "null"),
        ("servos.jaw", "off"),
        ("health.jaw.n", "1"),
        ("holds", "jaw"),
        ("holds", "lip"),
    ]


@pytest.mark.slow
@pytest.mark.parametrize("bus", ["feetech", "maestro"])
def test_all_that_a_face_says_from_start_to_stop_is_judged(bus):
    with heard_face(bus) as face:
        face.begin_face("daemon", "--listen", "none")
        assert face.wait_until_driven()
        face.command("status")
        assert face.command("stop", "--limp") == 0
        face.wait(0.5)
        found = judge_of(face).judge(list(face.statements))

    assert found.figures["unjudged"] == 0, found.lines
    assert found.figures["statements"] > 50
