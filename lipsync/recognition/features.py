"""Features of the network: 40 log-mel bands every 10 ms, normalised for level and microphone.

Recipe: pre-emphasis 0.97, 25 ms Hamming window, 10 ms hop, 512-point FFT, 40 mel bands from 60 to
7600 Hz, natural log of power + 1e-7 (design measurement, recogniser.md). On top of it the level: a
peak that rises within a few frames and falls slowly is subtracted from all bands, so that a voice
30 dB lower has the same features as soon as it speaks; then a causal running mean is subtracted
from each band.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache

import numpy as np

from lipsync.arrays import Array32
from lipsync.audio_block import SAMPLE_RATE_HZ

N_BANDS = 40
FRAMES_PER_S = 100
HOP = SAMPLE_RATE_HZ // FRAMES_PER_S
WINDOW = 400
_N_FFT = 512
_LOWEST_HZ, _HIGHEST_HZ = 60.0, 7600.0
_PRE_EMPHASIS = np.float32(0.97)
_POWER_FLOOR = np.float32(1e-7)

#: One natural-log unit of power in dB.
_DB_PER_NAT = 10.0 / np.log(10.0)
#: Mean log power over the bands of loud frames: 98th percentile of LibriSpeech (40 utterances).
SPEECH_PEAK = -1.0
#: Where the peak starts: between a voice at full level and one 30 dB lower.
_FIRST_PEAK = SPEECH_PEAK - 15.0 / _DB_PER_NAT
#: The peak falls no lower, so that quieter sound is not amplified: 45 dB under usual speech.
_LOWEST_PEAK = SPEECH_PEAK - 45.0 / _DB_PER_NAT
#: Share of the way to a louder frame; a click of one frame counts by a third.
_ATTACK = 0.3
#: The peak falls 1 dB a second.
_DECAY = 1.0 / _DB_PER_NAT / FRAMES_PER_S
#: Lower levels below the peak are clipped to this: rooms and codecs differ there.
_RANGE = 50.0 / _DB_PER_NAT
#: Frames within 35 dB of the peak move the running mean (design measurement).
_GATE = 35.0 / _DB_PER_NAT
#: The running mean: the mean of training counts as so many frames, and so many are remembered.
_PRIOR_FRAMES, _MEMORY_FRAMES = 100.0, 300.0
_OFFSETS = np.arange(WINDOW)
#: The log power of every band of digital silence.
_NOTHING = np.log(_POWER_FLOOR)


def log_mel(emphasised: Array32) -> Array32:
    """Return the log power of 40 mel bands in frames of 25 ms, one every 10 ms.

    Parameters
    ----------
    emphasised : Array32
        (160 (n - 1) + 400,) pre-emphasised samples at 16 kHz.

    Returns
    -------
    Array32
        (n, 40).
    """
    starts = np.arange(0, len(emphasised) - WINDOW + 1, HOP)
    # A copy: of a single frame, as live, numpy's sliding view takes longer to make.
    frames = emphasised[starts[:, None] + _OFFSETS]
    spectrum = np.fft.rfft(frames * _window(), _N_FFT).astype(np.complex64)
    power = np.square(spectrum.real) + np.square(spectrum.imag)
    logs: Array32 = np.log(power @ _mel_filters() + _POWER_FLOOR)
    return logs


class LogMelStream:
    """Converter of samples in pieces of any size to log-mel frames, once these are complete."""

    def __init__(self) -> None:
        self._last_sample = np.float32(0.0)
        self._waiting: Array32 = np.zeros(0, np.float32)

    def push(self, samples: Array32) -> Array32:
        """Add samples; return the log-mel frames of 25 ms that they complete.

        Parameters
        ----------
        samples : Array32
            (m,) at 16 kHz.

        Returns
        -------
        Array32
            (n, 40); n may be 0.
        """
        if len(samples) > 0:
            previous = np.concatenate(([self._last_sample], samples[:-1]))
            self._last_sample = samples[-1]
            self._waiting = np.concatenate((self._waiting, samples - _PRE_EMPHASIS * previous))
        n_frames = (len(self._waiting) - WINDOW) // HOP + 1
        if n_frames <= 0:
            return np.zeros((0, N_BANDS), np.float32)
        complete = self._waiting[: (n_frames - 1) * HOP + WINDOW]
        frames = log_mel(complete) if complete.any() else np.full((n_frames, N_BANDS), _NOTHING)
        self._waiting = self._waiting[n_frames * HOP :].copy()
        return frames


@dataclass(frozen=True, slots=True)
class FeatureScale:
    """Mean and standard deviation (40,) of each band relative to the peak, from training."""

    mean: Array32
    deviation: Array32

    @classmethod
    def of(cls, recordings: Iterable[Array32]) -> "FeatureScale":
        """Return the scale of recordings: mean and deviation of each band over their loud frames.

        Parameters
        ----------
        recordings : Iterable[Array32]
            (n, 40) log-mel frames each.

        Returns
        -------
        FeatureScale
            Mean and deviation, (40,) each.
        """
        loud = []
        for frames in recordings:
            peak = PeakFollower()
            levels = frames.mean(axis=1, dtype=np.float64).tolist()
            pairs = [peak.push(*pair) for pair in zip(frames, levels, strict=True)]
            loud += [below_peak for below_peak, is_loud in pairs if is_loud]
        stacked = np.stack(loud)
        return cls(stacked.mean(axis=0), stacked.std(axis=0))


class PeakFollower:
    """Follower of the peak level of log-mel frames, to subtract it from them; it falls slowly."""

    def __init__(self) -> None:
        self._peak = _FIRST_PEAK

    def push(self, frame: Array32, level: float) -> tuple[Array32, bool]:
        """Return one frame less its running peak, and whether it is within 35 dB of that peak.

        Parameters
        ----------
        frame : Array32
            (40,) log-mel.
        level : float
            The frame's mean over the bands.

        Returns
        -------
        tuple[Array32, bool]
            (40,), 0 for a band at the peak; and True within 35 dB.
        """
        if level > self._peak:
            self._peak += _ATTACK * (level - self._peak)
        else:
            self._peak = max(self._peak - _DECAY, _LOWEST_PEAK)
        below_peak = np.maximum(frame - np.float32(self._peak), np.float32(-_RANGE))
        return below_peak, level > self._peak - _GATE


class LevelNormalizer:
    """Normaliser of log-mel frames to features independent of the sound's level; causal."""

    def __init__(self, scale: FeatureScale) -> None:
        self._deviation = scale.deviation
        self._mean = scale.mean.astype(np.float64)
        self._n_frames = _PRIOR_FRAMES
        self._peak = PeakFollower()

    def push(self, frames: Array32) -> Array32:
        """Return the features of the next log-mel frames, independent of the sound's level.

        That is each band less the running peak level and less its running mean in loud frames, in
        standard deviations of the training.

        Parameters
        ----------
        frames : Array32
            (n, 40) log-mel.

        Returns
        -------
        Array32
            (n, 40).
        """
        features = np.empty_like(frames)
        levels = frames.mean(axis=1, dtype=np.float64).tolist()
        for index, (frame, level) in enumerate(zip(frames, levels, strict=True)):
            below_peak, is_loud = self._peak.push(frame, level)
            if is_loud:
                self._n_frames = min(self._n_frames + 1.0, _MEMORY_FRAMES)
                self._mean += (below_peak - self._mean) / self._n_frames
            features[index] = (below_peak - self._mean) / self._deviation
        return features


@cache
def _window() -> Array32:
    return np.hamming(WINDOW).astype(np.float32)


@cache
def _mel_filters() -> Array32:
    """Return mel filters (257, 40): triangles evenly spaced in 2595 log10(1 + f / 700)."""

    def mel(hz: float) -> float:
        return float(2595.0 * np.log10(1.0 + hz / 700.0))

    corners_mel = np.linspace(mel(_LOWEST_HZ), mel(_HIGHEST_HZ), N_BANDS + 2)
    corners_hz = 700.0 * (10.0 ** (corners_mel / 2595.0) - 1.0)
    bins_hz = np.arange(_N_FFT // 2 + 1) * (SAMPLE_RATE_HZ / _N_FFT)
    low, middle, high = corners_hz[:-2], corners_hz[1:-1], corners_hz[2:]
    rising = (bins_hz[:, None] - low) / (middle - low)
    falling = (high - bins_hz[:, None]) / (high - middle)
    return np.maximum(0.0, np.minimum(rising, falling)).astype(np.float32)
