"""One line, from what is heard and said in it to the motion of the mouth: the paper's method."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from lipsync.arrays import Array, Indices
from lipsync.offline.likeliest_motion import likeliest_trajectory
from lipsync.offline.path import Path, cheapest_path
from lipsync.offline.state_distances import (
    Candidates,
    Window,
    gaussian_window,
    nearest_of_each_state,
    unit_distances,
)
from lipsync.offline.state_model import StateModel
from lipsync.offline.stored_units import Spans, joined_phones, unit_spans, warped_distances
from lipsync.phonemes import PHONEMES, PhonemeEvent, stand_in

#: Of the Gaussian around a frame in equation (2), s.
WINDOW_DEVIATION_S = 0.04


@dataclass(frozen=True, slots=True)
class ModelledLine:
    """Motion (n, p) in the model's own components, one a frame, and the path it took."""

    motion: Array
    path: Path


def model_line(model: StateModel, cepstra: Array, events: Sequence[PhonemeEvent]) -> ModelledLine:
    """The motion of a line by the published method.

    cepstra: (n, m) at the model's frame rate, normalised like the model's; events: its phones.
    """
    duration_s = len(cepstra) / model.frame_rate_hz
    phones = joined_phones(events, duration_s)
    spans = unit_spans(phones, len(cepstra), model.frame_rate_hz)
    search = _UnitSearch(model, cepstra, spans)
    path = cheapest_path(len(cepstra), search.candidates, model.follows, search.widen)
    precisions = np.asarray(np.linalg.inv(model.covariances[path.states]), dtype=np.float64)
    motion = likeliest_trajectory(model.means[path.states], precisions)
    return ModelledLine(motion, path)


@dataclass(slots=True)
class _Ranked:
    """The stored units of one phone of the line, most similar first, and those in use.

    states and distances: of each unit in use, (n_j,) and (n frames of the span, n_j).
    """

    order: Indices
    states: list[Indices] = field(default_factory=list)
    distances: list[Array] = field(default_factory=list)


class _UnitSearch:
    """Which units are open to a line, and through them which states to each frame."""

    def __init__(self, model: StateModel, cepstra: Array, spans: Spans) -> None:
        self._model = model
        self._spans = spans
        self._window: Window = gaussian_window(WINDOW_DEVIATION_S, model.frame_rate_hz)
        n = len(cepstra)
        self._heard = self._window.of(cepstra, np.arange(n), (0, n))
        self._left, self._right = spans.neighbours(n, model.frame_rate_hz)
        known = frozenset(PHONEMES[i] for i in np.unique(model.units.phonemes))
        self._ranked = [
            _Ranked(self._order(cepstra[first:end], stand_in(phoneme, known)))
            for phoneme, first, end in zip(spans.phonemes, spans.first, spans.end, strict=True)
        ]
        for number in range(len(self._ranked)):
            self._take_next(number)

    def candidates(self, frame: int) -> Candidates:
        """Equation (2) from all units in use of the frame's left and right phone."""
        states: list[Indices] = []
        distances: list[Array] = []
        for number in {int(self._left[frame]), int(self._right[frame])}:
            ranked = self._ranked[number]
            states += ranked.states
            distances += [each[frame - self._spans.first[number]] for each in ranked.distances]
        return nearest_of_each_state(states, distances)

    def widen(self, frame: int) -> int | None:
        """One more unit for the frame's left and right phone; the first frame that is changed."""
        taken = [
            number
            for number in sorted({int(self._left[frame]), int(self._right[frame])})
            if self._take_next(number)
        ]
        return min(int(self._spans.first[number]) for number in taken) if taken else None

    def _order(self, target: Array, phonemes: tuple[str, ...]) -> Indices:
        """The numbers of all units of these phonemes, those that sound most alike first."""
        units = self._model.units
        numbers = np.concatenate([units.of(PHONEMES.index(p)) for p in phonemes])
        stored = [
            self._model.cepstra[units.first[i] : units.end[i]].astype(np.float64) for i in numbers
        ]
        return np.asarray(numbers[np.argsort(warped_distances(target, stored), kind="stable")])

    def _take_next(self, number: int) -> bool:
        """Open the next unit of a phone of the line; False where there is none left."""
        ranked = self._ranked[number]
        n_taken = len(ranked.states)
        if n_taken == len(ranked.order):
            return False
        unit = int(ranked.order[n_taken])
        first, end = int(self._model.units.first[unit]), int(self._model.units.end[unit])
        borders = self._model.sentence_of(first)
        stored = self._window.of(self._model.cepstra, np.arange(first, end), borders)
        span = slice(self._spans.first[number], self._spans.end[number])
        ranked.states.append(self._model.states[first:end])
        ranked.distances.append(unit_distances(self._heard[span], stored))
        return True
