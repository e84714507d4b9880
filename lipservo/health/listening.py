"""What half a minute at a microphone tells of its place: `doctor --listen`.

Speech is what the recogniser hears; noise is what lies between, once a room has fallen silent. A
room is told by how slowly the level falls where a sound stops (free decays: Ratnam and others, J.
Acoust. Soc. Am. 114(5), 2003), an echo by its peak in the cepstrum (Bogert, Healy and Tukey, 1963).
"""

import math
from collections.abc import Callable, Iterator
from typing import Final

import numpy as np

from firmware_bridge.bus_kinds import Finding, Severity
from lipsync.arrays import Array, Array32
from lipsync.audio.source import AudioSource
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.recognition.decoder import SILENCE_INDEX
from lipsync.recognition.features import FRAMES_PER_S, HOP, LogMelStream
from lipsync.recognition.network import NetworkWeights
from lipsync.recognition.posteriors import whole_posteriors

LISTENED_S: Final = 30.0
_LEAST_SPEECH_S: Final = 5.0
#: Frames after speech by which a room has fallen silent.
_FADED: Final = 40
#: Bounds between the conditions of docs/benchmarks.md, by ten validation talkers in each: share of
#: clipped samples; treble and signal to noise, dB; decay, s; level, dB; echo's share.
_CLIPPED, _MUFFLED_DB, _NOISY_DB = 0.02, -25.0, 22.0
_REVERBERANT_S, _FAINT_DB, _ECHO = 0.34, -45.0, 0.1
#: The network's head that decides, by its delay, frames; a probability of silence below is speech.
_HEAD, _SPEECH = 7, 0.5
#: Samples within so much of the loudest count as clipped, where many are.
_AT_TOP: Final = 0.985
#: The level of steady noise spreads less, dB (of all between its 20th and 60th percentile).
_STEADY_DB: Final = 0.8
#: Mel bands of 0.5 to 4 kHz, of 1 to 3, and above 4.5.
_VOICE, _MIDDLE, _TREBLE = slice(7, 31), slice(13, 27), slice(32, None)
_DB_PER_NAT: Final = 10.0 / math.log(10.0)


def listen(
    source: AudioSource, clock: Callable[[], float], sleep: Callable[[float], None]
) -> Array32:
    """Return what an entered microphone delivers in half a minute.

    Returns
    -------
    Array32
        (n,) samples at 16 kHz.
    """
    blocks, until_s = [], clock() + LISTENED_S
    while clock() < until_s:
        sleep(0.1)
        blocks += source.blocks(math.inf)
    return np.concatenate([np.zeros(0, np.float32), *(block.samples for block in blocks)])


def findings(samples: Array32, weights: NetworkWeights) -> Iterator[Finding]:
    """Yield what sound tells of level, noise, room and echo, with remedies.

    Parameters
    ----------
    samples : Array32
        (n,) at 16 kHz.
    weights : NetworkWeights
        Of the recogniser that tells speech from pauses.
    """
    if len(samples) < SAMPLE_RATE_HZ or np.ptp(samples) == 0.0:
        what = "the microphone sends nothing" if not samples.any() else "it sends one value"
        yield Finding(Severity.BAD, what, "unmute it, or name another: `sound: {input: NAME}`")
        return
    n = len(samples) // HOP - 2
    levels_db = _levels_db(samples[: n * HOP])
    bands_db = LogMelStream().push(samples)[:n] * _DB_PER_NAT
    heard = whole_posteriors(weights, samples)
    head = heard.delays.index(_HEAD)
    spoken = np.flatnonzero(heard.values[_HEAD:, head, SILENCE_INDEX][:n] < _SPEECH)
    speech_s = len(spoken) / FRAMES_PER_S
    last = np.concatenate(([-1], spoken))[np.searchsorted(spoken, np.arange(n), "right")]
    quiet_db = levels_db[np.arange(n) - last > _FADED]
    quiet_db = quiet_db if len(quiet_db) > _FADED else np.sort(levels_db)[: _FADED + 1]
    noise_db = float(np.median(quiet_db))
    spread_db = float(np.diff(np.percentile(_smooth(quiet_db, 5), [20, 60]))[0])
    if speech_s < _LEAST_SPEECH_S:
        what = f"{speech_s:.0f} s of speech in noise of {noise_db:.0f} dBFS: too little to judge by"
        yield Finding(
            Severity.BAD, what, "speak as to the robot while it listens; choose the input"
        )
        return
    speech_db = 10.0 * math.log10(float(np.mean(10.0 ** (levels_db[spoken] / 10.0))))
    clipped = float(np.mean(np.abs(samples) >= _AT_TOP * np.abs(samples).max()))
    treble_db = float(np.diff([bands_db[spoken, s].mean() for s in (_MIDDLE, _TREBLE)])[0])
    decay_s, (echo_s, echo) = _decay_s(_smooth(bands_db[:, _VOICE].mean(axis=1), 3)), _echo(samples)
    noise = "white" if spread_db < _STEADY_DB else "babble, music or servos"
    # Of each: whether it is bad, the row of the table that it is like, what was found, what helps.
    near, above_db = "nearer to the talker, away from fans and walls", speech_db - noise_db
    found = (
        (clipped > _CLIPPED, "clipped", f"{clipped:.1%} of the sound is clipped", "lower its gain"),
        (treble_db < _MUFFLED_DB, "telephone", f"treble {treble_db:.0f} dB", "use it at 16 kHz"),
        (above_db < _NOISY_DB, f"10 dB, {noise}", f"noise {above_db:.0f} dB below speech", near),
        (decay_s > _REVERBERANT_S, "a room", f"sound falls by 60 dB in {decay_s:.2f} s", near),
        (speech_db < _FAINT_DB, "-30 dB", f"speech {speech_db:.0f} dBFS", "raise its gain"),
        (echo > _ECHO, "none", f"echo of {echo:.0%} after {1e3 * echo_s:.0f} ms", near),
    )
    for is_bad, _, what, remedy in found:
        yield Finding(Severity.WARNING if is_bad else Severity.GOOD, what, remedy if is_bad else "")
    row = next((row for is_bad, row, *_ in found if is_bad), "own microphones")
    yield Finding(Severity.GOOD, f"like the row {row!r} of docs/benchmarks.md, Recognition")


def _levels_db(samples: Array32) -> Array:
    """Return the level of each 10 ms, dB of full scale, without its mean."""
    return np.asarray(10.0 * np.log10(samples.reshape(-1, HOP).var(axis=1) + 1e-12))


def _smooth(values: Array, n: int) -> Array:
    return np.convolve(values, np.full(n, 1.0 / n), "same" if n == 3 else "valid")


def _decay_s(levels_db: Array) -> float:
    """Return the time in which sounds that stop fall by 60 dB, s: quick ones of all; 0: unknown."""
    floor_db, times_s = float(np.percentile(levels_db, 5)) + 6.0, []
    for fall in np.split(levels_db, np.flatnonzero(np.diff(levels_db) >= 0.0) + 1):
        steady = fall[(fall < fall[0] - 3.0) & (fall > floor_db)]
        if len(steady) >= 5 and steady[0] - steady[-1] > 12.0:
            slope = np.polyfit(np.arange(len(steady)), steady, 1)[0]
            times_s.append(-60.0 / (float(slope) * FRAMES_PER_S))
    return float(np.percentile(times_s, 25)) if times_s else 0.0


def _echo(samples: Array32) -> tuple[float, float]:
    """Return delay (s) and share of the strongest repetition after 30 to 250 ms."""
    window, lags = np.hanning(8192), slice(round(0.03 * SAMPLE_RATE_HZ), SAMPLE_RATE_HZ // 4)
    pieces = [samples[n : n + 8192] for n in range(0, len(samples) - 8192, 4096)]
    powers = [np.abs(np.fft.rfft(each * window, 16384)) ** 2 for each in pieces if each.any()]
    cepstrum = np.fft.irfft(np.log(np.array(powers) + 1e-12).mean(axis=0))[lags]
    # Of a later repetition less lies in the same window.
    overlap = np.fft.irfft(np.abs(np.fft.rfft(window, 16384)) ** 2)
    shares = cepstrum / overlap[lags] * overlap[0]
    place = int(shares.argmax())
    return (lags.start + place) / SAMPLE_RATE_HZ, float(shares[place])
