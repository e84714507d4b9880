"""Speech over a real socket into a real playout, and what is told of it."""

import asyncio
import base64

import numpy as np
import pytest
from voice_agents.served_face import DELAY_MS, RATE_HZ, RawClient, ServedFace, client, tone, until
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from lipservo.agents.listener import AgentSettings


@pytest.fixture
def face():
    with ServedFace() as served:
        yield served


def energy(samples):
    return float(np.abs(samples).sum())


def test_a_stream_is_said_whole_and_its_events_come_in_order(face):
    async def talk():
        async with client(face) as agent:
            ready = await agent.start("hello")
            sent = tone(0.5)
            for first in range(0, len(sent), 1001):  # cut in the middle of samples
                await agent.send(sent[first : first + 1001])
            await agent.say("mark", name="all")
            await agent.say("end")
            return ready, await agent.next("finished"), agent.heard

    ready, finished, heard = asyncio.run(talk())

    assert ready == {
        "type": "ready",
        "stream": "hello",
        "delay_ms": DELAY_MS,
        "playback": "server",
    }
    assert finished["n_played"] == 12_000
    assert finished["played_s"] == 0.5
    kinds = [event["type"] for event in heard if event["type"] != "position"]
    assert [kind for kind in kinds if kind != "underrun"] == [
        "ready",
        "started",
        "mark",
        "finished",
    ]
    spoken = np.frombuffer(tone(0.5), dtype="<i2") / 32_768
    assert energy(face.sound.played()) == pytest.approx(energy(spoken), rel=1e-4)


def test_two_streams_of_one_client_are_said_one_after_the_other(face):
    async def talk():
        async with client(face) as agent:
            for stream in ("one", "two"):
                await agent.start(stream)
                await agent.send(tone(0.2))
                await agent.say("end")
            return [(await agent.next("finished"))["stream"] for _ in range(2)]

    assert asyncio.run(talk()) == ["one", "two"]


def test_an_interruption_tells_how_much_was_heard_and_the_rest_is_silent(face):
    async def talk():
        async with client(face) as agent:
            await agent.start()
            await agent.send(tone(60.0 / 6)[: 2 * RATE_HZ * 10])
            await agent.next("started")
            face.hold()
            await agent.say("interrupt")
            cut = await agent.next("interrupted")
            await agent.send(tone(0.1))  # was on its way: no mistake
            await agent.say("end")
            await agent.say("hello")
            await agent.next("hello")
            return cut, agent.heard

    cut, heard = asyncio.run(talk())
    n_heard = np.flatnonzero(face.sound.played())
    face.go_on()

    assert cut["n_played"] + cut["n_dropped"] == 10 * RATE_HZ
    assert cut["n_dropped"] == round(cut["dropped_s"] * RATE_HZ)
    assert 0 <= n_heard.max() - n_heard.min() + 2 - cut["n_played"] <= 0.02 * RATE_HZ
    assert [event for event in heard if event["type"] == "error"] == []
    until(lambda: face.playout.is_over)


def test_whoever_interrupts_silence_is_answered(face):
    async def talk():
        async with client(face) as agent:
            await agent.say("interrupt")
            return await agent.next("interrupted")

    assert asyncio.run(talk()) == {
        "type": "interrupted",
        "stream": None,
        "played_s": 0.0,
        "dropped_s": 0.0,
    }


def test_clear_lets_what_is_on_its_way_be_heard(face):
    async def talk():
        async with client(face) as agent:
            await agent.start()
            await agent.send(tone(10.0))
            await agent.next("started")
            await agent.say("clear")
            cleared = await agent.next("cleared")
            return cleared, await agent.next("finished")

    cleared, finished = asyncio.run(talk())

    assert cleared["n_dropped"] > 0
    assert finished["n_played"] + cleared["n_dropped"] == pytest.approx(10 * RATE_HZ, abs=1)
    assert finished["n_played"] > cleared["n_played"]


def test_a_client_that_vanishes_in_the_middle_of_a_word_is_silent(face):
    async def vanish():
        socket = await connect(face.url + "/stream")
        agent = RawClient(socket)
        await agent.start()
        await agent.send(tone(20.0))
        await agent.next("started")
        face.hold()
        socket.transport.abort()

    asyncio.run(vanish())

    until(lambda: face.server.status()["n_clients"] == 0)
    until(lambda: face.playout.is_over)
    face.go_on()
    n_played = len(face.sound.played())
    until(lambda: len(face.sound.played()) > n_played + RATE_HZ)
    assert energy(face.sound.played()[n_played:]) == 0.0


def test_a_client_that_leaves_after_its_end_is_heard_to_the_end(face):
    async def leave():
        async with client(face) as agent:
            await agent.start()
            await agent.send(tone(0.5))
            await agent.say("end")

    asyncio.run(leave())

    spoken = np.frombuffer(tone(0.5), dtype="<i2") / 32_768
    until(lambda: energy(face.sound.played()) >= 0.999 * energy(spoken))
    until(lambda: face.playout.is_over)


def test_a_client_that_leaves_a_stream_open_is_silent_with_its_ended_ones(face):
    async def leave():
        async with client(face) as agent:
            await agent.start("ended")
            await agent.send(tone(20.0))
            await agent.say("end")
            await agent.next("started")
            await agent.start("open")
            face.hold()

    asyncio.run(leave())

    until(lambda: face.playout.is_over)  # and sound stands still
    assert face.server.status()["n_clients"] == 0
    face.go_on()


def test_base64_and_float_samples_say_the_same(face):
    samples = np.frombuffer(tone(0.2), dtype="<i2")

    async def talk():
        async with client(face) as agent:
            await agent.start("text")
            await agent.say("audio", data=base64.b64encode(samples.tobytes()).decode())
            await agent.say("end")
            await agent.start("float", format="f32le")
            await agent.send((samples / np.float32(32_768)).astype("<f4").tobytes())
            await agent.say("end")
            return [(await agent.next("finished"))["n_played"] for _ in range(2)]

    assert asyncio.run(talk()) == [len(samples), len(samples)]
    once = energy(samples / 32_768)
    assert energy(face.sound.played()) == pytest.approx(2 * once, rel=1e-4)


def test_a_client_that_plays_the_sound_itself_is_followed_by_its_own_reports(face):
    async def talk():
        async with client(face) as agent:
            ready = await agent.start("mine", playback="client")
            await agent.send(tone(0.5))
            await agent.next("started")
            await agent.say("position", stream="mine", played_s=0.125)
            await agent.say("end")
            await agent.next("finished")
            return ready

    ready = asyncio.run(talk())

    assert (ready["playback"], ready["delay_ms"]) == ("client", DELAY_MS)
    ((_, stream, n_samples),) = face.reported
    assert stream.startswith("mine")
    assert n_samples == 3_000
    assert energy(face.sound.played()) == 0.0


def test_positions_are_told_unasked_and_grow(face):
    async def talk():
        async with client(face) as agent:
            await agent.start()
            await agent.send(tone(5.0))
            await agent.say("end")
            await agent.next("finished")
            return [event for event in agent.heard if event["type"] == "position"]

    positions = asyncio.run(talk())

    assert len(positions) > 2
    played_s = [event["played_s"] for event in positions]
    assert played_s == sorted(played_s)
    assert all(event["n_played"] == round(event["played_s"] * RATE_HZ) for event in positions)
    waiting_s = [event["waiting_s"] for event in positions]
    assert waiting_s[-1] < max(waiting_s)


def test_a_position_is_told_when_it_is_asked_for():
    with ServedFace(AgentSettings(position_s=3600.0)) as face:

        async def talk():
            async with client(face) as agent:
                face.hold()
                await agent.start()
                await agent.send(tone(1.0))
                await agent.say("position")
                return await agent.next("position")

        position = asyncio.run(talk())

    assert (position["stream"], position["played_s"]) == ("s", 0.0)


def test_phonemes_are_told_in_the_time_of_their_stream(face):
    async def talk():
        async with client(face) as agent:
            await agent.start()
            await agent.send(tone(5.0))
            started = await agent.next("started")
            face.hold()
            start_s = face.playout.position_s + 0.1
            in_stream_s = face.playout.stream_at(start_s)[1]
            face.playout.phonemes.append(("AA", start_s, start_s + 0.08))
            phoneme = await agent.next("phoneme")
            face.go_on()
            return started, phoneme, in_stream_s

    _, phoneme, in_stream_s = asyncio.run(talk())

    assert (phoneme["stream"], phoneme["phoneme"]) == ("s", "AA")
    assert phoneme["start_s"] == pytest.approx(in_stream_s, abs=1e-3)
    assert phoneme["end_s"] - phoneme["start_s"] == pytest.approx(0.08, abs=2e-3)
    assert phoneme["heard_in_s"] == pytest.approx(0.1, abs=1e-3)


def test_the_end_of_the_server_is_silence_and_every_client_is_told():
    face = ServedFace()

    async def talk():
        async with client(face) as agent:
            await agent.start()
            await agent.send(tone(20.0))
            await agent.next("started")
            await asyncio.get_running_loop().run_in_executor(None, face.server.__exit__)
            with pytest.raises(ConnectionClosed) as closed:
                await agent.next("never")
            return closed.value.rcvd

    with face:
        closed = asyncio.run(talk())
        until(lambda: face.playout.is_over)

    assert (closed.code, closed.reason) == (1001, "shutting_down")


def test_speech_that_was_ended_is_cut_off_as_well_when_the_server_ends():
    face = ServedFace()

    async def leave():
        async with client(face) as agent:
            await agent.start()
            for _ in range(6):
                await agent.send(tone(20.0))
            await agent.say("end")
            await agent.next("started")
            face.hold()

    with face:
        asyncio.run(leave())
        until(lambda: face.server.status()["n_clients"] == 0)
        assert not face.playout.is_over
        face.server.__exit__()
        until(lambda: face.playout.is_over)


def test_a_client_that_hangs_does_not_keep_the_server_from_ending():
    """It reads nothing and answers nothing: its connection is cut off."""
    face = ServedFace()

    async def hang():
        socket = await connect(face.url + "/stream", ping_interval=None)
        agent = RawClient(socket)
        await agent.start()
        await agent.send(tone(20.0))
        await agent.next("started")
        socket.transport.pause_reading()
        await asyncio.get_running_loop().run_in_executor(None, face.server.__exit__)
        socket.transport.abort()

    with face:
        asyncio.run(hang())

    assert not face.server._thread.is_alive()
