"""The motion at 100 Hz that a recording gives by what is heard of it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lipservo_lab.evaluation.motion.methods import LiveMethod
from lipservo_lab.evaluation.recognition.recognized_file import recognize_file
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipsync.arrays import Array
from lipsync.audio.file import FileSource
from lipsync.motion.tick_plan import TICK_S
from lipsync.phonemes import SILENCE, LiveRecognizer


@dataclass(frozen=True, slots=True)
class HeardMotion:
    """faces: (n, n_components) at times_s (n,), a tick apart; spoken_s: heard as speech.

    sound_s: how long the recording is; the faces go on a little in the silence after it.
    """

    times_s: Array
    faces: Array
    spoken_s: float
    sound_s: float = 0.0


def heard_motion(
    recording: Path, recognizer: LiveRecognizer, model: TrainedModel, lookahead_s: float
) -> HeardMotion:
    """Play a recording to a recogniser, which is reset, and the live method by what it says."""
    heard = recognize_file(recognizer, recording)
    n_ticks = round((heard.events[-1].end_s or 0.0) / TICK_S)
    times_s = np.arange(n_ticks, dtype=np.float64) * TICK_S
    spoken_s = sum(
        (event.end_s or 0.0) - event.start_s for event in heard.events if event.phoneme != SILENCE
    )
    faces = LiveMethod().faces(model, heard, times_s, lookahead_s)
    with FileSource(recording) as source:
        return HeardMotion(times_s, faces, spoken_s, source.duration_s)
