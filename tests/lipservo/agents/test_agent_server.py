"""Speech over a real socket into a real playout, and what is told of it."""

import asyncio
import base64

import numpy as np
import pytest
from voice_agents.served_face import DELAY_MS, RATE_HZ, RawClient, ServedFace, client, tone, until
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from lipservo.agents.listener import AgentSettings


def energy(samples):
    return float(np.abs(samples).sum())


async def test_a_stream_is_said_whole_and_its_events_come_in_order(face):
    async with client(face) as agent:
        ready = await agent.start("hello")
        sent = tone(0.5)
        for first in range(0, len(sent), 1001):  # cut in the middle of samples
            await agent.send(sent[first : first + 1001])
        await agent.say("mark", name="all")
        await agent.say("end")
        finished = await agent.next("finished")

    about = {"type": "ready", "stream": "hello", "delay_ms": DELAY_MS, "playback": "server"}
    assert ready == about
    assert (finished["n_played"], finished["played_s"]) == (12_000, 0.5)
    kinds = [event["type"] for event in agent.heard]
    kinds = [kind for kind in kinds if kind not in ("position", "underrun")]
    assert kinds == ["ready", "started", "mark", "finished"]
    spoken = np.frombuffer(tone(0.5), dtype="<i2") / 32_768
    assert energy(face.sound.played()) == pytest.approx(energy(spoken), rel=1e-4)


async def test_an_interruption_tells_how_much_was_heard_and_the_rest_is_silent(face):
    async with client(face) as agent:
        await agent.begin(10.0)
        face.hold()
        await agent.say("interrupt")
        cut = await agent.next("interrupted")
        await agent.send(tone(0.1))  # was on its way: no mistake
        await agent.say("end")
        await agent.say("hello")
        await agent.next("hello")
    n_heard = np.flatnonzero(face.sound.played())
    face.go_on()

    assert cut["n_played"] + cut["n_dropped"] == 10 * RATE_HZ
    assert cut["n_dropped"] == round(cut["dropped_s"] * RATE_HZ)
    assert 0 <= n_heard.max() - n_heard.min() + 2 - cut["n_played"] <= 0.02 * RATE_HZ
    assert "error" not in [event["type"] for event in agent.heard]
    until(lambda: face.playout.is_over)


async def test_whoever_interrupts_silence_is_answered(face):
    async with client(face) as agent:
        await agent.say("interrupt")
        answer = {"type": "interrupted", "stream": None, "played_s": 0.0, "dropped_s": 0.0}
        assert await agent.next("interrupted") == answer


async def test_clear_lets_what_is_on_its_way_be_heard(face):
    async with client(face) as agent:
        await agent.begin(10.0)
        await agent.say("clear")
        cleared = await agent.next("cleared")
        finished = await agent.next("finished")

    assert cleared["n_dropped"] > 0
    assert finished["n_played"] + cleared["n_dropped"] == pytest.approx(10 * RATE_HZ, abs=1)
    assert finished["n_played"] > cleared["n_played"]


async def test_a_client_that_vanishes_in_the_middle_of_a_word_is_silent(face):
    socket = await connect(face.url + "/stream")
    agent = RawClient(socket)
    await agent.begin(20.0)
    face.hold()
    socket.transport.abort()
    await socket.wait_closed()
    until(lambda: face.server.status()["n_clients"] == 0)
    until(lambda: face.playout.is_over)
    face.go_on()
    n_played = len(face.sound.played())
    until(lambda: len(face.sound.played()) > n_played + RATE_HZ)
    assert energy(face.sound.played()[n_played:]) == 0.0


async def test_a_client_that_leaves_after_its_end_is_heard_to_the_end(face):
    async with client(face) as agent:
        await agent.start()
        await agent.send(tone(0.5))
        await agent.say("end")

    spoken = np.frombuffer(tone(0.5), dtype="<i2") / 32_768
    until(lambda: energy(face.sound.played()) >= 0.999 * energy(spoken))
    until(lambda: face.playout.is_over)


async def test_a_client_that_leaves_a_stream_open_is_silent_with_its_ended_ones(face):
    async with client(face) as agent:
        await agent.start("ended")
        await agent.send(tone(20.0))
        await agent.say("end")
        await agent.next("started")
        await agent.start("open")
        face.hold()

    until(lambda: face.playout.is_over)  # and sound stands still
    assert face.server.status()["n_clients"] == 0
    face.go_on()


async def test_base64_and_float_samples_say_the_same_one_stream_after_the_other(face):
    samples = np.frombuffer(tone(0.2), dtype="<i2")
    async with client(face) as agent:
        await agent.start("text")
        await agent.say("audio", data=base64.b64encode(samples.tobytes()).decode())
        await agent.say("end")
        await agent.start("float", format="f32le")
        await agent.send((samples / np.float32(32_768)).astype("<f4").tobytes())
        await agent.say("end")
        finished = [await agent.next("finished") for _ in range(2)]

    assert [each["stream"] for each in finished] == ["text", "float"]
    assert [each["n_played"] for each in finished] == [len(samples)] * 2
    once = energy(samples / 32_768)
    assert energy(face.sound.played()) == pytest.approx(2 * once, rel=1e-4)


async def test_a_client_that_plays_the_sound_itself_is_followed_by_its_own_reports(face):
    async with client(face) as agent:
        ready = await agent.start("mine", playback="client")
        await agent.send(tone(0.5))
        await agent.next("started")
        await agent.say("position", stream="mine", played_s=0.125)
        await agent.say("end")
        await agent.next("finished")

    assert (ready["playback"], ready["delay_ms"]) == ("client", DELAY_MS)
    ((_, stream, n_samples),) = face.reported
    assert stream.startswith("mine")
    assert n_samples == 3_000
    assert energy(face.sound.played()) == 0.0


async def test_positions_are_told_unasked_and_grow(face):
    async with client(face) as agent:
        await agent.start()
        await agent.finish(5.0)
        positions = [event for event in agent.heard if event["type"] == "position"]

    assert len(positions) > 2
    played_s = [event["played_s"] for event in positions]
    assert played_s == sorted(played_s)
    assert all(event["n_played"] == round(event["played_s"] * RATE_HZ) for event in positions)
    waiting_s = [event["waiting_s"] for event in positions]
    assert waiting_s[-1] < max(waiting_s)


async def test_a_position_is_told_when_it_is_asked_for():
    with ServedFace(AgentSettings(position_s=3600.0)) as face:
        async with client(face) as agent:
            face.hold()
            await agent.start()
            await agent.send(tone(1.0))
            await agent.say("position")
            position = await agent.next("position")

    assert (position["stream"], position["played_s"]) == ("s", 0.0)


async def test_phonemes_are_told_in_the_time_of_their_stream(face):
    async with client(face) as agent:
        await agent.begin(5.0)
        face.hold()
        start_s = face.playout.position_s + 0.1
        in_stream_s = face.playout.stream_at(start_s)[1]
        face.playout.phonemes.append(("AA", start_s, start_s + 0.08))
        phoneme = await agent.next("phoneme")
        face.go_on()

    assert (phoneme["stream"], phoneme["phoneme"]) == ("s", "AA")
    assert phoneme["start_s"] == pytest.approx(in_stream_s, abs=1e-3)
    assert phoneme["end_s"] - phoneme["start_s"] == pytest.approx(0.08, abs=2e-3)
    assert phoneme["heard_in_s"] == pytest.approx(0.1, abs=1e-3)


async def test_the_end_of_the_server_is_silence_and_every_client_is_told(face):
    async with client(face) as agent:
        await agent.begin(20.0)
        await asyncio.to_thread(face.server.__exit__)
        with pytest.raises(ConnectionClosed) as closed:
            await agent.next("never")
    until(lambda: face.playout.is_over)

    assert (closed.value.rcvd.code, closed.value.rcvd.reason) == (1001, "shutting_down")


async def test_speech_that_was_ended_is_cut_off_as_well_when_the_server_ends(face):
    async with client(face) as agent:
        await agent.start()
        for _ in range(6):
            await agent.send(tone(20.0))
        await agent.say("end")
        await agent.next("started")
        face.hold()
    until(lambda: face.server.status()["n_clients"] == 0)
    assert not face.playout.is_over
    face.server.__exit__()
    until(lambda: face.playout.is_over)


async def test_a_client_that_hangs_does_not_keep_the_server_from_ending(face):
    """It reads nothing and answers nothing: its connection is cut off."""
    socket = await connect(face.url + "/stream", ping_interval=None)
    agent = RawClient(socket)
    await agent.begin(20.0)
    socket.transport.pause_reading()
    await asyncio.to_thread(face.server.__exit__)
    socket.transport.abort()

    assert not face.server._thread.is_alive()
