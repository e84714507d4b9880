"""Measurement of a loudspeaker's delay: clicks are played and found in a microphone's recording.

The times at which they are found are compared with those expected from the devices' time stamps.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from lipsync.audio.source import AudioSource, Loudspeaker, SoundError
from lipsync.audio_block import SAMPLE_RATE_HZ

Samples = NDArray[np.float32]
Seconds = NDArray[np.float64]

#: When each click begins. All distances between any two of them differ, by 40 ms at least, so that
#: a delay that puts one click on another's place misses all the rest. The first one waits until a
#: device that slept is awake: PulseAudio's null sink took 0.8 s.
CLICKS_S: Final = (1.20, 1.61, 2.16, 2.53, 3.17, 3.64, 4.23)
#: A click is a sweep, which is found in noise where a short impulse is not, and does not hurt.
_CLICK_S: Final = 0.04
#: What small loudspeakers play and the microphone's resampler passes.
_FROM_HZ, _TO_HZ = 1_500.0, 6_000.0
_LEVEL: Final = 0.5

#: Delays that are looked for; the most is what a face YAML may say.
EARLIEST_S, LATEST_S = -0.5, 2.0
#: One click may come so much before or after the delay that fits all of them best.
_AROUND_S: Final = 0.012
#: Correlation of a click with what is heard, 1 for the click alone: noise as loud as the click has
#: 0.7, noise alone in 24 ms hardly 0.25.
_LEAST_CORRELATION: Final = 0.35
_LEAST_FOUND: Final = 5
_MOST_SPREAD_S: Final = 0.010
#: A recording that is nowhere louder than this is silent.
_LEAST_PEAK: Final = 0.001


@dataclass(frozen=True, slots=True)
class Delay:
    """A measured delay in seconds: median over the clicks found, and the largest deviation from it.

    n_found: clicks found in the recording, of `n_played`.
    """

    median_s: float
    spread_s: float
    n_found: int
    n_played: int


def click_train(sample_rate_hz: int) -> Samples:
    """Return the test signal (n,) at this rate: a click at each time `CLICKS_S`, else silence."""
    click = _click(sample_rate_hz)
    train = np.zeros(round(CLICKS_S[-1] * sample_rate_hz) + len(click), dtype=np.float32)
    for begins_s in CLICKS_S:
        first = round(begins_s * sample_rate_hz)
        train[first : first + len(click)] += click
    return train


def find_delay(recorded: Samples, expected_s: Seconds) -> Delay:
    """Return how much later than expected the clicks are heard in `recorded`, (n,) at 16 kHz.

    expected_s: (n_clicks,) times at which the clicks would be heard without a delay, in seconds
    from the first sample. Raises SoundError, in one line, where no delay can be measured.
    """
    if np.max(np.abs(recorded), initial=0.0) < _LEAST_PEAK:
        raise SoundError("the microphone recorded no sound: is it the right one, is either muted?")
    matched, likeness = _match_click(recorded)
    peaks = _running_maximum(matched, round(0.003 * SAMPLE_RATE_HZ))
    delays_s = np.arange(EARLIEST_S, LATEST_S, 0.001)
    # For each delay the median over all clicks: a slamming door is louder, but only once.
    strength = np.median(_values_at(peaks, expected_s[None, :] + delays_s[:, None]), axis=1)
    coarse_s = float(delays_s[np.argmax(strength)])
    each_s = [_click_delay(matched, likeness, due_s, coarse_s) for due_s in expected_s]
    found_s = np.array([delay_s for delay_s in each_s if delay_s is not None])
    n_played = len(expected_s)
    if len(found_s) < _LEAST_FOUND:
        raise SoundError(
            f"only {len(found_s)} of {n_played} clicks were heard: too quiet, too much noise, or "
            "another microphone"
        )
    median_s = float(np.median(found_s))
    spread_s = float(np.max(np.abs(found_s - median_s)))
    if spread_s > _MOST_SPREAD_S:
        raise SoundError(
            f"the clicks were heard up to {spread_s * 1e3:.0f} ms apart from one another: too much "
            "noise or echo, or a device that stutters; bring the microphone nearer"
        )
    return Delay(median_s, spread_s, len(found_s), n_played)


def _click(sample_rate_hz: int) -> Samples:
    """Return a click (n,): a sweep of 40 ms from 1.5 to 6 kHz in a Hann window."""
    time_s = np.arange(round(_CLICK_S * sample_rate_hz)) / sample_rate_hz
    sweep = np.sin(
        2.0 * np.pi * (_FROM_HZ * time_s + (_TO_HZ - _FROM_HZ) * time_s**2 / (2.0 * _CLICK_S))
    )
    return (_LEVEL * np.hanning(len(time_s)) * sweep).astype(np.float32)


def _match_click(recorded: Samples) -> tuple[Seconds, Seconds]:
    """Return the strength and likeness (n,) of a click that begins at each sample of `recorded`.

    Strength: output of a matched filter, without its sign. Likeness: 0 to 1, whatever the loudness.
    A separate echo is more like a click than the click before it, but weaker: so both are needed.
    """
    click = _click(SAMPLE_RATE_HZ).astype(np.float64)
    click /= np.linalg.norm(click)
    padded = np.concatenate((recorded.astype(np.float64), np.zeros(len(click))))
    n = len(padded)
    matched = np.abs(np.fft.irfft(np.fft.rfft(padded) * np.conj(np.fft.rfft(click, n)), n))
    matched = matched[: len(recorded)]
    energy = np.concatenate(([0.0], np.cumsum(padded**2)))
    loudness = np.sqrt(np.maximum(energy[len(click) :] - energy[: -len(click)], 0.0))
    floor = _LEAST_PEAK * np.sqrt(len(click)) / 10.0
    return matched, matched / np.maximum(loudness[: len(recorded)], floor)


def _running_maximum(values: Seconds, reach: int) -> Seconds:
    """Return the largest of `values` (n,) within `reach` samples of each, (n,)."""
    padded = np.pad(values, reach)
    largest: Seconds = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1).max(axis=1)
    return largest


def _values_at(values: Seconds, times_s: Seconds) -> Seconds:
    """Return `values`, one per sample at 16 kHz, at the times `times_s`; 0 outside of them."""
    places = np.round(times_s * SAMPLE_RATE_HZ).astype(np.int64)
    is_there = (places >= 0) & (places < len(values))
    found: Seconds = np.where(is_there, values[np.where(is_there, places, 0)], 0.0)
    return found


def _click_delay(
    matched: Seconds, likeness: Seconds, expected_s: float, coarse_s: float
) -> float | None:
    """Return the delay in s of the click due at `expected_s`, within 12 ms of `coarse_s`.

    matched, likeness: the arrays of `_match_click`; coarse_s: the delay that fits all clicks best.
    None if the recording does not reach that far or no stretch there is like a click.
    """
    first = max(0, round((expected_s + coarse_s - _AROUND_S) * SAMPLE_RATE_HZ))
    window = matched[first : first + round(2.0 * _AROUND_S * SAMPLE_RATE_HZ)]
    if len(window) == 0:
        return None
    best_start = first + int(np.argmax(window))
    if likeness[best_start] < _LEAST_CORRELATION:
        return None
    return best_start / SAMPLE_RATE_HZ - expected_s


Reports = NDArray[np.float64]

#: Sound is written so far ahead of what is heard.
_AHEAD_S: Final = 0.5
#: A loudspeaker that has not played it by then does not play.
_PATIENCE_S: Final = 15.0
_TICK_S: Final = 0.01
#: Time stamps within this of a click are used for the time at which it left.
_NEAR_S: Final = 0.25


class Microphone(AudioSource, Protocol):
    """A sound source that reports when its sound was captured."""

    @property
    def captured(self) -> tuple[float, float] | None:
        """Newest stamp, (monotonic seconds, sound time captured then); None before the first."""


def measure_delay(
    speaker: Loudspeaker,
    microphone: Microphone,
    clock: Callable[[], float],
    sleep: Callable[[float], None],
) -> Delay:
    """Play clicks and return how much later they are heard than the loudspeaker reports; lasts 7 s.

    clock: returns monotonic seconds; sleep: waits for seconds. Both devices must be open. The error
    of the microphone's own time stamps is included, and the sound's travel through the air: 3 ms a
    metre. Raises SoundError where the clicks are not heard well enough, or the loudspeaker plays
    nothing, or the microphone delivers nothing.
    """
    train = np.concatenate((click_train(speaker.rate_hz), np.zeros(speaker.rate_hz, np.float32)))
    begun_s = clock()
    n_written = 0
    speaker_reports: list[tuple[float, float]] = []
    microphone_reports: list[tuple[float, float]] = []
    heard: list[Samples] = []
    ends_s = math.inf
    while clock() < ends_s:
        report = speaker.position()
        position_s = 0.0 if report is None else report[1]
        if report is not None:
            speaker_reports.append(report)
            if position_s > CLICKS_S[-1] and ends_s == math.inf:
                ends_s = clock() + LATEST_S
        n_due = round((position_s + _AHEAD_S) * speaker.rate_hz)
        if n_due > n_written:
            speaker.write(train[n_written:n_due])
            n_written = n_due
        heard += [block.samples for block in microphone.blocks(math.inf)]
        if microphone.captured is not None:
            microphone_reports.append(microphone.captured)
        if ends_s == math.inf and clock() - begun_s > _PATIENCE_S:
            raise SoundError("the loudspeaker has not started to play; choose another")
        sleep(_TICK_S)
    if not microphone_reports:
        raise SoundError("the microphone recorded no sound; choose another microphone")
    expected_s = _expected_times_s(np.array(speaker_reports), np.array(microphone_reports))
    return find_delay(np.concatenate(heard), expected_s)


def _expected_times_s(left: Reports, captured: Reports) -> NDArray[np.float64]:
    """Return the microphone's sound time at which each click is heard if it is not late, (n,).

    left: (n, 2), the loudspeaker's reports of clock and position heard then; captured: (n, 2), the
    microphone's of clock and sound time. Only the reports near each click count: while it wakes up,
    a device may lose sound without reporting it (a PulseAudio monitor 0.2 s of it).
    """
    expected_s = []
    for click_s in CLICKS_S:
        leaves_s = click_s + _zero_at_s(left, left[:, 1] - click_s)
        expected_s.append(leaves_s - _zero_at_s(captured, captured[:, 0] - leaves_s))
    return np.array(expected_s)


def _zero_at_s(reports: Reports, distance_s: NDArray[np.float64]) -> float:
    """Return the clock time in s of a device's position 0, the median over reports near a click.

    reports: (n, 2) clock and position; distance_s: (n,) of each from the click. Near is within 0.25
    s; if no report is, the nearest counts.
    """
    nearest_s = float(np.min(np.abs(distance_s)))
    is_near = np.abs(distance_s) <= max(_NEAR_S, nearest_s)
    return float(np.median(reports[is_near, 0] - reports[is_near, 1]))
