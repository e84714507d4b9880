"""Sound at any pace, and clocks that jump: what a client sends is heard, each sample once."""

import signal
import subprocess
import sys
import time
import tracemalloc

import numpy as np
import pytest
from lipservo_client.protocol import Played
from voice_agents.served_face import ForgottenSound, ServedFace, distinct, heard, until

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


async def test_sound_in_one_byte_pieces_and_faster_than_it_is_heard_arrives_whole():
    pcm = distinct(0.1).tobytes()
    second = distinct(1.0).tobytes()

    with ServedFace(step_s=0.4) as served:
        async with lipservo.connect_async(served.url) as face:
            async with face.stream() as small:
                for byte in pcm:
                    await small.write(bytes([byte]))
            async with face.stream() as fast:
                for _ in range(400):  # more than a face keeps
                    await fast.write(second)
            small, fast = await small.wait(), await fast.wait()
        expected = np.concatenate([distinct(0.1), np.tile(distinct(1.0), 400)])
        assert np.array_equal(heard(served), expected)
    assert small == Played(finished=True, played_s=0.1)
    assert fast == Played(finished=True, played_s=400.0)


@pytest.mark.campaign
async def test_an_hour_that_comes_faster_than_it_is_heard_is_heard_and_kept_nowhere():
    with ServedFace(sound=ForgottenSound, step_s=0.4) as served:
        second = distinct(1.0).tobytes()
        async with lipservo.connect_async(served.url) as face, face.stream() as speech:
            for number in range(3_600):
                await speech.write(second)
                if number == 60:
                    tracemalloc.start()
            grown = tracemalloc.get_traced_memory()[0]
            tracemalloc.stop()
            played = await speech.wait()
    assert played == Played(finished=True, played_s=3_600.0)
    assert grown < 10e6  # of 173 MB; half a minute waits in the face


async def test_sound_that_comes_slower_than_it_is_heard_is_heard_whole_with_silence_between(served):
    pieces = [distinct(0.1, seed) for seed in range(5)]
    async with lipservo.connect_async(served.url) as face:
        events = face.events()
        async with face.stream() as speech:
            for piece in pieces:
                await speech.write(piece)
                while (await anext(events))["type"] != "underrun":
                    pass
            played = await speech.wait()

    assert np.array_equal(heard(served), np.concatenate(pieces))
    assert played == Played(finished=True, played_s=0.5)


async def test_a_wall_clock_that_jumps_changes_nothing(served, monkeypatch):
    given = time.time()
    jumps = iter(range(10**9))
    monkeypatch.setattr(time, "time", lambda: given + (-1) ** next(jumps) * 86_400.0)
    pcm = distinct(0.5)
    async with lipservo.connect_async(served.url) as face, face.stream() as speech:
        await speech.write(pcm)
        played = await speech.wait()

    assert np.array_equal(heard(served), pcm)
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


async def test_an_agent_that_dies_in_mid_word_leaves_the_face_to_the_next(agent):
    """Which waits for its turn: without it the word, never ended, would be waited for in vain."""
    with ServedFace(AgentSettings(when_busy="queue")) as served:
        served.hold()  # in its hurry the word would be over
        agent(served).kill()
        served.go_on()
        async with lipservo.connect_async(served.url) as face, face.stream() as speech:
            await speech.write(distinct(0.1))
            assert (await speech.wait()).finished


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
