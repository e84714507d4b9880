"""Stops over HTTP beside clients that take places and ask for nothing, over real sockets."""

import contextlib
import socket
import threading

import httpx
import pytest
from lipservo_lab.bench.stops.idle_connections import OPENINGS, IdleCrowd
from lipservo_lab.bench.stops.stop_clients import post_stop
from served_dashboard import served, wait_for
from websockets.sync.client import connect

from lipservo.dashboard.web import access_layer, serving

TOKEN = "a secret"


@contextlib.contextmanager
def crowd(address, n_peers, n=300):
    """Yield a crowd of `n` connected clients, of `n_peers` addresses, that send nothing."""
    host, port = address.removeprefix("http://").split(":")
    idle = IdleCrowd((host, int(port)), n_peers, OPENINGS["page"], n)
    over = threading.Event()
    thread = threading.Thread(target=idle.run, args=(over.is_set,), daemon=True)
    thread.start()
    try:
        wait_for(lambda: idle.n_came >= n)
        yield idle
    finally:
        over.set()
        thread.join(30.0)


def connected(dashboard, sent=b""):
    host, port = dashboard.address.removeprefix("http://").split(":")
    client = socket.create_connection((host, int(port)), 20.0)
    client.sendall(sent)
    return client


def rest_of(client):
    """All that still comes, until the server hangs up."""
    data = b""
    with contextlib.suppress(ConnectionResetError):
        while more := client.recv(1000):
            data += more
    return data


@pytest.mark.parametrize("n_peers", [10, 1])
def test_every_stop_gets_in_beside_three_hundred_idle_clients(n_peers, monkeypatch):
    monkeypatch.setattr(serving, "HEAD_S", 2.0)
    with served(token=TOKEN) as dashboard, crowd(dashboard.address, n_peers) as idle:
        n_stops = 0
        while n_stops < 20 or idle.n_came < 400:  # they are dropped, and come again
            assert post_stop(dashboard.address, "limp", 0, 20.0) == (200, {"accepted": "limp"})
            n_stops += 1
    assert dashboard.face.said == ["limp"] * n_stops


@pytest.mark.parametrize("n", range(len(OPENINGS["page"])))
def test_what_does_not_finish_in_time_is_dropped_whatever_it_has_sent(n, monkeypatch):
    monkeypatch.setattr(serving, "HEAD_S", 0.3)
    with served(token=TOKEN) as dashboard, connected(dashboard, OPENINGS["page"][n].sent) as client:
        rest_of(client)
    assert dashboard.face.said == []


def test_a_stop_may_come_in_pieces_and_its_connection_is_used_again(monkeypatch):
    monkeypatch.setattr(serving, "HEAD_S", 3600.0)
    head = b"POST /api/stop HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 17\r\n\r\n"
    with served() as dashboard, connected(dashboard) as client:
        for _ in range(2):
            for part in (head[:20], head[20:], b'{"level": ', b'"limp"}'):
                client.sendall(part)
            answer = b""
            while b"accepted" not in answer:
                answer += client.recv(1000)
            assert answer.startswith(b"HTTP/1.1 200")
    assert dashboard.face.said == ["limp", "limp"]


def test_a_client_that_is_answered_late_is_not_idle(monkeypatch):
    """Nor one that reads a stream: only what it must send itself is awaited for a bounded time."""
    monkeypatch.setattr(serving, "HEAD_S", 0.1)
    with served() as dashboard, dashboard.client() as client:
        body = {"level": "limp", "wait_s": 1}
        assert client.post("/api/stop", json=body).status_code == 200
        with connect(f"{dashboard.streams}/api/twin", proxy=None) as stream:
            for _ in range(30):
                stream.recv(20.0)


def test_a_stop_is_answered_beside_the_most_requests_that_are(monkeypatch, tmp_path):
    monkeypatch.setattr(access_layer, "_MOST_REQUESTS", 8)
    upload = b"POST /api/lines?name=a.wav HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 9\r\n\r\nR"
    with served({"sounds": str(tmp_path), "config": "face_sim"}) as dashboard:
        slow = [connected(dashboard, upload) for _ in range(4)]
        wait_for(lambda: httpx.get(f"{dashboard.address}/api/status").status_code == 503)
        assert post_stop(dashboard.address, "limp", 0, 20.0) == (200, {"accepted": "limp"})
        for each in slow:
            each.close()
        wait_for(lambda: httpx.get(f"{dashboard.address}/api/status").status_code == 200)
