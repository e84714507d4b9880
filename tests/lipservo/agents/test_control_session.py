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
from lipservo.agents.listener import AgentSettings
from lipservo.agents.messages import Outbox
from lipservo.agents.turns import OpenStreams
from lipsync.audio.playout import Playout
from lipsync.errors import UserError


async def commanded(face, *messages):
    """The answer to each message."""
    async with client(face, "/control") as agent:
        answers = []
        for number, (kind, fields) in enumerate(messages):
            await agent.say(kind, id=number, **fields)
            answers.append(await agent.next("result", "error"))
        return answers


def voiceless(go_on=None):
    """What says no text, as soon as it may go on."""

    def say(_text, _name):
        if go_on is not None:
            go_on.wait(60.0)
        raise UserError("text: no such words")

    return say


async def test_status_and_settings_are_the_faces_own(face):
    status, done, refused, unknown = await commanded(
        face,
        ("status", {}),
        ("set", {"name": "strength", "value": 0.5}),
        ("set", {"name": "strength", "value": 5}),
        ("set", {"name": "beauty", "value": 1.0}),
    )

    assert (status["type"], status["id"]) == ("result", 0)
    assert status["result"]["state"] == "driven"
    assert done["result"]["value"] == 0.5
    assert face.commands.take_changes() == {"strength": 0.5}
    assert (refused["code"], refused["id"]) == ("refused", 2)
    assert "0 to 2" in refused["message"]
    assert unknown["code"] == "refused"


@pytest.mark.parametrize("level", [StopLevel.SOFT, StopLevel.FREEZE, StopLevel.LIMP])
async def test_a_stop_reaches_the_face(face, level):
    (answer,) = await commanded(face, ("stop", {"level": level.value}))
    until(lambda: face.stops)

    assert answer["type"] == "result"
    assert face.stops == [level]


async def test_a_face_that_does_not_answer_is_told(face):
    face.path.unlink()
    (answer,) = await commanded(face, ("status", {}))

    assert answer["code"] == "not_answering"


async def test_a_text_that_cannot_be_said_is_refused_in_the_faces_words():
    with ServedFace(say=voiceless()) as face:
        refused, no_play = await commanded(
            face, ("say", {"text": "gibberish"}), ("play", {"file": "clip.wav"})
        )

    assert (refused["code"], refused["message"]) == ("refused", "text: no such words")
    assert no_play["code"] == "not_available"


async def spoken(face, *texts, interrupts=False):
    """All that a client is told that lets the face say texts, until each of them has ended."""
    async with client(face, "/control") as agent, client(face) as other:
        for number, text in enumerate(texts):
            await agent.say("say", id=number, text=text)
        if interrupts:
            for _ in texts:
                await agent.next("result")
            await other.say("interrupt")
        for _ in texts:
            await agent.next("finished", "dropped")
        return agent.heard


async def test_a_text_has_a_name_a_length_a_beginning_and_an_end():
    with ServedFace(has_voice=True) as face:
        heard = await spoken(face, "hello")

    result, started, finished = sorted(heard, key=lambda event: event["type"] != "result")
    name = result["result"]["stream"]
    assert result["result"]["duration_s"] == 0.5
    assert (started["type"], started["id"], started["stream"]) == ("started", 0, name)
    assert (finished["type"], finished["id"], finished["stream"]) == ("finished", 0, name)
    assert finished["played_s"] == pytest.approx(0.5, abs=0.03)


async def test_texts_that_are_cut_off_are_dropped_each_by_its_id():
    with ServedFace(has_voice=True) as face:
        heard = await spoken(face, "a" * 2_500, "b" * 200, interrupts=True)

    dropped = [event for event in heard if event["type"] == "dropped"]
    assert [event["id"] for event in dropped] == [0, 1]
    assert 0.0 <= dropped[0]["played_s"] < 250.0
    assert dropped[1]["played_s"] == 0.0


async def test_a_text_may_ask_for_a_language_a_voice_a_rate_and_a_pitch():
    voice = {"language": "de", "voice": "joe", "rate_wpm": 120, "pitch": 30}
    with ServedFace(has_voice=True) as face:
        (answer,) = await commanded(face, ("say", {"text": "Guten Tag", **voice}))

    assert answer["type"] == "result"
    assert {name: face.asked[0][name] for name in voice} == voice


async def test_a_text_waits_for_no_agent_that_speaks_where_one_speaks_at_a_time():
    with ServedFace(has_voice=True) as face:
        async with client(face) as other, client(face, "/control") as agent:
            await other.start()
            await agent.say("say", id=7, text="hello")
            busy = await agent.next("error")

    assert (busy["code"], busy["id"]) == ("busy", 7)


async def test_a_request_of_an_unknown_type_is_answered_with_its_id_and_an_id_in_use_is_refused():
    go_on = threading.Event()
    with ServedFace(say=voiceless(go_on)) as face:
        async with client(face, "/control") as agent:
            await agent.say("dance", id="d")
            unknown = await agent.next("error")
            await agent.say("say", id="s", text="hello")
            await agent.say("status", id="s")
            in_use = await agent.next("error")
            go_on.set()
            await agent.next("error")
            await agent.say("status", id="s")
            status = await agent.next("result")

    assert (unknown["code"], unknown["id"]) == ("unknown_type", "d")
    assert "protocol 2" in unknown["message"]
    assert (in_use["code"], in_use["id"]) == ("bad_message", "s")
    assert status["id"] == "s"


async def test_a_wrong_command_is_told_with_its_id():
    wrong = [
        ("say", {"text": ""}),
        ("say", {"text": "a" * 20_001}),
        ("say", {"text": "a", "language": "German"}),
        ("say", {"text": "a", "rate_wpm": 9000}),
        ("say", {"text": "a", "pitch": "high"}),
        ("stop", {"level": "gently"}),
        ("set", {"name": "strength", "value": "much"}),
        ("set", {"name": "strength"}),
    ]
    with ServedFace(has_voice=True) as face:
        answers = await commanded(face, *wrong)

    told = [(answer["code"], answer["id"]) for answer in answers]
    assert told == [("bad_message", number) for number in range(len(wrong))]
    assert max(len(answer["message"]) for answer in answers) < 200


async def test_a_stop_waits_for_no_synthesiser_and_too_many_commands_are_refused():
    go_on = threading.Event()
    with ServedFace(say=voiceless(go_on)) as face:
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
                await agent.next("error")

    assert (stopped["type"], stopped["id"]) == ("result", "stop")
    assert (refused["code"], refused["id"]) == ("too_many_requests", "more 1")


async def test_audio_on_the_wrong_connection_and_text_that_is_none_are_told(face):
    async with client(face, "/control") as agent:
        await agent.send(b"\0\0")
        binary = await agent.next("error")
        await agent.send("status")
        text = await agent.next("error")

    assert (binary["code"], text["code"]) == ("unexpected_binary", "bad_json")


class Ear:
    """A face's control socket that keeps the words, and answers as it is set: None, not at all."""

    def __init__(self, answer=None):
        self.answer = answer
        self.path = short_folder() / "ear.sock"
        self.words, self.outbox = [], Outbox()

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

    def session(self, pool=None):
        """The session of a client of this face."""
        turns = OpenStreams(Playout(), AgentSettings())
        commands = Commands(self.path, None, None, pool, pool, pool)
        return ControlSession(self.outbox, commands, turns)

    async def told(self):
        """What the client is told next."""
        return json.loads(await self.outbox.take())

    def _hear(self):
        with contextlib.suppress(OSError):
            while True:
                client, _ = self._listener.accept()
                self._clients.append(client)
                self.words.append(client.recv(4096).decode())
                if self.answer is not None:
                    client.send(json.dumps(self.answer(self.words[-1])).encode())


def accepted(word):
    return {"accepted": word}


async def test_a_stop_passes_two_files_after_its_message_and_needs_no_thread(monkeypatch):
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

    with Ear(accepted) as ear:
        session = ear.session()
        sys.setprofile(profile)
        try:
            await session.hear('{"type": "stop", "id": 1, "level": "limp"}')
        finally:
            sys.setprofile(None)
        result = await ear.told()

    assert result == {"type": "result", "id": 1, "result": {"accepted": "limp"}}
    assert ear.words == ["limp"]
    assert {file for file, _ in calls} == {"control_session.py", "control_client.py"}
    assert len(calls) <= 6, calls


async def test_a_client_is_answered_once_the_face_has_taken_its_stop_and_not_before():
    may_answer = threading.Event()

    def answer(word):
        may_answer.wait(60.0)
        return accepted(word)

    with Ear(answer) as ear:
        await ear.session().hear('{"type": "stop", "id": 1, "level": "limp"}')
        result = asyncio.ensure_future(ear.told())
        await asyncio.to_thread(until, lambda: ear.words == ["limp"])
        await asyncio.sleep(0.05)
        assert not result.done()
        may_answer.set()
        assert (await result)["result"] == {"accepted": "limp"}


async def test_a_stop_waits_for_no_pending_command_and_no_stop_for_another():
    """The face takes every word and answers none: the ninth stop goes out as the first did."""
    with Ear() as ear:
        session = ear.session()
        for number in range(12):
            await session.hear(json.dumps({"type": "stop", "id": number, "level": "soft"}))
            await asyncio.sleep(0)
        refused = [await ear.told() for _ in range(4)]
        session.leave()
        until(lambda: len(ear.words) == 12)

    assert ear.words == ["soft"] * 12
    assert [each["id"] for each in refused] == [0, 1, 2, 3]
    assert {each["code"] for each in refused} == {"too_many_requests"}


async def test_a_stop_may_wait_for_what_the_servos_confirm():
    with Ear(accepted) as ear:
        session = ear.session()
        await session.hear('{"type": "stop", "id": 1, "wait_s": 20}')
        while not ear._clients:
            await asyncio.sleep(0.01)
        await asyncio.to_thread(until, lambda: ear.words == ["soft"])
        ear._clients[0].send(json.dumps({"ended": True, "confirmed": ["jaw"]}).encode())
        assert (await ear.told())["result"]["report"]["confirmed"] == ["jaw"]


async def test_a_stopped_face_is_started_and_a_daemon_ended():
    with Ear(accepted) as ear, ThreadPoolExecutor(1) as pool:
        session = ear.session(pool)
        await session.hear('{"type": "start", "id": 1}')
        assert (await ear.told())["result"] == {"accepted": "start"}
        await session.hear('{"type": "stop", "id": 2, "level": "soft", "end": true}')
        assert (await ear.told())["result"] == {"accepted": "soft end"}


async def test_a_change_waits_for_no_client_that_polls(face):
    """Every thread that asks for a status waits for a face that does not answer one."""
    blocked = threading.Event()
    pool = face.server._commands.statuses
    for _ in range(2):
        pool.submit(blocked.wait, 60.0)
    try:
        async with client(face, "/control") as polling, client(face, "/control") as agent:
            for number in range(8):
                await polling.say("status", id=number)
            await agent.say("set", id="set", name="strength", value=0.5)
            done = await agent.next("result", "error")
    finally:
        blocked.set()
    assert (done["type"], done["id"]) == ("result", "set")
