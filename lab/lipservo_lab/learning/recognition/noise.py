"""Sounds without speech, and what rooms and lines do to speech. For training and scoring.

All randomness comes from an argument: the same generator state gives the same samples. Samples are
(n,) float32 at 16 kHz.

`read_found_sounds`, `found`: the user's own sound files without speech: music, effects, the robot
in its room.
"""

import io
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import soundfile
import soxr
from numpy.typing import NDArray

from lipsync.arrays import Array, Array32
from lipsync.audio.file import read_speech
from lipsync.audio.source import SoundError
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.errors import UserError

Noise = Callable[[np.random.Generator, int], Array32]

SOUND_M_S = 343.0
#: Distance of the talker from the microphone, m; time up to which images are computed one by one,
#: s; reverberation times, s.
_AWAY_M, _IMAGES_S, _REVERBERATION_S = (0.25, 4.0), 0.05, (0.15, 0.8)


def white(rng: np.random.Generator, n: int) -> Array32:
    """Return white noise of unit power.

    Parameters
    ----------
    rng : np.random.Generator
        Draws the noise.
    n : int
        Number of samples.

    Returns
    -------
    Array32
        (n,).
    """
    return rng.standard_normal(n).astype(np.float32)


def coloured(rng: np.random.Generator, n: int) -> Array32:
    """Return noise whose power falls by 0 to 6 dB an octave, with one random resonance.

    Parameters
    ----------
    rng : np.random.Generator
        Draws the noise.
    n : int
        Number of samples.

    Returns
    -------
    Array32
        (n,).
    """
    spectrum = np.fft.rfft(white(rng, n))
    hz = np.linspace(20.0, SAMPLE_RATE_HZ / 2, len(spectrum))
    slope = rng.uniform(0.0, 2.0)
    centre_hz, width = np.exp(rng.uniform(np.log(100.0), np.log(6000.0))), rng.uniform(0.1, 1.0)
    resonance = 1.0 + rng.uniform(0.0, 5.0) * np.exp(-((np.log(hz / centre_hz) / width) ** 2))
    return unit_power(np.fft.irfft(spectrum * hz ** (-slope / 2) * resonance, n))


def chords(rng: np.random.Generator, n: int) -> Array32:
    """Return sustained harmonic tones that start, swell, waver and stop, as music-like noise.

    Parameters
    ----------
    rng : np.random.Generator
        Draws the tones.
    n : int
        Number of samples.

    Returns
    -------
    Array32
        (n,), of unit power.
    """
    total = np.zeros(n)
    for _ in range(max(2, round(n / SAMPLE_RATE_HZ * rng.uniform(2.0, 8.0)))):
        n_tone = min(n, round(SAMPLE_RATE_HZ * rng.uniform(0.15, 1.5)))
        time_s = np.arange(n_tone) / SAMPLE_RATE_HZ
        pitch_hz = np.exp(rng.uniform(np.log(60.0), np.log(1200.0)))
        vibrato = rng.uniform(0.0, 0.01) * np.sin(2 * np.pi * rng.uniform(3.0, 7.0) * time_s)
        phase = 2 * np.pi * pitch_hz * np.cumsum(1.0 + vibrato) / SAMPLE_RATE_HZ
        falloff = rng.uniform(0.5, 2.0)
        harmonics = np.arange(1, max(2, min(25, int(7_800 / pitch_hz))))
        strengths = rng.uniform(0.2, 1.0, len(harmonics)) / harmonics**falloff
        tone = sum(a * np.sin(k * phase) for a, k in zip(strengths, harmonics, strict=True))
        attack_s, decay_s = rng.uniform(0.005, 0.1), rng.uniform(0.1, 2.0)
        envelope = np.minimum(1.0, time_s / attack_s) * np.exp(-time_s / decay_s)
        start = int(rng.integers(0, n - n_tone + 1))
        total[start : start + n_tone] += tone * envelope * rng.uniform(0.3, 1.0)
    return unit_power(total + 0.02 * rng.standard_normal(n))


def band(rng: np.random.Generator, n: int) -> Array32:
    """Return plucked strings, bass and drums at a steady beat: the music of the benchmark.

    Made in another way than `chords`, so that no network was trained on anything like it. Strings
    are Karplus and Strong's (Computer Music Journal 7(2), 1983): a loop of noise, averaged each
    turn.

    Parameters
    ----------
    rng : np.random.Generator
        Draws the noise.
    n : int
        Number of samples.

    Returns
    -------
    Array32
        (n,), of unit power.
    """
    # In samples: half a beat of 90 to 140 a minute.
    beat = round(SAMPLE_RATE_HZ * 60.0 / rng.uniform(90.0, 140.0) / 2)
    scale_hz = 220.0 * 2.0 ** (np.array([0, 2, 4, 5, 7, 9, 11, 12]) / 12.0)
    total = np.zeros(n + 2 * SAMPLE_RATE_HZ)
    for index, start in enumerate(range(0, n, beat)):
        degree = int(rng.integers(0, 8))
        for pitch_hz in (scale_hz[degree], scale_hz[(degree + 2) % 8], scale_hz[(degree + 4) % 8]):
            string = _string(rng, pitch_hz, 4 * beat)
            total[start : start + len(string)] += string[: len(total) - start]
        if index % 2 == 0:
            bass = _string(rng, scale_hz[degree] / 4, 4 * beat)
            total[start : start + len(bass)] += 2.0 * bass[: len(total) - start]
        drum = rng.standard_normal(beat) * np.exp(-np.arange(beat) / (0.02 * SAMPLE_RATE_HZ))
        total[start : start + beat] += 0.7 * drum
    return unit_power(total[:n])


def babble(voices: Sequence[Array32], n_voices: int = 6) -> Noise:
    """Return a maker of noise of several voices at once, each from a random place on.

    Parameters
    ----------
    voices : Sequence[Array32]
        (m,) each; those at once are drawn from these.
    n_voices : int
        Number of voices at once.

    Returns
    -------
    Noise
        Makes (n,) samples of unit power.
    """

    def make_babble(rng: np.random.Generator, n: int) -> Array32:
        total = np.zeros(n, np.float32)
        for index in rng.choice(len(voices), size=min(n_voices, len(voices)), replace=False):
            voice = unit_power(voices[index])
            total += np.resize(np.roll(voice, -int(rng.integers(len(voice)))), n)
        return unit_power(total)

    return make_babble


def add_noise(speech: Array32, noise: Array32, snr_db: float) -> Array32:
    """Return speech with noise `snr_db` below it; both powers are means over the whole length.

    Parameters
    ----------
    speech, noise : Array32
        (n,).
    snr_db : float
        Signal-to-noise ratio, dB.

    Returns
    -------
    Array32
        (n,).
    """
    power = float(np.mean(np.square(speech, dtype=np.float64)))
    gain = np.sqrt(power * 10.0 ** (-snr_db / 10.0))
    return (speech + np.float32(gain) * unit_power(noise)).astype(np.float32)


def reverberate(rng: np.random.Generator, speech: Array32) -> Array32:
    """Return speech in a room: the talker's images in six walls, then a diffuse tail.

    Images (Allen and Berkley 1979) for the first 50 ms; after that they are so many that their sum
    is noise, whose power falls as Eyring's formula says. The direct sound keeps its time and level.

    Parameters
    ----------
    rng : np.random.Generator
        Draws the room, its walls, and where the talker and the microphone are.
    speech : Array32
        (n,) at 16 kHz.

    Returns
    -------
    Array32
        (n,).
    """
    size_m = rng.uniform((2.2, 2.2, 2.1), (9.0, 7.0, 3.8))
    surface_m2 = 2.0 * float(np.sum(size_m * np.roll(size_m, 1)))
    volume_m3 = float(np.prod(size_m))
    falls_per_s = np.log(1e6) / np.exp(rng.uniform(*np.log(_REVERBERATION_S)))
    # Eyring: a ray meets a wall every 4 V / S metres, which reflects reflected ** 2 of its power.
    reflected = np.exp(-falls_per_s / SOUND_M_S * 2.0 * volume_m3 / surface_m2)
    microphone_m = size_m * rng.uniform(0.1, 0.9, 3)
    direction = rng.normal(size=3) * [1.0, 1.0, 0.3]
    away_m = np.exp(rng.uniform(*np.log(_AWAY_M)))
    talker_m = microphone_m + away_m * direction / np.linalg.norm(direction)
    talker_m = np.clip(talker_m, 0.05 * size_m, 0.95 * size_m)
    distance_m, n_walls = images(size_m, talker_m, microphone_m, _IMAGES_S)
    level = reflected**n_walls / distance_m
    direct_m = max(0.1, float(np.linalg.norm(talker_m - microphone_m)))
    delays = np.rint((distance_m - direct_m) / SOUND_M_S * SAMPLE_RATE_HZ).astype(np.int64)
    is_early = (delays > 0) & (delays < round(_IMAGES_S * SAMPLE_RATE_HZ))

    # The diffuse tail: noise whose power density falls exponentially.
    time_s = np.arange(round(_REVERBERATION_S[1] * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ
    power = 4.0 * np.pi * SOUND_M_S / (volume_m3 * SAMPLE_RATE_HZ) * np.exp(-falls_per_s * time_s)
    response = np.sqrt(power) * rng.standard_normal(len(time_s))
    response[: round(_IMAGES_S * SAMPLE_RATE_HZ)] = 0.0
    np.add.at(response, delays[is_early], level[is_early])
    response *= direct_m
    response[0] = 1.0
    n_fft = 1 << (len(speech) + len(response)).bit_length()
    wet = np.fft.irfft(np.fft.rfft(speech, n_fft) * np.fft.rfft(response, n_fft), n_fft)
    return wet[: len(speech)].astype(np.float32)


def images(
    size_m: Array, spoken_m: Array, heard_m: Array, longest_s: float
) -> tuple[Array, NDArray[np.int64]]:
    """Return distances and reflections of a talker's images in the six walls of a room.

    Allen and Berkley 1979.

    Parameters
    ----------
    size_m : Array
        (3,): length, width and height.
    spoken_m, heard_m : Array
        (3,): where the talker and the microphone are, from a corner.
    longest_s : float
        At least all images whose sound takes no longer to the microphone are returned.

    Returns
    -------
    tuple[Array, NDArray[np.int64]]
        (n_x, n_y, n_z) each: the distance from each image to the microphone in m, and its number of
        reflections. The talker is the image with none.
    """
    offsets_m, reflections = [], []
    for length_m, talker, microphone in zip(size_m, spoken_m, heard_m, strict=True):
        n_each_side = int(np.ceil(SOUND_M_S * longest_s / (2 * length_m)))
        rooms = np.arange(-n_each_side, n_each_side + 1)
        places_m = (2 * rooms * length_m + talker, 2 * rooms * length_m - talker)
        offsets_m.append(np.concatenate(places_m) - microphone)
        reflections.append(np.concatenate((np.abs(2 * rooms), np.abs(2 * rooms - 1))))
    x_m, y_m, z_m = np.ix_(*offsets_m)
    x, y, z = np.ix_(*reflections)
    return np.sqrt(x_m**2 + y_m**2 + z_m**2), x + y + z


def telephone(speech: Array32) -> Array32:
    """Return speech as through a telephone: sampled at 8 kHz, 8-bit mu-law (ITU-T G.711's curve).

    Parameters
    ----------
    speech : Array32
        (n,) at 16 kHz.

    Returns
    -------
    Array32
        (n,) at 16 kHz.
    """
    narrow = np.clip(soxr.resample(speech, SAMPLE_RATE_HZ, 8_000), -1.0, 1.0)
    curve = np.log1p(255.0 * np.abs(narrow)) / np.log(256.0)
    steps = np.rint(curve * 127.0) / 127.0
    line = np.sign(narrow) * np.expm1(steps * np.log(256.0)) / 255.0
    wide = soxr.resample(line.astype(np.float32), 8_000, SAMPLE_RATE_HZ)
    return np.resize(wide, len(speech)).astype(np.float32)


def lossy(rng: np.random.Generator, speech: Array32) -> Array32:
    """Return speech as a lossy codec leaves it: Vorbis at some 28 to 53 kbit/s.

    Parameters
    ----------
    rng : np.random.Generator
        Draws the quality.
    speech : Array32
        (n,) at 16 kHz.

    Returns
    -------
    Array32
        (n,).
    """
    stream = io.BytesIO()
    quality = rng.uniform(0.4, 1.0)
    soundfile.write(stream, speech, SAMPLE_RATE_HZ, format="OGG", compression_level=quality)
    stream.seek(0)
    decoded = soundfile.read(stream, dtype="float32")[0]
    return np.resize(decoded, len(speech)).astype(np.float32)


def add_at(total: NDArray[np.float64], start: int, part: NDArray[np.float64]) -> None:
    """Add `part` to `total` from a sample on; what is beyond its end is lost.

    Parameters
    ----------
    total : NDArray[np.float64]
        (m,), changed in place.
    start : int
        Sample of `total` at which `part` begins.
    part : NDArray[np.float64]
        (n,).
    """
    end = min(len(total), start + len(part))
    if start < end:
        total[start:end] += part[: end - start]


def unit_power(samples: NDArray[np.floating]) -> Array32:
    """Return samples at a mean power of 1; silence stays silence.

    Parameters
    ----------
    samples : NDArray[np.floating]
        (n,).

    Returns
    -------
    Array32
        (n,).
    """
    power = float(np.mean(np.square(samples, dtype=np.float64)))
    return (samples / np.sqrt(power) if power > 0.0 else samples).astype(np.float32)


def _string(rng: np.random.Generator, pitch_hz: float, n: int) -> NDArray[np.float64]:
    """Return `n` samples of a plucked string (Karplus and Strong): a loop of noise that fades."""
    period = max(2, round(SAMPLE_RATE_HZ / pitch_hz))
    loop = rng.uniform(-1.0, 1.0, period)
    turns = []
    for _ in range(-(-n // period)):
        turns.append(loop)
        loop = 0.498 * (loop + np.roll(loop, 1))
    return np.concatenate(turns)[:n]


#: Only the middle 90 s of a long file are kept: to save memory, and so that it does not outweigh
#: the others.
_LONGEST_S = 90
_SAMPLES_PER_S = 16_000


class FoundSoundsError(UserError):
    """A folder of sounds cannot be used; the message is one line."""


def read_found_sounds(
    folder: Path, warn: Callable[[str], None] = lambda _line: None
) -> list[Array32]:
    """Read every sound file below a folder; other files are reported and left out.

    Parameters
    ----------
    folder : Path
        Of sounds.
    warn : Callable[[str], None]
        Called with a line for each file left out.

    Returns
    -------
    list[Array32]
        (n,) at 16 kHz each.

    Raises
    ------
    FoundSoundsError
        The folder holds no sound.
    """
    if not folder.is_dir():
        raise FoundSoundsError(f"{folder}: no such folder; give one of sounds without speech")
    sounds = []
    for path in sorted(folder.rglob("*")):
        if not path.is_file():
            continue
        try:
            samples = read_speech(path)
        except SoundError as error:
            warn(str(error))
            continue
        spare = max(0, len(samples) - _LONGEST_S * _SAMPLES_PER_S) // 2
        # Float16 would do; half the memory is not worth another type.
        sounds.append(samples[spare : spare + _LONGEST_S * _SAMPLES_PER_S].copy())
    if not sounds:
        raise FoundSoundsError(f"{folder}: holds no sound file that can be read")
    return sounds


def found(sounds: list[Array32]) -> Noise:
    """Return a maker of noise from parts of sounds.

    Short sounds are repeated with pauses; long ones are drawn more often.

    Parameters
    ----------
    sounds : list[Array32]
        (n,) each, at 16 kHz.

    Returns
    -------
    Noise
        Makes (n,) samples of unit power.
    """
    weights = np.sqrt([float(len(sound)) for sound in sounds])
    chances = weights / weights.sum()

    def make_part(rng: np.random.Generator, n: int) -> Array32:
        """Return `n` samples of unit power: a part of a long sound, or a short one repeated.

        Pauses between repetitions last up to two seconds.
        """
        sound = sounds[int(rng.choice(len(sounds), p=chances))]
        if len(sound) >= n:
            first = int(rng.integers(0, len(sound) - n + 1))
            return unit_power(sound[first : first + n])
        total = np.zeros(n, np.float32)
        start = int(rng.integers(0, max(1, n - len(sound))))
        while start < n:
            end = min(n, start + len(sound))
            total[start:end] = sound[: end - start]
            start = end + int(rng.integers(0, 2 * _SAMPLES_PER_S))
        return unit_power(total)

    return make_part
