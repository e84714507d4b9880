"""What systemd hears of a face, and when it hears nothing."""

import socket

import pytest

from firmware_bridge.process.operating_system import ServiceNotice


@pytest.fixture
def systemd(tmp_path, monkeypatch):
    """What systemd hears."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "notify"))
        listener.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        yield listener


def heard_in(seconds, systemd, face):
    """What systemd hears in so many seconds, second by second: few messages may wait."""
    said = []
    for _ in range(seconds):
        face.play(1.0)
        try:
            while True:
                said.append(systemd.recv(100).decode())
        except BlockingIOError:
            pass
    return said


def test_systemd_hears_that_the_face_is_ready_and_lives(systemd, face):
    assert heard_in(4, systemd, face)[:3] == ["READY=1", "WATCHDOG=1", "WATCHDOG=1"]


def test_systemd_hears_nothing_of_a_bridge_that_can_neither_be_killed_nor_replaced(systemd, face):
    """But a recovery has a minute, and a lost port all the time in the world."""
    face.bridge.beats, face.bridge.send = False, lambda _number: None
    assert len(heard_in(65, systemd, face)) > 50
    assert heard_in(20, systemd, face) == []
    face.unplugged, face.bridge.status = True, -9

    assert len(heard_in(100, systemd, face)) > 80


@pytest.mark.parametrize("address", ["/nonexistent/notify", "@gone", "x" * 200])
def test_a_stale_notify_socket_is_logged_once_and_kills_nobody(monkeypatch, caplog, address):
    monkeypatch.setenv("NOTIFY_SOCKET", address)
    now_s = [0.0]
    notice = ServiceNotice(lambda: now_s[0])
    notice.ready()
    for _ in range(5):
        now_s[0] += 2.0
        notice.alive()

    (line,) = caplog.messages
    assert address in line
