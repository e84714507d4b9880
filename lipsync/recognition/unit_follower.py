"""Phonemes sent with times ("units"), compared with the sound: shifted, smoothed, or ignored.

A sender's times are often off: a coder's priming or a resampler shifts them, a changed rate
stretches them, rounding scatters them; sometimes they are of another sentence. So each frame of
sound is compared with the units around it. The search finds how much later than sent the units
sound: a path of offsets through the frames (dynamic time warping, Sakoe and Chiba, IEEE
Transactions on Acoustics, Speech, and Signal Processing 26(1), 1978, as a Viterbi search). A change
of the offset costs much in the rigid mode, little in the loose one, which is for times that are
scattered. A third mode, the escape (as in `text_decoder`), wins where the units are not spoken.
"""

import math
from bisect import bisect_right
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Final

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array32
from lipsync.phonemes import SILENCE, VISEME_OF, FramePosteriors, PhonemeEvent
from lipsync.recognition.decoder import log_class_posteriors

_FRAMES_PER_S: Final = 100
#: Modes of the path; the escape: the sound does not contain the units.
_RIGID, _LOOSE, _ESCAPE = 0, 1, 2
_NEVER: Final = np.float32(-1e9)
#: Offsets of 1 to 3 frames are within what is heard inexactly, and cost `UnitSettings.moved`.
_NEAR: Final = 3
#: In place of a viseme class, for a frame of which the sender said nothing.
_UNKNOWN: Final = -1
#: A shorter gap between two units is silence; in a longer one the recogniser's phonemes count.
_GAP_S: Final = 0.5
#: The offset that is reported: the median of so many frames.
_REPORTED_FRAMES: Final = 50


@dataclass(frozen=True, slots=True)
class UnitSettings:
    """Costs in natural-log units, chosen on recordings that are not scored (docs/recognition.md).

    reach: the largest offset, in frames to both sides. delay: the network's head that is used is
    the one that waits so many frames. lowest: least score of a viseme class in one frame, relative
    to the likeliest. rigid, loose: cost, in that mode, of each frame by which the offset changes.
    looseness, escape: cost of every frame in the loose mode, in the escape. switch: of a change
    between rigid and loose; leave, resume: of a change to the escape, and back. unknown: of every
    frame for which nothing was sent. moved: of every frame at an offset of 1 to 3 frames, as heard
    borders are no more exact than sent ones. first: of each frame of the first offset.
    settled_frames: frames of scores that are stored; a frame's offset is final after them.
    """

    reach: int = 75
    delay: int = 7
    lowest: float = -5.0
    rigid: float = 3.0
    loose: float = 0.8
    looseness: float = 0.15
    escape: float = 1.2
    switch: float = 6.0
    leave: float = 8.0
    resume: float = 20.0
    unknown: float = 1.0
    moved: float = 0.2
    first: float = 0.05
    settled_frames: int = 17


FOLLOWED: Final = UnitSettings()


class OffsetSearch:
    """The search, frame by frame; offsets are whole frames, positive: later than sent."""

    def __init__(self, settings: UnitSettings = FOLLOWED) -> None:
        """Start in the rigid mode, at any offset; scores are (2 modes, n_offsets), natural logs."""
        self._settings = settings
        n_offsets = 2 * settings.reach + 1
        self.offsets: NDArray[np.int64] = np.arange(n_offsets) - settings.reach
        cost_per_frame = np.array([settings.rigid, settings.loose], np.float32)[:, None]
        self._change_costs = cost_per_frame
        self._ramps = cost_per_frame * np.arange(n_offsets, dtype=np.float32)
        is_near = (self.offsets != 0) & (np.abs(self.offsets) <= _NEAR)
        self._small_offset_costs = np.where(is_near, np.float32(settings.moved), np.float32(0.0))
        first_scores = -np.float32(settings.first) * np.abs(self.offsets).astype(np.float32)
        self._scores = np.stack((first_scores, first_scores - np.float32(settings.switch)))
        self._escape = np.float32(-0.5 * settings.leave)
        self._recent: deque[tuple[Array32, np.float32]] = deque([(self._scores, self._escape)])

    def push(self, agreement: Array32) -> None:
        """Search one frame further, given how well the unit at each offset agrees with it.

        Parameters
        ----------
        agreement : Array32
            (n_offsets,), natural logs: 0 for the likeliest viseme class, else negative.
        """
        # The best score of each mode and offset: within the mode, from the other, from the escape.
        scores, settings = self._scores, self._settings
        best = self._best_within_mode(scores)
        best = np.maximum(best, scores[::-1] - np.float32(settings.switch))
        best[_RIGID] = np.maximum(best[_RIGID], self._escape - np.float32(settings.resume))
        best += agreement - self._small_offset_costs
        best[_LOOSE] -= np.float32(settings.looseness)
        escape = max(self._escape, scores.max() - np.float32(settings.leave))
        escape -= np.float32(settings.escape)
        best_of_all = max(best.max(), escape)
        self._scores, self._escape = best - best_of_all, escape - best_of_all
        self._recent.append((self._scores, self._escape))
        if len(self._recent) > settings.settled_frames:
            self._recent.popleft()

    def _best_within_mode(self, scores: Array32) -> Array32:
        """Return each offset's best score, reached from offsets of the same mode one frame before.

        scores: (2 modes, n_offsets), also the shape returned. An offset may fall by any number of
        frames (units are skipped) and rise by one (a unit lasts longer), so units never go back.
        """
        down = np.maximum.accumulate((scores - self._ramps)[:, ::-1], axis=1)[:, ::-1] + self._ramps
        up = np.full_like(scores, _NEVER)
        up[:, 1:] = scores[:, :-1] - self._change_costs
        return np.maximum(down, up)

    def path(self) -> list[tuple[int, int]]:
        """Return (mode, offset) of the best path in each of the last frames, the oldest first.

        mode: 0 rigid, 1 loose, 2 escape. offset: in frames of 10 ms, positive: later than sent.
        """
        settings = self._settings
        scores, escape = self._recent[-1]
        mode, index = divmod(int(scores.argmax()), scores.shape[1])
        if escape >= scores[mode, index]:
            mode = _ESCAPE
        backwards = [(mode, int(self.offsets[index]))]
        for k in range(len(self._recent) - 2, 0, -1):
            scores_before, escape_before = self._recent[k]
            if mode == _ESCAPE:
                top_mode, top_index = divmod(int(scores_before.argmax()), scores_before.shape[1])
                if scores_before[top_mode, top_index] - settings.leave > escape_before:
                    mode, index = top_mode, top_index
            else:
                mode, index = self._predecessor(scores_before, escape_before, mode, index)
            backwards.append((mode, int(self.offsets[index])))
        return backwards[::-1]

    def _predecessor(
        self, scores_before: Array32, escape_before: np.float32, mode: int, index: int
    ) -> tuple[int, int]:
        """Return the (mode, offset's index) from which the best path came to (`mode`, `index`).

        scores_before, escape_before: scores one frame earlier. mode: 0 rigid or 1 loose.
        """
        cost, row = self._change_costs[mode, 0], scores_before[mode]
        fallen = row[index:] - cost * np.arange(len(row) - index, dtype=np.float32)
        n_fallen = int(fallen.argmax())
        # (score, mode, offset's index) from a larger offset, from the other mode, from the next
        # smaller offset, from the escape.
        sources = [
            (fallen[n_fallen], mode, index + n_fallen),
            (scores_before[1 - mode, index] - self._settings.switch, 1 - mode, index),
        ]
        if index:
            sources.append((row[index - 1] - cost, mode, index - 1))
        if mode == _RIGID:
            sources.append((escape_before - self._settings.resume, _ESCAPE, index))
        _, mode, index = max(sources, key=lambda source: source[0])
        return mode, index


#: (start_s, end_s, events): a time in which the units move the mouth, and the units in it.
Stretch = tuple[float, float, tuple[PhonemeEvent, ...]]


class UnitFollower:
    """The units sent with one stretch of sound, shifted to where they are heard; in sound time.

    Until some of the sound was heard, the units count at the times that were sent.
    """

    def __init__(self, start_s: float, settings: UnitSettings = FOLLOWED) -> None:
        """Begin where the sound begins; `end_s` is inf until the caller knows where it ends."""
        self._settings = settings
        self._search = OffsetSearch(settings)
        self._start_s = start_s
        self.end_s = math.inf
        self._units: tuple[PhonemeEvent, ...] = ()
        self._starts_s: list[float] = []
        self._first_sent = self._next_frame = math.floor(start_s * _FRAMES_PER_S + 0.5)
        self._sent = np.zeros(0, np.int64)
        self._path: list[tuple[int, int]] = []
        self._offsets: deque[int] = deque(maxlen=_REPORTED_FRAMES)

    @property
    def is_believed(self) -> bool:
        """Whether the units move the mouth now, rather than the phonemes that are recognised."""
        return not self._path or self._path[-1][0] != _ESCAPE

    @property
    def shifted_s(self) -> float:
        """Seconds that the units sound later than sent: the median of the last 50 offsets."""
        return float(np.median(self._offsets)) / _FRAMES_PER_S if self._offsets else 0.0

    def tell(self, units: Sequence[PhonemeEvent]) -> None:
        """Store the units around the present, in place of those stored before; all have ends."""
        self._units = tuple(units)
        self._starts_s = [unit.start_s for unit in units]
        self._sent = np.zeros(0, np.int64)

    def hear(self, heard: FramePosteriors) -> None:
        """Search for the units in the next frames of the sound, given by their posteriors.

        Posteriors are ignored if they are not 100 a second, or lack the head `settings.delay`.
        """
        settings = self._settings
        if heard.frames_per_s != _FRAMES_PER_S or settings.delay not in heard.delays:
            return
        log_classes = log_class_posteriors(heard.values[:, heard.delays.index(settings.delay)])
        log_classes -= log_classes.max(axis=1, keepdims=True)
        np.maximum(log_classes, np.float32(settings.lowest), out=log_classes)
        first_frame = heard.first_frame - settings.delay
        for frame, frame_log_classes in enumerate(log_classes, first_frame):
            if self._next_frame <= frame < self.end_s * _FRAMES_PER_S:
                self._next_frame = frame + 1
                # How well the class that each offset predicts agrees with the sound.
                classes_sent = self._classes_at_offsets(frame)
                agreement = frame_log_classes[np.maximum(classes_sent, 0)]
                agreement[classes_sent == _UNKNOWN] = -settings.unknown
                self._search.push(agreement)
                self._path = self._search.path()
        if self._path and self.is_believed:
            self._offsets.append(self._path[-1][1])

    def stretches(self, from_s: float, until_s: float) -> list[Stretch]:
        """Return when the units move the mouth between two times: (start_s, end_s, shifted units).

        In the rest of that time the recogniser's phonemes count. For times that the search has not
        reached, the units are shifted by its newest offset.
        """
        frames = [
            (frame, mode, offset)
            for frame, (mode, offset) in enumerate(self._path, self._next_frame - len(self._path))
            if frame + 1 > from_s * _FRAMES_PER_S
        ]
        found: list[Stretch] = []
        for is_escape, run in groupby(frames, key=lambda each: each[1] == _ESCAPE):
            if not is_escape:
                found += self._stretches_along([(frame, offset) for frame, _, offset in run])
        if self.is_believed:
            offset = self._path[-1][1] if self._path else 0
            now_s = self._next_frame / _FRAMES_PER_S if self._path else self._start_s
            found += self._shifted_units(now_s, until_s, offset / _FRAMES_PER_S)
        if found and found[0][0] <= from_s:
            # A unit that began before `from_s` keeps its start.
            found[0] = (max(self._start_s, found[0][2][0].start_s), *found[0][1:])
        return _merge_stretches(found, self._start_s, min(until_s, self.end_s))

    def _stretches_along(self, path: Sequence[tuple[int, int]]) -> list[Stretch]:
        """Return the units spoken in the frames of `path`, a stretch for each unit or silence.

        path: (frame, offset) of successive frames; the units are `offset` frames later than sent.
        """
        found: list[Stretch] = []
        for offset, run in groupby(path, key=lambda each: each[1]):
            frames = [frame for frame, _ in run]
            first_s, end_s = frames[0] / _FRAMES_PER_S, (frames[-1] + 1) / _FRAMES_PER_S
            found += self._shifted_units(first_s, end_s, offset / _FRAMES_PER_S)
        return found

    def _shifted_units(self, from_s: float, until_s: float, by_s: float) -> list[Stretch]:
        """Return the units moved `by_s` later, and silences in short gaps between them.

        One stretch each, cut to what lies between `from_s` and `until_s` (times after the move).
        """
        first = max(0, bisect_right(self._starts_s, from_s - by_s) - 1)
        # Silence before the first unit begins with the sound.
        found: list[Stretch] = []
        previous_end_s = self._start_s + by_s if first == 0 else -math.inf
        for unit in self._units[first:]:
            event = unit.later(by_s)
            end_s = math.inf if event.end_s is None else event.end_s
            if 0.0 < event.start_s - previous_end_s <= _GAP_S:
                silence = PhonemeEvent(SILENCE, previous_end_s, event.start_s)
                found.append((previous_end_s, event.start_s, (silence,)))
            if event.start_s >= until_s:
                break
            found.append((event.start_s, end_s, (event,)))
            previous_end_s = end_s
        clipped = [(max(a, from_s), min(b, until_s), events) for a, b, events in found]
        return [stretch for stretch in clipped if stretch[0] < stretch[1]]

    def _classes_at_offsets(self, frame: int) -> NDArray[np.int64]:
        """Return the viseme class that each offset predicts for `frame`, (n_offsets,), -1: none."""
        reach = self._settings.reach
        earliest = frame - reach
        if not self._first_sent <= earliest <= self._first_sent + len(self._sent) - 2 * reach - 1:
            self._lay_out_sent_classes(earliest)
        start = earliest - self._first_sent
        return self._sent[start : start + 2 * reach + 1][::-1]

    def _lay_out_sent_classes(self, first_frame: int) -> None:
        """Store in `_sent` the viseme class sent for each frame from `first_frame` on; -1: none.

        These are the frames that all offsets need (2 reach + 1), and another second.
        """
        self._first_sent = first_frame
        n_frames = 2 * self._settings.reach + 1 + _FRAMES_PER_S
        self._sent = np.full(n_frames, _UNKNOWN)
        n_before_sound = math.floor(self._start_s * _FRAMES_PER_S + 0.5) - first_frame
        self._sent[: max(0, n_before_sound)] = VISEME_OF[SILENCE]
        times_s = first_frame / _FRAMES_PER_S, (first_frame + n_frames) / _FRAMES_PER_S
        for start_s, end_s, (event,) in self._shifted_units(*times_s, 0.0):
            unit_frames = slice(*(round(t * _FRAMES_PER_S) - first_frame for t in (start_s, end_s)))
            self._sent[unit_frames] = VISEME_OF[event.phoneme]


def _merge_stretches(stretches: Sequence[Stretch], from_s: float, until_s: float) -> list[Stretch]:
    """Return the stretches clipped to `from_s` .. `until_s`, those that touch merged into one.

    Each stretch given has one event. Parts of one unit, where the offset changes within it, become
    one event.
    """
    merged: list[Stretch] = []
    for start_s, end_s, events in stretches:
        start_s, end_s = max(start_s, from_s), min(end_s, until_s)
        if end_s <= start_s:
            continue
        (event,) = events
        if not merged or merged[-1][1] < start_s - 1e-6:
            merged.append((start_s, end_s, (replace(event, end_s=end_s),)))
            continue
        first_s, _, earlier_events = merged[-1]
        if earlier_events[-1].phoneme == event.phoneme:
            earlier_events, event = earlier_events[:-1], replace(earlier_events[-1], end_s=end_s)
        else:
            event = replace(event, start_s=start_s, end_s=end_s)
        merged[-1] = (first_s, end_s, (*earlier_events, event))
    return merged
