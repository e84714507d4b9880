"""Clients that make mistakes, hang, send too much, or come at the same time."""

import asyncio
import json

import numpy as np
import pytest
from voice_agents.served_face import RATE_HZ, RawClient, ServedFace, client, tone, until
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from lipservo.agents.listener import AgentSettings


@pytest.fixture
def face():
    with ServedFace() as served:
        yield served


def started(**fields):
    return json.dumps({"type": "start", "stream": "s", "sample_rate": RATE_HZ, **fields})


def units(kind, *given, **fields):
    named = [
        dict(zip(("label", "start_sample", "end_sample"), each, strict=False)) for each in given
    ]
    return json.dumps({"type": kind, "units": named, **fields})


END, INTERRUPT = '{"type": "end"}', '{"type": "interrupt"}'


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
        (['{"type": "mark", "name": "x"}'], "no_stream", "`mark` without a stream"),
        ([started(), started(), INTERRUPT], "stream_open", "send `end` first"),
        ([started(), b"\0\0\0", END], "bad_audio", "the last 1 bytes"),
        ([started(), '{"type": "audio", "data": "%%"}', INTERRUPT], "bad_audio", "not base64"),
        ([started(), "speech", INTERRUPT], "bad_json", "not JSON"),
        ([units("words", ("a",))], "no_stream", "no stream is open"),
        ([units("words", ("a",), stream="x")], "no_stream", "stream 'x' does not exist"),
        (
            [started(), units("words", ("a", 900), ("b", 10)), INTERRUPT],
            "bad_text",
            "sample 10 is before 900",
        ),
        (
            [started(), units("phonemes", ("M", 0, 900), ("AA", 800, 990)), INTERRUPT],
            "bad_text",
            "sample 800 is before 900",
        ),
        (
            [started(), units("phonemes", ("M", 10**9)), INTERRUPT],
            "bad_text",
            "more than 300 s after the sound",
        ),
        (
            [started(), units("phonemes", ("qqq",), alphabet="klingon"), INTERRUPT],
            "bad_text",
            "alphabet 'klingon' is not known",
        ),
        (
            [started(), units("visemes", ("99", 0), alphabet="azure"), INTERRUPT],
            "bad_text",
            "'99' is not a viseme of azure",
        ),
        (
            [started(), units("visemes", ("21",), alphabet="azure"), INTERRUPT],
            "bad_text",
            "need a start_sample",
        ),
        (
            [started(), units("words", *[("a",)] * 2_001), INTERRUPT],
            "bad_message",
            "units: List should have at most 2000",
        ),
        (
            [started(), json.dumps({"type": "text", "text": "a" * 900_000}), INTERRUPT],
            "bad_message",
            "text: String should have at most 20000",
        ),
        (
            [started(), json.dumps({"type": "text", "text": ""}), INTERRUPT],
            "bad_message",
            "text: String should have at least 1",
        ),
        (
            [started(), json.dumps({"type": "text", "text": "a", "language": "../x"}), INTERRUPT],
            "bad_message",
            "language",
        ),
        (
            [started(), '{"type": "position", "played_s": NaN}', INTERRUPT],
            "bad_message",
            "played_s",
        ),
        (
            [started(), '{"type": "position", "played_s": 1}', INTERRUPT],
            "bad_message",
            "plays this stream itself",
        ),
    ],
)
def test_a_mistake_is_told_in_one_line_and_the_next_stream_is_said(face, messages, code, told):
    async def talk():
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
            return error

    error = asyncio.run(talk())

    assert error["code"] == code
    assert told in error["message"]
    assert "\n" not in error["message"]


@pytest.mark.parametrize("unknown", ['{"type": "dance"}', '{"type": "hello", "version": [9]}'])
def test_what_is_not_known_is_ignored(face, unknown):
    async def talk():
        async with client(face) as agent:
            await agent.send(unknown)
            await agent.say("hello")
            return await agent.next("hello", "error")

    assert asyncio.run(talk())["type"] == "hello"


def test_floats_that_are_no_numbers_are_silence(face):
    async def talk():
        async with client(face) as agent:
            await agent.start(format="f32le")
            await agent.send(np.array([np.nan, np.inf, -np.inf, 9.0] * 500, "<f4").tobytes())
            await agent.say("end")
            return await agent.next("finished")

    assert asyncio.run(talk())["n_played"] == 2000
    assert np.isfinite(face.sound.played()).all()
    assert np.abs(face.sound.played()).max() <= 1.0


def test_a_huge_message_ends_the_connection_and_nothing_else(face):
    async def talk():
        async with client(face) as agent:
            await agent.start()
            await agent.send(bytes((1 << 20) + 2))
            with pytest.raises(ConnectionClosed) as closed:
                await agent.next("never")
        return closed.value.rcvd.code

    assert asyncio.run(talk()) == 1009
    until(lambda: face.playout.is_over)


def test_speech_beyond_five_minutes_is_refused_chunk_by_chunk(face):
    chunk = bytes(2 * 8_000 * 59)

    async def talk():
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
            return error, await agent.next("interrupted")

    error, cut = asyncio.run(talk())

    assert error["code"] == "buffer_full"
    assert cut["n_played"] + cut["n_dropped"] == 8_000 * (5 * 59 + 1)


def test_too_many_marks_are_refused(face):
    async def talk():
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
            return error, sum(event["type"] == "mark" for event in agent.heard)

    error, n_marks = asyncio.run(talk())

    assert (error["code"], n_marks) == ("too_many_marks", 64)


def test_a_second_speaker_is_refused_until_the_first_is_done(face):
    async def talk():
        async with client(face) as first, client(face) as second:
            await first.start()
            refused = await second.start()
            await second.send(tone(0.1))
            await second.say("interrupt")  # silences nobody else
            await second.next("interrupted")
            await first.send(tone(0.1))
            await first.say("end")
            await first.next("finished")
            return refused, await second.start()

    n_refused = face.server.status()["n_streams_refused"]
    refused, ready = asyncio.run(talk())

    assert (refused["type"], refused["code"]) == ("error", "busy")
    assert ready["type"] == "ready"
    assert face.server.status()["n_streams_refused"] == n_refused + 1


def test_where_they_queue_the_second_waits_and_an_interruption_is_the_first_ones_alone():
    with ServedFace(AgentSettings(when_busy="queue", most_streams=3)) as face:

        async def talk():
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
                return too_many, finished, cut

        too_many, finished, cut = asyncio.run(talk())

    assert too_many["code"] == "too_many_streams"
    assert (finished["stream"], finished["n_played"]) == ("b", 4_800)
    assert cut["stream"] == "c"


def test_a_stream_that_stands_still_is_ended_so_that_others_may_speak():
    with ServedFace(AgentSettings(stalled_s=0.05, position_s=0.01)) as face:

        async def talk():
            async with client(face) as agent:
                await agent.start()
                await agent.send(tone(0.1))
                stalled = await agent.next("error")
                return stalled, await agent.next("finished")

        stalled, finished = asyncio.run(talk())

    assert (stalled["code"], stalled["stream"]) == ("stalled", "s")
    assert finished["n_played"] == 2_400


def test_whoever_says_nothing_at_first_is_sent_away():
    with ServedFace(AgentSettings(first_message_s=0.05)) as face:

        async def wait():
            async with client(face) as agent:
                with pytest.raises(ConnectionClosed) as closed:
                    await agent.next("never")
                return closed.value.rcvd

        closed = asyncio.run(wait())

    assert (closed.code, closed.reason.split(":")[0]) == (1008, "no_start")


def test_whoever_does_not_read_is_sent_away_and_is_silent():
    with ServedFace(AgentSettings(messages_per_s=1e9)) as face:

        async def talk():
            socket = await connect(face.url + "/stream", ping_interval=None)
            agent = RawClient(socket)
            await agent.start()
            await agent.send(tone(20.0))
            await agent.next("started")
            socket.transport.pause_reading()
            # Each is answered by an error, until the kernel holds no more, and then 256 events.
            while face.server.status()["n_clients"]:
                try:
                    await socket.send("x")
                except ConnectionClosed:
                    break
            await asyncio.get_running_loop().run_in_executor(
                None, until, lambda: face.server.status()["n_clients"] == 0
            )
            socket.transport.abort()

        asyncio.run(talk())

        until(lambda: face.playout.is_over)


def test_too_many_messages_a_second_wait_and_none_is_lost():
    with ServedFace(AgentSettings(messages_per_s=200.0, position_s=3600.0)) as face:

        async def talk():
            async with client(face) as agent:
                await agent.start()
                sent = tone(0.3)
                for first in range(0, len(sent), 48):
                    await agent.send(sent[first : first + 48])
                await agent.say("end")
                return await agent.next("finished")

        assert asyncio.run(talk())["n_played"] == 7_200


def test_a_text_that_cannot_be_pronounced_is_told_and_its_stream_is_said_all_the_same(face):
    async def talk():
        async with client(face) as agent:
            await agent.start("a")
            await agent.say("text", text="a", language="qq")
            error = await agent.next("error")
            await agent.say("text", text="🙂 <speak></speak>", language="de")
            await agent.send(tone(0.1))
            await agent.say("end")
            return error, await agent.next("finished", "error")

    error, finished = asyncio.run(talk())

    assert (error["code"], error["stream"]) == ("bad_text", "a")
    assert "does not speak 'qq'" in error["message"]
    assert finished["n_played"] == round(0.1 * RATE_HZ)


def test_words_of_a_stream_that_was_cut_off_or_is_over_are_no_mistake(face):
    async def talk():
        async with client(face) as agent:
            await agent.start("a")
            await agent.say("interrupt")
            await agent.next("interrupted")
            for about in ({}, {"stream": "a"}):
                await agent.say("words", units=[{"label": "late"}], **about)
            await agent.start("b")
            await agent.send(tone(0.1))
            await agent.say("end")
            await agent.next("finished", "error")
            await agent.say("phonemes", stream="b", units=[{"label": "M", "start_sample": 0}])
            await agent.say("position")
            await agent.start("c")
            return agent.heard

    assert "error" not in [event["type"] for event in asyncio.run(talk())]


def test_what_is_told_of_a_stream_is_what_its_samples_say(face):
    async def talk():
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
            return stream

    stream = asyncio.run(talk())

    assert [e.phoneme for e in stream.spoken["viseme"].events()] == ["P", "AA"]
