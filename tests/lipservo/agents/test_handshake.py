"""Connections to the agent server: full access, a stop alone, or none; over real HTTP too."""

import asyncio
import contextlib
import json
import select
import socket
import threading
import urllib.error
import urllib.request

import pytest
from lipservo_lab.bench.stops.idle_connections import OPENINGS, IdleCrowd
from lipservo_lab.bench.stops.stop_clients import stop_by_control
from voice_agents.served_face import ServedFace, client, until
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidStatus

from firmware_bridge.stopping import StopLevel
from lipservo.access.admission import Policy
from lipservo.agents import agent_server
from lipservo.agents.listener import AgentSettings, handshake, request_of

LOCKED = AgentSettings(policy=Policy("open sesame"))


def address(face):
    host, port = face.url.removeprefix("ws://").split(":")
    return host, int(port)


def opened(target="/stream", settings=None, n_connected=0, peer="127.0.0.1", **headers):
    given = {"host": "127.0.0.1:8765", "upgrade": "websocket", **headers}
    sent = [(name.title(), value) for name, value in given.items() if value]
    return handshake(request_of(target, sent, peer), settings or AgentSettings(), n_connected)


def status_of(*target, **how):
    """The HTTP status of a refusal; None: connected."""
    refused = opened(*target, **how).refused
    return None if refused is None else int(refused.status)


@pytest.mark.parametrize("path", ["/stream", "/control"])
def test_a_web_page_connects_only_where_the_faces_yaml_lists_it(path):
    """Of origins more in tests/lipservo/access/test_admission.py."""
    settings = AgentSettings(policy=Policy(None, ("https://robot.example",)))
    for origin in ("", "http://127.0.0.1:8765", "https://robot.example"):
        assert status_of(path, settings, origin=origin) is None
    for origin in ("http://127.0.0.1:3000", "https://robot.example.evil.example", "http://["):
        assert status_of(path, settings, origin=origin) == 403


@pytest.mark.parametrize(
    ("target", "authorization", "status"),
    [
        ("/stream", "", 401),
        ("/stream", "Bearer open sesame", None),
        ("/stream", "bearer open sesame", None),
        ("/stream?token=open+sesame", "", None),
        ("/stream?token=open", "", 401),
        ("/stream", "Bearer opén", 401),
        ("/stream", "Basic open sesame", 401),
        ("/status", "", 401),
        ("/" + "?a=b" * 5000, "", 401),
    ],
)
def test_everything_but_a_stop_needs_the_token(target, authorization, status):
    assert status_of(target, LOCKED, authorization=authorization) == status


@pytest.mark.parametrize("target", ["/?" + "a=b&" * 5000, "//["])
def test_what_cannot_be_read_is_no_request(target):
    with pytest.raises(ValueError, match=r".+"):
        opened(target, LOCKED)


@pytest.mark.parametrize("authorization", ["", "Bearer an old one"])
def test_without_the_token_control_is_open_to_a_stop_alone_and_on_this_computer_alone(
    authorization,
):
    here = opened("/control", LOCKED, authorization=authorization)
    assert (here.refused, here.may_only_stop.status) == (None, 401)
    for where in ({"peer": "192.0.2.7"}, {"x-forwarded-for": "192.0.2.7"}):
        assert status_of("/control", LOCKED, authorization=authorization, **where) == 401
    assert status_of("/control", LOCKED, host="evil.example") == 401
    assert status_of("/control", LOCKED, origin="http://localhost:3000") == 403
    assert status_of("/control", LOCKED, upgrade="") == 401


def test_a_stop_comes_in_where_no_more_clients_do():
    settings = AgentSettings(most_connections=2, policy=LOCKED.policy)
    bearer = {"authorization": "Bearer open sesame"}
    assert status_of("/stream", settings, 2, **bearer) == 503
    assert opened("/control", settings, 2, **bearer).may_only_stop.status == 503
    assert opened("/control", settings, 2).may_only_stop.status == 401
    far = {"peer": "192.0.2.7", "host": "robot.local:8765"}
    assert opened("/control", settings, 2, **far, **bearer).may_only_stop.status == 503


@pytest.mark.parametrize(
    ("target", "upgrade", "status"),
    [
        ("/nothing", "websocket", 404),
        ("/stream", "", 426),
        ("/control", "h2c", 426),
        ("/", "", None),
    ],
)
def test_another_path_or_protocol_is_refused(target, upgrade, status):
    assert status_of(target, upgrade=upgrade) == status


async def test_a_client_without_the_token_stops_the_face_and_does_nothing_else():
    with ServedFace(LOCKED, has_voice=True) as face:
        async with client(face, "/control") as agent:
            for kind, fields in (
                ("status", {}),
                ("set", {"name": "strength", "value": 0.5}),
                ("say", {"text": "hello"}),
                ("start", {}),
                ("stop", {"level": "limp", "end": True}),
            ):
                await agent.say(kind, id=kind, **fields)
                refused = await agent.next("result", "error")
                assert (refused.get("code"), refused["id"]) == ("unauthorized", kind)
            await agent.say("stop", id="stop", level="limp")
            stopped = await agent.next("result", "error")
        with pytest.raises(InvalidStatus) as refused:
            async with client(face, "/stream"):
                pass

        assert (stopped["type"], stopped["result"]["accepted"]) == ("result", "limp")
        assert refused.value.response.status_code == 401
        until(lambda: face.stops)
        assert face.stops == [StopLevel.LIMP]
        assert face.commands.values["strength"] == 1.0


async def test_clients_that_may_only_stop_take_no_room_from_others_nor_from_each_other():
    bearer = {"additional_headers": {"Authorization": "Bearer open sesame"}}
    with ServedFace(AgentSettings(policy=LOCKED.policy, most_connections=1)) as face:
        idle = [await connect(f"{face.url}/control") for _ in range(20)]
        for each in idle:
            await each.send('{"type": "status"}')
            await each.recv()
        async with client(face, **bearer) as agent:
            assert (await agent.start())["type"] == "ready"
            async with client(face, "/control") as late:
                await late.say("stop", level="limp")
                assert (await late.next("result", "error"))["type"] == "result"
        gone = 0
        for each in idle:
            try:
                await asyncio.wait_for(each.recv(), 0.05)
            except ConnectionClosed:
                gone += 1
            except TimeoutError:
                await each.close()
        assert gone == 20 + 1 - 12


async def test_more_clients_than_allowed_are_turned_away():
    with ServedFace(AgentSettings(most_connections=2)) as face:
        async with client(face) as first, client(face, "/control"):
            await first.start()
            with pytest.raises(InvalidStatus) as refused:
                async with client(face):
                    pass
            await first.finish(0.1)

    assert refused.value.response.status_code == 503
    assert refused.value.response.body == b"2 clients are connected already\n"


def fetch(url, **headers):
    try:
        with urllib.request.urlopen(urllib.request.Request(url, headers=headers)) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read().decode()


def test_a_plain_request_is_answered_in_one_line_that_never_holds_the_token(caplog):
    with ServedFace(AgentSettings(policy=Policy("a secret"))) as face:
        url = face.url.replace("ws", "http")
        health = fetch(url + "/status", Authorization="Bearer a secret")
        plain = fetch(url + "/stream?token=a+secret")
        without = fetch(url)

        assert health[0] == 200
        about = {"url": face.url, "n_clients": 0, "n_streams_refused": 0}
        assert json.loads(health[1]) == about
        assert plain == (426, "this is a WebSocket; use ws://\n")
        assert without[0] == 401
        assert "secret" not in str((plain, without, caplog.messages))


@pytest.mark.parametrize("request_line", [b"POST /stream HTTP/1.1", b"\x16\x03\x01\x02", b""])
def test_what_is_no_request_at_all_harms_nobody(face, request_line):
    with socket.create_connection(address(face), 10.0) as stranger:
        stranger.sendall(request_line + b"\r\nHost: 127.0.0.1\r\n\r\n")
        answer = stranger.recv(1000)

    assert fetch(face.url.replace("ws", "http"))[0] == 200
    assert answer == b"" or answer.startswith((b"HTTP/1.1 4", b"HTTP/1.1 5"))


def test_of_connections_that_ask_for_nothing_the_oldest_make_room(monkeypatch):
    monkeypatch.setattr(agent_server, "MOST_HEADS", 64)
    with ServedFace() as face, contextlib.ExitStack() as stack:
        idle = [
            stack.enter_context(socket.create_connection(address(face), 20.0)) for _ in range(60)
        ]
        assert fetch(face.url.replace("ws", "http"))[0] == 200
        for each in idle[:13]:
            with contextlib.suppress(ConnectionResetError):
                assert each.recv(1) == b""
        assert select.select(idle[13:], [], [], 0.0) == ([], [], [])


@pytest.mark.parametrize("n", range(len(OPENINGS["agents"])))
def test_who_does_not_finish_in_time_is_dropped_whatever_was_sent(n, monkeypatch):
    monkeypatch.setattr(agent_server, "HEAD_S", 0.3)
    with ServedFace(LOCKED) as face, socket.create_connection(address(face), 20.0) as client:
        client.sendall(OPENINGS["agents"][n].sent)
        with contextlib.suppress(ConnectionResetError):
            while client.recv(1000):
                pass
    assert face.stops == []


async def test_who_has_connected_to_stop_may_wait_to_do_so(monkeypatch):
    monkeypatch.setattr(agent_server, "HEAD_S", 0.3)
    with ServedFace(LOCKED) as face:
        async with client(face, "/control") as agent:
            await agent.say("status")
            await agent.next("error")
            with pytest.raises(ConnectionClosed):  # one that came after, and says nothing
                await (await connect(f"{face.url}/control")).recv()
            await agent.say("stop", level="limp")
            assert (await agent.next("result", "error"))["result"]["accepted"] == "limp"


@pytest.mark.parametrize("n_peers", [10, 1])
def test_every_stop_gets_in_beside_three_hundred_idle_clients(n_peers, monkeypatch):
    monkeypatch.setattr(agent_server, "HEAD_S", 2.0)
    over = threading.Event()
    with ServedFace(LOCKED) as face:
        crowd = IdleCrowd(address(face), n_peers, OPENINGS["agents"])
        thread = threading.Thread(target=crowd.run, args=(over.is_set,), daemon=True)
        thread.start()
        try:
            n_stops = 0
            while n_stops < 20 or crowd.n_came < 400:  # they are dropped, and come again
                answer = json.loads(stop_by_control(face.url, "limp", 20.0))
                assert (answer["type"], answer["result"]["accepted"]) == ("result", "limp")
                n_stops += 1
                until(lambda n=n_stops: len(face.stops) >= n)
        finally:
            over.set()
            thread.join(30.0)
