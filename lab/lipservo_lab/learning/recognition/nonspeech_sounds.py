"""Sounds of rooms, machines and people that are no speech, to be learned as silence.

Each function takes a random generator and a number of samples, and returns (n,) float32 at 16 kHz
of unit power, as those of noise.py. These are sounds of a room with a robot: keys, knocks, claps,
coughs, laughter, mains, motors, and the robot's own servos.

`laughter_of` makes laughter of real voices: one of their vowels again and again, with breath
between. A network that only learned synthetic laughter recognises a person's laughter as speech,
vowel by vowel. The rhythm distinguishes it from speech: the same vowel four to seven times a second
(Bachorowski, Smoski and Owren, "The acoustic features of human laughter", JASA 110(3), 2001),
falling in pitch and strength.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from lipservo_lab.learning.recognition.noise import Noise, add_at, unit_power
from lipsync.arrays import Array32
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.phonemes import PHONEMES
from lipsync.recognition.features import HOP

Samples = NDArray[np.float64]

#: People laugh with open, central vowels (the same paper).
_VOWELS = frozenset(PHONEMES.index(phoneme) for phoneme in ("AA", "AE", "AH", "EH", "IH", "ER"))
_SHORTEST_FRAMES = 6


def laughter_of(voices: Sequence[tuple[Array32, NDArray[np.int64]]]) -> Noise:
    """Return a maker of laughter from the vowels of recordings.

    Parameters
    ----------
    voices : Sequence[tuple[Array32, NDArray[np.int64]]]
        Samples (n,) at 16 kHz, and labels (n_frames,), of each recording.

    Returns
    -------
    Noise
        Makes (n,) samples of unit power; of zeros if no recording has a vowel of 60 ms.
    """
    vowels = [found for samples, labels in voices if (found := _vowels(samples, labels))]

    def make_laughter(rng: np.random.Generator, n: int) -> Array32:
        """Return `n` samples of one voice's laughter, of unit power; zeros without vowels."""
        total = 0.002 * rng.standard_normal(n)
        if not vowels:
            return np.zeros(n, np.float32)
        voice_vowels = vowels[int(rng.integers(len(vowels)))]
        start = int(rng.uniform(0.0, 0.5) * SAMPLE_RATE_HZ)
        while start < n:
            vowel = voice_vowels[int(rng.integers(len(voice_vowels)))]
            start = _add_bursts(rng, total, start, vowel)
            start += int(rng.uniform(0.3, 2.0) * SAMPLE_RATE_HZ)
        return unit_power(total)

    return make_laughter


def _vowels(samples: Array32, labels: NDArray[np.int64]) -> list[Samples]:
    """Return the pieces of a recording that are vowels of `_VOWELS`, each of unit power.

    labels: (n_frames,). Pieces last 60 ms at least.
    """
    borders = [0, *(np.flatnonzero(np.diff(labels)) + 1).tolist(), len(labels)]
    return [
        np.asarray(unit_power(samples[first * HOP : end * HOP]), np.float64)
        for first, end in pairwise(borders)
        if end - first >= _SHORTEST_FRAMES and labels[first] in _VOWELS
    ]


def _add_bursts(rng: np.random.Generator, total: Samples, start: int, vowel: Samples) -> int:
    """Add a few bursts of the vowel to `total` from sample `start` on; return where they end.

    Each burst is shorter than its period of 140 to 260 ms; breath fills the rest.
    """
    period_s, strength = rng.uniform(0.14, 0.26), 1.0
    # Laughter is higher than speech of the same person.
    pitch = rng.uniform(1.0, 1.6)
    for _ in range(int(rng.integers(3, 13))):
        length = int(period_s * rng.uniform(0.35, 0.65) * SAMPLE_RATE_HZ)
        # Played `pitch` times faster.
        burst = np.interp(np.arange(length) * pitch, np.arange(len(vowel)), vowel, right=0.0)
        burst *= np.hanning(length)
        breath = _breath_noise(rng, vowel, int(period_s * SAMPLE_RATE_HZ)) * rng.uniform(0.05, 0.4)
        add_at(total, start, strength * breath)
        add_at(total, start, strength * burst)
        start += int(period_s * rng.uniform(0.93, 1.07) * SAMPLE_RATE_HZ)
        pitch, strength = pitch * rng.uniform(0.94, 1.0), strength * rng.uniform(0.82, 1.0)
    return start


def _breath_noise(rng: np.random.Generator, vowel: Samples, n: int) -> Samples:
    """Return `n` samples of noise with the vowel's spectrum, as of the same mouth without voice."""
    strengths = np.abs(np.fft.rfft(vowel, n))
    smooth = np.convolve(strengths, np.ones(9) / 9.0, "same")
    noise = np.fft.irfft(smooth * np.exp(2j * np.pi * rng.random(len(smooth))), n)
    return np.asarray(noise / max(1e-9, float(np.std(noise))))


def impulses(rng: np.random.Generator, n: int) -> Array32:
    """Return typing, knocks, claps: short bursts through resonances of their own.

    Parameters
    ----------
    rng : np.random.Generator
        Draws the sounds.
    n : int
        Number of samples.

    Returns
    -------
    Array32
        (n,).
    """
    total = 0.003 * rng.standard_normal(n)
    rate_hz = np.exp(rng.uniform(np.log(0.7), np.log(12.0)))
    decay_s = np.exp(rng.uniform(np.log(0.002), np.log(0.06)))
    resonances_hz = np.exp(rng.uniform(np.log(90.0), np.log(6000.0), int(rng.integers(1, 5))))
    brightness = rng.uniform(0.0, 1.0)
    at_s = rng.exponential(1.0 / rate_hz)
    while at_s * SAMPLE_RATE_HZ < n:
        start = int(at_s * SAMPLE_RATE_HZ)
        strength = rng.uniform(0.2, 1.0)
        # A key goes down and comes up again; a knuckle bounces.
        for delay_s, share in ((0.0, 1.0), (rng.uniform(0.01, 0.12), rng.uniform(0.0, 0.6))):
            add_at(
                total,
                start + round(delay_s * SAMPLE_RATE_HZ),
                strength * share * _click(rng, resonances_hz, decay_s, brightness),
            )
        at_s += rng.exponential(1.0 / rate_hz)
    return unit_power(total)


def cough(rng: np.random.Generator, n: int) -> Array32:
    """Return coughs and cleared throats: an explosion of breath, a rasp, sometimes a voiced end.

    Parameters
    ----------
    rng : np.random.Generator
        Draws the sounds.
    n : int
        Number of samples.

    Returns
    -------
    Array32
        (n,).
    """
    total = 0.002 * rng.standard_normal(n)
    formants_hz = (rng.uniform(400, 900), rng.uniform(1000, 1900), rng.uniform(2300, 3600))
    start = int(rng.uniform(0.0, 0.5) * SAMPLE_RATE_HZ)
    while start < n:
        for _ in range(int(rng.integers(1, 4))):
            length = int(rng.uniform(0.12, 0.4) * SAMPLE_RATE_HZ)
            time_s = np.arange(length) / SAMPLE_RATE_HZ
            envelope = np.exp(-time_s / rng.uniform(0.02, 0.12))
            envelope += 0.3 * np.exp(-(((time_s - time_s[-1] * 0.7) / 0.05) ** 2)) * rng.random()
            breath = rng.standard_normal(length)
            rasp = _glottis(rng, length, rng.uniform(80.0, 250.0), roughness=0.3)
            add_at(
                total, start, _formants((breath + rng.uniform(0, 2) * rasp) * envelope, formants_hz)
            )
            start += int(length + rng.uniform(0.02, 0.2) * SAMPLE_RATE_HZ)
        start += int(rng.uniform(0.4, 2.5) * SAMPLE_RATE_HZ)
    return unit_power(total)


def laughter(rng: np.random.Generator, n: int) -> Array32:
    """Return bursts of one vowel with breath between, five a second, falling in pitch and strength.

    Parameters
    ----------
    rng : np.random.Generator
        Draws the sounds.
    n : int
        Number of samples.

    Returns
    -------
    Array32
        (n,).
    """
    total = 0.002 * rng.standard_normal(n)
    start = int(rng.uniform(0.0, 0.5) * SAMPLE_RATE_HZ)
    while start < n:
        pitch_hz = rng.uniform(130.0, 480.0)
        vowel_hz = (rng.uniform(500, 950), rng.uniform(1100, 1900), rng.uniform(2400, 3400))
        period_s, strength = rng.uniform(0.15, 0.26), 1.0
        for _ in range(int(rng.integers(3, 12))):
            voiced = int(period_s * rng.uniform(0.35, 0.6) * SAMPLE_RATE_HZ)
            source = _glottis(rng, voiced, pitch_hz, roughness=0.05)
            source = (source + 0.5 * rng.standard_normal(voiced)) * np.hanning(voiced)
            add_at(total, start, strength * _formants(source, vowel_hz))
            breath = 0.15 * rng.standard_normal(int(period_s * SAMPLE_RATE_HZ))
            add_at(total, start, strength * breath)
            start += int(period_s * SAMPLE_RATE_HZ)
            pitch_hz, strength = pitch_hz * rng.uniform(0.93, 1.0), strength * 0.9
        start += int(rng.uniform(0.4, 2.5) * SAMPLE_RATE_HZ)
    return unit_power(total)


def hum(rng: np.random.Generator, n: int) -> Array32:
    """Return mains hum, buzz of a bad contact, a whistle of electronics: constant harmonics.

    Parameters
    ----------
    rng : np.random.Generator
        Draws the sounds.
    n : int
        Number of samples.

    Returns
    -------
    Array32
        (n,).
    """
    time_s = np.arange(n) / SAMPLE_RATE_HZ
    base_hz = float(rng.choice([50.0, 60.0, 100.0, 120.0])) * rng.uniform(0.995, 1.005)
    if rng.random() < 0.3:
        base_hz = float(np.exp(rng.uniform(np.log(60.0), np.log(3000.0))))
    falloff, odd_only = rng.uniform(0.0, 2.0), rng.random() < 0.4
    total = np.zeros(n)
    for k in range(1, max(2, min(80, int(7800 / base_hz)))):
        if odd_only and k % 2 == 0:
            continue
        strength = rng.uniform(0.1, 1.0) / k**falloff
        total += strength * np.sin(2 * np.pi * base_hz * k * time_s + rng.uniform(0.0, 6.3))
    if rng.random() < 0.4:
        total *= _on_off(rng, n, (0.3, 4.0))
    hiss = 1e-3 + rng.uniform(0.0, 0.1) * np.std(total)
    return unit_power(total + hiss * rng.standard_normal(n))


def motors(rng: np.random.Generator, n: int) -> Array32:
    """Return fans, pumps, drills, vacuum cleaners: a rotating tone in the noise that it makes.

    Parameters
    ----------
    rng : np.random.Generator
        Draws the sounds.
    n : int
        Number of samples.

    Returns
    -------
    Array32
        (n,).
    """
    speed = 1.0 + 0.02 * np.cumsum(rng.standard_normal(n)) / np.sqrt(n)
    if rng.random() < 0.4:
        speed *= 0.2 + 0.8 * _on_off(rng, n, (0.5, 4.0), edge_s=0.4)
    return unit_power(_whine(rng, n, speed, rng.uniform(20.0, 400.0), rng.uniform(0.2, 2.0)))


def servos(rng: np.random.Generator, n: int) -> Array32:
    """Return geared servos that move as those of a mouth; each whines higher the faster it turns.

    One to five servos change speed 1.5 to 8 times a second, with pauses. The mesh of the gears
    gives a tone whose frequency and level are in proportion to the speed.

    Parameters
    ----------
    rng : np.random.Generator
        Draws the sounds.
    n : int
        Number of samples.

    Returns
    -------
    Array32
        (n,), of unit power.
    """
    total = 0.004 * rng.standard_normal(n)
    is_moving = _on_off(rng, n, (0.3, 3.0), edge_s=0.05)
    for _ in range(int(rng.integers(1, 6))):
        moves_hz = rng.uniform(1.5, 8.0)
        n_points = max(4, int(n / SAMPLE_RATE_HZ * moves_hz * 2))
        speed = np.interp(np.arange(n), np.linspace(0, n, n_points), rng.standard_normal(n_points))
        speed = np.abs(speed) * is_moving
        mesh_hz = np.exp(rng.uniform(np.log(150.0), np.log(2500.0)))
        total += _whine(rng, n, speed, mesh_hz, rng.uniform(0.05, 0.6)) * np.minimum(speed, 2.0)
    return unit_power(total)


#: The sounds of a room, and how likely each is drawn.
_KINDS: tuple[tuple[Callable[[np.random.Generator, int], Array32], float], ...] = (
    (impulses, 0.25),
    (cough, 0.15),
    (laughter, 0.12),
    (hum, 0.18),
    (motors, 0.12),
    (servos, 0.18),
)


def any_sound(rng: np.random.Generator, n: int) -> Array32:
    """Return one of the sounds of this file, drawn by the chances in `_KINDS`.

    Parameters
    ----------
    rng : np.random.Generator
        Draws the sound.
    n : int
        Number of samples.

    Returns
    -------
    Array32
        (n,), of unit power.
    """
    chances = [chance for _, chance in _KINDS]
    return _KINDS[int(rng.choice(len(_KINDS), p=chances))][0](rng, n)


def _click(
    rng: np.random.Generator, resonances_hz: Samples, decay_s: float, brightness: float
) -> Samples:
    """Return a click or knock, (m,): noise that fades and resonances that ring.

    resonances_hz: (n_resonances,), each detuned by up to 3 %. decay_s: their time constant.
    brightness: amplitude of the noise.
    """
    length = max(32, int(6 * decay_s * SAMPLE_RATE_HZ))
    time_s = np.arange(length) / SAMPLE_RATE_HZ
    burst = brightness * rng.standard_normal(length) * np.exp(-time_s / (0.4 * decay_s))
    for hz in resonances_hz * rng.uniform(0.97, 1.03):
        ringing = np.sin(2 * np.pi * hz * time_s + rng.uniform(0.0, 6.3))
        burst += rng.uniform(0.2, 1.0) * ringing * np.exp(-time_s / decay_s)
    return burst


def _glottis(rng: np.random.Generator, n: int, pitch_hz: float, roughness: float) -> Samples:
    """Return pulses of a voice, (n,): periods of 1 / pitch_hz, lengthened or shortened at random.

    roughness: standard deviation of a period, as a share of it.
    """
    source = np.zeros(n)
    place = 0.0
    while place < n:
        source[int(place)] = 4.0
        place += SAMPLE_RATE_HZ / pitch_hz * max(0.3, 1.0 + roughness * rng.standard_normal())
    return np.asarray(lfilter([1.0], [1.0, -0.95], source))


def _formants(source: Samples, hz: tuple[float, ...]) -> Samples:
    """Return a source, (n,), filtered by resonances at `hz`, 90 Hz wide and more, side by side."""
    total = 0.1 * source
    for number, centre_hz in enumerate(hz):
        radius = np.exp(-np.pi * (90.0 + 40.0 * number) / SAMPLE_RATE_HZ)
        poles = [1.0, -2.0 * radius * np.cos(2 * np.pi * centre_hz / SAMPLE_RATE_HZ), radius**2]
        total = total + lfilter([1.0 - radius], poles, source) / (1.0 + number)
    return np.asarray(total)


def _on_off(
    rng: np.random.Generator, n: int, lengths_s: tuple[float, float], edge_s: float = 0.01
) -> Samples:
    """Return an envelope, (n,): 1 while it is on, 0 while it is off, with soft edges.

    lengths_s: shortest and longest time in one state.
    """
    states, is_on = np.zeros(n), bool(rng.random() < 0.5)
    start = 0
    while start < n:
        length = int(rng.uniform(*lengths_s) * SAMPLE_RATE_HZ)
        states[start : start + length] = is_on
        start, is_on = start + length, not is_on
    share = np.exp(-1.0 / (edge_s * SAMPLE_RATE_HZ))
    return np.asarray(lfilter([1.0 - share], [1.0, -share], states))


def _whine(
    rng: np.random.Generator, n: int, speed: Samples, tone_hz: float, noisiness: float
) -> Samples:
    """Return a tone with harmonics that follows a speed, (n,), and noise in its rhythm.

    tone_hz: frequency at speed 1. noisiness: amplitude of the noise.
    """
    phase = 2 * np.pi * tone_hz * np.cumsum(speed) / SAMPLE_RATE_HZ
    n_harmonics = max(1, min(12, int(7000 / (tone_hz * max(1.0, float(speed.max()))))))
    tones = np.zeros(n)
    for k in range(1, n_harmonics + 1):
        tones += rng.uniform(0.1, 1.0) / k * np.sin(k * phase + rng.uniform(0.0, 6.3))
    noise = lfilter([1.0], [1.0, -rng.uniform(0.0, 0.95)], rng.standard_normal(n))
    noise /= max(1e-9, float(np.std(noise)))
    return np.asarray(tones + noisiness * noise * (0.6 + 0.4 * np.cos(phase)))
