"""What a source of expressions shows to a voice, as arrays, and how long it takes."""

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from typing import Final

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array
from lipsync.expression.cue import CUE_PERIOD_S, ExpressionCue, ExpressionSource
from lipsync.face.frame import Expression
from lipsync.prosody.voice_frame import VoiceFrame

#: Columns of a track of expressions.
NAMES: Final = tuple(field.name for field in fields(Expression))
#: As the speech side counts: a pause within a sentence is speech until it has lasted so long.
_PAUSE_S = 0.3


@dataclass(frozen=True, slots=True)
class ShownExpression:
    """A track of n cues, CUE_PERIOD_S apart.

    values: (n, 9), columns by NAMES, NaN where absent. is_speaking: (n,). loudness_z, pitch_z:
    (n,), of the voice. step_ms: (n,), how long each step took.
    """

    values: Array
    is_speaking: NDArray[np.bool_]
    loudness_z: Array
    pitch_z: Array
    step_ms: Array

    def column(self, name: str) -> Array:
        """One degree of freedom by its name in `Expression`."""
        return self.values[:, NAMES.index(name)]

    @property
    def gaze_deg(self) -> Array:
        """(n, 2): yaw and pitch in the robot's frame, head and eyes together."""
        yaw_deg = self.column("neck_yaw_deg") + self.column("eye_yaw_deg")
        return np.column_stack(
            [yaw_deg, self.column("neck_pitch_deg") + self.column("eye_pitch_deg")]
        )


def cues_of(voice: Iterable[VoiceFrame]) -> Iterator[ExpressionCue]:
    """The cues of a face that speaks with this voice and looks at nobody in particular."""
    silent_s, has_spoken = 0.0, False
    for n, frame in enumerate(voice, start=1):
        silent_s = 0.0 if frame.is_speech else silent_s + CUE_PERIOD_S
        has_spoken = has_spoken or frame.is_speech
        is_speaking = has_spoken and silent_s < _PAUSE_S
        yield ExpressionCue(n * CUE_PERIOD_S, frame, is_speaking, silent_s, arousal=frame.arousal)


def shown(source: ExpressionSource, cues: Iterable[ExpressionCue]) -> ShownExpression:
    """Steps a source through cues, each step timed."""
    values, speaking, loudness, pitch, took = [], [], [], [], []
    for cue in cues:
        began_ns = time.perf_counter_ns()
        expression = source.step(cue)
        took.append((time.perf_counter_ns() - began_ns) * 1e-6)
        values.append([_number(getattr(expression, name)) for name in NAMES])
        speaking.append(cue.is_speaking)
        loudness.append(cue.voice.loudness_z if cue.voice.is_speech else 0.0)
        pitch.append(cue.voice.pitch_z if cue.voice.is_speech else 0.0)
    return ShownExpression(
        np.array(values), np.array(speaking), np.array(loudness), np.array(pitch), np.array(took)
    )


def _number(value: float | None) -> float:
    return float("nan") if value is None else value
