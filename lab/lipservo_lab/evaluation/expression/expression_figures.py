"""The figures of a face's expression that `lipservo bench face` prints.

Blinks, found in the position of a lid, and how often they come; how much later than the voice's
loudness a head nods. Both are measured on what a source of expressions shows to a voice, as arrays.
A cue is the input of a source every `CUE_PERIOD_S`.
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

#: A lid that is more shut than this blinks (1: shut); with the gaze down it is half shut at most.
_SHUT = 0.66


def blink_cues(lid: Array) -> Indices:
    """Return the cues at which a lid passes two thirds on its way to shut.

    Parameters
    ----------
    lid : Array
        (n,), 0 open to 1 shut, at each cue.

    Returns
    -------
    Indices
        (n_blinks,) indices of cues.
    """
    is_shut = lid > _SHUT
    return np.flatnonzero(is_shut[1:] & ~is_shut[:-1]) + 1


def blinks_per_min(lid: Array, counts: NDArray[np.bool_]) -> float:
    """Return the number of blinks a minute among the chosen cues.

    Parameters
    ----------
    lid, counts : Array
        (n,) at each cue: 0 open to 1 shut; and whether the cue counts.

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
#: A pause within a sentence counts as speech until it has lasted so long, as in a running face.
_PAUSE_S = 0.3


@dataclass(frozen=True, slots=True)
class ShownExpression:
    """What a source of expressions showed at n cues, CUE_PERIOD_S apart.

    values: (n, 10), columns as in NAMES, NaN for parts that the source leaves alone. is_speaking:
    (n,). loudness_z, pitch_z: (n,), of the voice in standard deviations; 0 without speech.
    """

    values: Array
    is_speaking: NDArray[np.bool_]
    loudness_z: Array
    pitch_z: Array

    def column(self, name: str) -> Array:
        """Return one degree of freedom over all cues.

        Parameters
        ----------
        name : str
            A field of `Expression`.

        Returns
        -------
        Array
            (n,), in the field's unit.
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
    """Yield the cues of a face that speaks with this voice and has no person to look at.

    voice: a frame every CUE_PERIOD_S.
    """
    silent_s, has_spoken = 0.0, False
    for n, frame in enumerate(voice, start=1):
        silent_s = 0.0 if frame.is_speech else silent_s + CUE_PERIOD_S
        has_spoken = has_spoken or frame.is_speech
        is_speaking = has_spoken and silent_s < _PAUSE_S
        yield ExpressionCue(n * CUE_PERIOD_S, frame, is_speaking, silent_s, arousal=frame.arousal)


def shown(source: ExpressionSource, cues: Iterable[ExpressionCue]) -> ShownExpression:
    """Feed cues to a source of expressions; return all that it showed."""
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


#: Largest lag that is tried, either way.
_MOST_LAG_S: Final = 0.5


def lag_ms(shown: ShownExpression) -> float:
    """Return the lag, ms, at which |cross-correlation| of loudness and nodding speed is largest.

    Loudness is 0 outside speech; the speed is that of the neck's pitch. Lags up to half a second
    either way are tried. Positive: the head moves later than the voice.
    """
    loudness = _centred(np.where(shown.is_speaking, shown.loudness_z, 0.0))
    velocity = _centred(_velocity(shown.column("neck_pitch_deg")))
    n_most = round(_MOST_LAG_S / CUE_PERIOD_S)
    inner = slice(n_most, len(loudness) - n_most)
    lags = np.arange(-n_most, n_most + 1)
    strengths = [
        abs(float(loudness[inner] @ velocity[n_most + lag : len(velocity) - n_most + lag]))
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
    """Figures of one source of expressions with one voice."""

    blink_per_min_talking: float
    blink_per_min_silent: float
    prosody_lag_ms: float


def expression_figures(
    make_source: Callable[[], ExpressionSource], voice: Iterable[VoiceFrame]
) -> ExpressionFigures:
    """Return the figures of an expression source with a voice.

    make_source: called anew for each measure. voice: its frames are repeated as often as needed;
    blinks are counted over 20 minutes. Raises ValueError for a voice without a frame.
    """
    frames = list(voice)
    if not frames:
        raise ValueError("no voice to measure with: 0 frames; one at least is needed")
    n_counted = round(_COUNTED_S / CUE_PERIOD_S)
    talking = _shown_to(make_source(), islice(cycle(frames), n_counted))
    silent = _shown_to(make_source(), islice(_long_pauses(frames), n_counted))
    unrepeated = _first_cues(talking, min(len(frames), n_counted))
    return ExpressionFigures(
        blinks_per_min(talking.column("lid_left"), talking.is_speaking),
        blinks_per_min(silent.column("lid_left"), ~silent.is_speaking),
        lag_ms(unrepeated),
    )


def _shown_to(source: ExpressionSource, voice: Iterable[VoiceFrame]) -> ShownExpression:
    return shown(source, cues_of(voice))


def _long_pauses(frames: Sequence[VoiceFrame]) -> Iterator[VoiceFrame]:
    """Yield without end half a second of the voice's speech and two minutes of silence, in turn.

    The short speech keeps the face from going to rest.
    """
    n_speech, n_pause = round(0.5 / CUE_PERIOD_S), round(120.0 / CUE_PERIOD_S)
    speech = [frame for frame in frames if frame.is_speech][:n_speech]
    while True:
        yield from speech
        yield from (SILENT_VOICE for _ in range(n_pause))


def _first_cues(whole: ShownExpression, n: int) -> ShownExpression:
    """Return the first n cues."""
    return ShownExpression(
        whole.values[:n], whole.is_speaking[:n], whole.loudness_z[:n], whole.pitch_z[:n]
    )
