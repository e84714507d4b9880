"""Three short sounds whose motion is held: the bundled clip, and two that are made here."""

import random
from importlib import resources
from pathlib import Path

import numpy as np
import soundfile

RATE_HZ = 16_000
CLIP = Path(str(resources.files("lipservo.clips") / "welcome.flac"))
#: Rate of the replay of each, Hz.
SOUNDS = {"clip": 30.0, "slow_and_noisy": 50.0, "vowels": 100.0}


def write_sound(name: str, path: Path) -> None:
    """One of SOUNDS as a WAV of 16 bits."""
    makers = {"clip": _clip, "slow_and_noisy": _slow_and_noisy, "vowels": _vowels}
    soundfile.write(path, makers[name](), RATE_HZ, subtype="PCM_16")


def _clip() -> np.ndarray:
    samples, rate_hz = soundfile.read(CLIP)
    assert rate_hz == RATE_HZ
    return samples


def _slow_and_noisy() -> np.ndarray:
    """2.4 s of the clip, a fifth slower and lower, in noise 20 dB below."""
    part = _clip()[int(2.0 * RATE_HZ) : int(4.4 * RATE_HZ)]
    at = np.arange(0.0, len(part) - 1, 1.0 / 1.2)
    slow = np.interp(at, np.arange(len(part)), part)
    # Python's own generator promises the same numbers in every version; NumPy's does not.
    dice = random.Random(1)
    noise = np.array([dice.random() - 0.5 for _ in slow])
    noise *= 0.1 * slow.std() / noise.std()
    return slow + noise


def _vowels() -> np.ndarray:
    """A voice of 120 Hz through two formants, open, spread and round in turn, with pauses.

    Formants of men by Peterson and Barney, J. Acoust. Soc. Am. 24 (1952) 175.
    """
    pieces = []
    for first_hz, second_hz in ((730.0, 1090.0), (270.0, 2290.0), (300.0, 870.0), (730.0, 1090.0)):
        times_s = np.arange(int(0.3 * RATE_HZ)) / RATE_HZ
        harmonics = np.arange(1, 40) * 120.0
        gains = sum(1.0 / (1.0 + ((harmonics - f) / 80.0) ** 2) for f in (first_hz, second_hz))
        voice = gains @ np.sin(2 * np.pi * harmonics[:, None] * times_s)
        voice *= np.minimum(1.0, np.minimum(times_s, times_s[::-1]) / 0.03)
        pieces += [0.3 * voice / np.abs(voice).max(), np.zeros(int(0.15 * RATE_HZ))]
    return np.concatenate(pieces)
