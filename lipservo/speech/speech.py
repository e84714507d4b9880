"""The speech side of a face: phonemes in, targets for servos out. No threads, no sleep."""

import math
from collections.abc import Sequence

import numpy as np

from calibration.calibration import Calibration
from calibration.run.following import Follower
from calibration.run.viseme_trim import VisemeTrim
from firmware_bridge.targets import ServoTargets, TargetChannel
from lipservo.speech.cut_off import CutOff
from lipservo.speech.delay import PUBLISH_PERIOD_S, Delay
from lipservo.speech.expression_layer import ExpressionLayer
from lipservo.speech.layers import Claim, Layer, ServoLayers
from lipservo.speech.lip_gap_offset import LipGapOffset
from lipsync.arrays import Array
from lipsync.audio.playback_clock import PlaybackClock
from lipsync.face.frame import NO_EXPRESSION, Expression, Frame
from lipsync.face.synthesizer import Synthesizer
from lipsync.phonemes import (
    SILENCE,
    Hearing,
    Listener,
    PhonemeEvent,
    PhonemeSource,
    ServoListener,
)

#: After a stall, targets that would be shown longer ago than this are not computed any more.
_OLDEST_WORTH_SHOWING_S = 0.100
#: Of what a stall skipped, so much is still worked out for those that remember: filters of lag and
#: trim (0.2 s), backlash (until the joint turns), hand-overs (0.3 s) and the motion itself, which
#: goes back as far.
_REMEMBERED_S = 1.0
#: A sound that stood still goes on once it is so much further.
_GOES_ON_S = 0.03
#: Servos that are later than this are not fully made up for: all else would wait for them.
_MOST_ADVANCE_S = 0.200


class Speech:
    """The speech side: follows phonemes, publishes targets for times still to come."""

    def __init__(
        self,
        phonemes: PhonemeSource,
        clock: PlaybackClock,
        synthesizer: Synthesizer,
        calibration: Calibration,
        servo_names: Sequence[str],
        channel: TargetChannel,
        *,
        least_delay_s: float = 0.0,
        expression: ExpressionLayer | None = None,
    ) -> None:
        """servo_names: of the whole face, in the order of the targets.

        Those without calibration that the expression does not move stay at neutral. least_delay_s:
        the face waits for a loudspeaker that is so late. Raises ValueError for a calibrated servo
        that is not among them.
        """
        self._phonemes = phonemes
        self._clock = clock
        self._synthesizer = synthesizer
        self._calibration = calibration
        self._channel = channel
        n_servos = len(servo_names)
        # A joint's neutral is its 0 degrees (`firmware_bridge.joints.Joint`).
        self._layers = ServoLayers(servo_names, np.zeros(n_servos), PUBLISH_PERIOD_S)
        #: The numbers of the calibrated servos among those of the face.
        self.mouth = self._layers.indices(calibration.servo_names)
        self._trim = VisemeTrim(calibration.trim, len(self.mouth), PUBLISH_PERIOD_S)
        following = calibration.following
        self._follower = Follower(
            following and following.spread(self.mouth, n_servos),
            n_servos,
            PUBLISH_PERIOD_S,
            look_ahead_s=_MOST_ADVANCE_S,
        )
        self.delay = Delay(
            phonemes.latency_s,
            synthesizer.lookahead_s,
            actuation_s=self._follower.advance_s,
        ).at_least(least_delay_s)
        self._cut_off = CutOff(PUBLISH_PERIOD_S)
        self.expression = expression
        #: Lips more open or closed than planned; None: as planned.
        self.lip_gap: LipGapOffset | None = None
        self._newest_mouth_deg = np.zeros(len(self.mouth))
        self._newest_asked_s = self._newest_sound_s = -math.inf
        # The first sound is shown a delay late; until then the closed mouth is published.
        self._n_published = -round(self.delay.total_s / PUBLISH_PERIOD_S)

    @property
    def phonemes_planned(self) -> int:
        """Phonemes that moved the mouth so far."""
        return self._synthesizer.phonemes_planned

    @property
    def hears(self) -> Hearing | None:
        """What is believed about the sound that was settled last; None: nobody listens."""
        return self._phonemes.hears if isinstance(self._phonemes, Listener) else None

    @property
    def calibration(self) -> Calibration:
        """How faces become joint angles, for the servos of the mouth."""
        return self._calibration

    def note_servo_speeds(self, now_s: float, speeds_deg_s: Array) -> None:
        """All servos of the face (n_servos,) turned so fast at monotonic `now_s`."""
        if isinstance(self._phonemes, ServoListener):
            self._phonemes.note_servo_speeds(self._clock.sound_s(now_s), speeds_deg_s)

    def begin(self, zero_s: float) -> None:
        """The sound begins at monotonic `zero_s`."""
        self._clock.begin(zero_s)

    def sound_time_s(self, display_s: float) -> float:
        """The sound time whose face belongs to monotonic display time `display_s`."""
        return self._clock.sound_s(display_s) - self.delay.total_s

    def advance(self, now_s: float) -> None:
        """Hear and publish all that is due at monotonic `now_s`."""
        self._hear(now_s)
        heard_s = self._clock.sound_s(now_s)
        if self._cut_off.is_closing and heard_s - self.delay.synthesis_s < self._cut_off.until_s:
            self._close(now_s)
            return
        # Half a nanosecond of grace, or rounding would hold a target back for a whole period.
        n_due = math.floor((heard_s - self.delay.synthesis_s + 5e-10) / PUBLISH_PERIOD_S) + 1
        n_too_old = n_due - round(_OLDEST_WORTH_SHOWING_S / PUBLISH_PERIOD_S)
        n_remembered = n_too_old - round(_REMEMBERED_S / PUBLISH_PERIOD_S)
        if self._cut_off.is_closing:
            self._n_published = max(self._n_published, n_due - 1)
        for n in range(max(self._n_published, n_remembered), n_due):
            targets = self._targets(n * PUBLISH_PERIOD_S)
            if n >= n_too_old:
                self._publish(targets)
        self._n_published = max(self._n_published, n_due)

    def cut_off(self, now_s: float, rest: Array, until_s: float | None = None) -> None:
        """Close the mouth now, whatever was planned; what is said from `until_s` on is shown again.

        rest: the face (n_components,) of a mouth at rest. until_s: in sound time; None: until the
        sound, which stands still, goes on.
        """
        if until_s is None:
            until_s = self._clock.sound_s(now_s) - self.delay.synthesis_s + _GOES_ON_S
        rest_deg = self._calibration.positions_deg(
            rest if self.lip_gap is None else self.lip_gap.shifted(rest)
        )
        self._cut_off.begin(self._newest_mouth_deg, rest_deg, until_s)
        # Targets may have been dated ahead of this moment.
        self._newest_asked_s = min(self._newest_asked_s, now_s)

    @property
    def is_cut_off(self) -> bool:
        """Whether the mouth is at rest, or on its way there, because its sound was cut off."""
        return self._cut_off.is_closing

    def event_at(self, sound_s: float) -> PhonemeEvent | None:
        """The phoneme of a sound time, as far as it is known."""
        return self._synthesizer.event_at(sound_s)

    def captured_s(self, asked_s: float) -> float | None:
        """When the sound was captured that moves the servos at `asked_s`, on the same clock.

        Before any sound moves them, or where nobody knows: None. Ask in order.
        """
        # Beyond the newest target, whatever is shown was made of that one.
        sound_s = self._newest_sound_s - max(0.0, self._newest_asked_s - asked_s)
        return None if sound_s < 0.0 else self._clock.captured_s(sound_s)

    def shown_at(self, sound_s: float) -> tuple[str, Frame]:
        """The phoneme and the frame of a sound time that was published."""
        event = self._synthesizer.event_at(sound_s)
        phoneme = SILENCE if event is None else event.phoneme
        return phoneme, self._synthesizer.frame_at(sound_s)

    def _hear(self, now_s: float) -> None:
        updates = self._phonemes.updates(self._clock.sound_s(now_s))
        self._clock.arrived(now_s, self._phonemes.heard_until_s)
        for update in updates:
            self._synthesizer.push(update)

    def _close(self, now_s: float) -> None:
        """The mouth goes to rest by the clock of the computer, whatever the sound's clock does."""
        self._newest_asked_s = max(self._newest_asked_s, now_s - _OLDEST_WORTH_SHOWING_S)
        # Every period counts, also where ticks are farther apart: it closes in the same time.
        while self._newest_asked_s < now_s + PUBLISH_PERIOD_S / 2:
            self._newest_asked_s += PUBLISH_PERIOD_S
            self._newest_mouth_deg = self._cut_off.close()
            shown_s = self._newest_asked_s + self.delay.actuation_s
            pose_deg = self._compose(self._newest_sound_s, shown_s, SILENCE, NO_EXPRESSION)
            goals_deg = self._follower.feed(pose_deg)
            self._publish(ServoTargets(self._newest_asked_s, goals_deg))

    def _targets(self, sound_s: float) -> ServoTargets:
        phoneme, frame = self.shown_at(sound_s)
        face = frame.coefficients if self.lip_gap is None else self.lip_gap.feed(frame.coefficients)
        mouth_deg = self._calibration.positions_deg(face) + self._trim.feed(phoneme)
        self._newest_mouth_deg = self._cut_off.join(mouth_deg)
        shown_s = self._clock.monotonic_s(sound_s) + self.delay.total_s
        # Servos are asked before the face is shown, by as much as they are late.
        asked_s = shown_s - self.delay.actuation_s
        self._newest_asked_s, self._newest_sound_s = asked_s, sound_s
        pose_deg = self._compose(sound_s, shown_s, phoneme, frame.expression)
        return ServoTargets(asked_s, self._follower.feed(pose_deg))

    def _compose(
        self, sound_s: float, shown_s: float, phoneme: str, performed: Expression
    ) -> Array:
        """The pose (n_servos,) of the next 10 ms: the newest of the mouth, and the expression.

        performed: what a performance says of head and eyes.
        """
        mouth = Claim(Layer.LIPS, self.mouth, self._newest_mouth_deg)
        if self.expression is None:
            return self._layers.compose([mouth])
        is_speaking = phoneme != SILENCE
        self.expression.advance(sound_s, shown_s, is_speaking=is_speaking, performed=performed)
        return self._layers.compose(self.expression.claims(mouth))

    def _publish(self, targets: ServoTargets) -> None:
        """Nothing of a face that rests: the bridge lets its servos go, and takes them up again."""
        if self.expression is None or not self.expression.is_resting:
            self._channel.publish(targets)
