"""The phonemes and mouth shapes of a sound file, as `lipservo replay` computes them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from firmware_bridge.loop.targets import MemoryTargetChannel
from lipservo.rendering.spoken_line import pronounced_words
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
from lipsync.audio.file import FileSource, checked_sound
from lipsync.audio.playback_clock import clock_for
from lipsync.face.frame import Frame
from lipsync.phoneme_files.label_file import LabelFile
from lipsync.phoneme_files.reader import Labels, read_labels
from lipsync.phonemes import PhonemeEvent
from lipsync.recognition.fallback import FallbackRecognizer
from lipsync.recognition.recognizers import make_recognizer
from lipsync.recognition.scripted import ScriptedPhonemes
from lipsync.text_to_speech.pronunciation import spoken_words


@dataclass(frozen=True, slots=True)
class SpokenSound:
    """A sound file, the source of its phonemes, and the options by which they become motion.

    labels: phonemes or words; None: the recogniser is used, and follows `text` if not empty.
    config, model: the face's YAML, by name or path, and its face model; None: the default one.
    channel: the sound channel that is used; "": all are mixed.
    """

    path: Path
    labels: Labels | None
    motion: MotionOptions
    config: str
    model: Path | None
    text: str = ""
    channel: str = ""

    @property
    def duration_s(self) -> float:
        """Duration of the sound in s. Raises SoundError."""
        return checked_sound(self.path, self.channel).duration_s

    def events(self) -> list[PhonemeEvent]:
        """Return the phonemes in order. Raises SoundError, PronunciationError."""
        if self.labels is not None and self.labels.phones:
            return list(self.labels.phones)
        source = FileSource(self.path, channel=self.channel)
        return list(settled_events(source, self._recognizer()))

    def _recognizer(self) -> FallbackRecognizer:
        """Return a new recogniser that follows words or text, if any. Raises PronunciationError."""
        recognizer = make_recognizer(self.motion.engine, None, self.motion.weights)
        if self.labels is not None:
            recognizer.tell(pronounced_words(self.labels.words))
        elif self.text:
            recognizer.tell(spoken_words(self.text))
        return recognizer

    def frames(self, times_s: Sequence[float] | Array) -> Iterator[Frame]:
        """Yield the mouth shapes that the robot shows at given times of the sound.

        The speech side of a running face computes them, 100 a second, on the sound's own clock.

        Parameters
        ----------
        times_s : Sequence[float] | Array
            (n,) sound times in seconds, ascending.

        Yields
        ------
        Frame
            n frames; none is kept.
        """
        face = assemble_face(self.config, self.model)
        synthesizer = make_synthesizer(face.model, self.motion, self.model)
        phones = () if self.labels is None else self.labels.phones
        script = ScriptedPhonemes(phones) if phones else None
        recognizer = self._recognizer()
        with open_sound(Sound("file", str(self.path), channel=self.channel)) as source:
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
                yield speech.shown_at(float(time_s))[1]


def spoken_sound(
    sound: Path,
    script: LabelFile | None,
    chosen: ChosenMotion,
    config: str,
    model: Path | None,
    stage: float = 0.0,
) -> SpokenSound:
    """Return a `SpokenSound` of the file `sound`, whose motion options are those in `chosen`.

    Options that `chosen` lacks are those of the face YAML `config`. script: labels of the phonemes,
    None: recognised; model: file of the face model, None: the default; stage: how far the mouth
    moves for viewers at 3 m, 0 to 1, where YAML and `chosen` say nothing. Raises UserError.
    """
    settings, folder = load_settings(config)
    options = motion_options(chosen, settings.motion, folder, stage)
    labels = labels_of(sound, script)
    return SpokenSound(sound, labels, options, config, model, channel=settings.sound.channel)


def labels_of(sound: Path, script: LabelFile | None) -> Labels | None:
    """Return the labels of a sound file; None without a file. Raises SoundError, LabelError."""
    return None if script is None else read_labels(script, checked_sound(sound).duration_s)
