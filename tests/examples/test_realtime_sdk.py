"""The OpenAI example with the SDK's own event objects."""

import asyncio
import base64
import importlib.util

import pytest
from places import ROOT
from voice_agents.served_face import ServedFace, tone

import lipservo
from lipsync.audio.playout_stream import PlayoutRequest

realtime = pytest.importorskip("openai.types.realtime", reason="pip install openai")


def example():
    path = ROOT / "examples" / "openai_realtime.py"
    spec = importlib.util.spec_from_file_location("openai_realtime", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def item_events(item_id, duration_s):
    about = {"item_id": item_id, "response_id": "r", "output_index": 0, "content_index": 0}
    delta = base64.b64encode(tone(duration_s)).decode()
    yield realtime.ResponseAudioDeltaEvent(
        type="response.output_audio.delta", event_id="d", delta=delta, **about
    )
    yield realtime.ResponseAudioDoneEvent(type="response.output_audio.done", event_id="e", **about)


def delta(item_id, duration_s):
    return next(item_events(item_id, duration_s))


def started():
    return realtime.InputAudioBufferSpeechStartedEvent(
        type="input_audio_buffer.speech_started", event_id="s", item_id="u", audio_start_ms=9
    )


async def sounding(face, n_samples=1):
    while len(face.sound.played().nonzero()[0]) < n_samples:
        await asyncio.sleep(0.002)


def talked(work, **given):
    """What `work(voice, face)` returns, and how many samples were heard by then."""

    async def talk(face):
        async with lipservo.connect_async(face.url) as connection:
            answer = await work(example().RealtimeVoice(connection), face)
            return answer, 0 if face.sound is None else len(face.sound.played().nonzero()[0])

    with ServedFace(**given) as face:
        return asyncio.run(asyncio.wait_for(talk(face), 60.0))


def test_a_barge_in_truncates_what_is_said_where_it_was_heard_and_what_is_queued_at_its_start():
    async def work(voice, face):
        for item_id, duration_s in (("first", 0.2), ("second", 20.0), ("third", 5.0)):
            for event in item_events(item_id, duration_s):
                assert await voice.hear(event) == []
        await sounding(face, 24_000)
        return await voice.hear(started())

    answers, _ = talked(work)
    second, third = answers  # the first was heard whole, and is left alone
    assert (second["item_id"], third["item_id"]) == ("second", "third")
    assert 0 < second["audio_end_ms"] < 20_000
    assert third["audio_end_ms"] == 0
    sent = [realtime.ConversationItemTruncateEvent(**answer) for answer in answers]
    assert [each.type for each in sent] == ["conversation.item.truncate"] * 2


def test_what_still_comes_of_a_cancelled_item_is_not_spoken():
    async def work(voice, face):
        await voice.hear(delta("cancelled", 20.0))
        await sounding(face)
        (cut,) = await voice.hear(started())
        for event in item_events("cancelled", 3.0):
            assert await voice.hear(event) == []
        return cut, await voice.finish()

    (cut, answers), n_heard = talked(work)
    assert answers == []
    assert n_heard / 24 == pytest.approx(cut["audio_end_ms"], abs=30)


def test_more_items_than_a_face_takes_streams_are_all_heard():
    async def work(voice, face):
        face.hold()
        for number in range(12):
            for event in item_events(f"i{number}", 0.1):
                assert await voice.hear(event) == []
        face.go_on()
        return await voice.finish()

    answers, n_heard = talked(work)
    assert answers == []
    assert n_heard / 24_000 == pytest.approx(1.2, abs=0.01)


def test_a_barge_in_is_heard_while_the_face_takes_no_more_sound():
    """A face takes half a minute ahead; the API sends faster than people listen."""

    async def work(voice, face):
        face.hold()
        for _ in range(8):
            await asyncio.wait_for(voice.hear(delta("long", 10.0)), 10.0)
        face.go_on()
        await sounding(face)
        return await voice.hear(started())

    (cut,), _ = talked(work)
    assert 0 <= cut["audio_end_ms"] < 79_000


def test_an_item_of_which_only_the_transcript_came_is_deleted_and_not_truncated():
    about = {"item_id": "told", "response_id": "r", "output_index": 0, "content_index": 0}
    told = realtime.ResponseAudioTranscriptDeltaEvent(
        type="response.output_audio_transcript.delta", event_id="t", delta="Good morning", **about
    )

    async def work(voice, _face):
        assert await voice.hear(told) == []
        return await voice.hear(started())

    (answer,), _ = talked(work)
    sent = realtime.ConversationItemDeleteEvent(**answer)
    assert (sent.type, sent.item_id) == ("conversation.item.delete", "told")


def test_an_item_that_the_face_refuses_ends_no_session_and_is_told_as_not_heard():
    async def work(voice, _face):
        for event in item_events("refused", 0.5):
            assert await voice.hear(event) == []
        return await voice.finish()

    (answer,), _ = talked(work, sound=None)
    assert (answer["item_id"], answer["audio_end_ms"]) == ("refused", 0)


def test_an_item_that_the_face_cuts_off_is_told_as_far_as_it_was_heard():
    async def work(voice, face):
        for event in item_events("cut", 20.0):
            await voice.hear(event)
        await sounding(face)
        face.playout.requests.append(PlayoutRequest("interrupt"))
        return await voice.finish()

    (answer,), n_heard = talked(work)
    assert answer["audio_end_ms"] == pytest.approx(n_heard / 24, abs=30)
