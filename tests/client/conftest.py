"""What tests of clients share."""

import json
import socket

import pytest
from lipservo_client.wire import Wire
from pydantic import TypeAdapter
from voice_agents.served_face import ServedFace

from lipservo.agents.messages import COMMANDS, STREAM_MESSAGES
from lipservo.agents.protocol_schema import CONTROL_EVENTS, STREAM_EVENTS


@pytest.fixture
def unused_ports():
    """Two ports of this computer at which nobody listens."""
    with socket.socket() as one, socket.socket() as other:
        for probe in (one, other):
            probe.bind(("127.0.0.1", 0))
        return one.getsockname()[1], other.getsockname()[1]


@pytest.fixture
def unused_port(unused_ports):
    """One of them."""
    return unused_ports[0]


@pytest.fixture
def served():
    """A face that clients connect to."""
    with ServedFace() as face:
        yield face


@pytest.fixture
def traffic_by_the_schema(monkeypatch):
    """Whatever clients send and are sent is as the protocol's schema has it, without a field more.

    The models are those of docs/protocol.json.
    """
    sent, received = [], []
    send, take = Wire.send_message, Wire.__init__

    async def sending(self, message):
        if isinstance(message, str):
            sent.append(json.loads(message))
        await send(self, message)

    def taking(self, socket, token, on_event, on_close):
        def noted(event):
            received.append(event)
            on_event(event)

        take(self, socket, token, noted, on_close)

    monkeypatch.setattr(Wire, "send_message", sending)
    monkeypatch.setattr(Wire, "__init__", taking)
    yield
    events = TypeAdapter(STREAM_EVENTS | CONTROL_EVENTS)
    for event in received:
        events.validate_python(event)
    for message in sent:
        model = (COMMANDS if "id" in message else STREAM_MESSAGES)[message["type"]]
        model.model_validate(message)
        assert set(message) <= set(model.model_fields), message
    assert sent
    assert received
