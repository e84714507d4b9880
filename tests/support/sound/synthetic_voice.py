"""A voice made of harmonics: syllables that swell and glide, a pause after every seventh."""

import numpy as np

SAMPLE_RATE_HZ = 16_000
SYLLABLE_S, PAUSE_S, N_SYLLABLES = 0.22, 0.4, 7


def harmonics(pitch_hz: np.ndarray, falloff: float = 1.0) -> np.ndarray:
    """Samples (n,) of unit power whose pitch is (n,); harmonics below 3.8 kHz fall as 1 / k."""
    phase = 2.0 * np.pi * np.cumsum(pitch_hz) / SAMPLE_RATE_HZ
    n_harmonics = max(1, int(3800.0 / pitch_hz.max()))
    tone = sum(np.sin(k * phase + k) / k**falloff for k in range(1, n_harmonics + 1))
    return tone / np.sqrt(np.mean(np.square(tone)))


def voice(
    duration_s: float,
    rng: np.random.Generator,
    *,
    level_db: float = -26.0,
    pitch_hz: float = 140.0,
    falloff: float = 1.0,
) -> np.ndarray:
    """Samples (n,); level_db: of its syllables, which differ by some dB and semitones."""
    parts, n_samples = [], 0
    while n_samples < duration_s * SAMPLE_RATE_HZ:
        for _ in range(N_SYLLABLES):
            t = np.linspace(0.0, 1.0, round(SYLLABLE_S * SAMPLE_RATE_HZ), endpoint=False)
            glide_st = rng.normal(0.0, 2.0) + rng.normal(0.0, 2.0) * (t - 0.5)
            swell = np.sin(np.pi * t) ** 0.5 * 10.0 ** (rng.normal(level_db, 3.0) / 20.0)
            syllable = swell * harmonics(pitch_hz * 2.0 ** (glide_st / 12.0), falloff)
            parts.append(syllable)
        parts.append(np.zeros(round(PAUSE_S * SAMPLE_RATE_HZ)))
        n_samples = sum(map(len, parts))
    return np.concatenate(parts)[: round(duration_s * SAMPLE_RATE_HZ)]


def room(duration_s: float, rng: np.random.Generator, level_db: float = -65.0) -> np.ndarray:
    """Steady noise (n,), as of a quiet room and its microphone."""
    n_samples = round(duration_s * SAMPLE_RATE_HZ)
    return rng.normal(0.0, 10.0 ** (level_db / 20.0), n_samples)
