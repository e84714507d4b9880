"""How long a method takes for a phoneme and for a frame, on the phonemes that it is scored on."""

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from lipservo_lab.evaluation.motion.methods import (
    Heard,
    LiveMethod,
    Method,
    PublishedMethod,
    script_of,
)
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipsync.animpho.synthesizer import PublishedSynthesizer
from lipsync.face.frame import Frame
from lipsync.motion.live_synthesizer import LiveSynthesizer
from lipsync.motion.tick_plan import TICK_S
from lipsync.phonemes import PhonemeScript, PhonemeUpdate


@dataclass(frozen=True, slots=True)
class Times:
    """95th percentiles, ms, of the time to decide a phoneme and to compute a frame at 100 Hz."""

    phoneme_p95_ms: float
    frame_p95_ms: float


class _Synthesizer(Protocol):
    @property
    def phonemes_planned(self) -> int: ...

    def push(self, update: PhonemeUpdate) -> None: ...

    def frame_at(self, time_s: float) -> Frame: ...


def method_times(
    method: Method, model: TrainedModel, sentences: Iterable[Heard], lookahead_s: float
) -> Times | None:
    """Return a method's computing times for a phoneme and for a frame, at 100 Hz.

    None for methods that exist only for whole sentences. A tick in which a phoneme begins to move
    the mouth counts as the phoneme's cost, with what was recognised then; all others count as
    frames. The published method gets a whole sentence beforehand, as when it is scored; its
    look-ahead is the phone's own length.
    """
    phoneme_ms: list[float] = []
    frame_ms: list[float] = []
    for heard in sentences:
        synthesizer: _Synthesizer
        if isinstance(method, LiveMethod):
            synthesizer = method.synthesizer(model, lookahead_s)
            script = script_of(heard, lookahead_s)
        elif isinstance(method, PublishedMethod):
            synthesizer, script = method.synthesizer(model), _WholeSentence(heard)
        else:
            return None
        _add_times(synthesizer, script, heard, phoneme_ms, frame_ms)
    return Times(_p95(phoneme_ms), _p95(frame_ms))


class _WholeSentence:
    """A sentence that is known as a whole from the beginning."""

    def __init__(self, heard: Heard) -> None:
        self._updates = [PhonemeUpdate(0.0, math.inf, math.inf, heard.events)]

    def updates(self, until_s: float) -> list[PhonemeUpdate]:  # noqa: ARG002 - all at once
        due, self._updates = self._updates, []
        return due


def _add_times(
    synthesizer: LiveSynthesizer | PublishedSynthesizer | _Synthesizer,
    script: PhonemeScript,
    heard: Heard,
    phoneme_ms: list[float],
    frame_ms: list[float],
) -> None:
    """Synthesise a sentence and append the milliseconds of each 10 ms tick to one of two lists.

    Ticks in which a phoneme was planned go to `phoneme_ms`, all others to `frame_ms`.
    """
    for tick in range(int((heard.events[-1].end_s or 0.0) / TICK_S)):
        time_s = tick * TICK_S
        updates, n_planned = script.updates(time_s), synthesizer.phonemes_planned
        start_s = time.perf_counter()
        for update in updates:
            synthesizer.push(update)
        synthesizer.frame_at(time_s)
        elapsed_ms = (time.perf_counter() - start_s) * 1e3
        (phoneme_ms if synthesizer.phonemes_planned > n_planned else frame_ms).append(elapsed_ms)


def _p95(values: Sequence[float]) -> float:
    return float(np.percentile(values, 95)) if values else float("nan")
