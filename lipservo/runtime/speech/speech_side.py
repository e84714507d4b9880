"""From sound to servo targets: the speech side of a face, with its own voice where it has one."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from firmware_bridge.gate.joint_plan import JointPlan
from firmware_bridge.loop.targets import TargetChannel
from lipservo.runtime.servos.assembly import Face
from lipservo.runtime.speech.expression import make_expression
from lipservo.runtime.speech.phoneme_sources import RecognizedPhonemes, SpokenPhonemes
from lipservo.runtime.speech.speech import PUBLISH_PERIOD_S, LipGapOffset, Speech, SpeechOptions
from lipservo.runtime.status.live_board import MOST_PEAKS, LiveBoard, expression_values
from lipsync.arrays import Array
from lipsync.audio.playback_clock import OwnPlaybackClock, clock_for
from lipsync.audio.playout import Playout
from lipsync.audio.playout_stream import PlayoutRequest
from lipsync.audio.source import AudioSource
from lipsync.face.frame import DRAWN_MOUTH, NO_EXPRESSION, Frame, Synthesizer
from lipsync.face.model import FaceModel
from lipsync.motion.finishing import STRONGEST, FinishedSynthesizer, lip_gap_of
from lipsync.motion.rounding import ROUNDED, ROUNDING_S, lip_width_of
from lipsync.phonemes import PHONEMES, SILENCE, LiveRecognizer
from lipsync.recognition.own_noise import ServoSpeeds

#: Gain and valence are passed on so often at most, and once they are so far from those in force:
#: arousal takes half a second to rise, and each change is eased over 0.3 s.
_FOLLOWED_EVERY_S: Final = 0.5
_SMALLEST_CHANGE: Final = 0.02


class AdjustableMouth:
    """The settings of the mouth's motion that may change while it moves: strength and others.

    Strength does not scale closures (lips that touch): no gain opens them.
    """

    def __init__(self, synthesizer: Synthesizer) -> None:
        self._synthesizer = synthesizer if isinstance(synthesizer, FinishedSynthesizer) else None
        self._strength = 1.0 if self._synthesizer is None else self._synthesizer.strength
        self._gain, self._valence = 1.0, 0.0
        self._due_s = 0.0

    @property
    def is_settled(self) -> bool:
        """Whether gain and valence in force are neutral (1 and 0), so that they stay in silence."""
        return max(abs(self._gain - 1.0), abs(self._valence)) < _SMALLEST_CHANGE

    def change(self, settings: Mapping[str, float]) -> None:
        """Pass on changed settings, by name, that the synthesiser knows; it eases them in."""
        if self._synthesizer is None:
            return
        if "strength" in settings and settings["strength"] != self._strength:
            self._strength = settings["strength"]
            self._set_strength()
        for name in self._synthesizer.adjustable & settings.keys() - {"strength"}:
            self._synthesizer.adjust(name, settings[name])

    def follow(self, now_s: float, gain: float, valence: float) -> None:
        """Set the motion's gain and valence (-1 to 1) at monotonic `now_s`, at most each 0.5 s."""
        change = max(abs(gain - self._gain), abs(valence - self._valence))
        if self._synthesizer is None or now_s < self._due_s or change < _SMALLEST_CHANGE:
            return
        self._due_s = now_s + _FOLLOWED_EVERY_S
        if gain != self._gain:
            self._gain = gain
            self._set_strength()
        if valence != self._valence:
            self._valence = valence
            self._synthesizer.smile(valence)

    def _set_strength(self) -> None:
        """Set the synthesiser's amplitude to the set strength times the gain, within its limit."""
        if self._synthesizer is not None:
            self._synthesizer.adjust("strength", min(STRONGEST, self._strength * self._gain))


#: A loudspeaker whose position has not changed for so long has stalled: a few buffers of the
#: slowest device.
_STALE_S: Final = 0.15
#: At rest the speech side computes so often; goals are still published every 10 ms.
REST_PERIOD_S: Final = 0.05
#: When a loudspeaker stalls, the clock runs on a little. The mouth opens again once the clock is
#: ahead of the loudspeaker by less than this, an error that nobody notices.
_CAUGHT_UP_S: Final = 0.03


class OwnVoice:
    """A face's own voice: its playout, playback clock and `Speech`, kept in step.

    Call `advance` in each tick, before that of `Speech`.
    """

    def __init__(
        self,
        playout: Playout,
        clock: OwnPlaybackClock,
        speech: Speech,
        rest: Array,
        *,
        quiet_s: float = 0.0,
    ) -> None:
        """Link the parts of the voice; set the clock to lead by the delay of `speech`.

        clock: the one that `speech` uses. rest: the face (n_components,) of a mouth at rest.
        quiet_s: seconds of silence at the beginning, as servos are slow at first.
        """
        self._quiet_s = quiet_s
        self.playout = playout
        self._clock = clock
        self._speech = speech
        self._rest = rest
        # Start of the phoneme logged last, timeline s.
        self._logged_start_s = -1.0
        # The loudspeaker's last position, and the monotonic time since which it is there.
        self._reported_position_s, self._position_moved_s = -math.inf, -math.inf
        self._has_stalled = False
        clock.lead_s = speech.delay.total_s

    def begin(self) -> None:
        """Begin the playout's timeline now, to be heard later by the delay from sound to face."""
        self.playout.begin(self._clock.lead_s, self._quiet_s)

    def advance(self, now_s: float) -> None:
        """Run the playout until monotonic `now_s`, and append each phoneme heard to its `phonemes`.

        Closes the mouth when speech is cut off or the loudspeaker stalls.
        """
        self.follow(now_s)
        # A resting face with sound to play wakes, and its speech waits for the servos.
        expression = self._speech.expression
        if expression is not None and expression.is_resting and not self.playout.is_over:
            expression.wake()
            self.be_quiet()
        position_s = self._clock.sound_s(now_s) - self._clock.lead_s
        if self.playout.advance(position_s):
            self._speech.cut_off(now_s, self._rest, self.playout.committed_s)
        event = self._speech.event_at(max(0.0, position_s))
        if event is not None and event.start_s > self._logged_start_s:
            self._logged_start_s = event.start_s
            end_s = event.start_s if event.end_s is None else event.end_s
            self.playout.phonemes.append((event.phoneme, event.start_s, end_s))

    @property
    def is_idle(self) -> bool:
        """Whether nothing is spoken or heard, and the loudspeaker has some silence in store."""
        has_store = self._clock.lead_s > self.playout.latency_s + 2.0 * REST_PERIOD_S
        return has_store and self.playout.is_idle and not self._has_stalled

    def be_quiet(self) -> None:
        """Play nothing for the set `quiet_s`, as servos that just got torque cannot follow."""
        self.playout.be_quiet(self._quiet_s)

    def fall_silent(self) -> None:
        """Drop all speech that was not heard yet, because the face is stopped."""
        self.playout.requests.append(PlayoutRequest("interrupt"))
        self.playout.advance(self.playout.position_s)

    def follow(self, now_s: float) -> None:
        """Pass the loudspeaker's position to the clock; close the mouth while it stalls."""
        report = self.playout.report()
        if report is None:
            return
        reported_s, position_s = report
        self._clock.played(reported_s, position_s)
        # By how much the clock is ahead of the reported position, as that would be now.
        ahead_s = (
            self._clock.sound_s(now_s) - self._clock.lead_s - position_s - (now_s - reported_s)
        )
        # A stall begins when the position stays, and ends when it moves again and the clock agrees.
        if position_s != self._reported_position_s:
            self._reported_position_s, self._position_moved_s = position_s, now_s
            self._has_stalled = self._has_stalled and ahead_s > _CAUGHT_UP_S
        elif now_s - self._position_moved_s > _STALE_S:
            self._has_stalled = True
        if self._has_stalled:
            self._speech.cut_off(now_s, self._rest)


#: On the dashboard's head, lips round so much before the sound, the middle of a cubic of
#: `ROUNDING_S`; and the time constant of the rounding, s.
_ROUNDING_LEAD_S: Final = ROUNDING_S / 2.0
_ROUNDING_TIME_S: Final = 0.03


class SpeechBoard:
    """A writer of what a face shows, as speech records, to a `LiveBoard` (shared memory).

    The dashboard draws its head from the records. Its lips round for W, UW and the like, which the
    recorded talker's, and so the robot's, hardly do (`lipsync.motion.rounding`).
    """

    def __init__(self, board: LiveBoard, face: FaceModel) -> None:
        self._board = board
        self._rest = face.rest
        self._width = lip_width_of(face)
        self._rounding = 0.0
        self._shown_until_s = 0.0

    def tell(self, now_s: float, speech: Speech) -> None:
        """Write the speech record of what is shown at monotonic `now_s` to the board."""
        sound_s = speech.sound_time_s(now_s)
        phoneme, frame = speech.shown_at(max(0.0, sound_s))
        expression = speech.expression
        shown = NO_EXPRESSION if expression is None else expression.expression
        is_cut_off = speech.is_cut_off
        drawn = NO_EXPRESSION if is_cut_off else frame.expression
        mouth = {name: getattr(drawn, name) for name in DRAWN_MOUTH}
        heard = None if expression is None else expression.voice
        self._board.write_speech(
            [] if heard is None else heard.peaks(self._shown_until_s, sound_s, MOST_PEAKS),
            time_s=now_s,
            sound_s=sound_s,
            phoneme=PHONEMES.index(phoneme),
            is_cut_off=is_cut_off,
            is_speech=heard is not None and heard.at(sound_s).is_speech,
            arousal=0.0 if expression is None else expression.arousal,
            coefficients=self._rest if is_cut_off else self._rounded(frame, speech),
            expression=expression_values(replace(shown, **mouth)),
        )
        self._shown_until_s = max(self._shown_until_s, sound_s)

    def _rounded(self, frame: Frame, speech: Speech) -> Array:
        """Return the frame's face (n_components,), its lips rounded for W, UW and the like.

        For the dashboard's head. The rounding, 0 to 1, follows the phonemes with a time constant
        of 30 ms, and leads them a little. Faces without a measure of lip width stay as they are.
        """
        if self._width is None:
            return frame.coefficients
        event = speech.event_at(frame.time_s + _ROUNDING_LEAD_S)
        goal = float(event is not None and PHONEMES.index(event.phoneme) in ROUNDED)
        passed_s = max(0.0, frame.time_s - self._shown_until_s)
        self._rounding += (1.0 - math.exp(-passed_s / _ROUNDING_TIME_S)) * (goal - self._rounding)
        return self._width.rounded(frame.coefficients, self._rounding)


#: Servos are sent their full speed three times, a tenth of a second apart, since no chip
#: acknowledges it: sound waits so much longer.
_MARGIN_S: Final = 0.3


class SpeechSide:
    """The speech side of a face: call `start` or `begin` once, then `advance` in each tick."""

    def __init__(
        self,
        speech: Speech,
        voice: OwnVoice | None = None,
        mouth: AdjustableMouth | None = None,
        rest: Array | None = None,
        board: SpeechBoard | None = None,
        *,
        quiet_s: float = 0.0,
        is_live: bool = False,
    ) -> None:
        """Join the parts of the speech side.

        voice: the face's own; None: it only listens. mouth: gets changed settings, and a gain from
        the arousal of the voice heard. rest: the face (n_components,) of a mouth at rest, for while
        the face is stopped. board: gets what is shown; None: not written. quiet_s: seconds until
        servos follow after torque on. is_live: the sound, a microphone's, does not wait for that.
        """
        self._quiet_s, self._is_live = quiet_s, is_live
        self._was_stopped = False
        # Monotonic times: until which `hold` has put work off, None: not at all; and of the last
        # computation at rest.
        self._put_off_s: float | None = None
        self._computed_s = -math.inf
        self._rest = rest
        self.speech = speech
        self.voice = voice
        self._mouth = mouth
        self._servo_speeds = ServoSpeeds()
        self._board = board

    def begin(self, zero_s: float) -> None:
        """Begin the sound at monotonic `zero_s`, without waiting for servos."""
        self.speech.begin(zero_s)
        if self.voice is not None:
            self.voice.begin()

    def start(self, now_s: float) -> float:
        """Begin as servos get torque at monotonic `now_s`; return the monotonic start of the sound.

        Sound that can wait begins once all servos follow; else the mouth rests, or the voice is
        silent, until then: as servos come on one after another, only a part of the mouth would
        move.
        """
        waits = self.voice is None and not self._is_live
        zero_s = now_s + self._quiet_s if waits else now_s
        self.begin(zero_s)
        if waits:
            self.speech.rest_before(self._quiet_s)
        else:
            self._await_servos(now_s)
        return zero_s

    def _await_servos(self, now_s: float) -> None:
        """Keep the voice silent, or the mouth at rest, until servos that get torque now follow."""
        if self.voice is not None:
            self.voice.be_quiet()
        elif self._rest is not None and self._quiet_s:
            until_s = self.speech.sound_time_s(now_s) + self._quiet_s
            self.speech.cut_off(now_s, self._rest, until_s)

    def advance(self, now_s: float) -> None:
        """Recognise, play and publish all that is due at monotonic `now_s`."""
        if self.voice is not None:
            self.voice.advance(now_s)
        self._advance_parts(now_s)

    def hold(self, now_s: float, *, has_news: bool) -> bool:
        """Publish the unchanged goals due at monotonic `now_s` of a face at rest; save computing.

        Return False if the caller has to call `advance`: something is spoken, a microphone is open,
        a goal still changes, or `has_news` (a stop or a setting is to be followed). At rest the
        speech side computes only every 50 ms; the periods put off are computed before False is
        returned, with the same result as if computed in time.
        """
        voice = self.voice
        is_still = self.speech.is_still and (self._mouth is None or self._mouth.is_settled)
        if has_news or not is_still or voice is None or not voice.is_idle:
            if self._put_off_s is not None:
                self.speech.advance(self._put_off_s)
                self._put_off_s = None
            return False
        voice.follow(now_s)
        if now_s < self._computed_s + REST_PERIOD_S - PUBLISH_PERIOD_S / 2.0:
            self.speech.hold(now_s)
            self._put_off_s = now_s
            return True
        self._computed_s, self._put_off_s = now_s, None
        self._advance_parts(now_s)
        voice.advance(now_s)
        return True

    def _advance_parts(self, now_s: float) -> None:
        """Advance speech to monotonic `now_s`, pass on gain and valence, and write the board."""
        self.speech.advance(now_s)
        if self._mouth is not None and self.speech.expression is not None:
            affect = self.speech.expression
            self._mouth.follow(now_s, affect.mouth_gain, affect.valence)
        if self._board is not None:
            self._board.tell(now_s, self.speech)

    def shown(self, time_s: float) -> tuple[float, str, Frame]:
        """Return (sound time, phoneme, frame) shown at monotonic `time_s`; rest while cut off."""
        sound_s = self.speech.sound_time_s(time_s)
        if self.speech.is_cut_off and self._rest is not None:
            return sound_s, SILENCE, Frame(sound_s, self._rest)
        return sound_s, *self.speech.shown_at(max(0.0, sound_s))

    def note_servos(self, time_s: float, positions_deg: Array) -> None:
        """Note the encoder positions of all servos, from which the recogniser learns their speeds.

        Parameters
        ----------
        time_s : float
            Monotonic seconds.
        positions_deg : Array
            (n_servos,) degrees.
        """
        found = self._servo_speeds.take(time_s, positions_deg)
        if found is not None:
            self.speech.note_servo_speeds(*found)

    def change(self, settings: Mapping[str, float]) -> None:
        """Apply settings changed while the face runs, by name; unknown names are ignored."""
        if self._mouth is not None:
            self._mouth.change(settings)
        if self.speech.lip_gap is not None:
            self.speech.lip_gap.change(settings)
        if self.speech.expression is not None:
            self.speech.expression.change(settings)

    def fall_silent(self) -> None:
        """Drop all speech that was not heard yet, because the face is stopped."""
        if self.voice is not None:
            self.voice.fall_silent()

    def follow_stop(self, now_s: float, *, is_stopped: bool) -> None:
        """Silence the face and rest its mouth while `is_stopped`; call before each `advance`.

        After a stop the voice or the mouth waits again until the servos follow.
        """
        if is_stopped:
            self.fall_silent()
            if self._rest is not None:
                self.speech.cut_off(now_s, self._rest)
        elif self._was_stopped:
            self._await_servos(now_s)
        self._was_stopped = is_stopped


def mouth_plan(face: Face) -> JointPlan:
    """Return a planner of goals, every 10 ms, for the mouth's joints, in the calibration's order.

    It keeps to the speed and acceleration limits of the face's YAML, and to the top speed that the
    calibration has measured, if any.
    """
    servos = [face.settings.servos[name] for name in face.calibration.servo_names]
    speeds_deg_s = np.array([servo.max_speed_deg_s for servo in servos])
    if face.calibration.following is not None:
        speeds_deg_s = np.minimum(speeds_deg_s, face.calibration.following.top_speed_deg_s)
    accelerations = [servo.max_acceleration_deg_s2 or math.inf for servo in servos]
    return JointPlan(speeds_deg_s, np.array(accelerations), PUBLISH_PERIOD_S)


def make_speech_side(
    face: Face,
    source: AudioSource,
    recognizer: LiveRecognizer,
    synthesizer: Synthesizer,
    channel: TargetChannel,
    *,
    start_s: float,
    board: LiveBoard | None = None,
) -> SpeechSide:
    """Return the speech side between an entered source and the servo targets in `channel`.

    start_s: seconds until all servos follow after torque on; no sound is spoken before. board: gets
    what is shown; None: not written.
    """
    names: Sequence[str] = list(face.settings.servos)
    mouth, rest = AdjustableMouth(synthesizer), face.model.rest
    expression = make_expression(face.settings, is_watched=board is not None)
    voice = expression.voice
    offset_mm = face.settings.motion.lip_gap_offset_mm or 0.0
    lip_gap = LipGapOffset(face.model, offset_mm, PUBLISH_PERIOD_S)
    watched = None if board is None else SpeechBoard(board, face.model)
    quiet_s = start_s + _MARGIN_S if start_s else 0.0
    if not isinstance(source, Playout):
        heard = RecognizedPhonemes(source, recognizer, voice)
        options = SpeechOptions(expression=expression, lip_gap=lip_gap, plan=mouth_plan(face))
        clock = clock_for(source)
        speech = Speech(heard, clock, synthesizer, face.calibration, names, channel, options)
        is_live = source.is_live
        return SpeechSide(speech, None, mouth, rest, watched, quiet_s=quiet_s, is_live=is_live)
    from lipservo.runtime.speech.performed_line import performed_in
    from lipsync.offline.performed_motion import PerformedMotion

    spoken = SpokenPhonemes(source, recognizer, voice)
    played = OwnPlaybackClock()
    motion = PerformedMotion(synthesizer, performed_in(source), lip_gap_of(face.model))
    options = SpeechOptions(source.latency_s, expression, lip_gap, mouth_plan(face))
    speech = Speech(spoken, played, motion, face.calibration, names, channel, options)
    own = OwnVoice(source, played, speech, rest, quiet_s=quiet_s)
    return SpeechSide(speech, own, mouth, rest, watched, quiet_s=quiet_s)
