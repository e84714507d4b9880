"""Whose turn it is, besides what clients see over the wire: the face's own speech, lost events."""

import contextlib
import threading
import time
from collections import deque

import numpy as np
import pytest
import soundfile
from voice_agents.served_face import KeptSound

from lipservo.agents.listener import AgentSettings
from lipservo.agents.messages import MessageError, Outbox, Start
from lipservo.agents.turns import OpenStreams, OwnSpeech
from lipservo.runtime.sound import SpeechItem, SpeechQueue, spoken_chunks, spoken_file
from lipsync.audio.playout import Playout
from lipsync.audio.playout_stream import PlayoutEvent, PlayoutRequest, PlayoutStream

START = Start(type="start", stream="s", sample_rate=16_000)


class Stepped:
    """A playout that goes on when it is told to."""

    def __init__(self, when_busy="refuse"):
        self.playout = Playout(KeptSound())
        self.turns = OpenStreams(self.playout, AgentSettings(when_busy=when_busy))
        self.now_s = 0.0

    def step(self, duration_s=0.1):
        for _ in range(round(duration_s / 0.01)):
            self.now_s += 0.01
            self.playout.advance(self.now_s)
            self.playout.blocks(self.now_s + 0.2)

    def say_of_its_own(self, duration_s):
        speech = PlayoutStream("own", 16_000, 16_000)
        speech.push(np.full(round(16_000 * duration_s), 0.1, dtype=np.float32))
        speech.end()
        self.playout.requests.append(PlayoutRequest("say", speech))
        self.step(0.5)
        self.turns.take_events(self.now_s)


def test_while_the_face_says_something_of_its_own_a_client_is_refused_and_may_interrupt():
    face, client = Stepped(), Outbox()
    face.say_of_its_own(10.0)

    with pytest.raises(MessageError, match="of its own") as refused:
        face.turns.open(client, START, face.now_s)
    face.turns.interrupt(client)
    face.step()
    face.turns.take_events(face.now_s)

    assert refused.value.code == "busy"
    assert face.playout.is_over
    assert face.turns.open(client, START, face.now_s).stream_id == "s"


def test_what_the_face_said_of_its_own_is_over_when_it_was_heard():
    face = Stepped()
    face.say_of_its_own(0.1)
    face.step(1.0)
    face.turns.take_events(face.now_s)

    face.turns.open(Outbox(), START, face.now_s)


def test_nobody_interrupts_another_client_by_way_of_the_faces_own_speech():
    face, speaker, other = Stepped("queue"), Outbox(), Outbox()
    face.say_of_its_own(10.0)
    face.turns.open(speaker, START, face.now_s)

    face.turns.interrupt(other)

    assert [request.kind for request in face.playout.requests] == ["say"]


def test_a_stream_whose_end_was_never_told_holds_nobody_up():
    """Events are dropped where the server's thread stood still for long."""
    face, client, other = Stepped(), Outbox(), Outbox()
    stream = face.turns.open(client, START, face.now_s)
    stream.speech.end()
    face.step(1.0)
    face.playout.events.clear()

    face.turns.take_events(face.now_s)
    with pytest.raises(MessageError, match="another client"):
        face.turns.open(other, START, face.now_s)
    face.turns.take_events(face.now_s + 2.0)

    face.turns.open(other, START, face.now_s)


def test_a_face_whose_loop_stands_still_takes_no_speech():
    face = Stepped()
    for _ in range(40):
        face.playout.requests.append(PlayoutRequest("clear"))

    with pytest.raises(MessageError) as refused:
        face.turns.open(Outbox(), START, 0.0)

    assert refused.value.code == "not_available"


def test_what_the_face_is_about_to_say_of_its_own_is_interrupted_before_it_is_heard():
    face, client = Stepped(), Outbox()
    speech = PlayoutStream("own", 16_000, 16_000)
    face.playout.requests.append(PlayoutRequest("say", speech))
    face.turns.interrupt(client)
    face.step()

    assert speech.is_dropped
    assert face.playout.is_over


class Kept(Outbox):
    """What a client is told."""

    def __init__(self):
        super().__init__()
        self.told = []

    def put(self, event):
        self.told.append(event)


def test_a_waiting_stream_that_is_cleared_is_finished():
    """A client waits for `finished` after `cleared`: nothing else will come of this stream."""
    face, speaker, waiting = Stepped("queue"), Outbox(), Kept()
    face.turns.open(speaker, START, face.now_s)
    stream = face.turns.open(waiting, START, face.now_s)
    stream.push(np.zeros(1600, np.float32), face.now_s)

    face.turns.clear(waiting)

    cleared, finished = waiting.told
    assert (cleared["type"], cleared["n_dropped"]) == ("cleared", 1600)
    assert (finished["type"], finished["n_played"]) == ("finished", 0)


class OwnVoice(Stepped):
    """One whose own speech is read or synthesised, by a client's `say` or `play`."""

    def __init__(self, queue):
        super().__init__()
        self.client = Kept()
        self.own = self.turns.open_own(self.client, 7, "text")
        self.queue = queue(self.playout)

    def say(self, item):
        self.own.spoken = item
        self.queue.add(item, "text")

    def stream(self, duration_s=0.0):
        stream = PlayoutStream(self.own.stream_id, 16_000, self.playout.output_rate_hz)
        stream.push(chunk(duration_s))
        return stream

    def until_told(self, *kinds):
        """What the client is told last, one of these kinds; its end, if none is given."""
        kinds = kinds or ("finished", "dropped")
        give_up_s = time.monotonic() + 30.0
        while time.monotonic() < give_up_s:
            self.step(0.02)
            self.turns.take_events(self.now_s)
            if self.client.told and self.client.told[-1]["type"] in kinds:
                return self.client.told.pop()
            time.sleep(0.001)
        raise AssertionError("nothing was told")


@pytest.fixture
def voice():
    with contextlib.ExitStack() as stack:

        def queue(playout):
            return stack.enter_context(contextlib.closing(SpeechQueue(playout)))

        yield OwnVoice(queue)


def chunk(duration_s):
    return np.full(round(16_000 * duration_s), 0.1, np.float32)


def test_own_speech_whose_synthesis_fails_in_the_middle_is_told_dropped(voice):
    def broken():
        yield chunk(0.2)
        raise RuntimeError("the synthesiser failed")

    voice.say(spoken_chunks(broken(), voice.stream(), 0.4))

    told = voice.until_told()
    assert (told["type"], told["id"]) == ("dropped", 7)
    assert told["played_s"] == pytest.approx(0.2, abs=0.03)


def test_own_speech_interrupted_between_two_sentences_is_told_dropped(voice):
    first, second, synthesised = voice.stream(0.2), voice.stream(0.2), threading.Event()
    for stream in (first, second):
        stream.end()

    def pieces():
        assert synthesised.wait(30.0)
        voice.playout.requests.append(PlayoutRequest("say", second, after=first))
        yield second

    voice.say(SpeechItem(pieces(), deque([first]), 5.0, 0.2))
    voice.until_told("started")
    voice.step(1.0)
    voice.turns.interrupt(Outbox())
    voice.step()
    synthesised.set()

    assert voice.until_told()["type"] == "dropped"


def test_own_speech_that_was_heard_whole_is_told_finished(voice, tmp_path):
    voice.say(spoken_chunks(iter([chunk(0.2), chunk(0.2)]), voice.stream(), 0.4))
    assert voice.until_told()["type"] == "finished"

    soundfile.write(tmp_path / "line.wav", chunk(0.4), 16_000)
    voice.own = voice.turns.open_own(voice.client, 8, "line.wav")
    voice.say(spoken_file(tmp_path / "line.wav", voice.playout, voice.own.stream_id))
    told = voice.until_told()
    assert (told["type"], told["id"], told["duration_s"]) == ("finished", 8, 0.4)


@pytest.mark.parametrize("end", ["finished", "interrupted", "cleared"])
def test_the_silence_between_two_sentences_is_not_counted_as_heard(end):
    own = OwnSpeech(Outbox(), 7, "text")
    for kind, at_s in (("started", 1.0), ("finished", 1.2), ("started", 1.5), (end, 1.7)):
        own.take(PlayoutEvent(kind, "text", at_s))
    assert own.heard_s == pytest.approx(0.4)


def test_own_speech_interrupted_while_it_is_synthesised_is_dropped_and_never_heard(voice):
    voice.turns.interrupt(Outbox())
    told = voice.until_told()
    item = spoken_chunks(iter([chunk(0.2)]), voice.stream(), 0.2)
    voice.queue.add(item, "text")
    voice.turns.keep(voice.own, item)
    voice.step(1.0)

    assert (told["type"], told["id"], told["played_s"]) == ("dropped", 7, 0.0)
    assert item.is_dropped
    assert not voice.playout.loudspeaker.played().any()


def test_own_speech_is_not_interrupted_in_its_synthesis_where_another_client_speaks():
    face, speaker, other = Stepped("queue"), Outbox(), Outbox()
    own = face.turns.open_own(other, 7, "text")
    face.turns.open(speaker, START, face.now_s)

    face.turns.interrupt(other)
    face.turns.keep(own, spoken_chunks(iter([]), PlayoutStream("text", 16_000, 16_000), 0.2))

    assert not own.is_dropped
    assert [request.kind for request in face.playout.requests] == ["say"]


def test_a_stream_that_waits_for_its_turn_with_sound_to_play_is_not_stalled():
    face, waiting = Stepped("queue"), Kept()
    first = face.turns.open(Outbox(), START, face.now_s)
    first.push(chunk(100.0), face.now_s)
    first.speech.end()
    second = face.turns.open(waiting, START, face.now_s)
    second.push(chunk(30.0), face.now_s)
    face.step(61.0)
    face.turns.take_events(face.now_s)
    face.turns.end_stalled(face.now_s)

    assert waiting.told == []
    assert not second.speech.ended
