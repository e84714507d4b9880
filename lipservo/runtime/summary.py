"""The summary of a run: counts made during the run in bounded memory, printed at its end."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from firmware_bridge.clock import Clock
from lipservo.runtime.status.face_status import Status
from lipservo.runtime.status.street_tick import StreetTick
from lipservo.runtime.street import Street
from lipsync.arrays import Array

#: Lateness is counted in bins of 0.1 ms up to one second; later than that counts as one second.
_BIN_S = 1e-4
_N_BINS = 10_000
#: Less than a step of any encoder here.
_AT_LIMIT_DEG = 0.05
#: A joint at its limit, or held back, in so large a share of the frames is worth a word.
_OFTEN = 0.05


class Histogram:
    """A histogram of durations, for percentiles without keeping the values."""

    def __init__(self) -> None:
        self._counts = np.zeros(_N_BINS, dtype=np.int64)

    def add(self, duration_s: float) -> None:
        """Count one duration; negative ones count as 0, those over 1 s as 1 s."""
        self._counts[min(max(int(duration_s / _BIN_S), 0), _N_BINS - 1)] += 1

    def percentile_ms(self, percent: float) -> float:
        """Return the upper edge of the percentile's bin in ms; 0 if no duration was counted."""
        total = self._counts.sum()
        if total == 0:
            return 0.0
        reached = np.cumsum(self._counts) >= total * percent / 100.0
        return float((np.argmax(reached) + 1) * _BIN_S * 1e3)


@dataclass(frozen=True, slots=True)
class Summary:
    """The figures of one run, as `--json` prints them.

    latency: from the capture of a sound until the face made of it is due, that is the bus write
    that sends it plus the servos' delay from the calibration; measured, so it may exceed the
    computed delay, latency_declared_ms; lateness: from a grid tick's time to the start of its work;
    speed: seconds of sound in one second of the run; recognizer: the one in use last, after
    fallback_level better ones had failed.
    """

    source: str
    duration_s: float
    phonemes: int
    frames_sent: int
    late_ticks: int
    lateness_p50_ms: float
    lateness_p99_ms: float
    latency_declared_ms: float
    latency_p50_ms: float
    latency_p99_ms: float
    range_limits_hit: int
    rate_limits_hit: int
    targets_rejected: int
    stale_ticks: int
    lost_sound_blocks: int
    speed: float
    start_to_first_command_s: float
    rss_mb: float
    seconds: float
    strategy: str = ""
    recognizer: str = ""
    fallback_level: int = 0
    #: Whether the lips meet, as the calibration saw; None: nobody looked.
    mouth_closes: bool | None = None
    #: Joints that often stood at a limit in speech, and in which share of the frames.
    joints_at_limit: Mapping[str, float] = field(default_factory=dict)
    #: Joints too slow for what was said, and in which share of the time they gave way.
    joints_held_back: Mapping[str, float] = field(default_factory=dict)

    def as_dict(self) -> dict[str, object]:
        """Return the figures by name, for JSON."""
        return asdict(self)


class Tally:
    """A counter of ticks, delays, and goals at joint limits during a run."""

    def __init__(self, clock: Clock, street: Street) -> None:
        """Start with all counts 0. clock: measures lateness. street: the pipeline observed."""
        self._clock = clock
        self._street = street
        self._lateness = Histogram()
        self._latency = Histogram()
        calibration = street.speech.calibration
        self._mouth = street.speech.mouth
        self._limits_deg = np.stack([calibration.min_deg, calibration.max_deg])
        self._n_at_limit = np.zeros(len(calibration.servo_names), dtype=np.int64)
        self.frames_sent = 0
        self.first_command_s = 0.0

    def begin_tick(self, time_s: float) -> None:
        """Count how late the tick due at `time_s` is; call as its work begins."""
        self._lateness.add(self._clock.now() - time_s)

    def observe(self, tick: StreetTick) -> None:
        """Count a finished tick, unless torque is off: goals sent, joints at limits, latency.

        Latency: from the capture of the sound until now, plus the servos' lag.
        """
        if not tick.report.torque_on:
            return
        if self.frames_sent == 0:
            self.first_command_s = seconds_since_process_start()
        self.frames_sent += 1
        sent_deg = tick.report.sent_deg[self._mouth]
        at_limit = (np.abs(sent_deg - self._limits_deg) < _AT_LIMIT_DEG).any(axis=0)
        # At 0 degrees a joint is at rest, even where that is its limit.
        self._n_at_limit += at_limit & (np.abs(sent_deg) > _AT_LIMIT_DEG)
        if tick.captured_s is not None:
            actuation_s = self._street.speech.delay.actuation_s
            self._latency.add(self._clock.now() - tick.captured_s + actuation_s)

    def summary(self, status: Status, duration_s: float, seconds: float) -> Summary:
        """Return the figures of the run.

        status: at the end of the run; duration_s: seconds of its sound; seconds: real duration of
        the run.
        """
        speech = self._street.speech
        n_frames = max(self.frames_sent, 1)
        return Summary(
            source=status.speech.sound or "",
            duration_s=duration_s,
            phonemes=status.speech.n_phonemes or 0,
            frames_sent=self.frames_sent,
            late_ticks=status.bridge.n_late or 0,
            lateness_p50_ms=self._lateness.percentile_ms(50),
            lateness_p99_ms=self._lateness.percentile_ms(99),
            latency_declared_ms=speech.delay.total_s * 1e3,
            latency_p50_ms=self._latency.percentile_ms(50),
            latency_p99_ms=self._latency.percentile_ms(99),
            range_limits_hit=status.bridge.range_hits_total or 0,
            rate_limits_hit=status.bridge.rate_hits_total or 0,
            targets_rejected=status.bridge.n_rejected_targets or 0,
            stale_ticks=status.bridge.n_stale or 0,
            lost_sound_blocks=status.speech.n_lost_sound_blocks or 0,
            strategy=status.speech.strategy or "",
            recognizer=status.speech.recognizer or "",
            fallback_level=status.speech.fallback_level or 0,
            mouth_closes=status.speech.mouth_closes,
            speed=duration_s / seconds if seconds else 0.0,
            start_to_first_command_s=self.first_command_s,
            rss_mb=peak_resident_mb(),
            seconds=seconds,
            joints_at_limit=_often(speech.calibration.servo_names, self._n_at_limit / n_frames),
            joints_held_back=_often(speech.calibration.servo_names, speech.held_back_share),
        )


def _often(names: Sequence[str], shares: Array) -> dict[str, float]:
    return {
        name: round(share, 3)
        for name, share in zip(names, shares.tolist(), strict=True)
        if share >= _OFTEN
    }


def peak_resident_mb() -> float:
    """Return the largest resident memory of this process so far, in MB (10^6 bytes)."""
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak * 1024 / 1e6


def resident_mb() -> float:
    """Return the resident memory of this process now in MB (10^6 bytes); without /proc its peak."""
    import os

    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return peak_resident_mb()
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def seconds_since_process_start() -> float:
    """Return the seconds since this process began, interpreter start included; 0 without /proc."""
    import os
    import time

    try:
        after_name = Path("/proc/self/stat").read_text().rpartition(")")[2]
    except OSError:
        return 0.0
    # Field 22 of proc(5): start in clock ticks since boot; 3 is the first after the name.
    started_s = int(after_name.split()[22 - 3]) / os.sysconf("SC_CLK_TCK")
    return time.clock_gettime(time.CLOCK_BOOTTIME) - started_s


#: By the ends of figures' names.
_UNITS = {"ms": "ms", "s": "s", "mb": "MB"}
#: What a figure tells, and when it is good.
_MEANINGS = {
    "duration_s": "of sound, silence included",
    "phonemes": "moved the mouth",
    "frames_sent": "goals sent to every servo",
    "late_ticks": "good: 0; the computer was busy",
    "lateness_p50_ms": "good: below 1; how late ticks began",
    "lateness_p99_ms": "good: below 10; one in a hundred",
    "latency_declared_ms": "the face is so far behind the sound",
    "latency_p50_ms": "good: as declared",
    "latency_p99_ms": "good: at most 10 more",
    "range_limits_hit": "good: few; goals beyond a limit",
    "rate_limits_hit": "a few are normal; steps slowed",
    "targets_rejected": "good: 0; not let through the gate",
    "stale_ticks": "good: 0; nothing new to show",
    "lost_sound_blocks": "good: 0; sound not heard",
    "speed": "good: near 1 live, above 1 in replay",
    "start_to_first_command_s": "from the start of the program",
    "rss_mb": "the most memory used",
    "seconds": "the whole run took",
    "strategy": "moved the mouth; docs/motion.md",
    "recognizer": "good: network; others hear worse",
    "fallback_level": "good: 0; recognisers that failed",
}


def print_summary(summary: Summary, console: Console) -> None:
    """Print a table of the figures for people, with the meaning and good values of each."""
    table = Table(title=summary.source, show_header=False, title_justify="left", box=None)
    for name, meaning in _MEANINGS.items():
        value = getattr(summary, name)
        quantity, _, suffix = name.rpartition("_")
        shown = quantity if suffix in _UNITS else name
        unit = _UNITS.get(suffix, "x real time" if name == "speed" else "")
        text = f"{value:.2f}" if isinstance(value, float) else str(value)
        table.add_row(shown.replace("_", " "), f"{text} {unit}".rstrip(), meaning)
    console.print(table)
    if summary.mouth_closes is False:
        console.print(
            "the mouth does not close: `lipservo calibrate show` says which joint is at its limit",
            soft_wrap=True,
        )
    for name, share in summary.joints_at_limit.items():
        console.print(
            f"{name} stood at a limit in {share:.0%} of the frames: widen its min_deg and "
            "max_deg if it can go farther, else calibrate it again",
            soft_wrap=True,
        )
    for name, share in summary.joints_held_back.items():
        console.print(
            f"{name} was too slow for {share:.0%} of the motion, which was made smaller so that "
            "lips close in time: raise its max_speed_deg_s if the servo is faster",
            soft_wrap=True,
        )
