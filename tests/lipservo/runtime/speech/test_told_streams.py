"""What a sender tells beside its sound: phonemes move the mouth, words are looked for in it."""

from dataclasses import replace

import numpy as np
import pytest

from lipservo.runtime.speech.phoneme_sources import SpokenPhonemes
from lipsync.audio.playout import Playout
from lipsync.audio.playout_stream import PlayoutRequest, PlayoutStream, PlayoutTextError
from lipsync.phonemes import PHONEMES as INVENTORY
from lipsync.phonemes import FramePosteriors, PhonemeEvent, PhonemeUpdate
from lipsync.recognition.energy_recognizer import EnergyRecognizer
from lipsync.recognition.fallback import FallbackLevel, FallbackRecognizer
from lipsync.spoken_text import PronouncedWord, SpokenText, SpokenUnit
from lipsync.timeline import PhonemeTimeline

RATE_HZ = 16_000
MAMA = PronouncedWord("mama", (("M", "AA", "M", "AH"),))


class Follows:
    """A recogniser that says AA of all sound 0.1 s later, and keeps which words it is told."""

    latency_s = 0.1
    moved_by = "text"
    saying = (("mama",), 0)

    def __init__(self):
        self.heard_s, self.told = 0.0, []

    def feed(self, block):
        self.heard_s = block.end_s

    def updates(self):
        events = (PhonemeEvent("AA", max(0.0, self.heard_s - 0.1), None),)
        return [PhonemeUpdate(events[0].start_s, self.heard_s, events[0].start_s, events)]

    def reset(self):
        self.heard_s = 0.0

    def tell(self, words, behind_s=0.0):
        self.told += [(each.label, each.start_s, round(behind_s, 3)) for each in words]

    def forget(self):
        self.told.append("forget")


class Face:
    """A playout that somebody tells what it says, and what its phonemes are believed to be."""

    def __init__(self, ears=None):
        self.playout, self.timeline, self.ears = Playout(), PhonemeTimeline(), ears or Follows()
        self.source = SpokenPhonemes(self.playout, self.ears)
        self.until_s = 0.0

    def say(self, duration_s, name="a"):
        stream = PlayoutStream(name, RATE_HZ, RATE_HZ)
        stream.push(np.full(round(duration_s * RATE_HZ), 0.1, np.float32))
        stream.end()
        self.playout.requests.append(PlayoutRequest("say", stream))
        return stream

    def go_on(self, until_s):
        while self.until_s < until_s - 1e-9:
            self.until_s += 0.01
            self.playout.advance(self.until_s)
            for update in self.source.updates(self.until_s):
                self.timeline.apply(update)

    def shown(self, *times_s):
        events = [self.timeline.event_at(time_s) for time_s in times_s]
        return [None if event is None else event.phoneme for event in events]


class Evident(Follows):
    """The same, with the posteriors of what is truly said: `said`, of phonemes in seconds."""

    moved_by, saying, hearing = "sound", ((), 0), "speech"

    def __init__(self, said):
        super().__init__()
        self.said, self.n_frames = said, 0

    def updates(self):
        (update,) = super().updates()
        rows = []
        for frame in range(self.n_frames, round(self.heard_s * 100)):
            at_s = (frame - 7 + 0.5) / 100
            row = np.full(len(INVENTORY), 0.002, np.float32)
            row[INVENTORY.index(next((p for p, a, b in self.said if a <= at_s < b), "SIL"))] = 0.9
            rows.append(row)
        first, self.n_frames = self.n_frames, self.n_frames + len(rows)
        heard = FramePosteriors(100, first, (7,), np.array(rows)[:, None]) if rows else None
        return [replace(update, evidence=heard)]


def told(kind, *units):
    return SpokenText(kind, tuple(SpokenUnit(*unit) for unit in units), RATE_HZ)


PHONEMES = told("phoneme", ("M", 0, 3_200), ("IY", 3_200, 6_400), ("P", 6_400, 9_600))


def test_phonemes_that_come_before_their_sound_move_the_mouth_and_ears_take_over_behind_them():
    face = Face()
    face.say(1.2).tell(PHONEMES)
    face.go_on(0.3)
    assert face.source.moved_by == "phonemes"
    face.go_on(1.2)

    assert face.shown(0.1, 0.3, 0.5) == ["M", "IY", "P"]
    assert face.shown(0.7, 1.0) == ["AA", "AA"]
    assert face.source.moved_by == "text"


def test_phonemes_that_come_late_move_what_is_not_settled_yet():
    face = Face()
    stream = face.say(1.0)
    face.go_on(0.25)
    stream.tell(PHONEMES)
    face.go_on(0.9)

    assert face.shown(0.1, 0.14, 0.3, 0.5) == ["AA", "AA", "IY", "P"]


def test_phonemes_come_one_by_one_and_the_last_is_corrected():
    face = Face()
    stream = face.say(1.0)
    for unit in PHONEMES.units:
        stream.tell(told("phoneme", (unit.label, unit.start_sample)))
    stream.tell(told("phoneme", ("M", 6_400), ("SIL", 9_600)))
    face.go_on(1.0)

    assert face.shown(0.1, 0.3, 0.5, 0.7) == ["M", "IY", "M", "SIL"]


def test_a_phoneme_stays_one_however_often_more_is_told():
    face = Face()
    stream = face.say(3.0)
    stream.tell(told("phoneme", ("AA", 0), ("M", 1_600), ("AA", 17_600), ("SIL", 40_000)))
    for second in (0.5, 1.0, 2.0):
        face.go_on(second)
        stream.tell(told("phoneme", ("SIL", 40_000)))
    face.go_on(2.4)

    begun = [(each.phoneme, round(each.start_s, 2)) for each in face.timeline.events]
    assert begun[:3] == [("AA", 0.0), ("M", 0.1), ("AA", 1.1)]
    assert begun[3][0] == "SIL"


def test_visemes_alone_move_the_mouth_at_a_thousand_a_second_too():
    face = Face()
    labels = ("M", "AA")
    units = [(labels[n // 100 % 2], 16 * n, 16 * n + 16) for n in range(1_000)]
    stream = face.say(1.0)
    for first in range(0, 1_000, 20):
        stream.tell(told("viseme", *units[first : first + 20]))
    face.go_on(0.5)
    assert face.source.moved_by == "visemes"
    face.go_on(1.0)

    assert face.shown(0.05, 0.15, 0.25, 0.85) == ["M", "AA", "M", "M"]


def test_phonemes_behind_the_sound_move_nothing():
    face = Face()
    face.say(0.3).tell(told("phoneme", ("M", 0, 1_600), ("P", 16_000, 80_000)))
    face.go_on(1.0)

    assert face.shown(0.05, 0.25, 0.7) == ["M", "AA", "SIL"]


def test_words_are_looked_for_where_their_stream_sounds():
    face = Face()
    face.say(0.5).tell(told("text", ("ma",)), [MAMA])
    second = face.say(0.5, "b")
    later = PronouncedWord("later", MAMA.pronunciations, 0.2)
    second.tell(told("word", ("later", 3_200)), [later])
    face.go_on(0.4)
    assert face.ears.told == [("mama", None, 0.0)]
    face.go_on(0.6)

    assert face.ears.told[1:] == ["forget", ("later", pytest.approx(0.7), 0.0)]
    assert face.source.moved_by == "words"


SAID = [("M", 0.3, 0.5), ("IY", 0.5, 0.8), ("P", 0.8, 0.9), ("AA", 0.9, 1.3), ("F", 1.3, 1.5)]


def told_events(face):
    return [
        (e.kind, e.name or round(e.shifted_s, 2), e.reason)
        for e in face.playout.events
        if e.kind in ("moved_by", "units_shifted", "text_dropped")
    ]


def test_units_that_are_early_are_moved_and_their_sender_is_told_by_how_much():
    face = Face(Evident(SAID))
    units = [(p, round((a - 0.2) * RATE_HZ), round((b - 0.2) * RATE_HZ)) for p, a, b in SAID]
    face.say(2.0).tell(told("viseme", *units))
    face.go_on(1.6)

    assert face.shown(0.42, 0.6, 0.86, 1.1, 1.4) == ["M", "IY", "P", "AA", "F"]
    assert ("units_shifted", 0.2, "told") in told_events(face)
    assert ("moved_by", "visemes", "told") in told_events(face)
    assert face.source.units_shifted_s == pytest.approx(0.2, abs=0.011)


def test_units_that_are_not_said_are_left_and_their_sender_is_told_so():
    face = Face(Evident(SAID))
    others = ("SH", "UW", "K", "OW", "TH")
    units = [
        (p, int(a * RATE_HZ), int(b * RATE_HZ)) for p, (_, a, b) in zip(others, SAID, strict=True)
    ]
    face.say(2.0).tell(told("phoneme", *units))
    face.go_on(1.8)

    assert face.shown(1.1, 1.4) == ["AA", "AA"]
    assert told_events(face)[-1] == ("moved_by", "sound", "not_said")


def test_a_text_that_is_not_said_is_told_to_be_dropped_once():
    ears = Evident(SAID)
    ears.saying = (("mama",), 0)
    face = Face(ears)
    face.say(4.0).tell(told("text", ("ma",)), [MAMA])
    face.go_on(3.5)

    assert [kind for kind, *_ in told_events(face)].count("text_dropped") == 1
    assert ("moved_by", "sound", "not_said") in told_events(face)


class Fails(Evident):
    """Follows the text until it fails at 0.6 s."""

    moved_by, saying = "text", (("ma", "ma"), 0)

    def feed(self, block):
        if block.start_s >= 0.6:
            raise FloatingPointError("a fault")
        super().feed(block)


@pytest.mark.parametrize("network", [Fails(SAID), None])
def test_a_text_that_a_simpler_recogniser_does_not_follow_is_told_to_its_sender_as_such(network):
    levels = [FallbackLevel("network", lambda: network), FallbackLevel("energy", EnergyRecognizer)]
    face = Face(FallbackRecognizer(levels[network is None :], 0.1))
    face.say(1.5).tell(told("text", ("ma ma",)), [MAMA, MAMA])
    face.go_on(1.4)
    assert told_events(face)[-1] == ("moved_by", "sound", "not_followed")
    assert len(told_events(face)) == 1 + (network is not None)

    face.say(1.0, "without a text")
    face.go_on(2.4)
    assert told_events(face)[-1] == ("moved_by", "sound", "not_told")


def test_a_text_that_comes_late_and_a_correction_from_the_beginning_which_says_how_late():
    face = Face()
    stream = face.say(2.0)
    face.go_on(1.0)
    stream.tell(told("text", ("mama",)), [MAMA])
    face.go_on(1.2)
    stream.tell(told("text", ("papa", 0)), [PronouncedWord("papa", MAMA.pronunciations, 0.0)])
    face.go_on(1.4)

    assert face.ears.told == [("mama", None, 0.0), "forget", ("papa", None, 1.2)]


def test_an_interruption_forgets_the_words():
    face = Face()
    face.say(2.0).tell(told("text", ("mama",)), [MAMA])
    face.go_on(0.5)
    face.playout.requests.append(PlayoutRequest("interrupt"))
    face.go_on(0.7)

    assert face.ears.told[-1] == "forget"


def test_words_with_times_are_shown_as_they_are_heard():
    face = Face()
    face.say(1.0).tell(told("word", ("good", 0), ("day", 4_800), ("all", 9_600)), [MAMA])
    face.go_on(0.4)

    assert face.source.saying == (("good", "day", "all"), 1)


def test_of_too_many_words_nothing_is_taken():
    stream = PlayoutStream("a", RATE_HZ, RATE_HZ)
    with pytest.raises(PlayoutTextError, match="2000 words wait"):
        stream.tell(told("text", ("many",)), [MAMA] * 2_001)
    assert not stream.spoken
