"""Sound to targets: the speech side of a face, with its own voice where it has one."""

from collections.abc import Mapping, Sequence
from typing import Final

from firmware_bridge.dynamixel.soft_start import SOFT_FOR_S
from firmware_bridge.targets import TargetChannel
from lipservo.face.assembly import Face
from lipservo.speech.adjustable_mouth import AdjustableMouth
from lipservo.speech.delay import PUBLISH_PERIOD_S
from lipservo.speech.expression_servos import expression_servos
from lipservo.speech.face_expression import make_expression
from lipservo.speech.lip_gap_offset import LipGapOffset
from lipservo.speech.own_voice import OwnVoice
from lipservo.speech.performed_line import performed_in
from lipservo.speech.recognized_phonemes import RecognizedPhonemes
from lipservo.speech.speech import Speech
from lipservo.speech.speech_board import SpeechBoard
from lipservo.speech.spoken_phonemes import SpokenPhonemes
from lipsync.arrays import Array
from lipsync.audio.playback_clock import OwnPlaybackClock, clock_for
from lipsync.audio.playout import Playout
from lipsync.audio.source import AudioSource
from lipsync.face.synthesizer import Synthesizer
from lipsync.offline.performed_motion import PerformedMotion
from lipsync.phonemes import LiveRecognizer
from lipsync.recognition.servo_speeds import ServoSpeeds

#: Full speed is told three times, a tenth of a second apart, since nobody acknowledges it.
_MARGIN_S: Final = 0.3


class SpeechSide:
    """`begin` once, `advance` in each tick."""

    def __init__(
        self,
        speech: Speech,
        voice: OwnVoice | None = None,
        mouth: AdjustableMouth | None = None,
        rest: Array | None = None,
    ) -> None:
        """mouth: takes what is set of it, and moves livelier with a voice that is excited.

        rest: the face (n_components,) of a mouth at rest, for while the face is stopped.
        """
        self._rest = rest
        self.speech = speech
        self.voice = voice
        self._mouth = mouth
        self._servo_speeds = ServoSpeeds()
        #: Where it tells what it shows; None: nobody watches.
        self.board: SpeechBoard | None = None

    def begin(self, zero_s: float) -> None:
        """The sound begins at monotonic `zero_s`."""
        self.speech.begin(zero_s)
        if self.voice is not None:
            self.voice.begin()

    def advance(self, now_s: float) -> None:
        """Hear, play and publish all that is due at monotonic `now_s`."""
        if self.voice is not None:
            self.voice.advance(now_s)
        self.speech.advance(now_s)
        if self._mouth is not None and self.speech.expression is not None:
            self._mouth.follow(now_s, self.speech.expression.mouth_gain)
        if self.board is not None:
            self.board.tell(now_s, self.speech)

    def note_servos(self, time_s: float, positions_deg: Array) -> None:
        """All servos of the face (n_servos,) stood there at monotonic `time_s`, by encoders."""
        found = self._servo_speeds.take(time_s, positions_deg)
        if found is not None:
            self.speech.note_servo_speeds(*found)

    def change(self, settings: Mapping[str, float]) -> None:
        """Take what was set while the face runs, by name; what nobody here knows is left alone."""
        if self._mouth is not None:
            self._mouth.change(settings)
        if self.speech.lip_gap is not None:
            self.speech.lip_gap.change(settings)
        if self.speech.expression is not None:
            self.speech.expression.change(settings)

    def fall_silent(self) -> None:
        """The face is stopped: nothing is said any more."""
        if self.voice is not None:
            self.voice.fall_silent()

    def follow_stop(self, now_s: float, *, is_stopped: bool) -> None:
        """Before `advance`: a face that a person has stopped says nothing, and its mouth rests."""
        if is_stopped:
            self.fall_silent()
            if self._rest is not None:
                self.speech.cut_off(now_s, self._rest)


def make_speech_side(
    face: Face,
    source: AudioSource,
    recognizer: LiveRecognizer,
    synthesizer: Synthesizer,
    channel: TargetChannel,
    *,
    has_soft_start: bool,
    is_watchable: bool = True,
) -> SpeechSide:
    """Everything between an entered source and the targets of a face's servos.

    has_soft_start: the servos are slow at first, so that nothing is said until they are not.
    is_watchable: somebody may look on whose twin has eyes; where nobody can, a face that is only a
    mouth has no expression.
    """
    names: Sequence[str] = list(face.settings.servos)
    mouth = AdjustableMouth(synthesizer)
    expression = None
    if is_watchable or expression_servos(face.settings):
        expression = make_expression(face.settings, face.folder)
    voice = None if expression is None else expression.voice
    if not isinstance(source, Playout):
        heard = RecognizedPhonemes(source, recognizer, voice)
        clock = clock_for(source)
        speech = Speech(
            heard, clock, synthesizer, face.calibration, names, channel, expression=expression
        )
        speech.lip_gap = _lip_gap(face)
        return SpeechSide(speech, mouth=mouth, rest=face.model.rest)
    spoken = SpokenPhonemes(source, recognizer)
    source.on_said = None if voice is None else voice.hear
    played = OwnPlaybackClock()
    speech = Speech(
        spoken,
        played,
        PerformedMotion(synthesizer, performed_in(source)),
        face.calibration,
        names,
        channel,
        least_delay_s=source.latency_s,
        expression=expression,
    )
    speech.lip_gap = _lip_gap(face)
    quiet_s = SOFT_FOR_S + _MARGIN_S if has_soft_start else 0.0
    own = OwnVoice(source, played, speech, face.model.rest, quiet_s=quiet_s)
    return SpeechSide(speech, own, mouth, face.model.rest)


def _lip_gap(face: Face) -> LipGapOffset:
    offset_mm = face.settings.motion.lip_gap_offset_mm or 0.0
    return LipGapOffset(face.model, offset_mm, PUBLISH_PERIOD_S)
