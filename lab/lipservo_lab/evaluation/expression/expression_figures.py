"""The figures of a face's expression that `lipservo bench face` prints."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import cycle, islice

import numpy as np

from lipservo_lab.evaluation.expression.blink_times import blinks_per_min
from lipservo_lab.evaluation.expression.gaze_shifts import GazeShifts, gaze_shifts
from lipservo_lab.evaluation.expression.prosody_to_head import (
    canonical_r,
    canonical_r_shuffled,
    lag_ms,
)
from lipservo_lab.evaluation.expression.shown_expression import ShownExpression, cues_of, shown
from lipsync.expression.cue import CUE_PERIOD_S, ExpressionSource
from lipsync.prosody.voice_frame import SILENT_VOICE, VoiceFrame

#: Of a dialogue: this much of the voice, then as much silence.
_TURN_S = 5.0
_COUNTED_S = 1200.0


@dataclass(frozen=True, slots=True)
class ExpressionFigures:
    """Of one source and one voice.

    blink_per_min_dialogue: turns of 5 s of the voice and of silence. saccade_*: in talk, sizes at
    percentiles 50 and 90, share below 15 degrees, milliseconds a degree, median time between two.
    canonical_r: at the lag found; shuffled: at the same lag. expression_step_ms: 95th percentile.
    """

    blink_per_min_talking: float
    blink_per_min_silent: float
    blink_per_min_dialogue: float
    saccade_median_deg: float
    saccade_p90_deg: float
    saccade_share_below_15_deg: float
    saccade_ms_per_deg: float
    saccade_interval_s: float
    prosody_lag_ms: float
    canonical_r: float
    canonical_r_shuffled: float
    expression_step_ms: float


def expression_figures(
    make_source: Callable[[], ExpressionSource], voice: Iterable[VoiceFrame]
) -> ExpressionFigures:
    """Figures of a source, new for each measure, with a voice that is repeated as often as needed.

    Blinks are counted over 20 minutes. Raises ValueError for a voice without a frame.
    """
    frames = list(voice)
    if not frames:
        raise ValueError("no voice to measure with: 0 frames; one at least is needed")
    n_counted = round(_COUNTED_S / CUE_PERIOD_S)
    talking = _shown(make_source(), islice(cycle(frames), n_counted))
    silent = _shown(make_source(), islice(_pauses(frames), n_counted))
    dialogue = _shown(make_source(), islice(_turns(frames), n_counted))
    once = _first(talking, min(len(frames), n_counted))
    lag = lag_ms(once)
    shifts = gaze_shifts(talking.gaze_deg)
    return ExpressionFigures(
        blinks_per_min(talking.column("lid_left"), talking.is_speaking),
        blinks_per_min(silent.column("lid_left"), ~silent.is_speaking),
        blinks_per_min(dialogue.column("lid_left"), np.ones_like(dialogue.is_speaking)),
        *_saccade_figures(shifts),
        lag,
        canonical_r(once, max(0.0, lag * 1e-3)),
        canonical_r_shuffled(once, max(0.0, lag * 1e-3)),
        float(np.percentile(talking.step_ms, 95)),
    )


def _shown(source: ExpressionSource, voice: Iterable[VoiceFrame]) -> ShownExpression:
    return shown(source, cues_of(voice))


def _turns(frames: Sequence[VoiceFrame]) -> Iterator[VoiceFrame]:
    """The voice in turns, with silence between them, without end."""
    heard = cycle(frames)
    n_turn = round(_TURN_S / CUE_PERIOD_S)
    while True:
        yield from islice(heard, n_turn)
        yield from (SILENT_VOICE for _ in range(n_turn))


def _pauses(frames: Sequence[VoiceFrame]) -> Iterator[VoiceFrame]:
    """Half a second of voice every two minutes, so that the face is never at rest."""
    n_word, n_pause = round(0.5 / CUE_PERIOD_S), round(120.0 / CUE_PERIOD_S)
    word = [frame for frame in frames if frame.is_speech][:n_word]
    while True:
        yield from word
        yield from (SILENT_VOICE for _ in range(n_pause))


def _first(whole: ShownExpression, n: int) -> ShownExpression:
    """The first n cues: a voice repeated would be told from shuffled ones too easily."""
    return ShownExpression(
        whole.values[:n],
        whole.is_speaking[:n],
        whole.loudness_z[:n],
        whole.pitch_z[:n],
        whole.step_ms[:n],
    )


def _saccade_figures(shifts: GazeShifts) -> tuple[float, float, float, float, float]:
    return (
        float(np.median(shifts.magnitude_deg)),
        float(np.percentile(shifts.magnitude_deg, 90)),
        float(np.mean(shifts.magnitude_deg < 15.0)),
        shifts.seconds_per_deg * 1e3,
        float(np.median(np.diff(shifts.start_s))),
    )
