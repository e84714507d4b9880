"""The streams over real WebSockets: the newest frame to each, and nothing for who does not read."""

import asyncio
import json
import socket
import struct
import time
from contextlib import AsyncExitStack

import numpy as np
import pytest
from served_dashboard import served
from watched_face import LAYOUT, SERVOS
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from lipservo.dashboard.web.streams import MOST_CLIENTS

RATE_HZ = 30


@pytest.fixture(scope="module")
def dashboard():
    with served(ping_s=0.5) as made:
        yield made


def streamed(dashboard, path, n, **options):
    """The hello and n messages."""

    async def read():
        async with connect(f"{dashboard.streams}{path}", proxy=None, **options) as stream:
            return [await stream.recv() for _ in range(n + 1)]

    return asyncio.run(read())


def number(frame):
    return struct.unpack_from("<I", frame)[0]


def test_the_twin_is_told_names_once_and_then_frames(dashboard):
    hello, *frames = streamed(dashboard, "/api/twin", 10)

    assert json.loads(hello)["servos"] == list(SERVOS)
    assert json.loads(hello)["phonemes"] == list(LAYOUT.phonemes)
    numbers = [number(frame) for frame in frames]
    assert numbers == list(range(numbers[0], numbers[0] + 10))
    assert {len(frame) for frame in frames} <= set(range(107, 116))
    assert all(frame[10] == 1 | 16 for frame in frames)


def test_programs_are_told_the_same_in_json(dashboard):
    hello, *messages = streamed(dashboard, "/api/state", 5)
    fields = json.loads(hello)["fields"]
    for message in messages:
        told = dict(zip(fields, json.loads(message), strict=True))
        assert told["state"] == LAYOUT.states.index("driven")
        assert len(told["goals_tenths_deg"]) == len(SERVOS)


def test_both_sides_that_fall_silent_are_gone_within_a_second(dashboard):
    async def until_gone(flag):
        async with connect(f"{dashboard.streams}/api/twin", proxy=None) as stream:
            await stream.recv()
            began_s = struct.unpack_from("<If", await stream.recv())[1]
            while True:
                frame = await stream.recv()
                if frame[10] & flag:
                    return struct.unpack_from("<If", frame)[1] - began_s

    dashboard.face.writes_speech = False
    assert asyncio.run(until_gone(4)) < 1.0
    dashboard.face.writes_servos = False
    assert asyncio.run(until_gone(2)) < 1.0
    dashboard.face.writes_speech = dashboard.face.writes_servos = True
    _, *frames = streamed(dashboard, "/api/twin", 30)
    assert not frames[-1][10] & (2 | 4)


def test_no_more_than_so_many():
    async def many(streams):
        async with AsyncExitStack() as open_streams:
            for _ in range(MOST_CLIENTS):
                await open_streams.enter_async_context(connect(f"{streams}/api/twin", proxy=None))
            with pytest.raises((ConnectionClosed, InvalidStatus)):
                async with connect(f"{streams}/api/twin", proxy=None) as one_more:
                    await one_more.recv()

    with served() as patient:  # nobody is dropped for a ping that a busy computer answers late
        asyncio.run(many(patient.streams))
        wait_for(lambda: clients(patient) == 0)


def clients(dashboard):
    with dashboard.client() as client:
        lines = client.get("/metrics").text.splitlines()
    mark = 'lipservo_dashboard_clients{stream="twin"} '
    return next(float(line.removeprefix(mark)) for line in lines if line.startswith(mark))


def test_who_never_reads_is_dropped_and_holds_nobody_up(dashboard):
    host, port = dashboard.address.removeprefix("http://").split(":")
    with socket.socket() as deaf:
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        deaf.connect((host, int(port)))
        deaf.sendall(
            f"GET /api/twin HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\n"
            "Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
            "Sec-WebSocket-Version: 13\r\n\r\n".encode()
        )
        wait_for(lambda: clients(dashboard) == 1)
        _, *frames = streamed(dashboard, "/api/twin", 20)
        wait_for(lambda: clients(dashboard) == 0)
    gaps = np.diff([number(frame) for frame in frames])
    assert gaps.max() < RATE_HZ  # a computer that does much else loses some; patience is 5 s


def test_another_pages_script_gets_no_stream(dashboard):
    for path in ("/api/twin", "/api/state"):
        with pytest.raises(InvalidStatus) as raised:
            streamed(dashboard, path, 1, origin="http://evil.example")
        assert raised.value.response.status_code == 403


def test_what_clients_say_is_forgotten(dashboard):
    async def chatter():
        async with connect(f"{dashboard.streams}/api/twin", proxy=None) as stream:
            for _ in range(20):
                await stream.send("hello" * 100)
                await stream.send(b"\0" * 100)
            await stream.recv()
            return await stream.recv()

    assert len(asyncio.run(chatter())) > 100


def wait_for(condition):
    give_up_s = time.monotonic() + 20.0
    while not condition():
        assert time.monotonic() < give_up_s, "nothing happened"
        time.sleep(0.02)
