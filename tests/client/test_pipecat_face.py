"""A face in a real Pipecat pipeline: frames in, sound at the face, frames on."""

import asyncio
import warnings

import numpy as np
import pytest
from lipservo_lab.bench.agents.remembered_words import WORD_S
from voice_agents.remembered import heard_words, numbered, sound, wrong
from voice_agents.served_face import RATE_HZ, ServedFace, sounding_s, tone

import lipservo
from lipsync.text_to_speech.pronunciation import pronounced

# Its own imports warn of what it will drop one day.
with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    pytest.importorskip("pipecat", reason="pip install 'lipservo-client[pipecat]', 512 MB")
    from lipservo_client.pipecat_face import PipecatFace, PipecatFollower
    from pipecat.frames.frames import (
        AggregatedTextFrame,
        BotSpeakingFrame,
        BotStartedSpeakingFrame,
        BotStoppedSpeakingFrame,
        ErrorFrame,
        InterruptionFrame,
        TextFrame,
        TTSAudioRawFrame,
        TTSStartedFrame,
        TTSStoppedFrame,
        TTSTextFrame,
    )
    from pipecat.processors.frame_processor import FrameDirection
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
def test_what_the_tts_says_is_heard_at_the_face_before_the_pipeline_ends(served, channels):
    down, up = piped(PipecatFace(served.url), [*spoken(0.4, channels), TextFrame("on")])
    heard = served.sound.played()

    assert np.count_nonzero(heard) / RATE_HZ == pytest.approx(0.4, abs=0.02)
    assert np.abs(heard).max() == pytest.approx(8_000 / 32_768, rel=0.01)
    assert TTSAudioRawFrame not in kinds(down)
    assert {TTSStartedFrame, TTSStoppedFrame, TextFrame} <= set(kinds(down))
    for frames in (down, up):
        told = [each for each in kinds(frames) if "Bot" in each.__name__]
        assert BotSpeakingFrame in told
        told = [each for each in told if each is not BotSpeakingFrame]
        assert told == [BotStartedSpeakingFrame, BotStoppedSpeakingFrame]


def test_an_interruption_is_silence_and_tells_how_much_was_heard(served):
    def frames(served):
        yield from spoken(60.0)[:-1]
        while not served.sound.played().any():
            yield SleepFrame(0.01)
        yield InterruptionFrame()
        yield from spoken(0.2)

    processor = PipecatFace(served.url)
    down, _ = piped(processor, frames(served))
    heard_s = sounding_s(served)

    assert not processor.last_played.finished
    assert 0.0 < processor.last_played.played_s < 59.0
    assert heard_s == pytest.approx(processor.last_played.played_s + 0.2, abs=0.08)
    assert InterruptionFrame in kinds(down)


def test_without_a_face_the_sound_goes_to_the_transport():
    down, up = piped(PipecatFace("ws://127.0.0.1:9"), spoken(0.2))

    assert kinds(down).count(TTSAudioRawFrame) == 5
    (error,) = [frame for frame in up if isinstance(frame, ErrorFrame)]
    assert "no face answers" in error.error


def test_sound_that_may_not_be_interrupted_is_said_to_its_end(served):
    def frames(served):
        *start, stop = spoken(2.0)
        for frame in start:
            frame.interruptible = False
            yield frame
        yield stop
        while not served.sound.played().any():
            yield SleepFrame(0.005)
        yield InterruptionFrame()

    down, _ = piped(PipecatFace(served.url), frames(served))
    heard_s = sounding_s(served)

    assert heard_s == pytest.approx(2.0, abs=0.01)
    assert InterruptionFrame in kinds(down)


def test_of_mixed_sound_the_rest_of_what_may_not_be_interrupted_is_said_again(served):
    def frames(served):
        yield TTSStartedFrame()
        for number, frame in enumerate(spoken(4.0)[1:-1]):
            frame.interruptible = number < 50  # the last two seconds may not
            yield frame
        while not served.sound.played().any():
            yield SleepFrame(0.005)
        yield InterruptionFrame()
        yield TTSStoppedFrame()

    piped(PipecatFace(served.url), frames(served))
    heard_s = sounding_s(served)

    # As much as was heard before the interruption, and then the last two seconds.
    assert 2.0 <= heard_s <= 4.0


def told_words(face):
    """(kind, word, whether it has a time) of all that the face was told."""
    return [
        (told.kind, word.label, word.start_s is not None)
        for told in face.playout.take_words()
        for word in told.words
    ]


def test_the_face_knows_the_sentence_before_its_sound_and_not_twice():
    def frames():
        sentence = AggregatedTextFrame("Good day.", "sentence")
        sentence.will_be_spoken = True
        started, *rest = spoken(0.8)
        yield from (started, sentence, *rest[:-1])
        yield TTSTextFrame("Good day.", "sentence")
        yield rest[-1]

    pronounced("good day")  # or the sound is over before the dictionary is there
    with ServedFace(step_s=0.001) as face:
        down, _ = piped(PipecatFace(face.url), list(frames()))
        told = told_words(face)

    assert told == [("text", "Good", False), ("text", "day", False)]
    assert {AggregatedTextFrame, TTSTextFrame} <= set(kinds(down))


def test_words_that_the_tts_times_are_told_with_their_times():
    class Timed(PipecatFace):
        """The service's clock is the pipeline's: a word's time is known when its sound has come."""

        async def process_frame(self, frame, direction):
            if isinstance(frame, TTSTextFrame):
                frame.pts = self.get_clock().get_time() + 200_000_000
            await super().process_frame(frame, direction)

    def frames():
        *audio, stopped = spoken(1.0)
        yield from (*audio[:4], TTSTextFrame("good", "word"), *audio[4:], stopped)

    pronounced("good day")  # or the sound is over before the dictionary is there
    with ServedFace(step_s=0.001) as face:
        piped(Timed(face.url), list(frames()))
        told = told_words(face)

    assert told == [("word", "good", True)]


def test_more_sentences_than_a_face_keeps_streams_are_all_heard(served):
    def frames():
        for number in range(12):
            yield from spoken(0.1)
            yield TextFrame(str(number))

    down, _ = piped(PipecatFace(served.url), frames())
    heard_s = sounding_s(served)
    refused = served.server.status()["n_streams_refused"]

    assert heard_s == pytest.approx(1.2, abs=0.03)
    assert refused == 0
    assert TTSAudioRawFrame not in kinds(down)


def test_a_follower_shows_the_sound_hands_it_on_in_order_and_reports_what_is_played(served):
    def frames():
        yield from spoken(0.4)
        yield TextFrame("behind")
        yield SleepFrame(1.0)
        yield BotStartedSpeakingFrame()
        yield SleepFrame(0.4)
        yield BotStoppedSpeakingFrame()
        yield SleepFrame(0.2)

    served.hold()  # in its hurry it would be over before the transport begins
    down, _ = piped(PipecatFollower(served.url), frames())
    assert not served.sound.played().any()

    sound = [frame for frame in down if isinstance(frame, TTSAudioRawFrame)]
    assert b"".join(frame.audio for frame in sound) == tone(0.4)
    order = [each for each in kinds(down) if "Bot" not in each.__name__]
    assert order == [TTSStartedFrame, *[TTSAudioRawFrame] * len(sound), TTSStoppedFrame, TextFrame]
    reported = [n_samples for _, _, n_samples in served.reported]
    assert reported == sorted(reported)
    assert reported[-1] == round(0.4 * RATE_HZ)


def test_a_follower_shows_no_turn_whose_beginning_the_face_refused_and_the_next_whole():
    def frames(face, client):
        speech = client.stream()
        speech.__enter__()
        first, second = spoken(1.0), spoken(0.4)
        yield from first[:13]
        yield SleepFrame(0.3)  # until it was refused
        speech.wait()
        face.hold()
        yield from (*first[13:], *second)
        for _ in range(2):  # of the first turn, then of the second
            yield BotStartedSpeakingFrame()
            yield SleepFrame(0.3)
            yield BotStoppedSpeakingFrame()
        yield SleepFrame(0.2)

    with ServedFace() as face, lipservo.connect(face.url) as client:
        down, _ = piped(PipecatFollower(face.url), frames(face, client))
        refused = face.server.status()["n_streams_refused"]

    sound = [frame for frame in down if isinstance(frame, TTSAudioRawFrame)]
    assert b"".join(frame.audio for frame in sound) == tone(1.0) + tone(0.4)
    assert len({name for _, name, _ in face.reported}) == 1
    assert face.reported[-1][2] == round(0.4 * RATE_HZ)
    assert refused == 1


def words_of(frames):
    return [each.text for each in frames if isinstance(each, TTSTextFrame)]


def worded(n_words, first=0):
    """TTS frames of 40 ms, in which each word is known by its samples."""
    pcm, size = sound(n_words, first), 2 * RATE_HZ // 25
    return [TTSAudioRawFrame(pcm[at : at + size], RATE_HZ, 1) for at in range(0, len(pcm), size)]


def test_of_a_sentence_that_is_broken_off_the_words_that_were_heard_go_on(served):
    words = numbered(0, 40)

    def frames(served):
        yield TTSStartedFrame()
        yield from worded(40)
        yield TTSTextFrame(" ".join(words), "sentence")
        while heard_words(served) < 11.3:
            yield SleepFrame(0.002)
        yield InterruptionFrame()

    down, _ = piped(PipecatFace(served.url), frames(served))
    (remembered,) = words_of(down)
    assert wrong(words, served, remembered) == (0, 0)


def test_a_word_is_timed_from_when_its_sound_left_the_service_however_long_it_waits_here(served):
    """Half a minute of sound is all that a face takes: what follows waits before it."""
    words = numbered(0, 200)

    class Service(PipecatFace):
        """Times words as Pipecat's tracker does: from a context's first sound, or the last word."""

        began, began_ns, last_ns = "", 0, 0

        async def queue_frame(self, frame, direction=FrameDirection.DOWNSTREAM, callback=None):
            if isinstance(frame, TTSAudioRawFrame) and frame.context_id != self.began:
                self.began = frame.context_id
                self.began_ns = max(self.last_ns, self.get_clock().get_time())
            if isinstance(frame, TTSTextFrame):
                self.last_ns = frame.pts = self.began_ns + frame.pts
            await super().queue_frame(frame, direction, callback)

    def frames(served):
        yield TTSStartedFrame()
        for context in ("first", "second"):
            first = 0 if context == "first" else 180
            n_words = 180 if context == "first" else 20
            for frame in worded(n_words, first):
                frame.context_id = context
                yield frame
            for place in range(n_words):
                text = TTSTextFrame(words[first + place], "word", context_id=context)
                text.pts = 1 + round(1e9 * WORD_S * place)
                yield text
            yield TTSStoppedFrame(context_id=context)
        while heard_words(served) < 188.3:
            yield SleepFrame(0.002)
        yield InterruptionFrame()

    down, _ = piped(Service(served.url), frames(served))
    assert wrong(words, served, " ".join(words_of(down))) == (0, 0)


def test_a_face_without_a_loudspeaker_leaves_the_sound_to_the_transport():
    with ServedFace(sound=None) as face:
        down, up = piped(PipecatFace(face.url), [*spoken(0.2), TTSTextFrame("said", "sentence")])

    assert kinds(down).count(TTSAudioRawFrame) == 5
    assert words_of(down) == ["said"]
    (error,) = [frame for frame in up if isinstance(frame, ErrorFrame)]
    assert "no loudspeaker" in error.error
