"""Voices made up by a seed: phrases of accented syllables, for measures without a recording."""

import math
from collections.abc import Iterator

import numpy as np

from lipsync.arrays import Array
from lipsync.expression.cue import CUE_PERIOD_S
from lipsync.prosody.voice_frame import VoiceFrame

#: Syllables a second and the share of them that are accented, as of English conversation.
_SYLLABLES_PER_S, _ACCENTED = 4.5, 0.3
_SILENT_DB, _MEAN_DB, _SD_DB = -70.0, -25.0, 6.0
_MEAN_HZ, _SD_OCTAVES = 120.0, 2.5 / 12.0


def synthetic_voice(
    seed: int, duration_s: float, talking_s: float = 4.0, silent_s: float = 4.0
) -> Iterator[VoiceFrame]:
    """Frames of a voice that talks and is silent in turn, exponential times with these means.

    silent_s 0: it talks on and on; talking_s 0: it never does.
    """
    rng = np.random.default_rng(seed)
    n_frames = round(duration_s / CUE_PERIOD_S)
    frame = 0
    is_talking = talking_s > 0.0
    while frame < n_frames:
        mean_s = talking_s if is_talking else silent_s
        is_endless = talking_s == 0.0 or silent_s == 0.0
        n = n_frames if is_endless else 1 + round(rng.exponential(mean_s) / CUE_PERIOD_S)
        n = min(n, n_frames - frame)
        if is_talking:
            yield from _phrase(rng, frame, n)
        else:
            for k in range(frame, frame + n):
                yield _silence((k + 1) * CUE_PERIOD_S)
        frame += n
        is_talking = is_endless == is_talking


def _silence(time_s: float) -> VoiceFrame:
    return VoiceFrame(time_s, 0.0, _SILENT_DB, math.nan, 0.0, False, 0.0, 0.0, 0.0, 0.0)


def _phrase(rng: np.random.Generator, first: int, n_frames: int) -> Iterator[VoiceFrame]:
    loudness_z, pitch_z = _contours(rng, n_frames)
    for k in range(n_frames):
        loudness_db = _MEAN_DB + _SD_DB * float(loudness_z[k])
        is_voiced = loudness_z[k] > -1.0
        pitch = float(pitch_z[k]) if is_voiced else 0.0
        pitch_hz = _MEAN_HZ * 2.0 ** (_SD_OCTAVES * pitch) if is_voiced else math.nan
        yield VoiceFrame(
            (first + k + 1) * CUE_PERIOD_S,
            min(1.0, 4.0 * 10.0 ** (loudness_db / 20.0)),
            loudness_db,
            pitch_hz,
            0.0,
            True,
            float(loudness_z[k]),
            pitch,
            0.0,
            0.0,
        )


def _contours(rng: np.random.Generator, n_frames: int) -> tuple[Array, Array]:
    """Loudness and pitch, standard scores: a bump a syllable, a larger one an accent."""
    time_s = np.arange(n_frames) * CUE_PERIOD_S
    loudness_z = np.full(n_frames, -1.5) + 0.15 * rng.standard_normal(n_frames)
    pitch_z = -0.3 * np.sin(time_s / 1.1) + 0.1 * rng.standard_normal(n_frames)
    at_s = 0.0
    while at_s < n_frames * CUE_PERIOD_S:
        at_s += rng.gamma(9.0, 1.0 / (9.0 * _SYLLABLES_PER_S))
        size = 1.0 + 0.4 * rng.standard_normal()
        is_accented = rng.random() < _ACCENTED
        near = slice(max(0, int((at_s - 0.4) / CUE_PERIOD_S)), int((at_s + 0.4) / CUE_PERIOD_S))
        bump = np.exp(-0.5 * ((time_s[near] - at_s) / 0.07) ** 2)
        loudness_z[near] += (2.0 + 1.2 * is_accented) * size * bump
        pitch_z[near] += 1.6 * is_accented * bump
    return loudness_z, pitch_z
