"""A face in a real Pipecat pipeline: frames in, sound at the face, frames on."""

import asyncio
import warnings

import numpy as np
import pytest
from voice_agents.served_face import RATE_HZ, ServedFace, tone

# Its own imports warn of what it will drop one day.
with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    pytest.importorskip("pipecat", reason="pip install 'lipservo-client[pipecat]', 512 MB")
    from lipservo_client.pipecat_face import PipecatFace
    from pipecat.frames.frames import (
        BotSpeakingFrame,
        BotStartedSpeakingFrame,
        BotStoppedSpeakingFrame,
        ErrorFrame,
        InterruptionFrame,
        TextFrame,
        TTSAudioRawFrame,
        TTSStartedFrame,
        TTSStoppedFrame,
    )
    from pipecat.tests.utils import SleepFrame, run_test

pytestmark = pytest.mark.filterwarnings("ignore")


def spoken(duration_s, channels=1):
    """TTS frames of 40 ms."""
    pcm = np.frombuffer(tone(duration_s), dtype="<i2")
    pcm = np.repeat(pcm, channels).tobytes()
    size = 2 * channels * RATE_HZ // 25
    chunks = (pcm[first : first + size] for first in range(0, len(pcm), size))
    audio = [TTSAudioRawFrame(chunk, RATE_HZ, channels) for chunk in chunks]
    return [TTSStartedFrame(), *audio, TTSStoppedFrame()]


def piped(processor, frames):
    """Everything that came out of a pipeline with this processor alone: (down, up)."""
    return asyncio.run(run_test(processor, frames_to_send=frames, start_timeout=30.0))


def kinds(frames):
    return [type(frame) for frame in frames]


@pytest.mark.parametrize("channels", [1, 2])
def test_what_the_tts_says_is_heard_at_the_face_before_the_pipeline_ends(channels):
    with ServedFace() as face:
        down, up = piped(PipecatFace(face.url), [*spoken(0.4, channels), TextFrame("on")])
        heard = face.sound.played()

    assert np.count_nonzero(heard) / RATE_HZ == pytest.approx(0.4, abs=0.02)
    assert np.abs(heard).max() == pytest.approx(8_000 / 32_768, rel=0.01)
    assert TTSAudioRawFrame not in kinds(down)
    assert {TTSStartedFrame, TTSStoppedFrame, TextFrame} <= set(kinds(down))
    for frames in (down, up):
        told = [each for each in kinds(frames) if "Bot" in each.__name__]
        assert BotSpeakingFrame in told
        told = [each for each in told if each is not BotSpeakingFrame]
        assert told == [BotStartedSpeakingFrame, BotStoppedSpeakingFrame]


def test_an_interruption_is_silence_and_tells_how_much_was_heard():
    def frames(face):
        yield from spoken(60.0)[:-1]
        while not face.sound.played().any():
            yield SleepFrame(0.01)
        yield InterruptionFrame()
        yield from spoken(0.2)

    with ServedFace() as face:
        processor = PipecatFace(face.url)
        down, _ = piped(processor, frames(face))
        sounding_s = np.count_nonzero(face.sound.played()) / RATE_HZ

    assert not processor.last_played.finished
    assert 0.0 < processor.last_played.played_s < 59.0
    assert sounding_s == pytest.approx(processor.last_played.played_s + 0.2, abs=0.08)
    assert InterruptionFrame in kinds(down)


def test_without_a_face_the_sound_goes_to_the_transport():
    down, up = piped(PipecatFace("ws://127.0.0.1:9"), spoken(0.2))

    assert kinds(down).count(TTSAudioRawFrame) == 5
    (error,) = [frame for frame in up if isinstance(frame, ErrorFrame)]
    assert "nobody answers" in error.error
