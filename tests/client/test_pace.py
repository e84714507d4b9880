"""Sound at any pace, and clocks that jump: what a client sends is heard, each sample once."""

import asyncio
import signal
import subprocess
import sys
import time
import tracemalloc

import numpy as np
import pytest
from lipservo_client.protocol import Played
from voice_agents.served_face import RATE_HZ, ForgottenSound, ServedFace, until

import lipservo
from lipservo.agents.listener import AgentSettings

#: Says one word of ten seconds and never ends it; the process is stopped or killed meanwhile.
AGENT = """
import asyncio, sys, lipservo

async def talk():
    async with lipservo.connect_async(sys.argv[1]) as face:
        events = face.events()
        async with face.stream() as speech:
            await speech.write(bytes(480_000))
            print("said", flush=True)
            async for event in events:
                if event["type"] in ("disconnected", "reconnected"):
                    print(event["type"], flush=True)

asyncio.run(talk())
"""


def distinct(duration_s, seed=0):
    """Samples without a zero, as s16le: what is lost or doubled of them is seen."""
    rng = np.random.default_rng(seed)
    return rng.integers(1, 30_000, round(duration_s * RATE_HZ)).astype("<i2")


def heard(face):
    """What left the loudspeaker, without the silence between."""
    samples = np.rint(face.sound.played() * 32_768).astype(int)
    return samples[samples != 0]


def test_sound_in_one_byte_pieces_and_faster_than_it_is_heard_arrives_whole():
    pcm = distinct(0.1).tobytes()
    second = distinct(1.0).tobytes()

    async def talk(url):
        async with lipservo.connect_async(url) as face:
            async with face.stream() as small:
                for byte in pcm:
                    await small.write(bytes([byte]))
            async with face.stream() as fast:
                for _ in range(400):  # more than a face keeps
                    await fast.write(second)
            return await small.wait(), await fast.wait()

    with ServedFace(step_s=0.4) as face:
        small, fast = asyncio.run(talk(face.url))
        expected = np.concatenate([distinct(0.1), np.tile(distinct(1.0), 400)])
        assert np.array_equal(heard(face), expected)
    assert small == Played(finished=True, played_s=0.1)
    assert fast == Played(finished=True, played_s=400.0)


@pytest.mark.campaign
def test_an_hour_that_comes_faster_than_it_is_heard_is_heard_and_kept_nowhere():
    async def talk(url):
        second = distinct(1.0).tobytes()
        async with lipservo.connect_async(url) as face, face.stream() as speech:
            for number in range(3_600):
                await speech.write(second)
                if number == 60:
                    tracemalloc.start()
            grown = tracemalloc.get_traced_memory()[0]
            tracemalloc.stop()
            return await speech.wait(), grown

    with ServedFace(sound=ForgottenSound, step_s=0.4) as face:
        played, grown = asyncio.run(talk(face.url))
    assert played == Played(finished=True, played_s=3_600.0)
    assert grown < 10e6  # of 173 MB; half a minute waits in the face


def test_sound_that_comes_slower_than_it_is_heard_is_heard_whole_with_silence_between():
    pieces = [distinct(0.1, seed) for seed in range(5)]

    async def talk(url):
        async with lipservo.connect_async(url) as face:
            events = face.events()
            async with face.stream() as speech:
                for piece in pieces:
                    await speech.write(piece)
                    while (await anext(events))["type"] != "underrun":
                        pass
                return await speech.wait()

    with ServedFace() as face:
        played = asyncio.run(asyncio.wait_for(talk(face.url), 60.0))
        assert np.array_equal(heard(face), np.concatenate(pieces))
    assert played == Played(finished=True, played_s=0.5)


def test_a_wall_clock_that_jumps_changes_nothing(monkeypatch):
    given = time.time()
    jumps = iter(range(10**9))
    monkeypatch.setattr(time, "time", lambda: given + (-1) ** next(jumps) * 86_400.0)
    pcm = distinct(0.5)

    async def talk(url):
        async with lipservo.connect_async(url) as face, face.stream() as speech:
            await speech.write(pcm)
            return await speech.wait()

    with ServedFace() as face:
        played = asyncio.run(talk(face.url))
        assert np.array_equal(heard(face), pcm)
    assert played == Played(finished=True, played_s=0.5)


@pytest.fixture
def agent():
    """Starts `AGENT` at a face."""
    running = []

    def started(face):
        command = [sys.executable, "-c", AGENT, face.url]
        running.append(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        assert running[0].stdout.readline() == "said\n"
        return running[0]

    yield started
    for process in running:
        process.kill()
        process.wait()
        process.stdout.close()


def test_an_agent_that_dies_in_mid_word_leaves_the_face_to_the_next(agent):
    async def talk(url):
        async with lipservo.connect_async(url) as face, face.stream() as speech:
            await speech.write(distinct(0.1))
            return await speech.wait()

    with ServedFace() as face:
        face.hold()  # in its hurry the word would be over
        agent(face).kill()
        until(lambda: face.playout.is_over)
        face.go_on()
        assert asyncio.run(talk(face.url)).finished


@pytest.mark.slow
def test_an_agent_whose_computer_was_suspended_finds_the_face_again(agent):
    """Its monotonic clock has stood still; the face has given it up meanwhile."""
    with ServedFace(AgentSettings(ping_s=0.5)) as face:
        face.hold()
        process = agent(face)
        process.send_signal(signal.SIGSTOP)
        until(lambda: face.playout.is_over)
        process.send_signal(signal.SIGCONT)
        assert process.stdout.readline() == "disconnected\n"
        assert process.stdout.readline() == "reconnected\n"
