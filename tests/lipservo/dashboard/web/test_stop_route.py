"""A stop by HTTP: how few files it passes, and that nothing else of the dashboard holds it up."""

import asyncio
import contextlib
import json
import socket
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
import soundfile
from places import ROOT, short_folder
from served_dashboard import served, wait_for
from watched_face import WatchedFace

from lipservo.dashboard import sound_lines as uploads
from lipservo.dashboard.face_link import FaceLink, NothingDrivenError
from lipservo.dashboard.web.serving import with_access
from lipservo.dashboard.web.stop_route import StopRoute


def scope(**more):
    """Return the ASGI scope of a stop from this computer; `more` replaces fields."""
    return {
        "type": "http",
        "method": "POST",
        "path": "/api/stop",
        "query_string": b"",
        "headers": [(b"host", b"127.0.0.1:8080"), (b"content-type", b"application/json")],
        "client": ("127.0.0.1", 50_000),
        "server": ("127.0.0.1", 8080),
        **more,
    }


async def posted(app, *parts, **more):
    """Status and JSON of a stop whose body comes in these parts."""
    coming = [
        {"type": "http.request", "body": part, "more_body": n < len(parts) - 1}
        for n, part in enumerate(parts)
    ]
    sent = []

    async def receive():
        return coming.pop(0) if coming else await asyncio.Event().wait()

    async def send(message):
        sent.append(message)

    await app(scope(**more), receive, send)
    return sent[0]["status"], json.loads(sent[1]["body"])


@pytest.fixture
def face():
    with WatchedFace(short_folder() / "tom.sock") as made:
        yield made


@pytest.fixture
def app(face):
    link = FaceLink(lambda: face.path, control_path=face.path)
    yield with_access(None, link, "a secret")
    link.close()


class Walk:
    """The files and calls of ours, in the event loop's thread, until the stop is sent."""

    def __init__(self, monkeypatch):
        self.calls = []
        self.thread = threading.get_ident()
        monkeypatch.setattr(socket, "socket", self._socket)
        self._made = False
        self._files = [f"{ROOT / name}/" for name in ("lipservo", "firmware_bridge", "lipsync")]

    def _socket(self, *arguments, _kind=socket.socket, **options):
        walk = self

        class Sent(_kind):
            def send(self, data, *flags):
                if threading.get_ident() == walk.thread:  # not the face's own end
                    sys.setprofile(None)
                    walk.sent = data
                return super().send(data, *flags)

        return Sent(*arguments, **options)

    def profile(self, frame, event, _argument):
        name = frame.f_code.co_filename
        if event == "call" and any(name.startswith(each) for each in self._files):
            self.calls.append((Path(name).name, frame.f_code.co_name))

    @property
    def files(self):
        return {file for file, _ in self.calls}


def test_a_stop_passes_three_files_and_few_calls_before_it_is_sent(app, face, monkeypatch):
    walk = Walk(monkeypatch)

    async def traced():
        sys.setprofile(walk.profile)
        try:
            return await posted(app, b'{"level": "limp", "wait_s": 0}')
        finally:
            sys.setprofile(None)

    assert asyncio.run(traced()) == (200, {"accepted": "limp"})
    assert walk.sent == b"limp"
    assert walk.files == {"stop_route.py", "admission.py", "control_client.py"}
    assert len(walk.calls) <= 15, walk.calls
    wait_for(lambda: face.said == ["limp"])


@pytest.mark.parametrize(
    ("body", "status"),
    [
        (b"{", 400),
        (b"\xff\xfe", 400),
        (b"limp", 400),
        (b"{" * 1000, 400),
        (b"[]", 422),
        (b"null", 422),
        (b'"limp"', 422),
        (b'{"level": "hard"}', 422),
        (b'{"level": ""}', 422),
        (b'{"level": null}', 422),
        (b'{"level": ["limp"]}', 422),
        (b'{"level": "soft", "twice": true}', 422),
        (b'{"wait_s": -1}', 422),
        (b'{"wait_s": 31}', 422),
        (b'{"wait_s": "5"}', 422),
        (b'{"wait_s": NaN}', 422),
        (b'{"end": 1}', 422),
        (b'{"level": "soft"}' + b" " * 2000, 413),
    ],
)
def test_what_is_no_stop_is_refused_and_nothing_is_sent(app, face, body, status):
    got, answer = asyncio.run(posted(app, body))

    assert got == status
    assert list(answer) == ["error"]
    assert len(answer["error"].splitlines()) == 1
    assert face.said == []


def test_where_no_face_drives_servos_a_stop_says_so_at_once():
    def find():
        raise NothingDrivenError("No step runs", is_limp=True)

    link = FaceLink(find)
    status, answer = asyncio.run(posted(with_access(None, link, "a secret"), b'{"wait_s": 15}'))
    link.close()

    assert status == 200
    assert answer == {"accepted": None, "nothing_driven": "No step runs", "is_limp": True}


@pytest.mark.parametrize(
    ("body", "words"), [(b"", ["soft"]), (b"{}", ["soft"]), (b'{"level":"freeze"}', ["freeze"])]
)
def test_a_body_may_be_empty_or_come_in_parts(app, face, body, words):
    parts = [body[n : n + 1] for n in range(len(body))] or [b""]
    assert asyncio.run(posted(app, *parts))[0] == 200
    wait_for(lambda: face.said == words)


def test_a_freeze_is_waited_for_no_longer_than_its_answer(app):
    answered = asyncio.run(posted(app, b'{"level": "freeze", "wait_s": 30}'))
    assert answered == (200, {"accepted": "freeze", "report": None})


def test_a_client_that_goes_in_the_middle_of_a_body_stops_nothing(face):
    link = FaceLink(lambda: face.path, control_path=face.path)
    sent = []

    async def gone():
        coming = [
            {"type": "http.request", "body": b'{"level": "limp"}', "more_body": True},
            {"type": "http.disconnect"},
        ]

        async def receive():
            return coming.pop(0)

        async def send(message):
            sent.append(message)

        await StopRoute(None, link, None)(scope(), receive, send)

    asyncio.run(gone())
    link.close()
    assert sent[0]["status"] == 400
    assert face.said == []


class SlowBody:
    """A client that sends one byte of its body, and then no more."""

    def __init__(self):
        self.begun = asyncio.Event()
        self.sent = []

    async def receive(self):
        if self.begun.is_set():
            await asyncio.Event().wait()
        self.begun.set()
        return {"type": "http.request", "body": b"{", "more_body": True}

    async def send(self, message):
        self.sent.append(message)


def test_a_body_that_does_not_come_holds_up_no_other_stop(app, face):
    async def both():
        slow = SlowBody()
        waiting = asyncio.ensure_future(app(scope(), slow.receive, slow.send))
        await slow.begun.wait()
        quick = await posted(app, b'{"level": "limp"}')
        is_waiting = not waiting.done()
        waiting.cancel()
        return quick, is_waiting

    assert asyncio.run(both()) == ((200, {"accepted": "limp"}), True)
    wait_for(lambda: face.said == ["limp"])


def test_the_bridge_that_is_replaced_is_sent_the_stop_again():
    """The first process hangs up without an answer; the next answers, and reports the end."""
    path = short_folder() / "tom.sock"
    words = []
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(str(path))
        listener.listen()

        def face():
            for answers in ([], [{"accepted": "soft"}, {"ended": True, "confirmed": ["jaw"]}]):
                client, _ = listener.accept()
                with client:
                    words.append(client.recv(100))
                    for answer in answers:
                        client.send(json.dumps(answer).encode())

        thread = threading.Thread(target=face, daemon=True)
        thread.start()
        link = FaceLink(lambda: path, control_path=path)
        app = StopRoute(None, link, None)
        status, answer = asyncio.run(posted(app, b'{"wait_s": 20}'))
        link.close()
        thread.join(20.0)

    assert words == [b"soft", b"soft"]
    assert (status, answer["report"]["confirmed"]) == (200, ["jaw"])


def test_a_client_is_answered_once_the_face_has_taken_its_stop_and_not_before():
    path = short_folder() / "tom.sock"
    words, may_answer = [], threading.Event()
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(str(path))
        listener.listen()

        def face():
            client, _ = listener.accept()
            with client:
                words.append(client.recv(100))
                may_answer.wait(60.0)
                client.send(b'{"accepted": "limp"}')

        thread = threading.Thread(target=face, daemon=True)
        thread.start()

        async def stopped():
            link = FaceLink(lambda: path, control_path=path)
            answer = asyncio.ensure_future(posted(StopRoute(None, link, None), b'{"level":"limp"}'))
            await asyncio.to_thread(wait_for, lambda: words == [b"limp"])
            await asyncio.sleep(0.05)
            is_early = answer.done()
            may_answer.set()
            got = await answer
            link.close()
            return is_early, got

        assert asyncio.run(stopped()) == (False, (200, {"accepted": "limp"}))
        thread.join(20.0)


def test_a_stop_passes_a_busy_loop_a_full_pool_and_a_slow_upload(tmp_path, monkeypatch):
    """Twenty clients poll, threads wait, the disk takes as long as the test, a body never ends."""
    soundfile.write(tmp_path / "sound.wav", 0.1 * np.sin(np.arange(16_000)), 16_000)
    sound = (tmp_path / "sound.wav").read_bytes()
    is_over, in_fsync = threading.Event(), threading.Event()

    def fsync(_fd):
        in_fsync.set()
        is_over.wait(60.0)

    monkeypatch.setattr(uploads.os, "fsync", fsync)
    (tmp_path / "sounds").mkdir()
    with served({"sounds": str(tmp_path / "sounds"), "config": "face_sim"}) as dashboard:
        n_answers = []

        def poll():
            with contextlib.suppress(Exception), dashboard.client() as client:
                while not is_over.is_set():
                    for path in ("/api/status", "/api/calibration", "/metrics"):
                        n_answers.append(client.get(path).status_code)

        def upload():
            with contextlib.suppress(Exception), dashboard.client() as client:
                client.post("/api/lines", params={"name": "a.wav"}, content=sound)

        host, port = dashboard.address.removeprefix("http://").split(":")
        with socket.create_connection((host, int(port))) as dribbling:
            head = b"POST /api/stop HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 17\r\n\r\n{"
            dribbling.sendall(head)
            threads = [threading.Thread(target=poll, daemon=True) for _ in range(20)]
            threads.append(threading.Thread(target=upload, daemon=True))
            for thread in threads:
                thread.start()
            for _ in range(4):
                for pool in (dashboard.link._command_pool, dashboard.link._status_pool):
                    pool.submit(is_over.wait, 60.0)
            try:
                assert in_fsync.wait(30.0)
                wait_for(lambda: len(n_answers) > 20)
                with dashboard.client() as client:
                    answer = client.post("/api/stop", json={"level": "limp"})
                assert answer.json() == {"accepted": "limp"}
                wait_for(lambda: dashboard.face.said == ["limp"])
                assert not (tmp_path / "sounds" / "a.wav").exists()
            finally:
                is_over.set()
                for thread in threads:
                    thread.join(30.0)


def test_a_start_is_sent_and_waited_for_until_the_face_is_driven():
    path = short_folder() / "tom.sock"
    words, states = [], ["the bridge starts again", "starting", "driven"]
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(str(path))
        listener.listen()

        def face():
            with contextlib.suppress(OSError):
                while True:
                    client, _ = listener.accept()
                    with client:
                        words.append(client.recv(100).decode())
                        answer = {"accepted": "start"}
                        if words[-1] == "status":
                            servos = {"jaw": "driven"} if len(states) == 1 else {"jaw": "limp"}
                            answer = {"state": states[0], "servos": servos, "troubles": []}
                            del states[: len(states) > 1]
                        client.send(json.dumps(answer).encode())

        threading.Thread(target=face, daemon=True).start()

        async def started():
            link = FaceLink(lambda: path, control_path=path)
            try:
                return [dict(await link.start()), dict(await link.start(20.0))]
            finally:
                link.close()

        at_once, waited = asyncio.run(started())
        listener.shutdown(socket.SHUT_RDWR)

    assert at_once == {"accepted": "start"}
    assert waited == {
        "accepted": "start",
        "state": "driven",
        "servos": {"jaw": "driven"},
        "troubles": [],
    }
    assert words[:2] == ["start", "start"]
