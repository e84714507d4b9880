"""From phonemes to servo targets: the core of a face's speech side, without threads or sleeping."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from calibration.calibration import Calibration
from calibration.run.compensation import BacklashCompensation, LagCompensation, VisemeTrim
from firmware_bridge.gate.joint_plan import JointPlan, TargetWindow
from firmware_bridge.loop.targets import ServoTargets, TargetChannel
from lipservo.runtime.speech.expression import ExpressionLayer
from lipservo.runtime.speech.layers import Claim, Layer, ServoLayers
from lipservo.runtime.speech.phoneme_sources import SpokenPhonemes
from lipservo.settings.motion_names import LIP_GAP_OFFSET
from lipsync.arrays import Array
from lipsync.audio.playback_clock import PlaybackClock
from lipsync.audio_block import BLOCK_S
from lipsync.face.frame import (
    NO_EXPRESSION,
    Expression,
    FaceWindow,
    Frame,
    Synthesizer,
    frame_alone,
)
from lipsync.face.model import FaceModel
from lipsync.motion.finishing import lip_gap_of
from lipsync.phonemes import (
    SILENCE,
    Hearing,
    Listener,
    PhonemeEvent,
    PhonemeSource,
    ServoListener,
)
from lipsync.recognition.text_decoder import MouthMover, MovedBy

#: The speech side publishes at 100 Hz (architecture.md, Time).
PUBLISH_PERIOD_S = 0.010


@dataclass(frozen=True, slots=True)
class Delay:
    """The delay from a sound to the face shown for it, part by part, in s; summed only here."""

    recognizer_s: float
    lookahead_s: float
    sound_block_s: float = BLOCK_S
    publish_period_s: float = PUBLISH_PERIOD_S
    actuation_s: float = 0.0
    loudspeaker_s: float = 0.0

    @property
    def synthesis_s(self) -> float:
        """The seconds of sound needed after an instant before its face can be computed."""
        return self.recognizer_s + self.lookahead_s + self.sound_block_s + self.loudspeaker_s

    @property
    def total_s(self) -> float:
        """The whole delay: time at which a face is shown minus time of its sound, s."""
        return self.synthesis_s + self.publish_period_s + self.actuation_s

    def __str__(self) -> str:
        """Return the total delay and each part of it that is not 0, in ms, for a person."""
        parts = {
            "recogniser": self.recognizer_s,
            "look-ahead": self.lookahead_s,
            "sound block": self.sound_block_s,
            "publishing": self.publish_period_s,
            "actuation": self.actuation_s,
            "loudspeaker": self.loudspeaker_s,
        }
        listed = " + ".join(f"{name} {s * 1e3:.0f}" for name, s in parts.items() if s)
        return f"{self.total_s * 1e3:.0f} ms = {listed}"


#: From any pose to rest: as fast as a mouth closes for a P, so that with the servos' own lag the
#: mouth is closed within 200 ms.
CLOSING_S = 0.10
#: Back from rest to the pose of the speech by then: no jump, and over before the first vowel is.
JOINING_S = 0.08


class CutOff:
    """The mouth's path to rest when speech is cut off, and back: joint degrees, pose by pose."""

    def __init__(self, n_servos: int, period_s: float) -> None:
        """Start at neutral, where a face begins; the first `join` poses lead from there.

        period_s: seconds from one pose to the next.
        """
        self._period_s = period_s
        # Where the present path begins; and how much of the path to rest, or back, is done: 0 to 1.
        self._start_deg: Array = np.zeros(n_servos)
        self._rest_deg: Array = np.zeros(n_servos)
        self._closed_share = 1.0
        self._joined_share = 0.0
        #: Sound time: faces of earlier sound are not shown.
        self.until_s = -np.inf
        self.is_closing = False

    def begin(self, shown_deg: Array, rest_deg: Array, until_s: float) -> None:
        """Begin to close the mouth; if it closes already, only extend `until_s`.

        Parameters
        ----------
        shown_deg,rest_deg : Array
            (n_servos,) degrees: the present pose, and the pose at rest.
        until_s : float
            Sound time until which the mouth rests.
        """
        self.until_s = max(self.until_s, until_s) if self.is_closing else until_s
        if self.is_closing:
            return
        self.is_closing = True
        self._start_deg, self._rest_deg = shown_deg, rest_deg
        self._closed_share = 0.0

    def close(self) -> Array:
        """Return the next pose on the path to rest.

        Returns
        -------
        Array
            (n_servos,) degrees.
        """
        self._closed_share = min(1.0, self._closed_share + self._period_s / CLOSING_S)
        return self._between(self._start_deg, self._rest_deg, self._closed_share)

    def join(self, live_deg: Array) -> Array:
        """Return the next pose on the path back from rest to the live pose, at its end that pose.

        The first call after `close` starts the path at the pose that was reached then.

        Parameters
        ----------
        live_deg : Array
            (n_servos,) degrees.

        Returns
        -------
        Array
            (n_servos,) degrees.
        """
        if self.is_closing:
            self.is_closing = False
            self._start_deg = self._between(self._start_deg, self._rest_deg, self._closed_share)
            self._joined_share = 0.0
        if self._joined_share >= 1.0:
            return live_deg
        self._joined_share = min(1.0, self._joined_share + self._period_s / JOINING_S)
        return self._between(self._start_deg, live_deg, self._joined_share)

    @staticmethod
    def _between(start_deg: Array, end_deg: Array, share: float) -> Array:
        """Return start + (3 u^2 - 2 u^3) (end - start), u = `share`: speed 0 at both ends."""
        return np.asarray(start_deg + share * share * (3.0 - 2.0 * share) * (end_deg - start_deg))


#: Of each of two low-passes, one after the other: 3 mm in a third of a second, without a step in
#: speed.
_TIME_CONSTANT_S: Final = 0.06
#: An offset so close to the wanted one counts as that: less than an encoder step moves a lip.
_SETTLED_MM: Final = 0.005


class LipGapOffset:
    """A constant offset of the gap between the lips, eased in after changes."""

    def __init__(self, model: FaceModel, offset_mm: float, period_s: float) -> None:
        """Start with `offset_mm` fully applied. period_s: seconds between calls of `feed`."""
        #: The change of the face (n_components,) that goes with a gap 1 mm higher.
        self._per_mm: Array = np.asarray(lip_gap_of(model).response[1])
        self._share = float(1.0 - np.exp(-period_s / _TIME_CONSTANT_S))
        self.wanted_mm = self._halfway_mm = self._shown_mm = offset_mm

    @property
    def is_settled(self) -> bool:
        """Whether the wanted offset is fully applied."""
        return self._shown_mm == self.wanted_mm

    def change(self, settings: Mapping[str, float]) -> None:
        """Set the wanted offset from `settings`, if they contain one; `feed` eases it in."""
        self.wanted_mm = settings.get(LIP_GAP_OFFSET, self.wanted_mm)

    def feed(self, face: Array) -> Array:
        """Advance the offset by one period, and return the period's faces with it applied.

        Parameters
        ----------
        face : Array
            (..., n_components).

        Returns
        -------
        Array
            (..., n_components).
        """
        if not self.is_settled:
            # Two first-order low-passes in a row, until both are at the wanted offset.
            self._halfway_mm += self._share * (self.wanted_mm - self._halfway_mm)
            self._shown_mm += self._share * (self._halfway_mm - self._shown_mm)
            left_mm = [abs(self.wanted_mm - mm) for mm in (self._halfway_mm, self._shown_mm)]
            if max(left_mm) < _SETTLED_MM:
                self._halfway_mm = self._shown_mm = self.wanted_mm
        return self.shifted(face)

    def shifted(self, face: Array) -> Array:
        """Return faces with the present offset applied.

        Parameters
        ----------
        face : Array
            (..., n_components).

        Returns
        -------
        Array
            (..., n_components).
        """
        if self._shown_mm == 0.0:
            return face
        return np.asarray(face + self._shown_mm * self._per_mm)


#: After a stall, targets that would be shown longer ago than this are not computed any more.
_OLDEST_WORTH_SHOWING_S = 0.100
#: Of the time that a stall skipped, so much is still computed, unpublished, for all that has a
#: memory: filters of lag and trim (0.2 s), backlash (until the joint turns), hand-overs between
#: owners (0.3 s), and the motion itself, which looks back as far as this.
_REMEMBERED_S = 1.0
#: Goals that have not changed for so long are those of a mouth at rest: longer than any filter here
#: remembers.
_STILL_PERIODS: Final = round(_REMEMBERED_S / PUBLISH_PERIOD_S)
#: After a stall of the sound's clock, the mouth opens again once sound time is so much later.
_GOES_ON_S = 0.03
#: Times and closures of a window with a single pose, after which nothing is known.
_NOW: Final = np.zeros(1)
_NO_CLOSURE: Final = np.zeros(1, dtype=np.bool_)
#: Lags above this are compensated in part only: all other servos would have to wait.
_MOST_ADVANCE_S = 0.200


@dataclass(frozen=True, slots=True)
class SpeechOptions:
    """The optional parts of a face's speech side.

    least_delay_s: least delay from sound to face: the loudspeaker's latency. expression: moves head
    and eyes; None: they stay. lip_gap: opens or closes the lips more than planned; None: as
    planned. plan: keeps the mouth's joints within their speeds; None: they are not limited here.
    """

    least_delay_s: float = 0.0
    expression: ExpressionLayer | None = None
    lip_gap: LipGapOffset | None = None
    plan: JointPlan | None = None


class Speech:
    """The speech side of a face: turns phonemes into servo targets, published ahead of time."""

    def __init__(
        self,
        phonemes: PhonemeSource,
        clock: PlaybackClock,
        synthesizer: Synthesizer,
        calibration: Calibration,
        servo_names: Sequence[str],
        channel: TargetChannel,
        options: SpeechOptions | None = None,
    ) -> None:
        """Connect phonemes to a target channel. servo_names: of the whole face, in targets' order.

        Servos without calibration that the expression does not move stay at neutral. Raises
        ValueError for a calibrated servo that is not in `servo_names`.
        """
        options = options or SpeechOptions()
        self._phonemes = phonemes
        self._listener = phonemes if isinstance(phonemes, Listener) else None
        self._clock = clock
        self._synthesizer = synthesizer
        #: Maps faces to joint angles of the mouth's servos.
        self.calibration = calibration
        self._channel = channel
        n_servos = len(servo_names)
        # A joint's neutral is its 0 degrees (`firmware_bridge.joints.Joint`).
        self._layers = ServoLayers(servo_names, np.zeros(n_servos), PUBLISH_PERIOD_S)
        #: The numbers of the calibrated servos among those of the face.
        self.mouth = self._layers.indices(calibration.servo_names)
        self._trim = VisemeTrim(calibration.trim, len(self.mouth), PUBLISH_PERIOD_S)
        lag_s, backlash_deg = np.zeros(n_servos), np.zeros(len(self.mouth))
        if calibration.following is not None:
            lag_s[self.mouth] = calibration.following.lag_s
            backlash_deg = calibration.following.backlash_deg
        self._lag = LagCompensation(lag_s, PUBLISH_PERIOD_S, look_ahead_s=_MOST_ADVANCE_S)
        self._backlash = BacklashCompensation(backlash_deg)
        delay = Delay(phonemes.latency_s, synthesizer.lookahead_s, actuation_s=self._lag.advance_s)
        wait_s = max(0.0, options.least_delay_s - delay.total_s)
        self.delay = replace(delay, loudspeaker_s=wait_s)
        self._cut_off = CutOff(len(self.mouth), PUBLISH_PERIOD_S)
        self.expression = options.expression
        self.lip_gap = options.lip_gap
        self._plan = options.plan
        # Newest goals of the mouth's servos, and the pose that results; they differ by backlash.
        self._goals_deg = self._mouth_pose_deg = np.zeros(len(self.mouth))
        # Numbers of the next periods of 10 ms, from sound time 0 on, to be published and computed.
        # The first sound is shown a delay late; until then, in periods before 0, the mouth is shut.
        self._n_published = -round(self.delay.total_s / PUBLISH_PERIOD_S)
        self._n_computed = self._n_published
        self._newest_goal_s, self._newest_sound_s = -math.inf, -self.delay.total_s
        self._last_window: FaceWindow | None = None
        # The goals published last, and for how many periods they have been the same.
        self._still_deg, self._n_still = self._goals_deg, 0

    @property
    def is_still(self) -> bool:
        """Whether the mouth rests, and the goals of all servos have not changed for over 1 s.

        Always False for a face whose expression moves servos, for example a neck.
        """
        has_gap = self.lip_gap is None or self.lip_gap.is_settled
        return self._n_still > _STILL_PERIODS and has_gap and not self._cut_off.is_closing

    @property
    def phonemes_planned(self) -> int:
        """The number of phonemes that have moved the mouth so far."""
        return self._synthesizer.phonemes_planned

    @property
    def held_back_share(self) -> Array:
        """The share of time in which each joint of the mouth was kept off its target by its limits.

        Returns
        -------
        Array
            (n_joints,), 0 to 1.
        """
        return np.zeros(len(self.mouth)) if self._plan is None else self._plan.held_back_share

    @property
    def hearing(self) -> Hearing | None:
        """The class of the sound (speech, noise, ...) decided last; None: no recogniser listens."""
        return None if self._listener is None else self._listener.hearing

    @property
    def moved_by(self) -> MovedBy | None:
        """The source (sound, text, words, ...) of the newest final phonemes; None: not known."""
        return self._phonemes.moved_by if isinstance(self._phonemes, MouthMover) else None

    @property
    def units_shifted_ms(self) -> float | None:
        """How much later than sent timed units are heard, ms; None where none move the mouth."""
        spoken = self._phonemes if isinstance(self._phonemes, SpokenPhonemes) else None
        shifted_s = None if spoken is None else spoken.units_shifted_s
        return None if shifted_s is None else round(shifted_s * 1e3, 1)

    @property
    def saying(self) -> tuple[tuple[str, ...], int]:
        """The words around the one spoken now, and its index in them; ((), 0): no text is known."""
        return self._phonemes.saying if isinstance(self._phonemes, MouthMover) else ((), 0)

    def note_servo_speeds(self, now_s: float, speeds_deg_s: Array) -> None:
        """Pass the speeds of all servos to the phoneme source, if its recogniser uses them.

        Parameters
        ----------
        now_s : float
            Monotonic seconds.
        speeds_deg_s : Array
            (n_servos,) degrees a second.
        """
        if isinstance(self._phonemes, ServoListener):
            self._phonemes.note_servo_speeds(self._clock.sound_s(now_s), speeds_deg_s)

    def begin(self, zero_s: float) -> None:
        """Set the monotonic time of the sound's beginning, sound time 0, to `zero_s`."""
        self._clock.begin(zero_s)

    def rest_before(self, wait_s: float) -> None:
        """Publish the mouth at rest for `wait_s` seconds longer before the first sound is shown."""
        self._n_published -= round(wait_s / PUBLISH_PERIOD_S)
        self._n_computed = self._n_published

    def sound_time_s(self, display_s: float) -> float:
        """Return the sound time whose face is shown at monotonic time `display_s`."""
        return self._clock.sound_s(display_s) - self.delay.total_s

    def advance(self, now_s: float) -> None:
        """Recognise, compute and publish all that is due at monotonic `now_s`.

        After a stall, targets that are too old to be shown are not published, and the oldest of
        them not computed. While speech is cut off, poses on the path to rest are published instead.
        """
        updates = self._phonemes.updates(self._clock.sound_s(now_s))
        self._clock.arrived(now_s, self._phonemes.heard_until_s)
        for update in updates:
            self._synthesizer.push(update)
        heard_s = self._clock.sound_s(now_s)
        if self._cut_off.is_closing and heard_s - self.delay.synthesis_s < self._cut_off.until_s:
            self._publish_closing(now_s)
            return
        n_due = self._n_due(heard_s)
        n_too_old = n_due - round(_OLDEST_WORTH_SHOWING_S / PUBLISH_PERIOD_S)
        n_remembered = n_too_old - round(_REMEMBERED_S / PUBLISH_PERIOD_S)
        if self._cut_off.is_closing:
            self._n_computed = max(self._n_computed, n_due - 1)
        for n in range(max(self._n_computed, n_remembered), n_due):
            targets = self._compute_targets(n * PUBLISH_PERIOD_S)
            if n >= max(n_too_old, self._n_published):
                self._publish(targets)
        self._n_computed = self._n_published = max(self._n_computed, n_due)

    def hold(self, now_s: float) -> None:
        """Publish the last goals again for each 10 ms until monotonic `now_s`, while `is_still`.

        Nothing is recognised or computed: the next `advance` does that for the time passed.
        """
        n_due = self._n_due(self._clock.sound_s(now_s))
        for n in range(self._n_published, n_due):
            self._publish(ServoTargets(self._times_s(n * PUBLISH_PERIOD_S)[0], self._still_deg))
        self._n_published = max(self._n_published, n_due)

    def _n_due(self, heard_s: float) -> int:
        """Return how many periods of 10 ms, from sound time 0 on, have targets that are due.

        heard_s: sound time until which sound was heard.
        """
        # Half a nanosecond of grace, or rounding would hold a target back for a whole period.
        return math.floor((heard_s - self.delay.synthesis_s + 5e-10) / PUBLISH_PERIOD_S) + 1

    def _times_s(self, sound_s: float) -> tuple[float, float]:
        """Return (goal_s, shown_s) of the face of sound time `sound_s`, both monotonic.

        goal_s: when the servos are to get their goals. shown_s: when the face is shown.
        """
        shown_s = self._clock.monotonic_s(sound_s) + self.delay.total_s
        # Servos get their goals earlier than the face is shown, by as much as they lag.
        return shown_s - self.delay.actuation_s, shown_s

    def cut_off(self, now_s: float, rest: Array, until_s: float | None = None) -> None:
        """Close the mouth now, whatever was planned; speech from `until_s` on is shown again.

        Parameters
        ----------
        now_s : float
            Monotonic seconds.
        rest : Array
            (n_components,), the face of a mouth at rest.
        until_s : float | None
            Sound time; None: until the sound's clock, which has stopped, is 30 ms further.
        """
        if until_s is None:
            until_s = self._clock.sound_s(now_s) - self.delay.synthesis_s + _GOES_ON_S
        rest_deg = self.calibration.positions_deg(
            rest if self.lip_gap is None else self.lip_gap.shifted(rest)
        )
        self._cut_off.begin(self._mouth_pose_deg, rest_deg, until_s)
        # Targets already published may be dated later than now; the path to rest begins now.
        self._newest_goal_s = min(self._newest_goal_s, now_s)

    @property
    def is_cut_off(self) -> bool:
        """Whether the mouth rests, or is closing, because its sound was cut off."""
        return self._cut_off.is_closing

    def event_at(self, sound_s: float) -> PhonemeEvent | None:
        """Return the phoneme at a sound time, as known so far; None where none is known."""
        return self._synthesizer.event_at(sound_s)

    def captured_s(self, goal_s: float) -> float | None:
        """Return when the sound that moves the servos at `goal_s` was captured, both monotonic s.

        None before any sound moves them, or where the clock does not know. Call in order of time.
        """
        # After the newest target's time, the servos still show the sound of that target.
        sound_s = self._newest_sound_s - max(0.0, self._newest_goal_s - goal_s)
        return None if sound_s < 0.0 else self._clock.captured_s(sound_s)

    def shown_at(self, sound_s: float) -> tuple[str, Frame]:
        """Return (phoneme, frame) shown for a sound time; phoneme SIL where none is known."""
        event = self._synthesizer.event_at(sound_s)
        phoneme = SILENCE if event is None else event.phoneme
        return phoneme, self._synthesizer.frame_at(sound_s)

    def _publish_closing(self, now_s: float) -> None:
        """Publish poses on the path to rest up to monotonic `now_s`, even if the sound stalls."""
        self._n_still = 0
        self._newest_goal_s = max(self._newest_goal_s, now_s - _OLDEST_WORTH_SHOWING_S)
        # One pose for each 10 ms, even if ticks are farther apart: the mouth closes equally fast.
        while self._newest_goal_s < now_s + PUBLISH_PERIOD_S / 2:
            self._newest_goal_s += PUBLISH_PERIOD_S
            self._plan_mouth(TargetWindow(_NOW, self._cut_off.close()[None], _NO_CLOSURE))
            shown_s = self._newest_goal_s + self.delay.actuation_s
            pose_deg = self._compose_pose(self._newest_sound_s, shown_s, SILENCE, NO_EXPRESSION)
            self._publish(ServoTargets(self._newest_goal_s, self._lag.feed(pose_deg)))

    def _compute_targets(self, sound_s: float) -> ServoTargets:
        """Compute the servo goals, in degrees, that show the face of sound time `sound_s`.

        Called once for every period of 10 ms, in order: the filters of trim, backlash, joint plan
        and lag advance by a period in each call. A still mouth gets its last goals again, at little
        cost.
        """
        phoneme, frame = self.shown_at(sound_s)
        window = frame_alone(frame) if self._plan is None else self._synthesizer.window_after(frame)
        goal_s, shown_s = self._times_s(sound_s)
        self._newest_goal_s, self._newest_sound_s = goal_s, sound_s
        # At rest the synthesiser returns the same window again, and nothing need be computed.
        is_same, self._last_window = window is self._last_window, window
        if is_same and self.is_still and self._plan is not None:
            self._plan.stay()
            self._express(sound_s, shown_s, phoneme, frame.expression)
            return ServoTargets(goal_s, self._still_deg)
        # Faces now and later, and last the present one with pressed lips, become joint angles. The
        # present pose may still be on its way back from rest, after a cut-off.
        faces = np.concatenate([window.faces, window.shut[None]])
        if self.lip_gap is not None:
            faces = self.lip_gap.feed(faces)
        poses_deg = self.calibration.poses_deg(faces) + self._trim.feed(phoneme)
        poses_deg[0] = self._cut_off.join(poses_deg[0])
        self._plan_mouth(TargetWindow(window.times_s, poses_deg[:-1], window.closed, poses_deg[-1]))
        pose_deg = self._compose_pose(sound_s, shown_s, phoneme, frame.expression)
        goals_deg = self._lag.feed(pose_deg)
        is_same = is_same and not (self.expression is not None and self.expression.moves_servos)
        is_same = is_same and np.array_equal(goals_deg, self._still_deg)
        self._still_deg, self._n_still = goals_deg, self._n_still + 1 if is_same else 0
        return ServoTargets(goal_s, goals_deg)

    def _plan_mouth(self, window: TargetWindow) -> None:
        """Set the mouth's next goals, and the pose to which they bring it, from target poses.

        window: target poses of the mouth's joints, now and in the near future, degrees.

        Backlash is compensated before the plan, so that the plan sees every reversal and keeps the
        limits of the servos, not those of their horns.
        """
        ahead = replace(window, positions_deg=self._backlash.feed(window.positions_deg))
        self._goals_deg = ahead.positions_deg[0]
        if self._plan is not None:
            self._goals_deg = self._plan.step(ahead)
        # Without the compensation, goals are the pose to which they bring the mouth.
        self._mouth_pose_deg = self._goals_deg - (ahead.positions_deg[0] - window.positions_deg[0])

    def _compose_pose(
        self, sound_s: float, shown_s: float, phoneme: str, performed: Expression
    ) -> Array:
        """Return the pose (n_servos,), degrees, of mouth and expression for the next 10 ms.

        sound_s, shown_s: sound time, and monotonic time of display. phoneme: spoken then.
        performed: the expression that a rendered performance contains for it.
        """
        mouth = Claim(Layer.LIPS, self.mouth, self._goals_deg)
        self._express(sound_s, shown_s, phoneme, performed)
        claims = [mouth] if self.expression is None else self.expression.claims(mouth)
        return self._layers.compose(claims)

    def _express(self, sound_s: float, shown_s: float, phoneme: str, performed: Expression) -> None:
        """Compute the next 10 ms of expression, if any; arguments as `_compose_pose`."""
        if self.expression is not None:
            is_speaking = phoneme != SILENCE
            self.expression.advance(sound_s, shown_s, is_speaking=is_speaking, performed=performed)

    def _publish(self, targets: ServoTargets) -> None:
        """Publish the targets unless the face rests: then the bridge may switch torque off."""
        if self.expression is None or not self.expression.is_resting:
            self._channel.publish(targets)
