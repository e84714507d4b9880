"""What the robot says: streams on one timeline, heard and played, interrupted and counted."""

import numpy as np
import pytest
from fake_sound_card import install_sound_card
from hypothesis import given, settings
from hypothesis import strategies as st

from lipsync.audio.loudspeaker import LoudspeakerOutput
from lipsync.audio.playout import Playout
from lipsync.audio.playout_stream import (
    MOST_WAITING_S,
    PlayoutFullError,
    PlayoutRequest,
    PlayoutStream,
)
from lipsync.phonemes import PhonemeEvent

RATE_HZ = 16_000


class Recorder:
    """A loudspeaker that keeps what was written; it takes nothing back."""

    name, is_lost, rate_hz, latency_s = "recorder", False, 16_000, 0.05
    n_underruns = 2

    def __init__(self) -> None:
        self.written: list[np.ndarray] = []
        self.reported: tuple[float, float] | None = None

    @property
    def samples(self) -> np.ndarray:
        return np.concatenate(self.written)

    def write(self, samples: np.ndarray) -> None:
        self.written.append(samples)

    def silence_rest(self) -> float:
        return 0.3

    def position(self) -> tuple[float, float] | None:
        return self.reported


def stream_of(samples: np.ndarray, name: str = "a", rate_hz: int = RATE_HZ) -> PlayoutStream:
    stream = PlayoutStream(name, rate_hz, RATE_HZ)
    stream.push(samples.astype(np.float32))
    stream.end()
    return stream


def ramp(n_samples: int) -> np.ndarray:
    return np.linspace(0.1, 0.9, n_samples, dtype=np.float32)


def said(playout: Playout, *streams: PlayoutStream) -> None:
    for stream in streams:
        playout.requests.append(PlayoutRequest("say", stream))
    playout.advance(0.0)


def kinds(playout: Playout) -> list[str]:
    return [event.kind for event in playout.events]


def told(playout: Playout) -> list[tuple[str, int]]:
    return [(event.kind, event.n_played) for event in playout.events]


def test_what_is_said_is_heard_and_played_sample_by_sample_between_silences():
    speaker = Recorder()
    playout = Playout(speaker)
    before = playout.blocks(0.05)
    said(playout, stream_of(ramp(1_000)))
    blocks = [*before, *playout.blocks(0.2)]

    heard = np.concatenate([block.samples for block in blocks])
    assert [round(block.start_s, 6) for block in blocks] == [n / 100 for n in range(20)]
    np.testing.assert_array_equal(heard[800:1800], ramp(1_000))
    assert not heard[:800].any()
    assert not heard[1800:].any()
    np.testing.assert_array_equal(speaker.samples, heard)


def test_streams_follow_one_another_without_a_gap():
    playout = Playout()
    said(playout, stream_of(ramp(160)), stream_of(-ramp(160), "b"))
    heard = np.concatenate([block.samples for block in playout.blocks(0.03)])
    np.testing.assert_array_equal(heard[:320], np.concatenate([ramp(160), -ramp(160)]))


@settings(max_examples=30, deadline=None)
@given(
    rate_hz=st.sampled_from([8_000, 16_000, 22_050, 24_000, 44_100, 48_000]),
    pieces=st.lists(st.integers(0, 3_000), min_size=1, max_size=12),
)
def test_sound_in_any_pieces_at_any_rate_lasts_as_long_as_it_is(rate_hz, pieces):
    stream = PlayoutStream("a", rate_hz, 48_000)
    tone = 0.5 * np.sin(2 * np.pi * 200.0 * np.arange(sum(pieces)) / rate_hz).astype(np.float32)
    first = 0
    for n_samples in pieces:
        stream.push(tone[first : first + n_samples])
        first += n_samples
    stream.end()
    blocks = []
    while (block := stream.take()) is not None:
        blocks.append(block)

    assert abs(len(blocks) * 0.01 - sum(pieces) / rate_hz) <= 0.0201
    assert all(len(block.heard) == 160 and len(block.played) == 480 for block in blocks)
    if blocks:
        assert blocks[-1].n_samples == sum(pieces)
        heard = np.concatenate([block.heard for block in blocks])
        played = np.concatenate([block.played for block in blocks])[::3]
        # The same sound at both rates, apart from the edges of the filters.
        assert np.abs(heard - played)[50:-400].max(initial=0.0) < 0.02


def test_it_tells_what_was_heard_when_it_leaves_the_loudspeaker():
    playout = Playout()
    stream = PlayoutStream("a", 8_000, RATE_HZ)
    stream.push(np.zeros(800, np.float32))
    stream.mark("half")
    stream.push(np.zeros(800, np.float32))
    stream.end()
    said(playout, stream)
    playout.blocks(0.5)
    playout.advance(0.0)
    assert kinds(playout) == ["started"]
    playout.advance(0.05)
    assert (kinds(playout), playout.n_played("a")) == (["started"], 400)
    playout.advance(0.1)
    assert kinds(playout) == ["started", "mark"]
    playout.advance(0.2)
    assert told(playout)[1:] == [("mark", 800), ("finished", 1600)]
    assert playout.events[1].name == "half"
    assert playout.is_over


def test_a_stream_that_dries_up_is_silent_and_goes_on_where_it_was():
    playout = Playout()
    stream = PlayoutStream("a", RATE_HZ, RATE_HZ)
    stream.push(ramp(800))
    said(playout, stream)
    heard = playout.blocks(0.1)
    stream.push(-ramp(160))
    heard += playout.blocks(0.11)  # too little to go on with
    stream.end()
    heard += playout.blocks(0.14)
    samples = np.concatenate([block.samples for block in heard])
    np.testing.assert_array_equal(samples[:800], ramp(800))
    np.testing.assert_array_equal(samples[1760:1920], -ramp(160))
    assert not samples[800:1760].any()
    assert playout.n_underruns == kinds(playout).count("underrun") == 1
    playout.advance(0.115)
    assert playout.n_played("a") == 800 + 80, "the gap is no speech of the stream"


def test_an_interruption_drops_all_that_was_not_heard_and_says_how_much_was():
    playout = Playout(Recorder())
    said(playout, stream_of(ramp(16_000)), stream_of(ramp(1_600), "b"))
    playout.blocks(0.5)
    playout.requests.append(PlayoutRequest("interrupt"))
    assert playout.advance(0.25) is True

    told = {event.stream: event for event in playout.events if event.kind == "interrupted"}
    assert (told["a"].n_played, told["a"].n_dropped) == (4_800, 11_200), "silent from 0.3 s on"
    assert (told["b"].n_played, told["b"].n_dropped) == (0, 1_600)
    assert playout.is_over
    assert not np.concatenate([b.samples for b in playout.blocks(1.0)]).any()
    assert playout.advance(0.3) is False, "nothing was said any more"


def test_clearing_lets_what_is_on_its_way_be_heard():
    playout = Playout(Recorder())
    stream = PlayoutStream("a", RATE_HZ, RATE_HZ)
    stream.push(ramp(16_000))
    said(playout, stream)
    playout.blocks(0.5)
    playout.requests.append(PlayoutRequest("clear"))
    assert playout.advance(0.25) is False
    stream.push(ramp(160))  # whoever sends may not know yet
    (cleared,) = (event for event in playout.events if event.kind == "cleared")
    assert cleared.n_dropped == 8_000
    assert not playout.is_over
    playout.blocks(1.0)
    playout.advance(0.5)
    assert told(playout)[-1] == ("finished", 8_000)


def test_known_phonemes_lie_where_their_sound_does_and_nobody_recognises_it():
    playout = Playout()
    playout.blocks(0.5)
    known = (PhonemeEvent("M", 0.0, 0.1), PhonemeEvent("AA", 0.1, 0.2))
    stream = PlayoutStream("a", RATE_HZ, RATE_HZ, known)
    stream.push(ramp(3_200))
    stream.end()
    said(playout, stream)
    heard = playout.blocks(0.7)
    assert not np.concatenate([block.samples for block in heard]).any()
    (start_s, end_s, events) = playout.known_phonemes(0.5)[0]
    assert (start_s, end_s) == pytest.approx((0.5, 0.7))
    assert [(e.phoneme, round(e.start_s, 6)) for e in events] == [("M", 0.5), ("AA", 0.6)]


def test_sound_that_somebody_else_plays_is_silent_here_and_followed_by_their_reports():
    speaker = Recorder()
    playout = Playout(speaker)
    stream = PlayoutStream("a", RATE_HZ, RATE_HZ, played_elsewhere=True)
    stream.push(ramp(16_000))
    said(playout, stream)
    heard = playout.blocks(0.5)
    assert np.concatenate([block.samples for block in heard]).any()
    assert not speaker.samples.any()
    speaker.reported = (7.0, 0.4)
    assert playout.report() is None, "our loudspeaker says nothing about it"
    playout.reports.append((7.0, "a", 1_600))
    assert playout.report() == (7.0, pytest.approx(0.1))
    playout.reports.append((7.1, "nobody", 1_600))
    assert playout.report() is None


def test_five_minutes_may_wait_and_no_more():
    stream = PlayoutStream("a", 8_000, 8_000)
    stream.push(np.zeros(round(MOST_WAITING_S * 8_000), np.float32))
    with pytest.raises(PlayoutFullError, match="'a': 300 s of speech wait already"):
        stream.push(np.zeros(800, np.float32))
    assert stream.n_received == MOST_WAITING_S * 8_000


def test_the_loudspeaker_is_given_the_delay_that_it_does_not_have_itself():
    speaker = Recorder()
    playout = Playout(speaker)
    playout.begin(0.23)
    assert len(speaker.samples) == round(0.18 * RATE_HZ)
    speaker.reported = (10.0, 0.18)
    assert playout.report() == (10.0, pytest.approx(0.0))


def next_part(playout: Playout, stream: PlayoutStream, after: PlayoutStream) -> None:
    playout.requests.append(PlayoutRequest("say", stream, after=after))


def finished(playout: Playout) -> list[str]:
    return [event.stream for event in playout.events if event.kind == "finished"]


def test_the_next_part_of_a_stream_is_said_before_what_waits():
    playout = Playout()
    first, other = stream_of(ramp(1_600), "first"), stream_of(ramp(1_600), "other")
    said(playout, first, other)
    next_part(playout, stream_of(ramp(1_600), "second"), first)
    playout.advance(0.0)
    playout.blocks(1.0)
    playout.advance(1.0)
    assert finished(playout) == ["first", "second", "other"]


def test_a_part_that_comes_late_cuts_nothing_in_two():
    playout = Playout()
    first, other = stream_of(ramp(160), "first"), stream_of(ramp(1_600), "other")
    said(playout, first, other, stream_of(ramp(160), "last"))
    playout.blocks(0.05)
    playout.advance(0.05)
    next_part(playout, stream_of(ramp(160), "second"), first)
    playout.advance(0.05)
    playout.blocks(1.0)
    playout.advance(1.0)
    assert finished(playout) == ["first", "other", "second", "last"]


def test_the_next_part_of_what_was_cut_off_is_not_said():
    playout = Playout()
    first = stream_of(ramp(1_600), "first")
    said(playout, first)
    playout.requests.append(PlayoutRequest("interrupt"))
    second = stream_of(ramp(1_600), "second")
    next_part(playout, second, first)
    playout.advance(0.0)
    assert second.is_dropped
    assert playout.is_over


def test_a_loop_that_is_late_is_an_underrun_and_a_face_that_has_ended_is_none(monkeypatch):
    card = install_sound_card(monkeypatch)
    with LoudspeakerOutput(clock=card.clock, is_watched=False) as speaker:
        playout = Playout(speaker)
        playout.blocks(0.1)
        for _ in range(20):
            card.outputs[0].ask()
        assert playout.n_underruns == 0, "nothing more may come"
        playout.blocks(0.2)
        assert playout.n_underruns == 1


class Device(Recorder):
    """A loudspeaker that is silent at once, from where the test says it is."""

    latency_s = 0.0

    def __init__(self) -> None:
        super().__init__()
        self.heard: list[np.ndarray] = []
        self.position_s = 0.0

    def silence_rest(self) -> float:
        """Keep what was played until now, and forget the rest."""
        self.play_until(self.position_s)
        self.written.clear()
        return self.position_s

    def play_until(self, position_s: float) -> None:
        """Move the written samples before `position_s` to `heard`."""
        n_heard = sum(map(len, self.heard))
        everything = np.concatenate([*self.written, np.zeros(0, np.float32)])
        n_new = round(position_s * self.rate_hz) - n_heard
        self.heard.append(everything[:n_new])
        self.written = [everything[n_new:]]
        self.position_s = position_s


def test_what_is_paused_goes_on_where_it_stood_and_no_sample_is_lost_or_heard_twice():
    device = Device()
    playout = Playout(device)
    given = ramp(8_000)
    said(playout, stream_of(given))
    playout.blocks(0.4)
    device.play_until(0.2)
    playout.requests.append(PlayoutRequest("pause"))
    assert playout.advance(0.2)
    # What was silenced is committed as silence: the timeline goes on.
    device.written = [np.zeros(round(0.2 * RATE_HZ), np.float32)]
    playout.blocks(1.0)
    device.play_until(0.6)
    playout.advance(0.6)
    playout.requests.append(PlayoutRequest("resume"))
    playout.advance(0.6)
    playout.blocks(2.0)
    device.play_until(1.9)
    playout.advance(1.9)

    heard = np.concatenate(device.heard)
    np.testing.assert_array_equal(heard[heard != 0.0], given)
    paused = [("paused", 3_200), ("resumed", 3_200)]
    assert told(playout) == [("started", 0), *paused, ("finished", 8_000)]


def test_an_interruption_tells_the_marks_that_were_heard_before_it():
    device = Device()
    playout = Playout(device)
    stream = PlayoutStream("a", RATE_HZ, RATE_HZ)
    for name in ("first", "second"):
        stream.push(ramp(1_600))
        stream.mark(name)
    said(playout, stream)
    playout.blocks(0.4)
    device.play_until(0.15)
    playout.requests.append(PlayoutRequest("interrupt"))
    playout.advance(0.1)

    assert kinds(playout) == ["started", "mark", "interrupted"]
    assert playout.events[1].name == "first"


@pytest.mark.parametrize("rate_hz", [16_000, 22_050, 44_100])
def test_a_mark_is_heard_though_the_stream_goes_on(rate_hz):
    playout = Playout(Recorder())
    stream = PlayoutStream("a", rate_hz, RATE_HZ)
    said(playout, stream)
    for name in ("first", "second"):
        stream.push(ramp(round(0.123 * rate_hz)))
        stream.mark(name)
        stream.fill()
        playout.blocks(playout.committed_s + 0.5)
        playout.advance(playout.committed_s)
    stream.end()
    playout.advance(playout.committed_s)

    n_samples = round(0.123 * rate_hz)
    marks = [("mark", n_samples), ("mark", 2 * n_samples)]
    assert told(playout) == [("started", 0), *marks, ("finished", 2 * n_samples)]
    assert playout.n_underruns == Recorder.n_underruns, "those of the device count too"
