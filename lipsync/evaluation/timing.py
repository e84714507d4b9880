"""How long a method takes for a phoneme and for a frame."""

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from lipsync.animpho.live import TICK_S, LiveSynthesizer, Style
from lipsync.animpho.model import FaceModel
from lipsync.animpho.selection import SelectionStrategy
from lipsync.animpho.synthesizer import PublishedSynthesizer
from lipsync.phonemes import PhonemeEvent, PhonemeUpdate


@dataclass(frozen=True, slots=True)
class Times:
    """95th percentiles in milliseconds: of deciding a phoneme, of one frame at 100 Hz."""

    phoneme_p95_ms: float
    frame_p95_ms: float


def live_times(model: FaceModel, sentences: Iterable[Sequence[PhonemeEvent]]) -> Times:
    """Ours: a phoneme costs hearing of it and the first frame it moves."""
    phoneme_ms: list[float] = []
    frame_ms: list[float] = []
    for events in sentences:
        synthesizer = LiveSynthesizer(model, Style(lookahead_s=0.0))
        n_told = 0
        for tick in range(int((events[-1].end_s or 0.0) / TICK_S)):
            time_s, began = tick * TICK_S, time.perf_counter()
            is_new = n_told < len(events) and events[n_told].start_s <= time_s
            if is_new:
                event = events[n_told]
                n_told += 1
                going_on = PhonemeEvent(event.phoneme, event.start_s, None)
                synthesizer.push(PhonemeUpdate(event.start_s, time_s, event.start_s, (going_on,)))
            synthesizer.coefficients_at(time_s)
            (phoneme_ms if is_new else frame_ms).append((time.perf_counter() - began) * 1e3)
    return Times(_p95(phoneme_ms), _p95(frame_ms))


def published_times(
    model: FaceModel, strategy: SelectionStrategy, sentences: Iterable[Sequence[PhonemeEvent]]
) -> Times:
    """The paper's: a phoneme costs selection and blending, at its first frame."""
    phoneme_ms: list[float] = []
    frame_ms: list[float] = []
    for events in sentences:
        synthesizer = PublishedSynthesizer(model, strategy)
        synthesizer.push(PhonemeUpdate(0.0, np.inf, np.inf, tuple(events)))
        begins = {round(e.start_s / TICK_S) for e in events}
        for tick in range(int((events[-1].end_s or 0.0) / TICK_S)):
            began = time.perf_counter()
            synthesizer.coefficients_at(tick * TICK_S)
            took_ms = (time.perf_counter() - began) * 1e3
            (phoneme_ms if tick in begins else frame_ms).append(took_ms)
    return Times(_p95(phoneme_ms), _p95(frame_ms))


def _p95(values: Sequence[float]) -> float:
    return float(np.percentile(values, 95)) if values else float("nan")
