"""The face that a request names, as the processes of a running face read it anew."""

from contextlib import closing
from dataclasses import replace

import pytest
from places import ROOT

from firmware_bridge.process.lifeline import Lifeline, NotStarted, lifeline_pair
from lipservo.runtime.processes import Handed, run_bridge_process
from lipservo.runtime.requested_face import RequestedFace
from lipservo.runtime.run_request import SILENCE, RunRequest
from lipservo.settings.strict_yaml import SettingsError

JAW = "  jaw:\n    id: 11\n"


@pytest.fixture
def yaml(tmp_path):
    path = tmp_path / "mine.yaml"
    text = (ROOT / "config" / "face_four.yaml").read_text()
    path.write_text(text.replace("calibration: face_four.calibration.yaml\n", ""))
    return path


def test_a_stopped_face_takes_new_limits_from_its_yaml(yaml):
    request = RunRequest(str(yaml), SILENCE)
    request = replace(request, servos=RequestedFace(request).servos)
    yaml.write_text(yaml.read_text().replace("max_deg: 25", "max_deg: 20"))

    assert RequestedFace(request).settings.servos["jaw"].max_deg == 20


@pytest.mark.parametrize(
    ("old", "new"),
    [(JAW, JAW.replace("11", "17")), (JAW, "  chin:\n    id: 11\n")],
    ids=["address", "name"],
)
def test_a_yaml_whose_servos_have_changed_is_refused_before_any_torque(yaml, old, new):
    """Goals go by number: another servo would get those of this one."""
    request = RunRequest(str(yaml), SILENCE, port="/dev/none")
    request = replace(request, servos=RequestedFace(request).servos)
    yaml.write_text(yaml.read_text().replace(old, new))
    assert new in yaml.read_text()
    end, watch = lifeline_pair()
    with closing(watch), end:
        handed = Handed(-1, -1, -1, Lifeline(end))
        with pytest.raises(SettingsError, match=r"its servos have changed .* start it anew"):
            run_bridge_process(request, handed, -1, stopped=None, given_up={}, switched_off=[])
        (told,) = [each for each in watch.read() if isinstance(each, NotStarted)]

    assert "its servos have changed" in told.reason
