"""Clients that make mistakes, hang, send too much, or come at the same time."""

import asyncio
import json

import numpy as np
import pytest
from voice_agents.served_face import RATE_HZ, RawClient, ServedFace, client, tone, until
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from lipservo.agents.listener import AgentSettings


def message(kind, **fields):
    return json.dumps({"type": kind, **fields})


def started(**fields):
    return message("start", **{"stream": "s", "sample_rate": RATE_HZ, **fields})


def units(kind, *given, **fields):
    named = [
        dict(zip(("label", "start_sample", "end_sample"), each, strict=False)) for each in given
    ]
    return message(kind, units=named, **fields)


END, INTERRUPT = message("end"), message("interrupt")
AZURE = {"alphabet": "azure"}
#: Mistakes within a stream, which is interrupted then.
WITHIN = [
    (started(), "stream_open", "send `end` first"),
    (message("audio", data="%%"), "bad_audio", "not base64"),
    ("speech", "bad_json", "not JSON"),
    (units("words", ("a", 900), ("b", 10)), "bad_text", "sample 10 is before 900"),
    (units("phonemes", ("M", 0, 900), ("AA", 800, 990)), "bad_text", "sample 800 is before 900"),
    (units("phonemes", ("M", 10**9)), "bad_text", "more than 300 s after the sound"),
    (units("phonemes", ("q",), alphabet="klingon"), "bad_text", "alphabet 'klingon' is not known"),
    (units("visemes", ("99", 0), **AZURE), "bad_text", "'99' is not a viseme of azure"),
    (units("visemes", ("21",), **AZURE), "bad_text", "need a start_sample"),
    (units("words", *[("a",)] * 2_001), "bad_message", "units: List should have at most 2000"),
    (message("text", text="a" * 900_000), "bad_message", "text: String should have at most 20000"),
    (message("text", text=""), "bad_message", "text: String should have at least 1"),
    (message("text", text="a", language="../x"), "bad_message", "language"),
    ('{"type": "position", "played_s": NaN}', "bad_message", "played_s"),
    (message("position", played_s=1), "bad_message", "plays this stream itself"),
]


@pytest.mark.parametrize(
    ("messages", "code", "told"),
    [
        (["hello?"], "bad_json", "send audio as binary"),
        (["[1, 2]"], "bad_json", "not a JSON object"),
        (["{}"], "bad_json", "not a JSON object"),
        (["[" * 100_000], "bad_json", "not JSON"),
        ([started(sample_rate=2_000)], "bad_message", "sample_rate: Input should be greater"),
        ([started(sample_rate="24000")], "bad_message", "sample_rate"),
        ([started(channels=2)], "bad_message", "channels"),
        ([started(format="mp3")], "bad_message", "format"),
        ([started(stream="")], "bad_message", "stream"),
        ([started(stream="\ud800")], "bad_message", "stream"),
        ([started(playback="nobody")], "bad_message", "playback"),
        ([b"\0\0"], "no_stream", "audio was dropped"),
        ([END], "no_stream", "`end` without a stream"),
        ([message("mark", name="x")], "no_stream", "`mark` without a stream"),
        ([started(), b"\0\0\0", END], "bad_audio", "the last 1 bytes"),
        ([units("words", ("a",))], "no_stream", "no stream is open"),
        ([units("words", ("a",), stream="x")], "no_stream", "stream 'x' does not exist"),
        *[([started(), each, INTERRUPT], code, told) for each, code, told in WITHIN],
    ],
)
async def test_a_mistake_is_told_in_one_line_and_the_next_stream_is_said(
    face, messages, code, told
):
    async with client(face) as agent:
        for message in messages:
            await agent.send(message)
        error = await agent.next("error")
        if INTERRUPT in messages:
            await agent.next("interrupted", "finished")
        await agent.start("after")
        await agent.send(tone(0.1))
        await agent.say("end")
        while (await agent.next("finished"))["stream"] != "after":
            pass

    assert error["code"] == code
    assert code != "bad_text" or error["stream"] == "s"
    assert told in error["message"]
    assert "\n" not in error["message"]


@pytest.mark.parametrize("unknown", ['{"type": "dance"}', '{"type": "hello", "version": [9]}'])
async def test_what_is_not_known_is_ignored(face, unknown):
    async with client(face) as agent:
        await agent.send(unknown)
        await agent.say("hello")
        assert (await agent.next("hello", "error"))["type"] == "hello"


async def test_floats_that_are_no_numbers_are_silence(face):
    async with client(face) as agent:
        await agent.start(format="f32le")
        await agent.send(np.array([np.nan, np.inf, -np.inf, 9.0] * 500, "<f4").tobytes())
        await agent.say("end")
        assert (await agent.next("finished"))["n_played"] == 2000
    assert np.isfinite(face.sound.played()).all()
    assert np.abs(face.sound.played()).max() <= 1.0


async def test_a_huge_message_ends_the_connection_and_nothing_else(face):
    async with client(face) as agent:
        await agent.start()
        await agent.send(bytes((1 << 20) + 2))
        with pytest.raises(ConnectionClosed) as closed:
            await agent.next("never")
    assert closed.value.rcvd.code == 1009
    until(lambda: face.playout.is_over)


async def test_speech_beyond_five_minutes_is_refused_chunk_by_chunk(face):
    chunk = bytes(2 * 8_000 * 59)
    async with client(face) as agent:
        await agent.start(sample_rate=8_000)
        face.hold()
        for _ in range(6):
            await agent.send(chunk)
        error = await agent.next("error")
        await agent.send(bytes(16_000))  # a second still finds room
        await agent.say("hello")
        await agent.next("hello")
        face.go_on()
        await agent.say("interrupt")
        cut = await agent.next("interrupted")

    assert error["code"] == "buffer_full"
    assert cut["n_played"] + cut["n_dropped"] == 8_000 * (5 * 59 + 1)


async def test_too_many_marks_are_refused(face):
    async with client(face) as agent:
        await agent.start()
        face.hold()
        await agent.send(tone(0.1))
        for number in range(65):
            await agent.say("mark", name=str(number))
        error = await agent.next("error")
        face.go_on()
        await agent.say("end")
        await agent.next("finished")
        n_marks = sum(event["type"] == "mark" for event in agent.heard)

    assert (error["code"], n_marks) == ("too_many_marks", 64)


async def test_a_second_speaker_is_refused_until_the_first_is_done(face):
    n_refused = face.server.status()["n_streams_refused"]
    async with client(face) as first, client(face) as second:
        await first.start()
        refused = await second.start()
        await second.send(tone(0.1))
        await second.say("interrupt")  # silences nobody else
        await second.next("interrupted")
        await first.finish(0.1)
        ready = await second.start()

    assert (refused["type"], refused["code"]) == ("error", "busy")
    assert ready["type"] == "ready"
    assert face.server.status()["n_streams_refused"] == n_refused + 1


async def test_where_they_queue_the_second_waits_and_an_interruption_is_the_first_ones_alone():
    with ServedFace(AgentSettings(when_busy="queue", most_streams=3)) as face:
        async with client(face) as first, client(face) as second:
            await first.start("a")
            await second.start("b")
            await second.send(tone(0.2))
            await second.say("end")
            await first.send(tone(20.0))
            await first.next("started")
            await second.start("c")
            await second.send(tone(20.0))
            await second.say("end")
            too_many = await second.start("d")
            await first.say("interrupt")
            await first.next("interrupted")
            finished = await second.next("finished")
            await second.say("interrupt")
            cut = await second.next("interrupted")

    assert too_many["code"] == "too_many_streams"
    assert (finished["stream"], finished["n_played"]) == ("b", 4_800)
    assert cut["stream"] == "c"


async def test_a_stream_that_stands_still_is_ended_so_that_others_may_speak():
    with ServedFace(AgentSettings(stalled_s=0.05, position_s=0.01)) as face:
        async with client(face) as agent:
            await agent.start()
            await agent.send(tone(0.1))
            stalled = await agent.next("error")
            finished = await agent.next("finished")

    assert (stalled["code"], stalled["stream"]) == ("stalled", "s")
    assert finished["n_played"] == 2_400


async def test_whoever_says_nothing_at_first_is_sent_away():
    with ServedFace(AgentSettings(first_message_s=0.05)) as face:
        async with client(face) as agent:
            with pytest.raises(ConnectionClosed) as closed:
                await agent.next("never")

    assert closed.value.rcvd.code == 1008
    assert closed.value.rcvd.reason.startswith("no_start:")


async def test_whoever_does_not_read_is_sent_away_and_is_silent():
    with ServedFace(AgentSettings(messages_per_s=1e9)) as face:
        socket = await connect(face.url + "/stream", ping_interval=None)
        agent = RawClient(socket)
        await agent.begin(20.0)
        socket.transport.pause_reading()
        # Each is answered by an error, until the kernel holds no more, and then 256 events.
        while face.server.status()["n_clients"]:
            try:
                await socket.send("x")
            except ConnectionClosed:
                break
        await asyncio.to_thread(until, lambda: face.server.status()["n_clients"] == 0)
        socket.transport.abort()
        until(lambda: face.playout.is_over)


async def test_too_many_messages_a_second_wait_and_none_is_lost():
    with ServedFace(AgentSettings(messages_per_s=200.0, position_s=3600.0)) as face:
        async with client(face) as agent:
            await agent.start()
            sent = tone(0.3)
            for first in range(0, len(sent), 48):
                await agent.send(sent[first : first + 48])
            await agent.say("end")
            assert (await agent.next("finished"))["n_played"] == 7_200


async def test_a_text_that_cannot_be_pronounced_is_told_and_its_stream_is_said_all_the_same(face):
    async with client(face) as agent:
        await agent.start("a")
        await agent.say("text", text="a", language="qq")
        error = await agent.next("error")
        assert (await agent.finish(0.1))["n_played"] == round(0.1 * RATE_HZ)

    assert (error["code"], error["stream"]) == ("bad_text", "a")
    assert "does not speak 'qq'" in error["message"]


async def test_words_of_a_stream_that_is_over_and_a_text_without_words_are_no_mistake(face):
    async with client(face) as agent:
        await agent.start("a")
        await agent.say("interrupt")
        await agent.next("interrupted")
        for about in ({}, {"stream": "a"}):
            await agent.say("words", units=[{"label": "late"}], **about)
        await agent.start("b")
        await agent.say("text", text="🙂 <speak></speak>", language="de")
        await agent.send(tone(0.1))
        await agent.say("end")
        await agent.next("finished", "error")
        await agent.say("phonemes", stream="b", units=[{"label": "M", "start_sample": 0}])
        await agent.say("position")
        await agent.start("c")
        assert "error" not in [event["type"] for event in agent.heard]


async def test_what_is_told_of_a_stream_is_what_its_samples_say(face):
    async with client(face) as agent:
        await agent.start("a")
        azure = [{"label": "21", "start_sample": 0}, {"label": "2", "start_sample": 2_400}]
        await agent.say("visemes", units=azure, alphabet="azure")
        face.hold()
        await agent.send(tone(0.3))
        await asyncio.to_thread(until, lambda: len(face.playout._playing) == 1)
        stream = face.playout._playing[0].stream
        await asyncio.to_thread(until, lambda: stream.spoken)
        face.go_on()

    assert [e.phoneme for e in stream.spoken["viseme"].events()] == ["P", "AA"]
