"""A face as the audio output of a LiveKit agent session without a room."""

import asyncio
import socket
import warnings

import numpy as np
import pytest
from lipservo_lab.bench.agents.remembered_words import WORD_S
from voice_agents.remembered import heard_words, numbered, sound, wrong
from voice_agents.served_face import RATE_HZ, ServedFace, sounding_s, tone, until

import lipservo
from lipsync.audio.playout_stream import PlayoutRequest
from lipsync.text_to_speech.pronunciation import pronounced

# Its own imports warn of what it will drop one day.
with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    pytest.importorskip("livekit.agents", reason="pip install 'lipservo-client[livekit]'")
    from lipservo_client.livekit_face import LiveKitFace
    from livekit import rtc
    from livekit.agents import Agent, AgentSession
    from livekit.agents.types import USERDATA_TIMED_TRANSCRIPT, TimedString

pytestmark = pytest.mark.filterwarnings("ignore")


def frames(duration_s, channels=1):
    pcm = np.repeat(np.frombuffer(tone(duration_s), "<i2"), channels).tobytes()
    size = 2 * channels * RATE_HZ // 50
    for first in range(0, len(pcm), size):
        data = pcm[first : first + size]
        yield rtc.AudioFrame(data, RATE_HZ, channels, len(data) // (2 * channels))


async def captured(output, duration_s, channels=1):
    for frame in frames(duration_s, channels):
        await output.capture_frame(frame)


@pytest.mark.parametrize("channels", [1, 2])
async def test_segments_are_heard_whole_and_told_in_order(served, channels):
    told = []
    async with LiveKitFace(served.url) as output:
        output.on("playback_started", lambda _: told.append("started"))
        output.on("playback_finished", told.append)
        for duration_s in (0.4, 0.2):
            await captured(output, duration_s, channels)
            output.flush()
        await asyncio.wait_for(output.wait_for_playout(), 60.0)
    heard_s = sounding_s(served)

    assert heard_s == pytest.approx(0.6, abs=0.01)
    finished = [event for event in told if event != "started"]
    ends = [(each.playback_position, each.interrupted) for each in finished]
    assert ends == [(0.4, False), (0.2, False)]


async def test_a_timed_transcript_beside_the_sound_is_told_with_its_times():
    pronounced("good day")  # or the sound is over before the dictionary is there
    with ServedFace(step_s=0.001) as face:
        async with LiveKitFace(face.url) as output:
            for n, frame in enumerate(frames(0.8)):
                if n == 0:
                    timed = (("good ", 0.1), ("day", 0.4))
                    words = [TimedString(word, start_time=start_s) for word, start_s in timed]
                    frame.userdata[USERDATA_TIMED_TRANSCRIPT] = words
                await output.capture_frame(frame)
            output.flush()
            await asyncio.wait_for(output.wait_for_playout(), 60.0)
        told = [word for each in face.playout.take_words() for word in each.words]

    assert [word.label for word in told] == ["good", "day"]
    assert told[1].start_s - told[0].start_s == pytest.approx(0.3, abs=1e-3)


async def test_a_cleared_buffer_tells_what_was_heard_and_the_next_segment_is_heard(served):
    async with LiveKitFace(served.url) as output:
        await captured(output, 20.0)
        await sounded(served, 0.01)
        output.clear_buffer()
        output.flush()
        cut = await asyncio.wait_for(output.wait_for_playout(), 60.0)
        await captured(output, 0.2)
        output.flush()
        whole = await asyncio.wait_for(output.wait_for_playout(), 60.0)
    heard_s = sounding_s(served)

    assert cut.interrupted
    assert 0.0 < cut.playback_position < 19.0
    assert (whole.playback_position, whole.interrupted) == (0.2, False)
    assert heard_s == pytest.approx(cut.playback_position + 0.2, abs=0.03)


async def test_what_is_paused_goes_on_and_is_heard_whole(served):
    async with LiveKitFace(served.url) as output:
        assert output.can_pause
        await captured(output, 3.0)
        output.flush()
        await sounded(served, 0.01)
        output.pause()
        before_s = -1.0
        while before_s != sounding_s(served):  # in 50 ms a second of sound would be heard
            before_s = sounding_s(served)
            await asyncio.sleep(0.05)
        paused_s = before_s
        output.resume()
        whole = await asyncio.wait_for(output.wait_for_playout(), 60.0)
    heard_s = sounding_s(served)

    assert 0.0 < paused_s < 2.9
    assert (whole.playback_position, whole.interrupted) == (3.0, False)
    assert heard_s == pytest.approx(3.0, abs=0.03)


async def test_a_session_says_a_recording_through_the_face(served):
    async with LiveKitFace(served.url) as output:
        session = AgentSession()
        session.output.audio = output
        await session.start(Agent(instructions="none"))

        async def recording():
            for frame in frames(0.5):
                yield frame

        handle = session.say("Good morning.", audio=recording())
        await asyncio.wait_for(handle.wait_for_playout(), 60.0)
        history = [getattr(item, "text_content", "") for item in session.history.items]
        await session.aclose()
    heard_s = sounding_s(served)

    assert heard_s == pytest.approx(0.5, abs=0.01)
    assert "Good morning." in history


async def test_without_a_face_segments_end_at_once_with_nothing_heard():
    async with LiveKitFace("ws://127.0.0.1:9") as output:
        await captured(output, 0.2)
        output.flush()
        ended = await asyncio.wait_for(output.wait_for_playout(), 60.0)
    assert (ended.playback_position, ended.interrupted) == (0.0, True)


async def test_a_barge_in_before_the_face_has_taken_the_segment_ends_it():
    """As LiveKit's forwarding task ends: the robot is off, and connecting takes until then."""
    with socket.create_server(("127.0.0.1", 0)) as silent:
        output = LiveKitFace(f"ws://127.0.0.1:{silent.getsockname()[1]}", token="t")
        output._face.keep_trying()
        saying = asyncio.ensure_future(captured(output, 0.2))
        await asyncio.sleep(0.1)
        saying.cancel()
        await asyncio.wait([saying])
        output.flush()
        output.clear_buffer()
        ended = await asyncio.wait_for(output.wait_for_playout(), 10.0)
        await output.__aexit__()
        assert (saying.cancelled(), ended.interrupted, ended.playback_position) == (True, True, 0.0)


async def test_a_face_that_goes_while_it_speaks_ends_the_segment():
    face = ServedFace()
    face.__enter__()
    async with LiveKitFace(face.url) as output:
        await captured(output, 20.0)
        output.flush()
        while not face.sound.played().any():
            await asyncio.sleep(0.002)
        ending = asyncio.get_running_loop().run_in_executor(None, face.__exit__)
        ended = await asyncio.wait_for(output.wait_for_playout(), 60.0)
        await ending
        assert ended.interrupted
    until(lambda: face.playout.is_over)


async def test_a_segment_that_is_spoken_while_the_face_is_left_ends_as_interrupted(served):
    told = []
    async with LiveKitFace(served.url) as output:
        output.on("playback_finished", told.append)
        await captured(output, 20.0)
        output.flush()
        await sounded(served, 0.01)
    assert [each.interrupted for each in told] == [True]


def worded_frames(n_words, timed_words=()):
    pcm = sound(n_words)
    size = 2 * RATE_HZ // 50
    for n, first in enumerate(range(0, len(pcm), size)):
        data = pcm[first : first + size]
        frame = rtc.AudioFrame(data, RATE_HZ, 1, len(data) // 2)
        if n == 0 and timed_words:
            frame.userdata[USERDATA_TIMED_TRANSCRIPT] = [
                TimedString(f"{word} ", start_time=WORD_S * place)
                for place, word in enumerate(timed_words)
            ]
        yield frame


async def sounded(face, n_words):
    while heard_words(face) < n_words:
        await asyncio.sleep(0.001)


async def conversation(url, turns):
    """Let a session say turns, (words, has times, work meanwhile); the texts that it remembers."""
    async with LiveKitFace(url) as output:
        session = AgentSession()
        session.output.audio = output
        await session.start(Agent(instructions="none"))
        for words, has_times, meanwhile in turns:

            async def recording(words=words, has_times=has_times):
                for frame in worded_frames(len(words), words if has_times else ()):
                    yield frame

            handle = session.say(" ".join(words), audio=recording())
            await meanwhile(handle)
            await asyncio.wait_for(handle, 60.0)
        texts = [getattr(item, "text_content", None) or "" for item in session.history.items]
        agent = session.current_agent
        own = [getattr(item, "text_content", None) or "" for item in agent.chat_ctx.items]
        await session.aclose()
        assert [text for text in texts if text] == [text for text in own if text]
        return " ".join(texts)


@pytest.mark.parametrize("has_times", [False, True])
async def test_of_a_turn_that_is_broken_off_the_session_remembers_what_was_heard(served, has_times):
    words = numbered(0, 40)

    async def break_in(handle):
        await sounded(served, 7.3)
        handle.interrupt()

    remembered = await conversation(served.url, [(words, has_times, break_in)])
    assert 7 <= heard_words(served) < 39
    assert wrong(words, served, remembered) == (0, 0)


async def test_a_turn_that_is_broken_off_by_another_client_is_not_remembered_whole(served):
    words = numbered(0, 40)

    async def silence(_handle):
        await sounded(served, 5.3)
        served.playout.requests.append(PlayoutRequest("interrupt"))

    remembered = await conversation(served.url, [(words, False, silence)])
    assert wrong(words, served, remembered) == (0, 0)


async def nothing(_handle):
    pass


async def test_without_a_face_nothing_that_was_said_is_remembered():
    told = await conversation("ws://127.0.0.1:9", [(numbered(0, 9), False, nothing)])
    assert told.split() == []


async def test_a_turn_that_the_face_refuses_is_forgotten_and_the_next_is_heard_and_remembered(
    served,
):
    words = [numbered(0, 6), numbered(1, 6)]
    other = lipservo.connect_async(served.url)
    await other.__aenter__()
    speech = other.stream()
    await speech.__aenter__()
    await speech.write(bytes(4800))

    async def refused(handle):
        await handle
        await speech.wait()
        await other.__aexit__()

    turns = [(words[0], False, refused), (words[1], False, nothing)]
    remembered = await conversation(served.url, turns)
    assert remembered.split() == words[1]
