"""`lipservo.connect_async`: an agent with an event loop speaks through a face."""

import asyncio
import contextlib
import itertools
import threading
from collections import deque

import numpy as np
import pytest
from lipservo_client import async_face, wire
from lipservo_client.protocol import FaceError, Played, unit_messages
from voice_agents.served_face import DELAY_MS, RATE_HZ, ServedFace, tone, until

import lipservo
from lipservo.access.admission import Policy
from lipservo.agents.listener import AgentSettings
from lipservo.runtime.sound import SpeechItem
from lipsync.audio.playout_stream import PlayoutRequest, PlayoutStream
from lipsync.spoken_text import LONGEST_LABEL


async def test_sentences_one_after_the_other(served):
    async with lipservo.connect_async(served.url) as face:
        speeches = []
        for _ in range(3):
            async with face.stream() as speech:
                await speech.write(tone(0.1))
                speeches.append(speech)
        played = [await speech.wait() for speech in speeches]

    assert played == [Played(finished=True, played_s=0.1)] * 3


async def test_barge_in_from_another_task_ends_the_writing(served):
    async with lipservo.connect_async(served.url) as face, face.stream() as speech:

        async def listen():
            async for event in face.events():
                if event["type"] == "started":
                    return await face.interrupt()

        listening = asyncio.ensure_future(listen())
        n_written = 0
        while await speech.write(tone(0.5)):
            n_written += 1
            await asyncio.sleep(0.001)
        played = await listening

    assert n_written > 0
    assert not played.finished
    assert 0.0 < played.played_s < 0.5 * n_written


async def test_the_late_end_of_an_interrupted_stream_does_not_end_the_next(served):
    async with lipservo.connect_async(served.url) as face, face.stream() as old:
        await old.write(tone(20.0))
        await face.interrupt()
        events = face.events()
        async with face.stream() as reply:
            await reply.write(tone(0.1))
            await old.mark("late")
            await old.end()
            await reply.write(tone(0.1))
            played = await reply.wait()
        kinds = {event["type"] async for event in until_finished(events)}

    assert played == Played(finished=True, played_s=0.2)
    assert not kinds & {"error", "mark"}


async def until_finished(events):
    async for event in events:
        yield event
        if event["type"] == "finished":
            return


async def test_a_client_that_plays_the_sound_gets_the_delay_and_reports(served):
    async with lipservo.connect_async(served.url) as face, face.stream(playback="client") as speech:
        await speech.write(tone(1.0))
        await speech.report_played(0.5)
        played = await speech.wait()

    assert speech.delay_ms == DELAY_MS
    assert played.finished
    assert [n_samples for _, _, n_samples in served.reported] == [12_000]


async def test_many_commands_at_once_get_each_its_own_answer(served):
    async with lipservo.connect_async(served.url) as face:
        calls = [face.set("strength", value / 10) for value in range(5)]
        calls += [face.status(), face.say("hello")]
        *settings, status, said = await asyncio.gather(*calls, return_exceptions=True)

    assert [answer["value"] for answer in settings] == [0.0, 0.1, 0.2, 0.3, 0.4]
    assert status["state"] == "driven"
    assert isinstance(said, FaceError)


@pytest.mark.parametrize(("language", "code"), [("qq", "bad_text"), ("en_US", "bad_message")])
async def test_a_text_that_the_face_cannot_use_does_not_end_the_speech(served, language, code):
    async with lipservo.connect_async(served.url) as face, face.stream() as speech:
        events = face.events()
        await speech.tell("a", language=language)
        await speech.write(tone(0.1))
        async for event in events:
            if event["type"] == "error":
                break
        await speech.write(tone(0.1))
        played = await speech.wait()

    assert event["code"] == code
    assert played == Played(finished=True, played_s=0.2)


async def test_commands_are_sent_with_the_token_that_the_face_admitted_and_not_with_a_stale_one(
    monkeypatch,
):
    monkeypatch.setattr(wire, "found_tokens", lambda _url: ["stale", "right"])

    with ServedFace(AgentSettings(policy=Policy("right"))) as face:
        async with lipservo.connect_async(face.url) as client:
            assert (await client.set("strength", 0.8))["value"] == 0.8


async def test_a_client_that_came_to_a_full_face_may_do_more_than_stop_it_once_others_have_left(
    served,
):
    async with contextlib.AsyncExitStack() as others, lipservo.connect_async(served.url) as face:
        for _ in range(7):
            await others.enter_async_context(lipservo.connect_async(served.url))
        with pytest.raises(FaceError) as refused:
            await face.set("strength", 0.7)
        await others.aclose()
        await asyncio.to_thread(until, lambda: served.server.status()["n_clients"] == 1)
        assert refused.value.code == "unauthorized"
        assert (await face.set("strength", 0.8))["value"] == 0.8


async def test_a_text_of_many_sentences_is_waited_for_as_long_as_the_face_speaks(monkeypatch):
    """Its duration is known of the first sentence alone; limit and speech are a thousandth."""
    monkeypatch.setattr(async_face, "STILL_S", 0.31)

    def say(given, name):
        rates_hz = RATE_HZ, face.playout.output_rate_hz
        streams = [PlayoutStream(name, *rates_hz) for _ in range(20)]
        for stream in streams:
            stream.push(np.frombuffer(tone(1.0), "<i2").astype(np.float32) / 32_768)
            stream.end()

        def pieces():
            for last, stream in itertools.pairwise(streams):
                face.playout.requests.append(PlayoutRequest("say", stream, after=last))
                yield stream

        spoken = SpeechItem(pieces(), deque(streams[:1]), 2.0, 0.05)
        face._queue.add(spoken, given.text)
        return spoken

    with ServedFace(say=say) as face:
        async with lipservo.connect_async(face.url) as client:
            answer = await client.say("twenty sentences", wait=True)

    assert (answer["finished"], round(answer["played_s"])) == (True, 20)


def test_a_label_longer_than_a_face_takes_is_cut_short():
    url = "https://example.org/" + "a" * 200
    (message,) = unit_messages(("words", [url, (url, 0, 9)]))

    label = url[:LONGEST_LABEL]
    timed = {"label": label, "start_sample": 0, "end_sample": 9}
    assert message == {"type": "words", "units": [{"label": label}, timed]}


async def test_a_text_that_is_dropped_before_its_command_is_answered_is_not_waited_for_in_vain():
    synthesises, synthesised = threading.Event(), threading.Event()

    def say(given, name):
        synthesises.set()
        assert synthesised.wait(60.0)
        return face._say(given, name)

    with ServedFace(say=say) as face:
        async with lipservo.connect_async(face.url) as client:
            said = asyncio.ensure_future(client.say("good day", wait=True))
            await asyncio.to_thread(synthesises.wait, 60.0)
            await client.interrupt()
            while face.server._streams._own_items:
                await asyncio.sleep(0.002)
            synthesised.set()
            answer = await asyncio.wait_for(said, 60.0)

    assert (answer["finished"], answer["played_s"]) == (False, 0.0)
    # What was on its way before the face heard of the end may be heard: a tenth of a second.
    assert (face.sound.played() != 0.0).sum() < 2400
