"""Augmentation of training speech: voice, speed, room, noise, line, level."""

from dataclasses import dataclass

import numpy as np
import soxr
from numpy.typing import NDArray

from lipservo_lab.learning.recognition import noise, nonspeech_sounds, voice_changes
from lipservo_lab.learning.recognition.noise import Noise
from lipsync.arrays import Array32
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.phonemes import PHONEMES, SILENCE
from lipsync.recognition.features import FRAMES_PER_S, HOP

Labels = NDArray[np.int64]

#: The recipe's gain was -25..+5 dB and lost .12 at -30 dB; -40 covers it.
_GAIN_DB = (-40.0, 5.0)
_SNR_DB = (2.0, 25.0)
#: Beside somebody who is louder than this nobody could tell which talker is meant.
_SECOND_TALKER_DB = (8.0, 25.0)
_SPEED = (0.88, 1.12)
#: Vocal tracts from a large man's to a small child's; adults who read are between.
_WARP = (0.85, 1.40)
#: Of the made sounds. Laughter by real vowels is hardest to tell from speech.
_LAUGHTER_SHARE = 0.15
#: Heard before somebody speaks, s.
_BEFORE_S = (0.2, 1.5)
_SILENCE_INDEX = PHONEMES.index(SILENCE)


@dataclass(frozen=True, slots=True)
class LabelledSamples:
    """Samples (n,) float32 at 16 kHz and the label of each 10 ms frame."""

    samples: Array32
    labels: Labels


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What is heard beside the voice.

    babble: many others; talker: one other; laughter: of those that speak; found: files, or None
    where there are none.
    """

    babble: Noise
    talker: Noise
    laughter: Noise
    found: Noise | None = None

    def sound(self, rng: np.random.Generator, n: int) -> Array32:
        """A sound that is no speech: made, or found."""
        if self.found is not None and rng.random() < 0.45:
            return self.found(rng, n)
        chance = rng.random()
        if chance < _LAUGHTER_SHARE:
            return self.laughter(rng, n)
        if chance < 0.65:
            return nonspeech_sounds.any_sound(rng, n)
        makers = (noise.white, noise.coloured, noise.chords)
        return makers[int(rng.integers(len(makers)))](rng, n)

    def beside_speech(self, rng: np.random.Generator, speech: Array32) -> Array32:
        """The speech with a sound, many voices or one other voice in it."""
        chance, n = rng.random(), len(speech)
        if chance < 0.15:
            return noise.add_noise(speech, self.babble(rng, n), rng.uniform(*_SNR_DB))
        if chance < 0.25:
            return noise.add_noise(speech, self.talker(rng, n), rng.uniform(*_SECOND_TALKER_DB))
        return noise.add_noise(speech, self.sound(rng, n), rng.uniform(*_SNR_DB))


def augment_lightly(rng: np.random.Generator, clean: LabelledSamples) -> LabelledSamples:
    """Only another loudness."""
    return LabelledSamples(_at_level(rng, clean.samples, -12.0, 5.0), clean.labels)


def augment_heavily(
    rng: np.random.Generator, clean: LabelledSamples, around: Surroundings
) -> LabelledSamples:
    """Another voice, speed, room, line, noise, loudness: each with its own chance."""
    changed = _by_another_voice(rng, clean)
    samples = changed.samples
    if rng.random() < 0.25:
        samples = noise.reverberate(rng, samples)
    if rng.random() < 0.75:
        samples = around.beside_speech(rng, samples)
    if rng.random() < 0.12:
        samples = noise.telephone(samples)
    elif rng.random() < 0.12:
        samples = noise.lossy(rng, samples)
    if rng.random() < 0.08:
        samples = np.clip(samples * np.float32(10.0 ** rng.uniform(0.3, 1.2)), -1.0, 1.0)
    result = LabelledSamples(_at_level(rng, samples, *_GAIN_DB), changed.labels)
    return _after_a_sound(rng, result, around) if rng.random() < 0.3 else result


def no_speech(rng: np.random.Generator, n: int, around: Surroundings) -> Array32:
    """A sound alone at any level down to nothing, now and then with a pause, in a room, cut off."""
    samples = around.sound(rng, n)
    if rng.random() < 0.2:
        samples = noise.add_noise(samples, around.sound(rng, n), rng.uniform(0.0, 20.0))
    if rng.random() < 0.2:
        samples = noise.reverberate(rng, samples)
    low_db = -75.0 if rng.random() < 0.3 else -45.0
    samples = samples * np.float32(10.0 ** (rng.uniform(low_db, -8.0) / 20))
    if rng.random() < 0.4:
        first, last = np.sort(rng.integers(0, n, 2))
        samples[first:last] *= np.float32(10.0 ** (-rng.uniform(0.0, 100.0) / 20))
    clipped: Array32 = np.clip(samples, -1.0, 1.0)
    return clipped.astype(np.float32)


def _by_another_voice(rng: np.random.Generator, clean: LabelledSamples) -> LabelledSamples:
    chance = rng.random()
    if chance < 0.3:
        return _at_speed(rng, clean)
    if chance < 0.65:
        samples = voice_changes.warped(clean.samples, rng.uniform(*_WARP))
        return LabelledSamples(samples, clean.labels)
    if chance < 0.70:
        return LabelledSamples(voice_changes.shouted(rng, clean.samples), clean.labels)
    if chance < 0.74:
        return LabelledSamples(voice_changes.whispered(rng, clean.samples), clean.labels)
    return clean


def _after_a_sound(
    rng: np.random.Generator, speech: LabelledSamples, around: Surroundings
) -> LabelledSamples:
    """Speech that begins after a knock, a cough, a bar of music: as loud as itself, or less."""
    n_frames = round(rng.uniform(*_BEFORE_S) * FRAMES_PER_S)
    level = np.sqrt(np.mean(np.square(speech.samples, dtype=np.float64)))
    gain = np.float32(level * 10.0 ** (rng.uniform(-25.0, 3.0) / 20.0))
    before = np.clip(gain * around.sound(rng, n_frames * HOP), -1.0, 1.0)
    return LabelledSamples(
        np.concatenate((before.astype(np.float32), speech.samples)),
        np.concatenate((np.full(n_frames, _SILENCE_INDEX), speech.labels)),
    )


def _at_speed(rng: np.random.Generator, clean: LabelledSamples) -> LabelledSamples:
    """Faster or slower with the pitch, as a tape would."""
    speed = rng.uniform(*_SPEED)
    samples = soxr.resample(clean.samples, round(SAMPLE_RATE_HZ * speed), SAMPLE_RATE_HZ)
    n_frames = len(samples) * FRAMES_PER_S // SAMPLE_RATE_HZ
    sources = ((np.arange(n_frames) + 0.5) * speed).astype(np.int64)
    labels = clean.labels[np.minimum(sources, len(clean.labels) - 1)]
    return LabelledSamples(samples.astype(np.float32), labels)


def _at_level(rng: np.random.Generator, samples: Array32, low_db: float, high_db: float) -> Array32:
    gain = np.float32(10.0 ** (rng.uniform(low_db, high_db) / 20.0))
    # Microphones hand out 16 bits: very quiet speech is rounded.
    rounded: Array32 = np.rint(np.clip(samples * gain, -1.0, 1.0) * 32767.0) / 32767.0
    return rounded.astype(np.float32)
