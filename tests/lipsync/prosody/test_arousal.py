"""How arousal answers to a voice: the tests that the design note lists."""

from copy import deepcopy
from functools import cache

import numpy as np
import pytest
from synthetic_voice import SAMPLE_RATE_HZ, room, voice

from lipsync.prosody.voice_tracker import VoiceTracker, score

BEFORE_S, AFTER_S = 30.0, 10.0
FRAMES_PER_S = 100
ROOM_DB = -60.0


def feed(tracker, samples):
    """The arousal of each frame."""
    blocks = samples[: len(samples) // 160 * 160].reshape(-1, 160).astype(np.float32)
    return np.array([tracker.feed(block).arousal for block in blocks])


@cache
def knows_the_voice():
    """A tracker that has heard a voice for 30 s in a room with some noise; copy it."""
    tracker, rng = VoiceTracker(), np.random.default_rng(0)
    feed(tracker, voice(BEFORE_S, rng) + room(BEFORE_S, rng, ROOM_DB))
    return tracker


def then(samples):
    """Its arousal when it hears these samples next, in the same room."""
    noise = room(len(samples) / SAMPLE_RATE_HZ, np.random.default_rng(2), ROOM_DB)
    return feed(deepcopy(knows_the_voice()), samples + noise)


def goes_on(duration_s=AFTER_S, **changed):
    return voice(duration_s, np.random.default_rng(1), **changed)


def after_3_s(arousal):
    return arousal[3 * FRAMES_PER_S :].mean()


def test_the_score_of_a_standard_deviation():
    assert score(1.0) == pytest.approx(0.6827, abs=1e-4)  # share of the normal within one sd
    assert score(-1.0) == -score(1.0)
    assert score(0.0) == 0.0


def test_a_voice_that_goes_on_as_before_is_near_zero():
    assert abs(after_3_s(then(goes_on()))) < 0.08


@pytest.mark.parametrize(
    ("more", "less", "least"),
    [
        ({"level_db": -20.0}, {"level_db": -32.0}, 0.1),
        ({"pitch_hz": 140.0 * 2.0**0.25}, {"pitch_hz": 140.0 * 2.0**-0.25}, 0.1),
        ({"falloff": 0.5}, {"falloff": 1.6}, 0.08),
    ],
    ids=["6 dB louder or quieter", "3 semitones higher or lower", "brighter or duller"],
)
def test_louder_higher_or_brighter_is_more_aroused_and_the_reverse_less(more, less, least):
    as_before = after_3_s(then(goes_on()))
    assert after_3_s(then(goes_on(**more))) > as_before + least
    assert after_3_s(then(goes_on(**less))) < as_before - 0.08


def test_a_louder_voice_becomes_usual_after_two_minutes():
    arousal = then(np.tile(goes_on(20.0, level_db=-20.0), 6))
    at_first = arousal[300:1000].mean()

    assert at_first > 0.1
    assert abs(arousal[-2000:].mean()) < 0.4 * at_first


@pytest.mark.parametrize("gain", [0.1, 4.0])
def test_another_gain_from_the_beginning_changes_nothing(gain):
    rng = np.random.default_rng(1)
    samples = 0.25 * (voice(15.0, rng) + room(15.0, rng, ROOM_DB))

    changed = feed(VoiceTracker(), gain * samples)
    assert changed == pytest.approx(feed(VoiceTracker(), samples), abs=0.02)
    assert np.abs(changed).max() > 0.02


def test_a_jump_of_the_microphone_s_gain_counts_for_less_than_a_louder_voice():
    """12 dB: of voice and noise together, as automatic gain does, or of the voice alone."""
    after = goes_on(20.0)
    noise = room(20.0, np.random.default_rng(2), ROOM_DB)
    by_voice = feed(deepcopy(knows_the_voice()), 4.0 * after + noise)
    by_gain = feed(deepcopy(knows_the_voice()), 4.0 * (after + noise))

    assert by_gain[600:].mean() < 0.4 * by_voice[600:].mean()


def test_in_silence_arousal_goes_to_zero():
    excited = goes_on(4.0, level_db=-16.0, pitch_hz=200.0)
    arousal = then(np.concatenate((excited, np.zeros(16 * SAMPLE_RATE_HZ))))
    end = 4 * FRAMES_PER_S

    assert arousal[end] > 0.2
    # 2 s of decay, after at most 0.15 s in which the gate is open still.
    assert arousal[end + 215] < arousal[end] * np.exp(-1.0) * 1.1
    assert abs(arousal[-1]) < 0.002


def test_before_anything_is_known_it_is_zero():
    shouted = voice(1.0, np.random.default_rng(0), level_db=-6.0, pitch_hz=400.0)

    assert np.abs(feed(VoiceTracker(), shouted)).max() < 0.05
