"""The shipped recogniser, told how the robot's servos move."""

import numpy as np
import pytest
import soundfile
from lipservo_lab.evaluation.recognition.benchmark import false_speech
from lipservo_lab.evaluation.recognition.conditions import encoder_readings_deg, servo_noise
from lipservo_lab.evaluation.recognition.half_duplex import half_duplex_false_speech
from lipservo_lab.evaluation.recognition.stream_observers import label_frames
from speech import CLIP_PATH

from lipsync.phonemes import PHONEMES, SILENCE
from lipsync.recognition.fallback import FallbackLevel, FallbackRecognizer
from lipsync.recognition.network import LATENCY_S, load_shipped_weights
from lipsync.recognition.network_recognizer import NetworkRecognizer

RATE_HZ = 16_000


def recognizer():
    return NetworkRecognizer(load_shipped_weights())


@pytest.fixture(scope="module")
def clip():
    return soundfile.read(CLIP_PATH, dtype="float32")[0][: 4 * RATE_HZ]


def test_servos_that_stand_still_change_nothing(clip):
    alone = label_frames(recognizer(), clip)[0].labels
    still = np.full((len(clip) // 160, 8), 12.0)
    assert np.array_equal(label_frames(recognizer(), clip, still)[0].labels, alone)


@pytest.mark.slow
def test_a_robot_that_listened_to_its_servos_hears_a_voice_beside_them(clip):
    ears = recognizer()
    rng = np.random.default_rng(4)
    level = np.float32(10 ** (-40 / 20))
    sound, speeds = servo_noise(rng, 30 * RATE_HZ, robot=3)
    false_speech(ears, level * sound, encoder_readings_deg(speeds))
    sound, speeds = servo_noise(rng, len(clip), robot=3)
    servos_deg = encoder_readings_deg(speeds)
    assert false_speech(ears, level * sound, servos_deg) < 0.03
    untold = label_frames(recognizer(), clip + level * sound)[0].labels
    told = label_frames(ears, clip + level * sound, servos_deg)[0].labels
    silence = PHONEMES.index(SILENCE)
    spoken = untold != silence
    assert np.mean(told[spoken] == untold[spoken]) > 0.9


@pytest.mark.slow
def test_a_robot_that_could_speak_learns_its_servos_by_its_microphone():
    """Sound in pieces of 40 ms, 20 ms late, while encoders are read at once."""
    level = np.float32(10 ** (-36 / 20))
    sound, speeds = servo_noise(np.random.default_rng(0), 50 * RATE_HZ, robot=1)
    sound, servos_deg = (level * sound).astype(np.float32), encoder_readings_deg(speeds)
    learned, later = slice(0, 3000), slice(3000, 5000)
    untold = half_duplex_false_speech(recognizer(), sound[30 * RATE_HZ :], None)
    ears = recognizer()
    half_duplex_false_speech(ears, sound[: 30 * RATE_HZ], servos_deg[learned])
    told = half_duplex_false_speech(ears, sound[30 * RATE_HZ :], servos_deg[later])
    assert told < 0.5 * untold


def test_through_the_fallback_levels_and_with_a_level_that_cannot_be_told():
    told = []

    class Ears(NetworkRecognizer):
        def note_servo_speeds(self, sound_s, speeds_deg_s):
            told.append((sound_s, speeds_deg_s))

    class Deaf:
        latency_s = 0.05

        def feed(self, block): ...

        def updates(self):
            return []

        def reset(self): ...

    weights = load_shipped_weights()
    for make in (lambda: Ears(weights), Deaf):
        listener = FallbackRecognizer([FallbackLevel("one", make)], LATENCY_S)
        listener.note_servo_speeds(0.5, np.array([1.0]))
    assert told == [(0.5, np.array([1.0]))]
