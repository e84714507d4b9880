"""The phonemes and mouth shapes of a sound file, as `lipservo replay` computes them."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from firmware_bridge.loop.targets import MemoryTargetChannel
from lipservo.runtime.motion_options import (
    ChosenMotion,
    MotionOptions,
    make_synthesizer,
    motion_options,
)
from lipservo.runtime.run_request import Sound
from lipservo.runtime.servos.assembly import assemble_face, load_settings
from lipservo.runtime.settled_phonemes import settled_events
from lipservo.runtime.sound import open_sound
from lipservo.runtime.speech.phoneme_sources import RecognizedPhonemes
from lipservo.runtime.speech.speech import PUBLISH_PERIOD_S, Speech
from lipsync.arrays import Array
from lipsync.audio.file import FileSource
from lipsync.audio.playback_clock import clock_for
from lipsync.face.frame import Frame
from lipsync.phonemes import PhonemeEvent
from lipsync.recognition.fallback import FallbackRecognizer
from lipsync.recognition.recognizers import make_recognizer
from lipsync.recognition.scripted import ScriptedPhonemes
from lipsync.text_to_speech.pronunciation import spoken_words
from lipsync.textgrid import read_phonemes


@dataclass(frozen=True, slots=True)
class SpokenSound:
    """A sound file, the source of its phonemes, and the options by which they become motion.

    script: a TextGrid of them; None: the recogniser is used, and follows `text` if not empty.
    """

    path: Path
    script: Path | None
    motion: MotionOptions
    config: str
    model: Path | None
    text: str = ""

    @property
    def duration_s(self) -> float:
        """Duration of the sound in s. Raises SoundError."""
        return FileSource(self.path).duration_s

    def events(self) -> list[PhonemeEvent]:
        """Return the phonemes in order. Raises LabelError, SoundError, PronunciationError."""
        if self.script is not None:
            return list(read_phonemes(self.script))
        recognizer = self._recognizer()
        return list(settled_events(FileSource(self.path), recognizer))

    def _recognizer(self) -> FallbackRecognizer:
        """Return a new recogniser that follows the text, if any. Raises PronunciationError."""
        recognizer = make_recognizer(self.motion.engine, None, self.motion.weights)
        if self.text:
            recognizer.tell(spoken_words(self.text))
        return recognizer

    def frames(self, times_s: Sequence[float] | Array) -> list[Frame]:
        """Return the mouth shapes that the robot shows at given times of the sound.

        Parameters
        ----------
        times_s : Sequence[float] | Array
            (n,) sound times in seconds, ascending.

        Returns
        -------
        list[Frame]
            n frames.
        """
        face = assemble_face(self.config, self.model)
        synthesizer = make_synthesizer(face.model, self.motion, self.model)
        script = None if self.script is None else ScriptedPhonemes(read_phonemes(self.script))
        recognizer = self._recognizer()
        found: list[Frame] = []
        with open_sound(Sound("file", str(self.path))) as source:
            speech = Speech(
                script or RecognizedPhonemes(source, recognizer),
                clock_for(source),
                synthesizer,
                face.calibration,
                list(face.settings.servos),
                MemoryTargetChannel(),
            )
            speech.begin(0.0)
            n = 0
            for time_s in times_s:
                while speech.sound_time_s(n * PUBLISH_PERIOD_S) < time_s:
                    n += 1
                    speech.advance(n * PUBLISH_PERIOD_S)
                found.append(speech.shown_at(float(time_s))[1])
        return found


def spoken_sound(
    sound: Path, script: Path | None, chosen: ChosenMotion, config: str, model: Path | None
) -> SpokenSound:
    """Return a `SpokenSound` of the file `sound`, whose motion options are those in `chosen`.

    Options that `chosen` lacks are those of the face YAML `config`. script: a TextGrid of the
    phonemes, None: recognised; model: file of the face model, None: the default. Raises UserError.
    """
    settings, folder = load_settings(config)
    return SpokenSound(
        sound, script, motion_options(chosen, settings.motion, folder), config, model
    )
