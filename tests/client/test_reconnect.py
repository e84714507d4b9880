"""A client whose face goes and comes back, hangs, or never answers."""

import asyncio
import contextlib
import threading
import time

import numpy as np
import pytest
from lipservo_client import async_face, wire
from lipservo_client.async_face import AsyncFace
from lipservo_client.protocol import FaceError, Played
from lipservo_lab.bench.agents.cable import Cable
from voice_agents.served_face import RATE_HZ, ServedFace, tone, until
from websockets.asyncio.server import serve

import lipservo
from lipservo.access.admission import Policy
from lipservo.agents import stream_session
from lipservo.agents.listener import AgentSettings


@contextlib.asynccontextmanager
async def frozen():
    """A server that answers a greeting and then stands still: its address."""
    held = threading.Event()

    async def answer(connection):
        await connection.recv()
        await connection.send('{"type": "hello", "protocol": 2, "delay_ms": 0.0}')
        await asyncio.sleep(0.05)
        held.wait(30.0)  # its loop, pings and all

    started, ports = threading.Event(), []

    def run():
        async def serving():
            async with serve(answer, "127.0.0.1", 0, ping_interval=None) as server:
                ports.append(server.sockets[0].getsockname()[1])
                started.set()
                await asyncio.to_thread(held.wait, 30.0)

        asyncio.run(serving())

    thread = threading.Thread(target=run)
    thread.start()
    await asyncio.to_thread(started.wait)
    try:
        yield f"ws://127.0.0.1:{ports[0]}"
    finally:
        held.set()
        await asyncio.to_thread(thread.join)


async def test_a_face_that_comes_back_is_spoken_through_again_and_says_nothing_old():
    first = ServedFace()
    first.__enter__()
    port = first.url.rpartition(":")[2]
    async with lipservo.connect_async(first.url) as face:
        events = face.events()
        speech = face.stream()
        await speech.__aenter__()
        await speech.write(tone(20.0))
        await asyncio.to_thread(first.__exit__)
        while (await anext(events))["type"] != "disconnected":
            pass
        with pytest.raises(FaceError):
            await speech.write(tone(0.1))
        with contextlib.suppress(FaceError):  # a face in a hurry does not say how much it was
            assert not (await speech.heard()).finished
        with pytest.raises(FaceError, match="connecting again"):
            face.stream()
        with ServedFace(port=port) as second:
            while (await anext(events))["type"] != "reconnected":
                pass
            async with face.stream() as again:
                await again.write(tone(0.3))
                played = await again.wait()
            heard_s = np.count_nonzero(second.sound.played()) / RATE_HZ
    assert played == Played(finished=True, played_s=0.3)
    assert heard_s == pytest.approx(0.3, abs=0.01)


async def next_change(events):
    async for event in events:
        if event["type"] in ("disconnected", "reconnected"):
            return event["type"], event["code"], event["message"]
    return None


@contextlib.asynccontextmanager
async def left_in_mid_word():
    """A client that was told that its face has gone, its events, and the address."""
    first = ServedFace()
    first.__enter__()
    async with lipservo.connect_async(first.url) as face, asyncio.timeout(60.0):
        events = face.events()
        async with face.stream() as speech:
            await speech.write(tone(20.0))
            await asyncio.to_thread(first.__exit__)
        assert (await next_change(events))[0] == "disconnected"
        yield face, events, int(first.url.rpartition(":")[2])


async def test_a_face_that_is_updated_while_an_agent_speaks_is_told_once_and_found_when_it_fits():
    async with left_in_mid_word() as (_, events, port):
        with ServedFace(port=port), pytest.MonkeyPatch.context() as patch:
            patch.setattr(stream_session, "PROTOCOL", 3)
            kind, code, message = await next_change(events)
            patch.undo()
            back = await next_change(events)
    assert (kind, code) == ("disconnected", "bad_protocol")
    assert "install the lipservo-client of the face's version" in message
    assert back[0] == "reconnected"


async def test_a_face_that_comes_back_with_another_token_is_told():
    async with left_in_mid_word() as (_, events, port):
        with ServedFace(AgentSettings(policy=Policy("another")), port=port):
            kind, code, message = await next_change(events)
    assert (kind, code) == ("disconnected", "unauthorized")
    assert "needs the token" in message


async def test_a_face_that_is_renamed_while_an_agent_speaks_takes_its_commands_again():
    """Another name is another control socket."""
    async with left_in_mid_word() as (face, events, port):
        with ServedFace(port=port) as renamed:
            assert (await next_change(events))[0] == "reconnected"
            await face.set("strength", 0.8)
            assert renamed.commands.take_changes() == {"strength": 0.8}


async def test_a_peer_that_is_gone_without_a_word_is_noticed(monkeypatch):
    monkeypatch.setattr(wire, "_PING_S", 0.1)
    monkeypatch.setattr(wire, "_PONG_S", 0.2)
    monkeypatch.setattr(wire, "_CLOSING_S", 0.1)
    async with frozen() as url, AsyncFace(url, "t") as face:
        assert (await anext(face.events()))["type"] == "disconnected"


def test_a_dead_peer_is_noticed_within_ten_seconds_by_both_ends():
    ours = wire._PING_S + wire._PONG_S + wire._CLOSING_S
    theirs = AgentSettings().ping_s
    assert ours < 10.0
    assert 3.0 * theirs + 0.5 < 10.0


@pytest.mark.campaign
async def test_a_pulled_cable_is_noticed_within_ten_seconds_by_both_ends(capsys):
    noticed_s = []
    with ServedFace() as face, Cable(int(face.url.rpartition(":")[2])) as cable:
        async with lipservo.connect_async(f"ws://127.0.0.1:{cable.port}") as client:
            events = client.events()
            cable.pull()
            pulled_s = time.monotonic()
            ends = asyncio.to_thread(until, lambda: face.server.status()["n_clients"] == 0)
            face_end = asyncio.ensure_future(ends)
            face_end.add_done_callback(lambda _: noticed_s.append(time.monotonic() - pulled_s))
            await next_change(events)
            noticed_s.append(time.monotonic() - pulled_s)
            await face_end
            cable.plug()
    with capsys.disabled():
        print(f"a pulled cable was noticed after {noticed_s[0]:.1f} and {noticed_s[1]:.1f} s")  # noqa: T201
    assert max(noticed_s) <= 10.0


async def test_every_call_to_a_hung_face_has_a_limit(monkeypatch):
    for module in (async_face, wire):
        monkeypatch.setattr(module, "PATIENCE_S", 0.3)
    monkeypatch.setattr(wire, "_CLOSING_S", 0.1)
    monkeypatch.setattr(async_face, "_READING_S", 0.3)

    async def interrupt(face):
        face.stream().hear({"type": "ready", "delay_ms": 0.0})
        await face.interrupt()

    async def told(call):
        try:
            async with frozen() as url, AsyncFace(url, "t") as face:
                await asyncio.sleep(0.1)
                await call(face)
        except FaceError as error:
            return error.code

    calls = [AsyncFace.status, AsyncFace.stop, AsyncFace.start, interrupt]
    calls += [lambda face: face.say("hello"), lambda face: face.stream().__aenter__()]
    assert await asyncio.gather(*map(told, calls)) == ["not_answering"] * 6


async def test_a_stream_under_an_id_in_use_is_refused_and_the_first_goes_on(served):
    async with lipservo.connect_async(served.url) as face, face.stream(stream="a") as first:
        with pytest.raises(FaceError) as raised:
            face.stream(stream="a")
        await first.write(tone(0.1))
        assert (await first.wait()).finished
    assert raised.value.code == "stream_open"


async def test_events_that_are_never_read_are_bounded_and_forgotten_with_their_reader(served):
    async with lipservo.connect_async(served.url) as face:
        kept, _ = face.events(), face.events()
        del _
        for number in range(3_000):
            face._emit({"type": "phoneme", "n": number})
        assert len(face._events) == 1
        assert [event["n"] for event in kept._waiting] == list(range(3_000 - 1_024, 3_000))
