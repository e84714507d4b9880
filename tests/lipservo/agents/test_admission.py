"""Who is let in: path, host, origin, token, number; over real HTTP where the answer is bytes."""

import asyncio
import json
import socket
import urllib.error
import urllib.request

import pytest
from voice_agents.served_face import ServedFace, client, tone, until
from websockets.exceptions import InvalidStatus

from lipservo.agents.admission import refusal
from lipservo.agents.agent_settings import AgentSettings

NONE = {"Host": "127.0.0.1:8765", "Origin": "", "Authorization": "", "Upgrade": "websocket"}


def status_of(target="/stream", settings=None, n_connected=0, **headers):
    """The HTTP status of a refusal; None: let in."""
    given = NONE | {name.title(): value for name, value in headers.items()}
    refused = refusal(target, given, settings or AgentSettings(), n_connected)
    return None if refused is None else int(refused.status)


@pytest.mark.parametrize(
    ("origin", "status"),
    [
        ("", None),
        ("http://localhost:3000", None),
        ("http://127.0.0.1:8765", None),
        ("http://[::1]:8765", None),
        ("https://robot.example", None),
        ("https://robot.example.evil.example", 403),
        ("https://evil.example", 403),
        ("http://localhost.evil.example", 403),
        ("http://127.0.0.1.evil.example", 403),
        ("null", 403),
        ("http://[", 403),
    ],
)
def test_a_web_page_connects_only_from_this_computer_or_where_it_is_allowed(origin, status):
    settings = AgentSettings(allowed_origins=("https://robot.example",))
    assert status_of(settings=settings, origin=origin) == status


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("localhost:8765", None),
        ("[::1]:8765", None),
        ("192.0.2.7:8765", None),
        ("", None),
        ("evil.example:8765", 403),
    ],
)
def test_a_name_that_a_web_page_could_own_is_no_name_of_the_face(host, status):
    """A page may make its own name lead to 127.0.0.1; then its requests are of its own origin."""
    assert status_of(host=host) == status
    assert status_of("/status", host=host, upgrade="") == status
    assert status_of("/stream?token=t", AgentSettings(token="t"), host=host) is None


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
        ("/?" + "a=b&" * 5000, "", 400),
        ("//[", "", 400),
    ],
)
def test_a_token_is_asked_for_everywhere(target, authorization, status):
    settings = AgentSettings(token="open sesame")
    assert status_of(target, settings, authorization=authorization) == status


@pytest.mark.parametrize(
    ("target", "upgrade", "status"),
    [
        ("/nothing", "websocket", 404),
        ("/stream", "", 426),
        ("/control", "h2c", 426),
        ("/", "", None),
    ],
)
def test_another_path_or_protocol_is_told(target, upgrade, status):
    assert status_of(target, upgrade=upgrade) == status


def test_more_clients_than_allowed_are_turned_away():
    with ServedFace(AgentSettings(most_connections=2)) as face:

        async def crowd():
            async with client(face) as first, client(face, "/control"):
                await first.start()
                with pytest.raises(InvalidStatus) as refused:
                    async with client(face):
                        pass
                await first.send(tone(0.1))
                await first.say("end")
                await first.next("finished")
                return refused.value.response

        response = asyncio.run(crowd())

    assert response.status_code == 503
    assert response.body == b"2 clients are connected already\n"


def fetch(url, **headers):
    try:
        with urllib.request.urlopen(urllib.request.Request(url, headers=headers)) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read().decode()


def test_a_plain_request_is_answered_in_one_line_that_never_holds_the_token():
    with ServedFace(AgentSettings(token="a secret")) as face:
        url = face.url.replace("ws", "http")
        health = fetch(url + "/status", Authorization="Bearer a secret")
        plain = fetch(url + "/stream?token=a+secret")
        without = fetch(url)

        assert health[0] == 200
        assert json.loads(health[1]) == {
            "url": face.url,
            "n_clients": 0,
            "n_streams_refused": 0,
        }
        assert plain == (426, "this is a WebSocket; use ws://\n")
        assert without[0] == 401
        assert "secret" not in str((plain, without, face.said))


@pytest.mark.parametrize("request_line", [b"POST /stream HTTP/1.1", b"\x16\x03\x01\x02", b""])
def test_what_is_no_request_at_all_harms_nobody(request_line):
    with ServedFace() as face:
        host, port = face.url.removeprefix("ws://").split(":")
        with socket.create_connection((host, int(port)), 10.0) as stranger:
            stranger.sendall(request_line + b"\r\nHost: 127.0.0.1\r\n\r\n")
            answer = stranger.recv(1000)
        assert fetch(face.url.replace("ws", "http"))[0] == 200

    assert answer == b"" or answer.startswith((b"HTTP/1.1 4", b"HTTP/1.1 5"))


def is_healthy(face):
    try:
        return fetch(face.url.replace("ws", "http"))[0] == 200
    except OSError:  # those that hung up are not all forgotten yet
        return False


def test_connections_that_ask_for_nothing_are_bounded_and_others_come_in():
    with ServedFace() as face:
        host, port = face.url.removeprefix("ws://").split(":")
        idle = [socket.create_connection((host, int(port)), 10.0) for _ in range(80)]
        n_cut = 0
        for each in idle[64:]:
            try:
                n_cut += each.recv(1) == b""
            except ConnectionResetError:
                n_cut += 1
        for each in idle:
            each.close()

        assert n_cut == 16
        until(lambda: is_healthy(face))
