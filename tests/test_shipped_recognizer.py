"""The recogniser as it is shipped: its weights, what it hears, what it costs in memory."""

import math
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import soundfile
from speech import (
    CLIP_LABELS_PATH,
    CLIP_PATH,
    phoneme_frames,
    viseme_accuracy,
    white_noise,
)

from lipservo.manner import make_recognizer
from lipsync.audio.block import AudioBlock
from lipsync.phonemes import SILENCE
from lipsync.recognition.features import LevelNormalizer, LogMelStream
from lipsync.recognition.live import NetworkRecognizer
from lipsync.recognition.network import StreamingNetwork
from lipsync.recognition.scripted import read_phonemes
from lipsync.recognition.weights import load_shipped_weights
from lipsync.timeline import PhonemeTimeline

RATE_HZ = 16_000
#: Posteriors that torch gave for frames 100 to 119 of the clip: make_recognizer_posteriors.py.
REFERENCE_PATH = Path(__file__).parent / "data" / "recognizer_posteriors.npz"


@pytest.fixture(scope="module")
def weights():
    return load_shipped_weights()


@pytest.fixture(scope="module")
def clip():
    return soundfile.read(CLIP_PATH, dtype="float32")[0]


def listen(recognizer, samples, on_block=lambda _timeline, _end_s: None):
    timeline = PhonemeTimeline(horizon_s=math.inf)
    for first in range(0, len(samples), 160):
        block = AudioBlock(samples[first : first + 160].astype(np.float32), first / RATE_HZ)
        recognizer.feed(block)
        for update in recognizer.updates():
            timeline.apply(update)
        on_block(timeline, block.end_s)
    return timeline


def test_the_weights_are_small_enough_to_ship():
    with resources.as_file(resources.files("lipsync.models") / "recognizer.npz") as path:
        assert path.stat().st_size < 3_000_000
        assert path.with_suffix(".md").is_file()


def test_numpy_gives_the_posteriors_that_torch_gave(weights, clip):
    with np.load(REFERENCE_PATH) as file:
        expected = file["posteriors"]
    features = LevelNormalizer(weights.scale).push(LogMelStream().push(clip[: 2 * RATE_HZ]))
    heard = StreamingNetwork(weights).push(features[:120])[100:]

    assert np.abs(heard - expected).max() < 2e-3


def test_it_hears_most_visemes_that_a_synthetic_voice_spoke(weights, clip):
    n_frames = len(clip) // 160
    truth = phoneme_frames(read_phonemes(CLIP_LABELS_PATH), n_frames)
    heard = listen(NetworkRecognizer(weights), np.concatenate((clip, np.zeros(1_600))))

    assert viseme_accuracy(phoneme_frames(heard.events, n_frames), truth) > 0.65


def test_a_voice_30_db_lower_is_heard_nearly_as_well(weights, clip):
    n_frames = len(clip) // 160
    truth = phoneme_frames(read_phonemes(CLIP_LABELS_PATH), n_frames)
    accuracies = [
        viseme_accuracy(
            phoneme_frames(listen(NetworkRecognizer(weights), clip * gain).events, n_frames), truth
        )
        for gain in (1.0, 10.0**-1.5)
    ]

    assert accuracies[1] > accuracies[0] - 0.03


@pytest.mark.parametrize("level_db", [-80.0, -50.0, -26.0])
def test_white_noise_is_no_speech(weights, level_db):
    heard = listen(NetworkRecognizer(weights), white_noise(3.0, level_db))

    spoken = [label != SILENCE for label in phoneme_frames(heard.events, 290)]
    assert np.mean(spoken) <= 0.01


def test_the_mouth_is_told_to_close_soon_after_the_last_sound(weights, clip):
    """Speech cut off within a word: 250 ms later silence is settled, and the activity is over."""
    for cut_s in (1.8, 4.4, 6.0):
        samples = np.concatenate((clip[: int(cut_s * RATE_HZ)], np.zeros(RATE_HZ, np.float32)))
        recognizer, closed_s, quiet_s = NetworkRecognizer(weights), [], []

        def watch(timeline, end_s, recognizer=recognizer, closed_s=closed_s, quiet_s=quiet_s):
            event = timeline.event_at(timeline.final_until_s - 0.001)
            if event is not None and event.phoneme == SILENCE:
                closed_s.append(end_s)
            if not recognizer.is_speaking:
                quiet_s.append(end_s)

        listen(recognizer, samples, watch)
        assert min(t for t in closed_s if t > cut_s) <= cut_s + 0.25
        assert min(t for t in quiet_s if t > cut_s) <= cut_s + 0.25


def test_a_stop_gap_is_no_end_of_speech(weights, clip):
    """120 ms of nothing inside a word do not end the activity; half a second does."""
    recognizer, spoken, first = NetworkRecognizer(weights), {}, 6 * RATE_HZ
    samples = np.concatenate(
        (clip[:first], np.zeros(int(0.12 * RATE_HZ)), clip[first : first + 4_000], np.zeros(8_000))
    )

    def watch(_timeline, end_s):
        spoken[round(end_s, 2)] = recognizer.is_speaking

    listen(recognizer, samples, watch)
    assert all(spoken[t] for t in np.arange(6.0, 6.3, 0.01).round(2))
    assert not spoken[max(spoken)]


def test_the_network_is_the_default_and_every_rung_can_listen(clip):
    for engine in ("network", "pocketsphinx"):
        recognizer = make_recognizer(engine)
        assert (recognizer.level, recognizer.reasons) == (engine, ())
        heard = listen(recognizer, clip[: 2 * RATE_HZ])
        assert len({event.phoneme for event in heard.events}) > 5


def test_another_language_is_heard_as_some_phonemes(weights):
    """Vowel-like buzzes and clicks of no language at all."""
    rng = np.random.default_rng(2)
    time_s = np.arange(3 * RATE_HZ) / RATE_HZ
    buzz = 0.2 * np.sign(np.sin(2 * np.pi * (100 + 60 * np.sin(9 * time_s)) * time_s))
    heard = listen(NetworkRecognizer(weights), buzz * (rng.random(len(buzz)) < 0.9))

    assert heard.final_until_s > 2.8
