"""The figures of a face's expression that `lipservo bench face` prints.

Blinks found in the track of a lid, and how often they come.

What a source of expressions shows to a voice, as arrays.

How much later than the voice a head moves.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from itertools import cycle, islice
from typing import Final

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array, Indices
from lipsync.expression.cue import CUE_PERIOD_S, ExpressionCue, ExpressionSource
from lipsync.face.frame import Expression
from lipsync.prosody.voice_frame import SILENT_VOICE, VoiceFrame

#: A lid that is more than half shut blinks: a gaze down takes it to half at most.
_SHUT = 0.66


def blink_cues(lid: Array) -> Indices:
    """Return the cues at which a lid passes two thirds on its way to shut.

    Parameters
    ----------
    lid : Array
        (n,).

    Returns
    -------
    Indices
        (n_blinks,) numbers.
    """
    is_shut = lid > _SHUT
    return np.flatnonzero(is_shut[1:] & ~is_shut[:-1]) + 1


def blinks_per_min(lid: Array, counts: NDArray[np.bool_]) -> float:
    """Return blinks a minute among the cues that count.

    Parameters
    ----------
    lid,counts : Array
        (n,).

    Returns
    -------
    float
        NaN where no cue counts.
    """
    if not counts.any():
        return float("nan")
    minutes = float(counts.sum()) * CUE_PERIOD_S / 60.0
    return float(counts[blink_cues(lid)].sum()) / minutes


#: Columns of a track of expressions.
NAMES: Final = tuple(field.name for field in fields(Expression))
#: As the speech side counts: a pause within a sentence is speech until it has lasted so long.
_PAUSE_S = 0.3


@dataclass(frozen=True, slots=True)
class ShownExpression:
    """A track of n cues, CUE_PERIOD_S apart.

    values: (n, 10), columns by NAMES, NaN where absent. is_speaking: (n,). loudness_z, pitch_z:
    (n,), of the voice.
    """

    values: Array
    is_speaking: NDArray[np.bool_]
    loudness_z: Array
    pitch_z: Array

    def column(self, name: str) -> Array:
        """Return one degree of freedom by its name in `Expression`.

        Parameters
        ----------
        name : str
            Of it.

        Returns
        -------
        Array
            (n,).
        """
        return self.values[:, NAMES.index(name)]

    @property
    def gaze_deg(self) -> Array:
        """Yaw and pitch in the robot's frame, head and eyes together.

        Returns
        -------
        Array
            (n, 2) degrees.
        """
        yaw_deg = self.column("neck_yaw_deg") + self.column("eye_yaw_deg")
        return np.column_stack(
            [yaw_deg, self.column("neck_pitch_deg") + self.column("eye_pitch_deg")]
        )


def cues_of(voice: Iterable[VoiceFrame]) -> Iterator[ExpressionCue]:
    """The cues of a face that speaks with this voice and has no person to look at."""
    silent_s, has_spoken = 0.0, False
    for n, frame in enumerate(voice, start=1):
        silent_s = 0.0 if frame.is_speech else silent_s + CUE_PERIOD_S
        has_spoken = has_spoken or frame.is_speech
        is_speaking = has_spoken and silent_s < _PAUSE_S
        yield ExpressionCue(n * CUE_PERIOD_S, frame, is_speaking, silent_s, arousal=frame.arousal)


def shown(source: ExpressionSource, cues: Iterable[ExpressionCue]) -> ShownExpression:
    """Steps a source through cues."""
    values, speaking, loudness, pitch = [], [], [], []
    for cue in cues:
        expression = source.step(cue)
        values.append([_number(getattr(expression, name)) for name in NAMES])
        speaking.append(cue.is_speaking)
        loudness.append(cue.voice.loudness_z if cue.voice.is_speech else 0.0)
        pitch.append(cue.voice.pitch_z if cue.voice.is_speech else 0.0)
    return ShownExpression(*map(np.array, (values, speaking, loudness, pitch)))


def _number(value: float | None) -> float:
    return float("nan") if value is None else value


#: Lags looked through, either way.
_MOST_LAG_S: Final = 0.5


def lag_ms(shown: ShownExpression) -> float:
    """Return how much later head pitch velocity follows loudness, ms, by |cross-correlation|.

    Loudness counts in speech only; both are sampled at cue times. Positive: the head is later.
    """
    loudness = _centred(np.where(shown.is_speaking, shown.loudness_z, 0.0))
    velocity = _centred(_velocity(shown.column("neck_pitch_deg")))
    most = round(_MOST_LAG_S / CUE_PERIOD_S)
    inner = slice(most, len(loudness) - most)
    lags = np.arange(-most, most + 1)
    strengths = [
        abs(float(loudness[inner] @ velocity[most + lag : len(velocity) - most + lag]))
        for lag in lags
    ]
    return float(lags[int(np.argmax(strengths))]) * CUE_PERIOD_S * 1e3


def _velocity(values: Array) -> Array:
    return np.asarray(np.gradient(values, CUE_PERIOD_S))


def _centred(values: Array) -> Array:
    return np.asarray(values - values.mean())


_COUNTED_S = 1200.0


@dataclass(frozen=True, slots=True)
class ExpressionFigures:
    """Of one source and one voice."""

    blink_per_min_talking: float
    blink_per_min_silent: float
    prosody_lag_ms: float


def expression_figures(
    make_source: Callable[[], ExpressionSource], voice: Iterable[VoiceFrame]
) -> ExpressionFigures:
    """Return the figures of an expression source, made anew for each measure.

    The voice is repeated as often as needed; blinks are counted over 20 minutes. Raises ValueError
    for a voice without a frame.
    """
    frames = list(voice)
    if not frames:
        raise ValueError("no voice to measure with: 0 frames; one at least is needed")
    n_counted = round(_COUNTED_S / CUE_PERIOD_S)
    talking = _shown(make_source(), islice(cycle(frames), n_counted))
    silent = _shown(make_source(), islice(_pauses(frames), n_counted))
    once = _first(talking, min(len(frames), n_counted))
    return ExpressionFigures(
        blinks_per_min(talking.column("lid_left"), talking.is_speaking),
        blinks_per_min(silent.column("lid_left"), ~silent.is_speaking),
        lag_ms(once),
    )


def _shown(source: ExpressionSource, voice: Iterable[VoiceFrame]) -> ShownExpression:
    return shown(source, cues_of(voice))


def _pauses(frames: Sequence[VoiceFrame]) -> Iterator[VoiceFrame]:
    """Half a second of voice every two minutes, so that the face is never at rest."""
    n_word, n_pause = round(0.5 / CUE_PERIOD_S), round(120.0 / CUE_PERIOD_S)
    word = [frame for frame in frames if frame.is_speech][:n_word]
    while True:
        yield from word
        yield from (SILENT_VOICE for _ in range(n_pause))


def _first(whole: ShownExpression, n: int) -> ShownExpression:
    """The first n cues, in which no voice is repeated."""
    return ShownExpression(
        whole.values[:n], whole.is_speaking[:n], whole.loudness_z[:n], whole.pitch_z[:n]
    )
