"""The OpenAI example with the SDK's own event objects."""

import asyncio
import base64
import importlib.util

import pytest
from places import ROOT
from voice_agents.served_face import ServedFace, tone

import lipservo

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


def test_a_barge_in_truncates_what_is_said_where_it_was_heard_and_what_is_queued_at_its_start():
    started = realtime.InputAudioBufferSpeechStartedEvent(
        type="input_audio_buffer.speech_started", event_id="s", item_id="u", audio_start_ms=9
    )

    async def talk(face):
        async with lipservo.connect_async(face.url) as connection:
            voice = example().RealtimeVoice(connection)
            for item_id, duration_s in (("first", 0.2), ("second", 20.0), ("third", 5.0)):
                for event in item_events(item_id, duration_s):
                    assert await voice.hear(event) == []
            while len(face.sound.played().nonzero()[0]) < 24_000:
                await asyncio.sleep(0.002)
            return await voice.hear(started)

    with ServedFace() as face:
        answers = asyncio.run(talk(face))

    second, third = answers  # the first was heard whole, and is left alone
    assert (second["item_id"], third["item_id"]) == ("second", "third")
    assert 0 < second["audio_end_ms"] < 20_000
    assert third["audio_end_ms"] == 0
    sent = [realtime.ConversationItemTruncateEvent(**answer) for answer in answers]
    assert [each.type for each in sent] == ["conversation.item.truncate"] * 2
