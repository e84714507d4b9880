"""Phonemes of what the robot says: known in stretches of the timeline, recognised elsewhere."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lipservo_lab.evaluation.recognition.half_duplex import PieceMicrophone
from spoken_phonemes import spoken, update_streams

from lipservo.runtime.speech.phoneme_sources import SpokenPhonemes, with_known
from lipsync.audio.playout import ListenedMicrophone, Playout
from lipsync.audio.playout_stream import PlayoutRequest, PlayoutStream
from lipsync.phonemes import FramePosteriors, PhonemeEvent, PhonemeUpdate
from lipsync.timeline import PhonemeTimeline

RATE_HZ = 16_000
#: Nothing in the inventory: whatever is told of it was known.
KNOWN = "known"


def end_s(event):
    return math.inf if event.end_s is None else event.end_s


@st.composite
def known_stretches(draw):
    """In order, not overlapping; some cut off in the middle of a phoneme, some with gaps."""
    stretches, at_s = [], 0.0
    for _ in range(draw(st.integers(0, 4))):
        start_s = at_s = at_s + draw(st.floats(0.0, 1.0))
        events = []
        for duration_s in draw(st.lists(st.floats(0.01, 0.5), min_size=1, max_size=6)):
            at_s += draw(st.sampled_from([0.0, 0.0, 0.05]))
            events.append(PhonemeEvent(KNOWN, at_s, at_s + duration_s))
            at_s += duration_s
        at_s = start_s + (at_s - start_s) * draw(st.just(1.0) | st.floats(0.1, 1.0))
        stretches.append((start_s, at_s, tuple(events)))
    return stretches


@given(update_streams(), known_stretches())
def test_known_phonemes_win_inside_their_stretches_and_nowhere_else(updates, stretches):
    timeline = PhonemeTimeline()
    for update in updates:
        ahead = [each for each in stretches if each[1] > update.replace_from_s]
        told = with_known(update, ahead)
        timeline.apply(told)  # refuses what overlaps or is out of order
        for event in told.events:
            if event.phoneme == KNOWN:
                assert any(a <= event.start_s < end_s(event) <= b for a, b, _ in stretches)
            else:
                assert all(end_s(event) <= a or event.start_s >= b for a, b, _ in ahead)
        for _, until_s, known in ahead:
            for event in known:
                # What sounds soon is told.
                if update.replace_from_s < event.start_s < min(until_s, update.heard_until_s):
                    assert event.start_s in [each.start_s for each in told.events]
        unheard = [each for each in told.events if each.phoneme == KNOWN]
        assert all(each.start_s < update.heard_until_s + 1.0 for each in unheard)


def test_with_nothing_known_an_update_stays_as_it_is():
    update = PhonemeUpdate(0.2, 0.5, 0.3, spoken(("M", 0.3), ("AA", 0.4)))
    assert with_known(update, []) == update


def test_what_is_known_is_not_doubted_by_what_is_heard():
    believed = FramePosteriors(100, 0, (2,), np.full((50, 1, 40), 1 / 40, np.float32))
    update = PhonemeUpdate(0.2, 0.5, 0.3, spoken(("M", 0.3), ("AA", 0.4)), believed)
    assert with_known(update, []).posteriors is believed
    known = (0.3, 0.6, (PhonemeEvent(KNOWN, 0.3, 0.6),))
    assert with_known(update, [known]).posteriors is None


class Hears:
    """A recogniser that says AA of all sound, as soon as it is there."""

    latency_s = 0.0

    def __init__(self):
        self.heard_s = 0.0

    def feed(self, block):
        self.heard_s = block.end_s

    def updates(self):
        return [PhonemeUpdate(0.0, self.heard_s, 0.0, (PhonemeEvent("AA", 0.0, None),))]

    def reset(self):
        self.heard_s = 0.0


class Spoken:
    """A playout with known streams and what its phonemes are believed to be."""

    def __init__(self):
        self.playout = Playout()
        self.timeline = PhonemeTimeline()
        self.source = SpokenPhonemes(self.playout, Hears())

    def say(self, *phones, duration_s=None):
        known = spoken(*phones)
        stream = PlayoutStream("a", RATE_HZ, RATE_HZ, known)
        sound_s = known[-1].end_s if duration_s is None else duration_s
        stream.push(np.full(round(sound_s * RATE_HZ), 0.1, np.float32))
        self.playout.requests.append(PlayoutRequest("say", stream))
        return stream

    def ask(self, kind):
        self.playout.requests.append(PlayoutRequest(kind))

    def go_on(self, until_s, position_s=None):
        self.playout.advance(until_s if position_s is None else position_s)
        for update in self.source.updates(until_s):
            self.timeline.apply(update)

    def told(self, *times_s):
        events = [self.timeline.event_at(time_s) for time_s in times_s]
        return [None if event is None else event.phoneme for event in events]


def test_an_interruption_in_the_middle_of_a_known_phoneme_ends_it_there():
    face = Spoken()
    face.say(("M", 0.2), ("IY", 0.4), ("P", 0.2)).end()
    face.say(("OW", 0.5)).end()
    face.go_on(0.1)
    face.go_on(0.45)
    face.ask("interrupt")
    face.go_on(0.5, position_s=0.45)
    face.go_on(1.5)
    assert face.told(0.1, 0.3, 0.44, 0.46, 0.7, 1.0) == ["M", "IY", "IY", "SIL", "SIL", "SIL"]


def test_a_stream_that_was_committed_and_never_heard_says_nothing():
    face = Spoken()
    face.say(("M", 0.2)).end()
    face.say(("OW", 0.5)).end()
    face.go_on(0.1, position_s=0.0)
    face.go_on(0.4, position_s=0.1)
    face.ask("interrupt")
    face.go_on(0.5, position_s=0.15)
    face.go_on(1.0)
    assert face.told(0.1, 0.17, 0.3, 0.6) == ["M", "SIL", "SIL", "SIL"]


def test_what_is_cleared_before_it_sounds_is_not_shown():
    face = Spoken()
    face.say(("M", 0.2), ("IY", 0.8)).end()
    face.go_on(0.3, position_s=0.1)
    face.ask("clear")
    face.go_on(0.5, position_s=0.3)
    face.go_on(1.0)
    assert face.told(0.25, 0.35, 0.8) == ["IY", "SIL", "SIL"]


def test_known_phonemes_that_outlast_their_sound_end_with_it():
    face = Spoken()
    face.say(("M", 0.2), ("IY", 0.8), duration_s=0.4).end()
    face.say(("OW", 0.5)).end()
    for n in range(100):
        face.go_on(n / 100)
    assert face.told(0.1, 0.39, 0.41, 0.89, 0.91) == ["M", "IY", "OW", "OW", "SIL"]


def test_a_known_stream_that_dries_up_takes_its_phonemes_up_where_its_sound_goes_on():
    face = Spoken()
    stream = face.say(("M", 0.2), ("IY", 0.2), ("P", 0.2), duration_s=0.3)
    face.go_on(0.1)
    face.go_on(0.5)
    stream.push(np.full(round(0.3 * RATE_HZ), 0.1, np.float32))
    stream.end()
    for n in range(50, 100):
        face.go_on(n / 100)
    assert face.told(0.1, 0.29, 0.35, 0.45) == ["M", "IY", "SIL", "SIL"]
    assert face.told(0.55, 0.65, 0.75, 0.85) == ["IY", "P", "P", "SIL"]


class ServoEars:
    """A recogniser that remembers what it is told of the servos."""

    latency_s = 0.05

    def __init__(self):
        self.told = []

    def feed(self, block): ...

    def updates(self):
        return []

    def reset(self): ...

    def note_servo_speeds(self, sound_s, _speeds_deg_s):
        self.told.append(sound_s)


def test_servo_speeds_are_told_where_the_microphone_is_heard_and_nowhere_else():
    """A second of listening, half a second of speech without servos in it, and its echo."""
    ears = ServoEars()
    microphone = PieceMicrophone(np.zeros(3 * RATE_HZ, np.float32))
    playout = Playout(None, ListenedMicrophone(microphone))
    source = SpokenPhonemes(playout, ears)
    stream = PlayoutStream("a", RATE_HZ, RATE_HZ)
    stream.push(np.zeros(RATE_HZ // 2, np.float32))
    stream.end()
    for n in range(300):
        if n == 100:
            playout.requests.append(PlayoutRequest("say", stream))
        microphone.advance(n / 100)
        playout.advance(n / 100)
        source.updates((n + 1) / 100)
        source.note_servo_speeds(n / 100, np.array([40.0]))
    told_s = np.array(ears.told)
    # What the microphone captures now is committed after the 40 ms that are held back.
    assert told_s[:3] == pytest.approx([0.05, 0.06, 0.07])
    assert not ((told_s > 1.05) & (told_s < 1.85)).any()
    assert told_s[-1] == pytest.approx(3.04)
    mute = ServoEars()
    SpokenPhonemes(Playout(None), mute).note_servo_speeds(0.0, np.array([40.0]))
    assert mute.told == []
