"""Commands by WebSocket reach the face's own control socket, and their results come back."""

import asyncio
import threading

import pytest
from voice_agents.served_face import ServedFace, client, until

from firmware_bridge.stopping import StopLevel
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
