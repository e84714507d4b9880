"""A client older or newer than the face: one line that names both versions."""

import asyncio
import json

import pytest
from lipservo_client import async_face, protocol
from lipservo_client.protocol import FaceError
from voice_agents.served_face import ServedFace
from websockets.asyncio.server import serve

import lipservo
from lipservo.agents import messages


def test_client_and_face_of_one_checkout_speak_the_same():
    assert protocol.PROTOCOL == messages.PROTOCOL


@pytest.mark.parametrize("version", [1, 3])
def test_a_client_of_another_version_is_told_both_by_the_face(version, monkeypatch):
    monkeypatch.setattr(async_face, "PROTOCOL", version)
    with ServedFace() as served, pytest.raises(FaceError) as raised:
        lipservo.connect(served.url).__enter__()

    assert raised.value.code == "bad_protocol"
    assert f"this client speaks protocol {version}, the face 2; install" in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("version", [1, 3, "unknown"])
def test_a_face_of_another_version_is_told_both_by_the_client(version):
    """A face that does not compare: what it answers is compared here."""

    async def answer(connection):
        await connection.recv()
        about = {} if version == "unknown" else {"protocol": version}
        await connection.send(json.dumps({"type": "hello", "delay_ms": 0.0, **about}))
        await connection.wait_closed()

    async def talk():
        async with serve(answer, "127.0.0.1", 0) as server:
            port = server.sockets[0].getsockname()[1]
            async with lipservo.connect_async(f"ws://127.0.0.1:{port}", token="t"):
                pass

    with pytest.raises(FaceError) as raised:
        asyncio.run(talk())
    assert raised.value.code == "bad_protocol"
    assert f"the face speaks protocol {version}, this lipservo-client 2; install" in str(
        raised.value
    )
    assert "\n" not in str(raised.value)


def test_a_face_that_hangs_up_before_its_greeting_is_a_face_error():
    async def answer(connection):
        await connection.recv()
        await connection.close(1001, "shutting_down")

    async def talk():
        async with serve(answer, "127.0.0.1", 0) as server:
            port = server.sockets[0].getsockname()[1]
            async with lipservo.connect_async(f"ws://127.0.0.1:{port}", token="t"):
                pass

    with pytest.raises(FaceError) as raised:
        asyncio.run(talk())
    assert raised.value.code == "shutting_down"
