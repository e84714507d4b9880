"""Commands by WebSocket reach the face's own control socket, and their results come back."""

import asyncio
import contextlib
import json
import socket
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from places import ROOT, short_folder
from voice_agents.served_face import ServedFace, client, until

from firmware_bridge.stopping import StopLevel
from lipservo.agents import control_session
from lipservo.agents.control_session import Commands, ControlSession
from lipservo.agents.messages import Outbox
from lipsync.errors import UserError


def commanded(face, *messages):
    """The answer to each message."""

    async def talk():
        async with client(face, "/control") as agent:
            answers = []
            for number, (kind, fields) in enumerate(messages):
                await agent.say(kind, id=number, **fields)
                answers.append(await agent.next("result", "error"))
            return answers

    return asyncio.run(talk())


def test_status_and_settings_are_the_faces_own():
    with ServedFace() as face:
        status, done, refused, unknown = commanded(
            face,
            ("status", {}),
            ("set", {"name": "strength", "value": 0.5}),
            ("set", {"name": "strength", "value": 5}),
            ("set", {"name": "beauty", "value": 1.0}),
        )
        changes = face.commands.take_changes()

    assert status["type"] == "result"
    assert status["id"] == 0
    assert status["result"]["state"] == "driven"
    assert done["result"]["value"] == 0.5
    assert changes == {"strength": 0.5}
    assert (refused["code"], refused["id"]) == ("refused", 2)
    assert "0 to 2" in refused["message"]
    assert unknown["code"] == "refused"


@pytest.mark.parametrize("level", [StopLevel.SOFT, StopLevel.FREEZE, StopLevel.LIMP])
def test_a_stop_reaches_the_face(level):
    with ServedFace() as face:
        (answer,) = commanded(face, ("stop", {"level": level.value}))
        until(lambda: face.stops)

    assert answer["type"] == "result"
    assert face.stops == [level]


def test_a_face_that_does_not_answer_is_told():
    with ServedFace() as face:
        face.path.unlink()
        (answer,) = commanded(face, ("status", {}))

    assert answer["code"] == "not_answering"


def test_say_and_play_are_what_the_face_has():
    def say(text):
        if text == "gibberish":
            raise UserError("text: no such words")
        return {"duration_s": 0.1 * len(text)}

    with ServedFace(say=say) as face:
        said, refused, no_play = commanded(
            face,
            ("say", {"text": "hello 🙂"}),
            ("say", {"text": "gibberish"}),
            ("play", {"file": "clip.wav"}),
        )

    assert said["result"] == {"duration_s": pytest.approx(0.7)}
    assert (refused["code"], refused["message"]) == ("refused", "text: no such words")
    assert no_play["code"] == "not_available"


@pytest.mark.parametrize(
    ("kind", "fields", "code"),
    [
        ("say", {"text": ""}, "bad_message"),
        ("say", {"text": "a" * 20_001}, "bad_message"),
        ("stop", {"level": "gently"}, "bad_message"),
        ("set", {"name": "strength", "value": "much"}, "bad_message"),
        ("set", {"name": "strength"}, "bad_message"),
    ],
)
def test_a_wrong_command_is_told_with_its_id(kind, fields, code):
    with ServedFace(say=lambda _: None) as face:
        (answer,) = commanded(face, (kind, fields))

    assert (answer["code"], answer["id"]) == (code, 0)
    assert len(answer["message"]) < 200


def test_a_stop_waits_for_no_synthesiser_and_too_many_commands_are_refused():
    go_on = threading.Event()

    def say(_):
        go_on.wait(60.0)

    with ServedFace(say=say) as face:

        async def talk():
            async with client(face, "/control") as agent:
                for number in range(7):
                    await agent.say("say", id=number, text="long")
                await agent.say("stop", id="stop")
                stopped = await agent.next("result", "error")
                for number in range(2):
                    await agent.say("say", id=f"more {number}", text="long")
                refused = await agent.next("error")
                go_on.set()
                for _ in range(8):
                    await agent.next("result")
                return stopped, refused

        stopped, refused = asyncio.run(talk())

    assert (stopped["type"], stopped["id"]) == ("result", "stop")
    assert (refused["code"], refused["id"]) == ("too_many_requests", "more 1")


def test_audio_on_the_wrong_connection_and_text_that_is_none_are_told():
    with ServedFace() as face:

        async def talk():
            async with client(face, "/control") as agent:
                await agent.send(b"\0\0")
                binary = await agent.next("error")
                await agent.send("status")
                return binary, await agent.next("error")

        binary, text = asyncio.run(talk())

    assert (binary["code"], text["code"]) == ("unexpected_binary", "bad_json")


class Ear:
    """A face's control socket that keeps the words, and answers as it is set: None, not at all."""

    def __init__(self, answer=None):
        self.answer = answer
        self.path = short_folder() / "ear.sock"
        self.words = []

    def __enter__(self):
        self._clients = []
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._listener.bind(str(self.path))
        self._listener.listen(64)
        threading.Thread(target=self._hear, daemon=True).start()
        return self

    def __exit__(self, *exc):
        self._listener.shutdown(socket.SHUT_RDWR)
        for each in (self._listener, *self._clients):
            each.close()

    def _hear(self):
        with contextlib.suppress(OSError):
            while True:
                client, _ = self._listener.accept()
                self._clients.append(client)
                self.words.append(client.recv(4096).decode())
                if self.answer is not None:
                    client.send(json.dumps(self.answer(self.words[-1])).encode())


def session_at(path, outbox, pool=None):
    return ControlSession(outbox, Commands(path, None, None, pool, pool, pool))


def test_a_stop_passes_two_files_after_its_message_and_needs_no_thread(monkeypatch):
    """The third is the server's own, which hands the message on."""
    files = [f"{ROOT / name}/" for name in ("lipservo", "firmware_bridge", "lipsync")]
    calls = []

    def profile(frame, event, _argument):
        name = frame.f_code.co_filename
        if event == "call" and any(name.startswith(each) for each in files):
            calls.append((Path(name).name, frame.f_code.co_name))

    def sent(path, level, *, end):
        sys.setprofile(None)
        calls.append(("control_client.py", "send_stop"))
        return real(path, level, end=end)

    real = control_session.send_stop
    monkeypatch.setattr(control_session, "send_stop", sent)

    async def stopped(path):
        outbox = Outbox()
        session = session_at(path, outbox)
        sys.setprofile(profile)
        try:
            await session.hear('{"type": "stop", "id": 1, "level": "limp"}')
        finally:
            sys.setprofile(None)
        return json.loads(await outbox.take())

    with Ear(lambda word: {"accepted": word}) as ear:
        result = asyncio.run(stopped(ear.path))

    assert result == {"type": "result", "id": 1, "result": {"accepted": "limp"}}
    assert ear.words == ["limp"]
    assert {file for file, _ in calls} == {"control_session.py", "control_client.py"}
    assert len(calls) <= 6, calls


def test_a_stop_waits_for_no_pending_command_and_no_stop_for_another():
    """The face takes every word and answers none: the ninth stop goes out as the first did."""

    async def stopped(ear):
        outbox = Outbox()
        session = session_at(ear.path, outbox)
        for number in range(12):
            await session.hear(json.dumps({"type": "stop", "id": number, "level": "soft"}))
            await asyncio.sleep(0)
        refused = [json.loads(await outbox.take()) for _ in range(4)]
        session.leave()
        return refused

    with Ear() as ear:
        refused = asyncio.run(stopped(ear))
        until(lambda: len(ear.words) == 12)

    assert ear.words == ["soft"] * 12
    assert [(each["id"], each["code"]) for each in refused] == [
        (number, "too_many_requests") for number in range(4)
    ]


def test_a_stop_may_wait_for_what_the_servos_confirm():
    def reports(_word):
        return {"accepted": "soft"}

    with Ear(reports) as ear:

        async def stopped():
            outbox = Outbox()
            session = session_at(ear.path, outbox)
            await session.hear('{"type": "stop", "id": 1, "wait_s": 20}')
            while not ear._clients:
                await asyncio.sleep(0.01)
            await asyncio.to_thread(until, lambda: ear.words == ["soft"])
            ear._clients[0].send(json.dumps({"ended": True, "confirmed": ["jaw"]}).encode())
            return json.loads(await outbox.take())["result"]

        result = asyncio.run(stopped())

    assert result["report"]["confirmed"] == ["jaw"]


def test_a_stopped_face_is_started_and_a_daemon_ended():
    with Ear(lambda word: {"accepted": word}) as ear:

        async def talk():
            outbox = Outbox()
            with ThreadPoolExecutor(1) as pool:
                session = session_at(ear.path, outbox, pool)
                await session.hear('{"type": "start", "id": 1}')
                started = json.loads(await outbox.take())
                await session.hear('{"type": "stop", "id": 2, "level": "soft", "end": true}')
                return started, json.loads(await outbox.take())

        started, ended = asyncio.run(talk())

    assert started["result"] == {"accepted": "start"}
    assert ended["result"] == {"accepted": "soft end"}


def test_a_change_waits_for_no_client_that_polls():
    """Every thread that asks for a status waits for a face that does not answer one."""

    async def talk(face):
        async with client(face, "/control") as polling, client(face, "/control") as agent:
            for number in range(8):
                await polling.say("status", id=number)
            await agent.say("set", id="set", name="strength", value=0.5)
            return await agent.next("result", "error")

    with ServedFace() as face:
        blocked = threading.Event()
        pool = face.server._commands.statuses
        for _ in range(2):
            pool.submit(blocked.wait, 60.0)
        try:
            done = asyncio.run(talk(face))
        finally:
            blocked.set()
    assert (done["type"], done["id"]) == ("result", "set")
