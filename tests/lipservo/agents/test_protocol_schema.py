"""The protocol as a document: served, written to docs, and complete."""

import json
import urllib.request

import pytest
from places import ROOT
from voice_agents.served_face import ServedFace

from lipservo.agents.messages import COMMANDS, STREAM_MESSAGES
from lipservo.agents.protocol_schema import EVENTS, protocol_schema


def test_the_face_serves_the_document_that_the_docs_have():
    """After a change: write what `protocol_schema()` gives to docs/protocol.json."""
    written = json.loads((ROOT / "docs" / "protocol.json").read_text("utf-8"))
    with ServedFace() as face:
        address = face.url.replace("ws://", "http://") + "/protocol.json"
        with urllib.request.urlopen(address, timeout=60.0) as answer:
            served = json.load(answer)

    assert served == written


def test_every_message_of_a_client_is_in_it_and_every_reference_leads_somewhere():
    document = protocol_schema()

    def types(channel):
        names = document["channels"][channel]["messages"]
        return {
            document["components"]["schemas"][name]["properties"]["type"].get("const")
            for name in names
        }

    assert types("stream") >= set(STREAM_MESSAGES)
    assert types("control") >= set(COMMANDS)
    for reference in references(document):
        place = document
        for step in reference.removeprefix("#/").split("/"):
            place = place[step]


def references(value):
    if isinstance(value, dict):
        yield from [value["$ref"]] if "$ref" in value else []
        for each in value.values():
            yield from references(each)
    elif isinstance(value, list):
        for each in value:
            yield from references(each)


@pytest.mark.parametrize("path", EVENTS)
def test_a_message_of_the_face_that_is_not_described_would_be_noticed(path):
    with pytest.raises(ValueError, match="type"):
        EVENTS[path].validate_python({"type": "dance"})
