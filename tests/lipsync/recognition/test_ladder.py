"""The ladder by a clock: backlogs, what is left for them, and the way back.

The clock is the test's. Sound comes by it, work takes it as much as a script says, and other
programs may take all of it.
"""

import math

import numpy as np
import pytest
import soundfile
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from ladder_face import LATENCY_S, Cheap, Computer, Face, Network
from lipservo_lab.learning.motion.trained_model import load_trained_model
from small_network import random_weights
from speech import CLIP_PATH, phoneme_frames

from lipsync.audio_block import BLOCK_S, AudioBlock
from lipsync.motion.live_synthesizer import LiveSynthesizer
from lipsync.phonemes import SILENCE
from lipsync.recognition.energy_recognizer import EnergyRecognizer
from lipsync.recognition.fallback import FallbackLevel, FallbackRecognizer
from lipsync.recognition.network import find_weights
from lipsync.recognition.network_recognizer import NetworkRecognizer
from lipsync.timeline import PhonemeTimeline


@pytest.fixture(scope="module")
def clip():
    """8.6 s of speech with pauses, in whole blocks, that are heard again and again."""
    sound = soundfile.read(CLIP_PATH, dtype="float32")[0]
    return np.concatenate((sound, np.zeros(160 - len(sound) % 160 + 160, np.float32)))


@pytest.fixture(scope="module")
def weights():
    return find_weights("default")


@pytest.mark.parametrize("seconds", [1.0, 2.0])
@pytest.mark.parametrize("begin_s", [2.0, 4.8, 6.5])
def test_a_busy_second_or_two_do_not_take_the_network_away(clip, weights, seconds, begin_s):
    computer = Computer(busy=[(begin_s, begin_s + seconds)])
    face = Face(computer, clip, weights)
    face.live_until(8.0)
    (network,) = face.networks

    assert {level for _, level in face.levels} == {"network"}
    assert face.changes == []
    assert network.n_heard_blocks == face.n_handed  # nothing was left out
    alone = NetworkRecognizer(weights)
    heard = PhonemeTimeline(horizon_s=math.inf)
    for n in range(face.n_handed):
        alone.feed(face.block(n))
        for update in alone.updates():
            heard.apply(update)
    assert phoneme_frames(face.timeline.events, 780) == phoneme_frames(heard.events, 780)


def test_nor_do_two_seconds_in_which_everything_takes_ten_times_as_long(clip, weights):
    face = Face(Computer(slower=[(3.0, 5.0, 10.0)], share=0.15), clip, weights)
    face.live_until(12.0)
    assert {level for _, level in face.levels} == {"network"}


def test_after_a_stall_the_network_catches_up_in_a_few_ticks(clip):
    computer = Computer(busy=[(3.0, 5.0)])
    face = Face(computer, clip, random_weights())
    face.live_until(5.3)
    assert face.timeline.final_until_s > computer.now_s - LATENCY_S - 0.03


def test_a_network_that_takes_ten_times_as_long_as_its_sound_is_left_at_once(clip):
    face = Face(Computer(share=10.0), clip, random_weights())
    face.live_until(4.0)

    (left_s,) = face.when("energy")
    assert left_s < 1.0
    (change,) = face.changes
    why = "takes 10.0 s for a second of sound, 0.5 s wait"
    assert change == f"recogniser network left: {why}; energy takes over"
    assert face.recognizer.reasons == (f"network: {why}",)
    assert face.timeline.final_until_s > 3.8


def test_one_that_is_a_little_slower_than_its_sound_is_left_when_it_does_not_catch_up(clip):
    face = Face(Computer(share=1.3), clip, random_weights())
    face.live_until(10.0)

    assert 6.0 < face.when("energy")[0] < 9.0
    assert "did not catch up in 6." in face.changes[0]
    assert face.timeline.final_until_s > 9.8


def test_it_is_tried_ever_more_rarely_and_a_try_costs_a_few_blocks(clip):
    computer = Computer(share=10.0)
    face = Face(computer, clip, random_weights())
    face.live_until(3.0)
    (network,) = face.networks
    n_before = network.n_heard_blocks
    face.live_until(200.0)

    assert {level for _, level in face.levels[300:]} == {"energy"}
    n_tried = network.n_heard_blocks - n_before
    assert 3 * 4 <= n_tried <= 3 * 7
    assert len(face.changes) == 1


def test_what_does_not_catch_up_is_left_and_is_back_soon_after(clip, weights):
    """Forty times as slow for ten seconds: sound comes twice as fast as it is recognised."""
    busy_until_s = 14.0
    computer = Computer(slower=[(4.0, busy_until_s, 40.0)])
    face = Face(computer, clip, weights)
    face.live_until(40.0)

    (left_s,) = face.when("energy")
    (back_s,) = face.when("network")
    assert 10.0 < left_s < busy_until_s
    assert busy_until_s < back_s < busy_until_s + 8.0
    assert face.recognizer.reasons == ()
    left, back = face.changes
    assert "left:" in left
    assert back == f"recogniser network is back after {back_s - left_s:.1f} s"


def test_it_is_back_in_a_pause_with_its_state_as_if_it_had_never_been_away(clip, weights):
    computer = Computer(slower=[(4.0, 9.0, 80.0)])
    face = Face(computer, clip, weights)
    face.live_until(26.0)
    (back_s,) = face.when("network")
    alone = NetworkRecognizer(weights)
    heard = PhonemeTimeline(horizon_s=math.inf)
    for n in range(face.n_handed):
        alone.feed(face.block(n))
        for update in alone.updates():
            heard.apply(update)
    assert heard.event_at(back_s - 0.15).phoneme == SILENCE
    first, end = round(back_s * 100), face.n_handed - 20
    ours = phoneme_frames(face.timeline.events, end)[first:]
    theirs = phoneme_frames(heard.events, end)[first:]
    assert np.mean([a == b for a, b in zip(ours, theirs, strict=True)]) > 0.95


def test_without_a_pause_it_is_back_after_some_seconds_all_the_same(clip):
    """Weights that find speech everywhere."""

    class Awake(Network):
        def updates(self):
            updates = super().updates()
            return [
                type(u)(
                    u.replace_from_s,
                    u.heard_until_s,
                    u.final_until_s,
                    tuple(type(e)("AA", e.start_s, e.end_s) for e in u.events),
                )
                for u in updates
            ]

    face = Face(Computer(slower=[(4.0, 8.0, 80.0)]), clip, random_weights(), make=Awake)
    face.live_until(40.0)
    assert 8.0 < face.when("network")[0] < 28.0


def test_a_level_that_raises_is_tried_again_too(clip, weights):
    class Faulty(Network):
        def prepare(self, blocks):
            if 3.0 <= self.computer.now_s < 4.0:
                raise FloatingPointError("a fault")
            super().prepare(blocks)

    face = Face(Computer(), clip, weights, make=Faulty)
    face.live_until(20.0)
    assert face.when("energy") == [pytest.approx(3.0, abs=0.02)]
    assert 4.0 < face.when("network")[0] < 14.0
    assert "FloatingPointError: a fault" in face.changes[0]


def test_what_is_left_again_and_again_waits_longer_each_time(clip):
    """The computer is busy for 4 s of every 8: the network is not taken up for a moment each."""
    slower = [(t, t + 4.0, 80.0) for t in np.arange(4.0, 120.0, 8.0)]
    face = Face(Computer(slower=slower), clip, random_weights())
    face.live_until(120.0)
    assert len(face.changes) < 2 * 15 * 0.6


def test_a_face_that_gets_too_little_of_the_computer_is_late_and_keeps_the_network(clip):
    """What else the face does takes nearly all of its time: loudness would be as late."""
    face = Face(Computer(), clip, random_weights())
    face.live_until(30.0, on_tick=lambda: face.computer.wait_until(face.computer.now_s + 0.5))
    assert {level for _, level in face.levels} == {"network"}


def test_loudness_is_never_replaced_by_a_closed_mouth_for_being_late(clip):
    computer = Computer(share=10.0)
    levels = [FallbackLevel("energy", lambda: Cheap(computer, None))]
    recognizer = FallbackRecognizer(levels, LATENCY_S, timer_s=lambda: computer.now_s)
    for n in range(100):
        recognizer.feed_all([AudioBlock(clip[:160], (10 * n + k) * BLOCK_S) for k in range(10)])
        recognizer.updates()
    assert recognizer.level == "energy"


def test_hours_after_the_beginning_a_change_costs_no_more(clip):
    class Counting(EnergyRecognizer):
        fed: list = []  # noqa: RUF012

        def feed(self, block):
            self.fed.append(block)
            super().feed(block)

    computer = Computer(share=10.0)
    computer.now_s = start_s = 36_000.0
    recognizer = FallbackRecognizer(
        [
            FallbackLevel("network", lambda: Network(computer, random_weights())),
            FallbackLevel("energy", Counting),
        ],
        LATENCY_S,
        timer_s=lambda: computer.now_s,
    )
    for step in range(20):
        first = start_s + step * 0.1
        blocks = [AudioBlock(clip[:160], first + n * BLOCK_S) for n in range(10)]
        recognizer.feed_all(blocks)
        updates = recognizer.updates()
    assert recognizer.level == "energy"
    assert Counting.fed[0].start_s == 0.0
    assert updates[-1].heard_until_s == pytest.approx(start_s + 2.0)


def test_of_a_minute_that_waits_only_the_last_seconds_are_recognised(clip):
    """A process that was stopped and goes on: its sound file went on, too."""
    computer = Computer(busy=[(3.0, 63.0)])
    face = Face(computer, clip, random_weights())
    face.live_until(63.5)
    (network,) = face.networks

    assert network.n_heard_blocks < 300 + 300 + 60
    assert face.timeline.final_until_s > computer.now_s - LATENCY_S - 0.03
    assert {level for _, level in face.levels} == {"network"}


@settings(max_examples=12, deadline=None, phases=[Phase.explicit, Phase.generate])
@given(
    st.lists(
        st.tuples(st.floats(0.0, 20.0), st.floats(0.1, 6.0), st.floats(2.0, 200.0)), max_size=3
    ),
    st.floats(0.02, 2.0),
)
def test_whatever_the_computer_does_nothing_final_changes_and_time_goes_on(loads, share):
    sound = soundfile.read(CLIP_PATH, dtype="float32")[0][: 160 * 800]
    slower = [(begin_s, begin_s + length_s, times) for begin_s, length_s, times in loads]
    computer = Computer(share=share, slower=slower)
    face = Face(computer, sound, None, make=Cheap)
    face.live_until(26.0)
    face.live_until(computer.now_s + 8.0)

    final_s = 0.0
    for update in face.updates:
        assert update.replace_from_s >= final_s - 1e-9
        assert update.final_until_s >= final_s
        assert update.heard_until_s >= update.final_until_s
        final_s = update.final_until_s
    # Back at the best level or further down: whichever, the mouth is not left behind.
    assert final_s > computer.now_s - LATENCY_S - 0.45


@pytest.mark.slow
def test_at_a_change_the_mouth_moves_no_faster_than_in_speech(clip, weights):
    """Steps of the lips in 10 ms; levels are left in the middle of words."""
    model = load_trained_model()

    def widest_step_mm(slower):
        """Return the lips' widest step in 10 ms, the widest at a change of level, and n of changes.

        slower: (from_s, to_s, factor) of the computer.
        """
        synthesizer = LiveSynthesizer(model, model.expectation)
        computer = Computer(slower=slower)
        face = Face(computer, clip, weights)
        gaps_mm = []

        def show():
            for update in face.updates[len(show.pushed) :]:
                synthesizer.push(update)
                show.pushed.append(update)
            sound_s = len(gaps_mm) * BLOCK_S
            while sound_s < face.timeline.final_until_s - synthesizer.lookahead_s - 0.02:
                frame = synthesizer.frame_at(sound_s)
                gaps_mm.append(model.lip_gap_mm(frame.coefficients))
                sound_s = len(gaps_mm) * BLOCK_S

        show.pushed = []
        face.live_until(30.0, show)
        steps_mm = np.abs(np.diff(gaps_mm))
        # Where phonemes of the one meet those of the other, and what is shown at that moment.
        near = [
            steps_mm[round((now_s - back_s) * 100) :][:6].max()
            for now_s in (*face.when("energy"), *face.when("network"))
            for back_s in (LATENCY_S + 0.03, LATENCY_S + synthesizer.lookahead_s + 0.03)
        ]
        return float(steps_mm.max()), max(near, default=0.0), len(face.changes)

    usual_mm, _, n_none = widest_step_mm([])
    changed_mm, at_change_mm, n_changes = widest_step_mm([(3.1, 6.6, 80.0), (14.3, 18.1, 80.0)])
    assert n_none == 0
    assert n_changes >= 2
    assert at_change_mm <= 4.5
    assert changed_mm <= 1.05 * usual_mm
