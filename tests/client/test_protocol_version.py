"""A client older or newer than the face: one line that names both versions."""

import json

import pytest
from lipservo_client import async_face, protocol
from lipservo_client.protocol import FaceError
from websockets.asyncio.server import serve

import lipservo
from lipservo.agents import messages


async def refused(answer):
    """What a client is told by a server that answers so."""
    async with serve(answer, "127.0.0.1", 0) as server:
        url = f"ws://127.0.0.1:{server.sockets[0].getsockname()[1]}"
        with pytest.raises(FaceError) as raised:
            await lipservo.connect_async(url, token="t").__aenter__()
    return raised.value


def test_client_and_face_of_one_checkout_speak_the_same():
    assert protocol.PROTOCOL == messages.PROTOCOL


@pytest.mark.parametrize("version", [1, 3])
def test_a_client_of_another_version_is_told_both_by_the_face(served, version, monkeypatch):
    monkeypatch.setattr(async_face, "PROTOCOL", version)
    with pytest.raises(FaceError) as raised:
        lipservo.connect(served.url).__enter__()

    assert raised.value.code == "bad_protocol"
    assert f"this client speaks protocol {version}, the face 2; install" in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("version", [1, 3, "unknown"])
async def test_a_face_of_another_version_is_told_both_by_the_client(version):
    """A face that does not compare: what it answers is compared here."""

    async def answer(connection):
        await connection.recv()
        about = {} if version == "unknown" else {"protocol": version}
        await connection.send(json.dumps({"type": "hello", "delay_ms": 0.0, **about}))
        await connection.wait_closed()

    error = await refused(answer)
    assert error.code == "bad_protocol"
    assert f"the face speaks protocol {version}, this lipservo-client 2; install" in str(error)
    assert "\n" not in str(error)


async def test_a_face_that_hangs_up_before_its_greeting_is_a_face_error():
    async def answer(connection):
        await connection.recv()
        await connection.close(1001, "shutting_down")

    assert (await refused(answer)).code == "shutting_down"
