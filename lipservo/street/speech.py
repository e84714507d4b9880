"""The speech side of a face: sound in, targets for servos out. No threads, no sleep."""

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from calibration.calibration import Calibration
from calibration.run.following import Follower
from calibration.run.viseme_trim import VisemeTrim
from firmware_bridge.targets import ServoTargets, TargetChannel
from lipservo.street.arrival import ArrivalLag
from lipservo.street.delay import PUBLISH_PERIOD_S, Delay
from lipsync.audio.source import AudioSource
from lipsync.face.synthesizer import Synthesizer
from lipsync.phonemes import SILENCE, LiveRecognizer
from lipsync.recognition.streaming import RecognizerStream, SoundAhead

Array = NDArray[np.float64]

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
        self._sound = SoundAhead(source, recognizer)
        self._recognition = RecognizerStream(recognizer)
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
        blocks = self._sound.blocks(math.inf if self._source.is_live else clock_s)
        step = self._recognition.feed(blocks)
        if blocks:
            self._heard_until_s = blocks[-1].end_s
        if self._source.is_live:
            self._arrival.observe(now_s, clock_s - self._heard_until_s)
            if not self._arrivals or self._arrivals[-1][0] < self._heard_until_s:
                self._arrivals.append((self._heard_until_s, now_s - self._heard_until_s))
        for update in step.updates:
            self._synthesizer.push(update)

    def _targets(self, sound_s: float, zero_s: float) -> ServoTargets:
        phoneme, coefficients = self.shown_at(sound_s)
        positions_deg = self._calibration.positions_deg(coefficients) + self._trim.feed(phoneme)
        # Servos are asked before the face is shown, by as much as they are late.
        asked_s = zero_s + sound_s + self.delay.total_s - self.delay.actuation_s
        self._newest_asked_s, self._newest_sound_s = asked_s, sound_s
        return ServoTargets(asked_s, self._follower.feed(positions_deg))
