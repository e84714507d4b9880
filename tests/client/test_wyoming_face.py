"""A face as the `snd` service of Wyoming, spoken to by wyoming's own client."""

import asyncio
import contextlib
import gc
import warnings

import numpy as np
import pytest
from voice_agents.served_face import RATE_HZ, sounding_s, tone, until

from lipsync.audio.playout_stream import PlayoutRequest

# Its own imports warn of what Python will drop one day.
with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    pytest.importorskip("wyoming", reason="pip install 'lipservo-client[wyoming]'")
    from lipservo_client import wyoming_face
    from lipservo_client.wyoming_face import serve_wyoming
    from wyoming.audio import AudioChunk, AudioStart, AudioStop
    from wyoming.client import AsyncTcpClient
    from wyoming.error import Error
    from wyoming.event import Event
    from wyoming.info import Describe, Info
    from wyoming.snd import Played

# It leaves closed connections to the garbage collector.
pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.fixture(autouse=True)
def _collected():
    """Its connections go with the test that they belong to."""
    yield
    gc.collect()


@contextlib.asynccontextmanager
async def satellite(url, port):
    serving = asyncio.ensure_future(serve_wyoming("127.0.0.1", port, url, None))
    try:
        for _ in range(2_000):
            with contextlib.suppress(OSError):
                client = AsyncTcpClient("127.0.0.1", port)
                await client.connect()
                break
            await asyncio.sleep(0.005)
        yield client
        await client.disconnect()
    finally:
        serving.cancel()
        await asyncio.gather(serving, return_exceptions=True)


async def said(client, pcm, *, channels=1, n_bytes=2_400, ends=True):
    about = {"rate": RATE_HZ, "width": 2, "channels": channels}
    await client.write_event(AudioStart(**about).event())
    for first in range(0, len(pcm), n_bytes):
        await client.write_event(AudioChunk(audio=pcm[first : first + n_bytes], **about).event())
    if ends:
        await client.write_event(AudioStop().event())
        return await asyncio.wait_for(client.read_event(), 60.0)
    return None


@pytest.mark.parametrize("channels", [1, 2])
async def test_what_a_satellite_sends_is_heard_whole_before_it_is_told_so(
    served, unused_port, channels
):
    pcm = np.repeat(np.frombuffer(tone(0.4), "<i2"), channels).tobytes()

    async with satellite(served.url, unused_port) as client:
        await client.write_event(Describe().event())
        info = Info.from_event(await client.read_event())
        answers = [await said(client, pcm, channels=channels) for _ in range(2)]
    heard_s = sounding_s(served)

    assert [program.name for program in info.snd] == ["lipservo"]
    assert all(Played.is_type(answer.type) for answer in answers)
    assert heard_s == pytest.approx(0.8, abs=0.01)


async def test_a_satellite_that_dies_in_mid_word_is_silent(served, unused_port):
    async with satellite(served.url, unused_port) as client:
        await said(client, tone(20.0), ends=False)
    await asyncio.to_thread(until, lambda: served.playout.is_over)
    assert sounding_s(served) < 19.0


async def test_an_event_that_cannot_be_read_ends_its_client_alone(served, unused_port, caplog):
    async with satellite(served.url, unused_port) as client:
        await client.write_event(Event("audio-chunk", {"rate": "loud"}, payload=b"\0\0"))
        assert await asyncio.wait_for(client.read_event(), 60.0) is None
        other = AsyncTcpClient("127.0.0.1", unused_port)
        await other.connect()
        answer = await said(other, tone(0.1))
        await other.disconnect()

    assert Played.is_type(answer.type)
    assert "cannot be read" in caplog.text


async def test_where_no_face_answers_a_satellite_is_told_that_nothing_was_played(
    unused_port, caplog
):
    async with satellite("ws://127.0.0.1:9", unused_port) as client:
        answer = await said(client, tone(0.2))
    assert Error.is_type(answer.type)
    assert "no face answers" in Error.from_event(answer).text
    assert caplog.text.count("not said") == 1


async def test_an_announcement_that_is_cut_off_is_not_told_as_played(served, unused_port):
    async with satellite(served.url, unused_port) as client:
        saying = asyncio.ensure_future(said(client, tone(20.0)))
        while not served.sound.played().any():
            await asyncio.sleep(0.002)
        served.playout.requests.append(PlayoutRequest("interrupt"))
        assert Error.from_event(await saying).code == "interrupted"


async def test_a_start_within_an_announcement_begins_another_and_both_are_told_as_played(
    served, unused_port
):
    async with satellite(served.url, unused_port) as client:
        await said(client, tone(0.3), ends=False)
        first = await said(client, tone(0.2))
        answers = first, await asyncio.wait_for(client.read_event(), 60.0)
    heard_s = sounding_s(served)

    assert [answer.type for answer in answers] == ["played", "played"]
    assert heard_s == pytest.approx(0.5, abs=0.01)


@contextlib.asynccontextmanager
async def two_satellites(url, port):
    async with satellite(url, port) as client:
        other = AsyncTcpClient("127.0.0.1", port)
        await other.connect()
        yield client, other
        await other.disconnect()


async def test_announcements_of_two_satellites_are_heard_one_after_the_other(served, unused_port):
    async with two_satellites(served.url, unused_port) as (one, other):
        answers = await asyncio.gather(said(one, tone(1.0)), said(other, tone(0.5)))
    heard_s = sounding_s(served)

    assert [answer.type for answer in answers] == ["played", "played"]
    assert heard_s == pytest.approx(1.5, abs=0.02)


async def test_a_satellite_that_falls_silent_within_an_announcement_holds_up_no_other(
    served, unused_port, monkeypatch
):
    monkeypatch.setattr(wyoming_face, "_SILENT_S", 0.3)

    async with two_satellites(served.url, unused_port) as (silent, other):
        await said(silent, tone(0.2), ends=False)
        last = await said(other, tone(0.2))
        answers = await asyncio.wait_for(silent.read_event(), 60.0), last
    heard_s = sounding_s(served)

    assert [answer.type for answer in answers] == ["played", "played"]
    assert heard_s == pytest.approx(0.4, abs=0.02)


async def test_a_satellite_that_is_lost_within_a_chunk_holds_up_no_other_and_speaks_again(
    served, unused_port, monkeypatch
):
    monkeypatch.setattr(wyoming_face, "_SILENT_S", 0.3)

    async with two_satellites(served.url, unused_port) as (lost, other):
        await said(lost, tone(0.2), ends=False)
        header = b'{"type": "audio-chunk", "data": {"rate": 24000, "width": 2, "channels": 1}'
        lost._writer.write(header + b', "payload_length": 2400}\n' + tone(0.02))
        last = await said(other, tone(0.2))
        lost._writer.write(tone(0.03))
        await lost.write_event(AudioStop().event())
        answers = [last, *[await asyncio.wait_for(lost.read_event(), 60.0) for _ in range(2)]]
    heard_s = sounding_s(served)

    assert [answer.type for answer in answers] == ["played"] * 3
    assert heard_s == pytest.approx(0.45, abs=0.02)
