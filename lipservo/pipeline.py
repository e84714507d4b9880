"""One tick of the street: sound in, servo goals out. No threads, no sleep, no I/O of its own.

Live running and `replay` share it; they differ in the clock and in who watches.
"""

import math
from collections import deque
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calibration.calibration import Calibration
from calibration.following import Follower
from calibration.viseme_trim import VisemeTrim
from firmware_bridge.bridge import Bridge
from firmware_bridge.report import TickReport
from firmware_bridge.targets import ServoTargets, TargetChannel
from lipservo.arrival import ArrivalLag
from lipsync.audio.block import BLOCK_S
from lipsync.audio.source import AudioSource
from lipsync.phonemes import SILENCE, LiveRecognizer, PhonemeEvent, PhonemeUpdate

Array = NDArray[np.float64]

#: The speech side publishes at 100 Hz (architecture.md, Time).
PUBLISH_PERIOD_S = 0.010
#: After a stall, targets that would be shown longer ago than this are not computed any more.
_OLDEST_WORTH_SHOWING_S = 0.100
#: Of what a stall skipped, so much is still worked out for those that remember: filters of lag and
#: trim (0.2 s), play (until the joint turns) and the motion itself, which goes back as far.
_REMEMBERED_S = 1.0
#: Arrivals of live sound that are remembered, to tell when what is shown now was captured: more
#: than the longest delay, at 100 a second.
_ARRIVALS = 512
#: Servos that are later than this are not fully made up for: all else would wait for them.
_MOST_ADVANCE_S = 0.200


@dataclass(frozen=True, slots=True)
class Delay:
    """How much later than its sound a face is shown, part by part. Added up here and only here."""

    recognizer_s: float
    lookahead_s: float
    sound_block_s: float = BLOCK_S
    publish_period_s: float = PUBLISH_PERIOD_S
    actuation_s: float = 0.0

    @property
    def synthesis_s(self) -> float:
        """How much sound must have been heard after an instant before its face is computed."""
        return self.recognizer_s + self.lookahead_s + self.sound_block_s

    @property
    def total_s(self) -> float:
        """Display time minus sound time."""
        return self.synthesis_s + self.publish_period_s + self.actuation_s

    def __str__(self) -> str:
        parts = {
            "recogniser": self.recognizer_s,
            "look-ahead": self.lookahead_s,
            "sound block": self.sound_block_s,
            "publishing": self.publish_period_s,
            "actuation": self.actuation_s,
        }
        listed = " + ".join(f"{name} {s * 1e3:.0f}" for name, s in parts.items() if s)
        return f"{self.total_s * 1e3:.0f} ms = {listed}"


class Synthesizer(Protocol):
    """Phonemes in, faces out: ours or the paper's."""

    phonemes_planned: int

    @property
    def lookahead_s(self) -> float:
        """How much sound after an instant must have been heard before its face is asked for."""

    def push(self, update: PhonemeUpdate) -> None:
        """Believe a recogniser; what has been shown stays as it is."""

    def coefficients_at(self, time_s: float) -> Array:
        """The face (n_components,) at a sound time; the same time gives the same face."""

    def event_at(self, time_s: float) -> PhonemeEvent | None:
        """The phoneme believed at a time, for displays."""


class Speech:
    """The speech side: hears sound, publishes targets for times still to come."""

    def __init__(
        self,
        source: AudioSource,
        recognizer: LiveRecognizer,
        synthesizer: Synthesizer,
        calibration: Calibration,
        channel: TargetChannel,
    ) -> None:
        self._source = source
        self._recognizer = recognizer
        self._synthesizer = synthesizer
        self._calibration = calibration
        self._channel = channel
        n_servos = len(calibration.servo_names)
        self._trim = VisemeTrim(calibration.trim, n_servos, PUBLISH_PERIOD_S)
        self._follower = Follower(
            calibration.following, n_servos, PUBLISH_PERIOD_S, look_ahead_s=_MOST_ADVANCE_S
        )
        self.delay = Delay(
            recognizer.latency_s,
            synthesizer.lookahead_s,
            actuation_s=self._follower.advance_s,
        )
        self._arrival = ArrivalLag()
        self._heard_until_s = 0.0
        # Of live sound: until when it was heard, and how far the clock was ahead of that.
        self._arrivals: deque[tuple[float, float]] = deque(maxlen=_ARRIVALS)
        self._zero_s = 0.0
        self._newest_asked_s = self._newest_sound_s = -math.inf
        # The first sound is shown a delay late; until then the closed mouth is published.
        self._n_published = -round(self.delay.total_s / PUBLISH_PERIOD_S)

    @property
    def phonemes_planned(self) -> int:
        """Phonemes that moved the mouth so far."""
        return self._synthesizer.phonemes_planned

    @property
    def calibration(self) -> Calibration:
        """How faces become joint angles, for all servos that targets are published for."""
        return self._calibration

    @property
    def lag_s(self) -> float:
        """How far the sound of a live device is behind the clock; 0 for everything else."""
        return self._arrival.lag_s

    def advance(self, now_s: float, zero_s: float) -> None:
        """Hear and publish all that is due at monotonic `now_s`; the sound began at `zero_s`."""
        self._hear(now_s, zero_s)
        zero_s += self.lag_s
        heard_s = now_s - zero_s
        # Half a nanosecond of grace, or rounding would hold a target back for a whole period.
        n_due = math.floor((heard_s - self.delay.synthesis_s + 5e-10) / PUBLISH_PERIOD_S) + 1
        n_too_old = n_due - round(_OLDEST_WORTH_SHOWING_S / PUBLISH_PERIOD_S)
        n_remembered = n_too_old - round(_REMEMBERED_S / PUBLISH_PERIOD_S)
        for n in range(max(self._n_published, n_remembered), n_due):
            targets = self._targets(n * PUBLISH_PERIOD_S, zero_s)
            if n >= n_too_old:
                self._channel.publish(targets)
        self._n_published = max(self._n_published, n_due)

    def captured_s(self, asked_s: float) -> float | None:
        """When the sound was captured that moves the servos at `asked_s`, on the same clock.

        What a live device hands over is taken as captured until that moment; the sound of a file
        is captured when it would be heard. Before any sound moves them: None. Ask in order.
        """
        # Beyond the newest target, whatever is shown was made of that one.
        sound_s = self._newest_sound_s - max(0.0, self._newest_asked_s - asked_s)
        if sound_s < 0.0:
            return None
        if not self._source.is_live:
            return self._zero_s + sound_s
        while self._arrivals and self._arrivals[0][0] < sound_s:
            self._arrivals.popleft()
        return sound_s + self._arrivals[0][1] if self._arrivals else None

    def shown_at(self, sound_s: float) -> tuple[str, Array]:
        """The phoneme and the face (n_components,) of a sound time that was published."""
        event = self._synthesizer.event_at(sound_s)
        phoneme = SILENCE if event is None else event.phoneme
        return phoneme, self._synthesizer.coefficients_at(sound_s)

    def _hear(self, now_s: float, zero_s: float) -> None:
        clock_s = now_s - zero_s
        self._zero_s = zero_s
        # A device gives what has arrived, whatever the clock says.
        for block in self._source.blocks(math.inf if self._source.is_live else clock_s):
            self._recognizer.feed(block)
            self._heard_until_s = block.end_s
        if self._source.is_live:
            self._arrival.observe(now_s, clock_s - self._heard_until_s)
            if not self._arrivals or self._arrivals[-1][0] < self._heard_until_s:
                self._arrivals.append((self._heard_until_s, now_s - self._heard_until_s))
        for update in self._recognizer.updates():
            self._synthesizer.push(update)

    def _targets(self, sound_s: float, zero_s: float) -> ServoTargets:
        phoneme, coefficients = self.shown_at(sound_s)
        positions_deg = self._calibration.positions_deg(coefficients) + self._trim.feed(phoneme)
        # Servos are asked before the face is shown, by as much as they are late.
        asked_s = zero_s + sound_s + self.delay.total_s - self.delay.actuation_s
        self._newest_asked_s, self._newest_sound_s = asked_s, sound_s
        return ServoTargets(asked_s, self._follower.feed(positions_deg))


@dataclass(frozen=True, slots=True)
class StreetTick:
    """What one tick of the street showed. sound_s is negative before the first sound is shown.

    captured_s: when the sound was captured that the servos were moved by; None before there is one.
    """

    sound_s: float
    phoneme: str
    coefficients: Array
    report: TickReport
    captured_s: float | None = None


class TickObserver(Protocol):
    """Somebody who watches every tick; must return at once."""

    def observe(self, tick: StreetTick) -> None:
        """See one tick."""


class Street:
    """Speech and bridge in one process, joined by a target channel."""

    def __init__(self, speech: Speech, bridge: Bridge, rest: Array) -> None:
        """rest: the face (n_components,) of a mouth at rest."""
        self.speech = speech
        self.bridge = bridge
        self._rest = rest
        self._zero_s = 0.0

    def begin(self, zero_s: float) -> None:
        """The sound begins at monotonic `zero_s`."""
        self._zero_s = zero_s

    def sound_time_s(self, display_s: float) -> float:
        """The sound time whose face belongs to monotonic display time `display_s`."""
        return display_s - self._zero_s - self.speech.lag_s - self.speech.delay.total_s

    def tick(self, time_s: float, late: int) -> StreetTick:
        """Everything that happens at monotonic grid time `time_s`."""
        self.speech.advance(time_s, self._zero_s)
        report = self.bridge.tick(time_s, late)
        sound_s = self.sound_time_s(time_s)
        phoneme, coefficients = self.speech.shown_at(max(0.0, sound_s))
        captured_s = self.speech.captured_s(time_s)
        return StreetTick(sound_s, phoneme, coefficients, report, captured_s)

    def rest(self, time_s: float, late: int) -> StreetTick:
        """The same once the face is stopped: nothing is heard any more, the mouth goes to rest."""
        report = self.bridge.tick(time_s, late)
        return StreetTick(self.sound_time_s(time_s), SILENCE, self._rest, report)
