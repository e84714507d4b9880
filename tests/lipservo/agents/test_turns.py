"""Whose turn it is, besides what clients see over the wire: the face's own speech, lost events."""

import asyncio
import json

import numpy as np
import pytest
from voice_agents.served_face import KeptSound

from lipservo.agents.listener import AgentSettings
from lipservo.agents.messages import MessageError, Outbox, Start
from lipservo.agents.turns import OpenStreams
from lipsync.audio.playout import Playout
from lipsync.audio.playout_stream import PlayoutRequest, PlayoutStream

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


def test_a_waiting_stream_that_is_cleared_is_finished():
    """A client waits for `finished` after `cleared`: nothing else will come of this stream."""
    face, speaker, waiting = Stepped("queue"), Outbox(), Outbox()
    face.turns.open(speaker, START, face.now_s)
    stream = face.turns.open(waiting, START, face.now_s)
    stream.push(np.zeros(1600, np.float32), face.now_s)

    face.turns.clear(waiting)

    def took():
        return json.loads(asyncio.run(asyncio.wait_for(waiting.take(), 5.0)))

    cleared, finished = took(), took()
    assert (cleared["type"], cleared["n_dropped"]) == ("cleared", 1600)
    assert (finished["type"], finished["n_played"]) == ("finished", 0)
