"""The speech of a sound file as the text of an export: phonemes and frames as `replay` has them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

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
from lipsync.animpho.units import load_face_with_animphos
from lipsync.arrays import Array
from lipsync.audio.file import FileSource
from lipsync.audio.playback_clock import clock_for
from lipsync.export.arkit import ARKIT_NAMES, ArkitMap, lip_measures
from lipsync.export.mouth_cues import MouthCue, cues_json, cues_tsv, cues_xml, rule_cues
from lipsync.export.ovr_visemes import OVR_NAMES, viseme_weights
from lipsync.export.shapes_of_motion import (
    lips_shut,
    motion_cues,
    sampling_times_s,
    shape_prototypes,
)
from lipsync.export.weight_track import (
    WeightTrack,
    frame_times_s,
    live_link_csv,
    track_csv,
    track_lines,
)
from lipsync.face.frame import Frame
from lipsync.face.model import load_face
from lipsync.phonemes import PhonemeEvent
from lipsync.recognition.fallback import FallbackRecognizer
from lipsync.recognition.recognizers import make_recognizer
from lipsync.recognition.scripted import ScriptedPhonemes
from lipsync.text_to_speech.pronunciation import spoken_words
from lipsync.textgrid import read_phonemes


@dataclass(frozen=True, slots=True)
class Exported:
    """What is exported. ending: of the file, lower case.

    phonemes: a TextGrid, or None: listen, and follow the text if there is one.
    """

    file_format: Literal["rhubarb", "arkit", "ovr"]
    ending: str
    sound: Path
    phonemes: Path | None
    text: str
    shapes: Literal["motion", "rules"]
    rate_hz: float


@dataclass(frozen=True, slots=True)
class SpokenSound:
    """A sound file, who says its phonemes, and how they become motion.

    script: a TextGrid, or None: the recogniser listens, and follows the text if there is one.
    """

    path: Path
    script: Path | None
    motion: MotionOptions
    config: str
    model: Path | None
    text: str = ""

    @property
    def duration_s(self) -> float:
        """How long the sound is. Raises SoundError."""
        return FileSource(self.path).duration_s

    def events(self) -> list[PhonemeEvent]:
        """The phonemes in order. Raises LabelError for a script, SoundError for a sound."""
        if self.script is not None:
            return list(read_phonemes(self.script))
        recognizer = self._recognizer()
        return list(settled_events(FileSource(self.path), recognizer))

    def _recognizer(self) -> FallbackRecognizer:
        """Told the text. Raises PronunciationError."""
        recognizer = make_recognizer(self.motion.engine, None, self.motion.weights)
        if self.text:
            recognizer.tell(spoken_words(self.text))
        return recognizer

    def frames(self, times_s: Sequence[float] | Array) -> list[Frame]:
        """The faces of ascending sound times, as the robot shows them."""
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
    """With the motion that was typed, or that the face's YAML says. Raises UserError."""
    settings, folder = load_settings(config)
    return SpokenSound(
        sound, script, motion_options(chosen, settings.motion, folder), config, model
    )


def motion_shapes(spoken: SpokenSound) -> list[MouthCue]:
    """The mouth shapes of what the robot shows."""
    duration_s = spoken.duration_s
    model = load_face_with_animphos(spoken.model)
    measures = lip_measures(model)
    frames = spoken.frames(sampling_times_s(duration_s))
    faces = np.array([frame.coefficients for frame in frames])
    shut = lips_shut(measures, faces)
    return motion_cues(shape_prototypes(model, measures), faces, shut, duration_s)


def exported_text(
    asked: Exported, chosen: ChosenMotion, config: str, model: Path | None
) -> tuple[str, dict[str, object]]:
    """What the file holds, and in a few words what that is. Raises UserError."""
    heard = spoken_sound(asked.sound, asked.phonemes, chosen, config, model)
    spoken = replace(heard, text=asked.text)
    duration_s = spoken.duration_s
    if asked.file_format == "rhubarb":
        is_motion = asked.shapes == "motion"
        cues = motion_shapes(spoken) if is_motion else rule_cues(spoken.events(), duration_s)
        text = _cue_text(cues, asked, duration_s)
        return text, {"duration_s": duration_s, "shapes": asked.shapes, "n_cues": len(cues)}
    times_s = frame_times_s(duration_s, asked.rate_hz)
    if asked.file_format == "arkit":
        arkit = ArkitMap(lip_measures(load_face_with_animphos(model)))
        values = np.array([arkit.values(frame) for frame in spoken.frames(times_s)])
        names = ARKIT_NAMES
    else:
        values = viseme_weights(spoken.events(), times_s, load_face(model).tightest_s)
        names = OVR_NAMES
    track = WeightTrack(asked.file_format, asked.rate_hz, names, times_s, values)
    write = live_link_csv if track.kind == "arkit" else track_csv
    text = track_lines(track) if asked.ending == ".jsonl" else write(track)
    return text, {"duration_s": duration_s, "rate_hz": asked.rate_hz, "n_frames": len(times_s)}


def _cue_text(cues: Sequence[MouthCue], asked: Exported, duration_s: float) -> str:
    if asked.ending == ".tsv":
        return cues_tsv(cues)
    write = cues_json if asked.ending == ".json" else cues_xml
    return write(cues, str(asked.sound), duration_s)
