"""One status of the whole face: every part of it documented, put together, unchangeable."""

import json
import re
from dataclasses import FrozenInstanceError, asdict, fields, replace

import pytest
from places import ROOT
from speaking_status import SPEECH

from firmware_bridge.clock import ManualClock
from firmware_bridge.loop.targets import MemoryTargetChannel
from lipservo.runtime.servos.assembly import assemble_face, bridge_for, bus_for
from lipservo.runtime.status.face_status import BridgeSide, SpeechStatus, Status, whole_status

FIELDS = [field.name for side in (BridgeSide, SpeechStatus) for field in fields(side)]


@pytest.fixture(scope="module")
def of_bridge():
    face = assemble_face("face_jaw", None)
    with bus_for(face.settings, ManualClock()) as bus:
        return bridge_for(face.settings, bus, MemoryTargetChannel(), rate_hz=30.0).as_dict()


def test_bridge_and_speech_fill_in_every_field_but_what_only_a_loop_or_a_servo_knows(of_bridge):
    about = {"name": "tom", "port": "/dev/x", "config": "face_jaw", "sounds": "."}
    status = whole_status({**of_bridge, **about}, SPEECH)

    unknown = [name for name, value in status.as_dict().items() if value is None]
    assert unknown == ["stopped", "stopped_by", "stop_report", "can_start", "torque_on"]
    assert list(status.bridge.servos) == ["jaw"]
    assert status.speech is SPEECH
    assert asdict(SPEECH).items() <= status.as_dict().items()


def test_a_lesser_recogniser_is_a_trouble_beside_those_of_the_servos():
    ears = "recogniser energy in use: network: broken"
    bridge = {"state": "driven", "troubles": ["joint 'jaw' is hot"]}
    status = whole_status(bridge, SPEECH)
    assert status.troubles == status.as_dict()["troubles"] == ("joint 'jaw' is hot", ears)
    heard_by_the_best = whole_status(bridge, replace(SPEECH, fallback_level=0))
    assert heard_by_the_best.troubles == ["joint 'jaw' is hot"]


def test_what_nobody_knows_is_none_and_the_whole_is_json():
    status = whole_status({"state": "waiting", "stopped": "freeze", "troubles": []}, None)

    told = json.loads(json.dumps(status.as_dict()))
    assert (told["state"], told["stopped"], told["strategy"]) == (
        "waiting",
        "freeze",
        None,
    )
    assert list(told) == FIELDS


def test_a_part_that_has_no_field_is_refused():
    with pytest.raises(TypeError, match="heat"):
        whole_status({"heat": 3}, None)


def test_a_status_cannot_be_changed():
    with pytest.raises(FrozenInstanceError):
        Status(BridgeSide()).bridge.state = "driven"


def test_the_table_in_the_documentation_has_the_fields_in_their_order():
    text = (ROOT / "docs" / "architecture.md").read_text()
    section = text.split("## Status", 1)[1].split("\n## ", 1)[0]
    named = re.findall(r"^\| `(\w+)` \| (\w+) \| .+ \|$", section, re.MULTILINE)

    assert [name for name, _ in named] == FIELDS
    of_speech = {field.name for field in fields(SpeechStatus)}
    assert {name for name, who in named if who == "speech"} == of_speech
