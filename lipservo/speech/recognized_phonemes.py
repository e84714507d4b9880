"""Phonemes that a recogniser finds in sound."""

import math

from lipservo.speech.heard_voice import HeardVoice
from lipsync.arrays import Array
from lipsync.audio.source import AudioSource
from lipsync.phonemes import Hearing, Listener, LiveRecognizer, PhonemeUpdate, ServoListener
from lipsync.recognition.streaming import RecognizerStream, SoundAhead


class RecognizedPhonemes:
    """A `PhonemeSource` that feeds the sound of a source to a recogniser."""

    def __init__(
        self, source: AudioSource, recognizer: LiveRecognizer, voice: HeardVoice | None = None
    ) -> None:
        """voice: hears the same sound."""
        self._voice = voice
        self._source = source
        self._recognizer = recognizer
        self._sound = SoundAhead(source, recognizer)
        self._recognition = RecognizerStream(recognizer)
        self._heard_until_s = 0.0

    @property
    def latency_s(self) -> float:
        """At sound time t the phonemes before t - latency_s are settled."""
        return self._recognizer.latency_s

    @property
    def heard_until_s(self) -> float:
        """Sound has been heard until then."""
        return self._heard_until_s

    @property
    def hears(self) -> Hearing | None:
        """What is believed about the sound; None where the recogniser does not say."""
        return self._recognizer.hears if isinstance(self._recognizer, Listener) else None

    def note_servo_speeds(self, sound_s: float, speeds_deg_s: Array) -> None:
        """The robot's servos turned so fast; only a device can hear them, a file cannot."""
        if self._source.is_live and isinstance(self._recognizer, ServoListener):
            self._recognizer.note_servo_speeds(sound_s, speeds_deg_s)

    def updates(self, until_s: float) -> list[PhonemeUpdate]:
        """Hear the sound that is due at sound time `until_s`; what became known by it."""
        # A device gives what has arrived, whatever the clock says.
        blocks = self._sound.blocks(math.inf if self._source.is_live else until_s)
        if self._voice is not None:
            for block in blocks:
                self._voice.hear(block)
        step = self._recognition.feed(blocks)
        if blocks:
            self._heard_until_s = blocks[-1].end_s
        return list(step.updates)
