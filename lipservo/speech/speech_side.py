"""Sound to targets: the speech side of a face, with its own voice where it has one."""

from collections.abc import Sequence
from typing import Final

from firmware_bridge.dynamixel.soft_start import SOFT_FOR_S
from firmware_bridge.targets import TargetChannel
from lipservo.face.assembly import Face
from lipservo.speech.own_voice import OwnVoice
from lipservo.speech.recognized_phonemes import RecognizedPhonemes
from lipservo.speech.speech import Speech
from lipservo.speech.spoken_phonemes import SpokenPhonemes
from lipsync.audio.playback_clock import OwnPlaybackClock, clock_for
from lipsync.audio.playout import Playout
from lipsync.audio.source import AudioSource
from lipsync.face.synthesizer import Synthesizer
from lipsync.phonemes import LiveRecognizer

#: Full speed is told three times, a tenth of a second apart, since nobody acknowledges it.
_MARGIN_S: Final = 0.3


class SpeechSide:
    """`begin` once, `advance` in each tick."""

    def __init__(self, speech: Speech, voice: OwnVoice | None = None) -> None:
        self.speech = speech
        self.voice = voice

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

    def fall_silent(self) -> None:
        """The face is stopped: nothing is said any more."""
        if self.voice is not None:
            self.voice.fall_silent()


def make_speech_side(
    face: Face,
    source: AudioSource,
    recognizer: LiveRecognizer,
    synthesizer: Synthesizer,
    channel: TargetChannel,
    *,
    has_soft_start: bool,
) -> SpeechSide:
    """Everything between an entered source and the targets of a face's servos.

    has_soft_start: the servos are slow at first, so that nothing is said until they are not.
    """
    names: Sequence[str] = list(face.settings.servos)
    if not isinstance(source, Playout):
        heard = RecognizedPhonemes(source, recognizer)
        clock = clock_for(source)
        return SpeechSide(Speech(heard, clock, synthesizer, face.calibration, names, channel))
    spoken = SpokenPhonemes(source, recognizer)
    played = OwnPlaybackClock()
    speech = Speech(
        spoken,
        played,
        synthesizer,
        face.calibration,
        names,
        channel,
        least_delay_s=source.latency_s,
    )
    quiet_s = SOFT_FOR_S + _MARGIN_S if has_soft_start else 0.0
    return SpeechSide(speech, OwnVoice(source, played, speech, face.model.rest, quiet_s=quiet_s))
