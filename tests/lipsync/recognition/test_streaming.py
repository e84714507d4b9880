"""One stream for every recogniser: what is prepared ahead changes nothing of what is told when."""

import numpy as np
import pytest
import soundfile
from hypothesis import given, settings
from hypothesis import strategies as st
from small_network import random_weights
from speech import CLIP_PATH

from lipsync.audio.file import FileSource
from lipsync.audio.source import SilenceAfter
from lipsync.audio_block import AudioBlock
from lipsync.phonemes import LiveRecognizer
from lipsync.recognition.energy_recognizer import EnergyRecognizer
from lipsync.recognition.fallback import FallbackLevel, FallbackRecognizer
from lipsync.recognition.network import StreamingNetwork
from lipsync.recognition.network_recognizer import NetworkRecognizer
from lipsync.recognition.streaming import (
    PreparingRecognizer,
    RecognizerStream,
    SoundAhead,
    blocks_of,
)

RATE_HZ = 16_000
WEIGHTS = random_weights()


class BlockByBlock:
    """The same recogniser, but nothing can be prepared."""

    def __init__(self, recognizer: LiveRecognizer):
        self._recognizer = recognizer
        self.latency_s = recognizer.latency_s
        self.feed, self.updates = recognizer.feed, recognizer.updates
        self.reset = recognizer.reset


class Steps:
    def __init__(self):
        self.seen = []

    def observe(self, step):
        self.seen.append(step)


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """3.0037 s: the last block is shorter than the others."""
    path = tmp_path_factory.mktemp("sound") / "clip.wav"
    soundfile.write(path, soundfile.read(CLIP_PATH)[0][: 3 * RATE_HZ + 59], RATE_HZ)
    return path


def steps_of_ticks(sound, recognizer, tick_s, n_ticks):
    """Return the start times of the blocks fed at each tick, and the updates after them."""
    stream = RecognizerStream(recognizer)
    steps = []
    with SilenceAfter(FileSource(sound)) as source:
        ahead = SoundAhead(source, recognizer)
        for n in range(n_ticks):
            step = stream.feed(ahead.blocks(n * tick_s))
            steps.append(([b.start_s for b in step.blocks], step.updates))
    return steps


@pytest.mark.parametrize("rate_hz", [30, 50, 100])
def test_every_tick_learns_the_same_whether_sound_is_prepared_or_not(sound, rate_hz):
    n_ticks = round(3.6 * rate_hz)
    prepared = NetworkRecognizer(WEIGHTS)
    assert isinstance(prepared, PreparingRecognizer)
    plain = BlockByBlock(NetworkRecognizer(WEIGHTS))
    assert not isinstance(plain, PreparingRecognizer)

    told = steps_of_ticks(sound, prepared, 1 / rate_hz, n_ticks)
    assert told == steps_of_ticks(sound, plain, 1 / rate_hz, n_ticks)
    assert sum(len(blocks) for blocks, _ in told) > 350
    assert len({e.phoneme for _, updates in told for u in updates for e in u.events}) > 5


def test_a_recogniser_whose_time_is_judged_is_shown_nothing_ahead(sound):
    level = FallbackLevel("network", lambda: NetworkRecognizer(WEIGHTS))
    live = FallbackRecognizer([level], 0.095, timer_s=lambda: 0.0)
    replayed = FallbackRecognizer([level], 0.095)
    assert (live.ahead_s, replayed.ahead_s > 0.1) == (0.0, True)
    assert steps_of_ticks(sound, live, 0.01, 50) == steps_of_ticks(sound, replayed, 0.01, 50)


def test_a_fault_while_sound_is_prepared_falls_back_and_loses_no_block(sound):
    class Faulty(NetworkRecognizer):
        def prepare(self, blocks):
            if blocks[-1].end_s > 1.5:
                raise FloatingPointError("a fault")
            super().prepare(blocks)

    recognizer = FallbackRecognizer(
        [
            FallbackLevel("network", lambda: Faulty(WEIGHTS)),
            FallbackLevel("energy", EnergyRecognizer),
        ],
        0.095,
    )
    told = steps_of_ticks(sound, recognizer, 0.01, 360)
    starts_s = [start_s for blocks, _ in told for start_s in blocks]
    assert recognizer.level == "energy"
    assert recognizer.reasons == ("network: FloatingPointError: a fault",)
    assert np.allclose(starts_s[:300], np.arange(300) / 100)
    assert told[-1][1][-1].heard_until_s == pytest.approx(3.59, abs=0.02)


def test_another_block_than_the_one_prepared_is_refused():
    recognizer = NetworkRecognizer(WEIGHTS)
    first, second = blocks_of(np.zeros(320, np.float32))
    recognizer.prepare([first, second])
    with pytest.raises(
        ValueError, match=r"block of sound at 0\.01 s, but prepare\(\) that at 0\.0 s"
    ):
        recognizer.feed(second)


def test_a_gap_in_prepared_sound_is_heard_as_it_is_live():
    sound = soundfile.read(CLIP_PATH, dtype="float32")[0]
    blocks = [
        AudioBlock(sound[:8_000], 0.0),
        AudioBlock(sound[8_000:16_000], 0.7),
        AudioBlock(sound[16_000:24_000], 9.0),
    ]
    told = []
    for prepares in (True, False):
        recognizer, steps = NetworkRecognizer(WEIGHTS), Steps()
        if prepares:
            recognizer.prepare(blocks)
        RecognizerStream(recognizer, (steps,)).run(blocks)
        told.append([step.updates for step in steps.seen])
    assert told[0] == told[1]
    assert told[0][-1][-1].heard_until_s == pytest.approx(9.5, abs=0.02)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.integers(1, 20), min_size=1, max_size=8), st.integers(0, 2**31))
def test_frames_in_pieces_of_any_size_give_the_posteriors_of_single_frames(sizes, seed):
    features = np.random.default_rng(seed).standard_normal((sum(sizes), 40)).astype(np.float32)
    single, pieces = StreamingNetwork(WEIGHTS), StreamingNetwork(WEIGHTS)
    expected = np.concatenate([single.push(frame[None]) for frame in features])
    parts = np.split(features, np.cumsum(sizes)[:-1])
    assert np.abs(np.concatenate([pieces.push(p) for p in parts]) - expected).max() < 1e-5


def test_observers_see_every_block_with_its_cost():
    """A clock that shows 2 ms more at each reading."""
    readings = iter(range(0, 10**9, 2_000_000))
    steps = Steps()
    stream = RecognizerStream(EnergyRecognizer(), (steps,), clock_ns=lambda: next(readings))
    stream.run(blocks_of(np.zeros(500, np.float32), n_first=80))
    assert [len(step.blocks[0].samples) for step in steps.seen] == [80, 160, 160, 100]
    assert [step.cost_s for step in steps.seen] == pytest.approx([0.002] * 4)
