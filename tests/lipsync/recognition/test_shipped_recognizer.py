"""The recogniser as it is shipped: its weights, what it hears, what it costs in memory."""

import math
from importlib import resources

import numpy as np
import pytest
import soundfile
import soxr
from lipservo_lab.evaluation.recognition.closing_times import (
    ClosingBench,
    closing_times,
    cut_dead,
    stop_onsets,
    vowel_cuts,
    with_gap,
)
from lipservo_lab.evaluation.recognition.heard_motion import recognize_file
from lipservo_lab.learning.motion.trained_model import load_trained_model
from places import DATA
from speech import (
    CLIP_LABELS_PATH,
    CLIP_PATH,
    phoneme_frames,
    viseme_accuracy,
    white_noise,
)

from lipsync.audio_block import AudioBlock
from lipsync.phoneme_files.reader import read_phonemes
from lipsync.phonemes import PHONEMES, SILENCE
from lipsync.recognition.features import LevelNormalizer, LogMelStream
from lipsync.recognition.network import SHIPPED, StreamingNetwork, load_shipped_weights
from lipsync.recognition.network_recognizer import NetworkRecognizer
from lipsync.recognition.recognizers import make_recognizer
from lipsync.timeline import PhonemeTimeline

RATE_HZ = 16_000
#: Posteriors that torch gave for frames 100 to 119 of the clip: make_recognizer_posteriors.py.
REFERENCE_PATH = DATA / "recognizer_posteriors.npz"


@pytest.fixture(scope="module")
def weights():
    return load_shipped_weights()


@pytest.fixture(scope="module")
def clip():
    return soundfile.read(CLIP_PATH, dtype="float32")[0]


def clip_phones():
    return [event for event in read_phonemes(CLIP_LABELS_PATH) if event.end_s is not None]


def listen(recognizer, samples):
    """Feed samples in blocks of 10 ms; return the timeline of all updates."""
    timeline = PhonemeTimeline(horizon_s=math.inf)
    for first in range(0, len(samples), 160):
        block = AudioBlock(samples[first : first + 160].astype(np.float32), first / RATE_HZ)
        recognizer.feed(block)
        for update in recognizer.updates():
            timeline.apply(update)
    return timeline


@pytest.mark.parametrize("name", SHIPPED)
def test_the_weights_are_small_enough_to_ship_and_have_a_card(name):
    assert load_shipped_weights(name).phonemes == PHONEMES
    with resources.as_file(resources.files("lipsync.models") / SHIPPED[name]) as path:
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


@pytest.mark.slow
def test_a_voice_30_db_lower_is_heard_nearly_as_well(weights, clip):
    n_frames = len(clip) // 160
    truth = phoneme_frames(read_phonemes(CLIP_LABELS_PATH), n_frames)
    accuracies = [
        viseme_accuracy(
            phoneme_frames(listen(NetworkRecognizer(weights), clip * gain).events, n_frames), truth
        )
        for gain in (1.0, 10.0**-1.5)
    ]

    # The clip's 8.6 s are over before the running level has fallen by all of 30 dB.
    assert accuracies[1] > accuracies[0] - 0.04


@pytest.mark.parametrize(
    ("name", "rate_hz", "subtype", "is_stereo", "least"),
    [
        ("stereo.wav", 16_000, "PCM_16", True, 0.6),
        ("float.wav", 44_100, "FLOAT", False, 0.6),
        ("int24.flac", 48_000, "PCM_24", True, 0.6),
        ("narrow.wav", 8_000, "PCM_16", False, 0.5),
    ],
)
def test_files_of_all_kinds_are_heard_alike(
    weights, clip, tmp_path, name, rate_hz, subtype, is_stereo, least
):
    truth = phoneme_frames(read_phonemes(CLIP_LABELS_PATH), len(clip) // 160)[:400]
    samples = soxr.resample(clip[: 4 * RATE_HZ], RATE_HZ, rate_hz)
    if is_stereo:
        samples = np.stack((1.2 * samples, 0.8 * samples), axis=1)
    soundfile.write(tmp_path / name, samples, rate_hz, subtype=subtype)
    heard = recognize_file(NetworkRecognizer(weights), tmp_path / name)

    assert viseme_accuracy(phoneme_frames(heard.events, 400), truth) > least


def test_a_voice_clipped_ten_times_over_is_still_heard_in_part(weights, clip):
    n_frames = len(clip) // 160
    truth = phoneme_frames(read_phonemes(CLIP_LABELS_PATH), n_frames)
    clipped = np.clip(clip * 10.0 / np.abs(clip).max(), -1.0, 1.0)
    heard = listen(NetworkRecognizer(weights), np.concatenate((clipped, np.zeros(1_600))))

    assert viseme_accuracy(phoneme_frames(heard.events, n_frames), truth) > 0.3


@pytest.mark.parametrize("level_db", [-80.0, -50.0, -26.0])
def test_white_noise_is_no_speech(weights, level_db):
    heard = listen(NetworkRecognizer(weights), white_noise(3.0, level_db))

    spoken = [label != SILENCE for label in phoneme_frames(heard.events, 290)]
    assert np.mean(spoken) <= 0.01


@pytest.fixture(scope="module")
def closing(weights):
    return ClosingBench(NetworkRecognizer(weights), load_trained_model(), 0.1)


@pytest.mark.parametrize("cut_s", [1.8, 4.4, 6.0])
def test_the_mouth_closes_soon_after_a_voice_stops_in_mid_word(closing, clip, cut_s):
    mouth = closing.watch(*cut_dead(clip, cut_s))

    assert mouth.is_resting.argmax() * 0.01 <= 0.25
    assert mouth.is_resting[25:].all()
    times_s = closing_times(mouth.opening_mm)
    if times_s is not None:  # else the lips were closed already
        assert times_s[0] <= 0.25
        assert times_s[1] <= 0.40


@pytest.mark.parametrize("gap_s", [0.04, 0.08, 0.12])
def test_a_stop_gap_inside_a_word_sends_no_mouth_to_rest(closing, clip, gap_s):
    labels = [(e.phoneme, round(e.start_s * 100), round(e.end_s * 100)) for e in clip_phones()]
    for at_s in [t for t in stop_onsets(labels) if t > 0.5][:3]:
        mouth = closing.watch(*with_gap(clip, at_s, gap_s))
        assert not mouth.is_resting[: round(gap_s * 100) + 5].any()


def test_closing_times_of_a_known_motion():
    """Open by 5 mm until 50 ms, then 1 mm less a tick: less than a tenth is left at 100 ms."""
    opening_mm = np.concatenate((np.full(6, 5.0), np.arange(4.0, -0.1, -1.0), np.zeros(60)))

    assert closing_times(opening_mm) == pytest.approx((0.06, 0.10))
    assert closing_times(np.zeros(80)) is None
    assert closing_times(np.full(80, 5.0)) == (math.inf, math.inf)


def test_digital_silence_does_not_reach_back_into_the_speech_before_it(weights, clip):
    """A frame is silent where nothing could be heard in it, not where the head that speaks is."""
    labels = [(e.phoneme, round(e.start_s * 100), round(e.end_s * 100)) for e in clip_phones()]
    late_s = []
    for cut_s in vowel_cuts(labels)[2:7]:
        samples, at_s = cut_dead(clip, cut_s)
        heard = listen(NetworkRecognizer(weights), samples)
        silences_s = (e.start_s for e in heard.events if e.phoneme == SILENCE)
        late_s.append(next(start_s for start_s in silences_s if start_s > at_s - 0.2) - at_s)

    assert np.median(late_s) == pytest.approx(0.0, abs=0.03)


def test_the_network_is_the_default_and_every_rung_can_listen(clip):
    for engine, n_phonemes in (("network", 5), ("energy", 3)):
        recognizer = make_recognizer(engine)
        assert (recognizer.level, recognizer.reasons) == (engine, ())
        heard = listen(recognizer, clip[: 2 * RATE_HZ])
        assert len({event.phoneme for event in heard.events}) >= n_phonemes


def test_another_language_is_heard_as_some_phonemes(weights):
    """Vowel-like buzzes and clicks of no language at all."""
    rng = np.random.default_rng(2)
    time_s = np.arange(3 * RATE_HZ) / RATE_HZ
    buzz = 0.2 * np.sign(np.sin(2 * np.pi * (100 + 60 * np.sin(9 * time_s)) * time_s))
    heard = listen(NetworkRecognizer(weights), buzz * (rng.random(len(buzz)) < 0.9))

    assert heard.final_until_s > 2.8
