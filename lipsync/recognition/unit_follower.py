"""Phonemes with times, held against what is heard: shifted, smoothed, or not believed.

A sender's times are often off: a coder's priming or a resampler shifts them, a changed rate
stretches them, a rounding of its own scatters them; sometimes they are of another sentence. So each
frame of sound is compared with the units around it. What is searched is how much later than sent
the units sound, a path of offsets through the frames (dynamic time warping, Sakoe and Chiba, IEEE
Transactions on Acoustics, Speech, and Signal Processing 26(1), 1978, as a Viterbi search). A change
of the offset costs much on a rigid path, little on a loose one, which is for times that are
scattered; and beside both runs the escape of `text_decoder`, for units that are not spoken.
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
_RIGID, _LOOSE, _ESCAPE = 0, 1, 2
_NEVER: Final = np.float32(-1e9)
#: Offsets of so many frames are hardly any.
_NEAR: Final = 3
#: Of a frame for which nothing is sent.
_UNKNOWN: Final = -1
#: Between two units: a shorter gap is silence, in a longer one somebody may be heard.
_GAP_S: Final = 0.5
#: The offset that is reported: the median of so many frames.
_REPORTED_FRAMES: Final = 50


@dataclass(frozen=True, slots=True)
class UnitSettings:
    """Costs in natural-log units, chosen on recordings that are not scored (docs/recognition.md).

    reach: frames that units may be early or late. delay: frames that the head of the network waits
    that is listened to. lowest: least score of a viseme class in one frame, relative to the
    likeliest. rigid, loose: of each frame by which the offset changes. looseness: of every frame on
    the loose path. escape: of every frame on the escape. switch: of going from one path to the
    other; leave, resume: to the escape and back. unknown: of every frame for which nothing is sent.
    moved: of every frame that is hardly moved: borders that are heard are no more exact than those
    that are sent. first: of each frame of the first offset.
    settled_frames: frames after which the offset of a frame is final.
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
        self._settings = settings
        n = 2 * settings.reach + 1
        self.offsets: NDArray[np.int64] = np.arange(n) - settings.reach
        costs = np.array([settings.rigid, settings.loose], np.float32)[:, None]
        self._changes = costs
        self._slopes = costs * np.arange(n, dtype=np.float32)
        is_near = (self.offsets != 0) & (np.abs(self.offsets) <= _NEAR)
        self._moved = np.where(is_near, np.float32(settings.moved), np.float32(0.0))
        as_sent = -np.float32(settings.first) * np.abs(self.offsets).astype(np.float32)
        self._scores = np.stack((as_sent, as_sent - np.float32(settings.switch)))
        self._escape = np.float32(-0.5 * settings.leave)
        self._kept: deque[tuple[Array32, np.float32]] = deque([(self._scores, self._escape)])

    def push(self, agreement: Array32) -> None:
        """Search one frame further, given how well the unit at each offset agrees with it.

        Parameters
        ----------
        agreement : Array32
            (n_offsets,), natural logs: 0 for the likeliest viseme class, else negative.
        """
        s, settings = self._scores, self._settings
        best = self._from_within(s)
        best = np.maximum(best, s[::-1] - np.float32(settings.switch))
        best[_RIGID] = np.maximum(best[_RIGID], self._escape - np.float32(settings.resume))
        best += agreement - self._moved
        best[_LOOSE] -= np.float32(settings.looseness)
        escape = max(self._escape, s.max() - np.float32(settings.leave))
        escape -= np.float32(settings.escape)
        top = max(best.max(), escape)
        self._scores, self._escape = best - top, escape - top
        self._kept.append((self._scores, self._escape))
        if len(self._kept) > settings.settled_frames:
            self._kept.popleft()

    def _from_within(self, s: Array32) -> Array32:
        """Return the best score of each offset by staying, one frame later, or any earlier."""
        down = np.maximum.accumulate((s - self._slopes)[:, ::-1], axis=1)[:, ::-1] + self._slopes
        up = np.full_like(s, _NEVER)
        up[:, 1:] = s[:, :-1] - self._changes
        return np.maximum(down, up)

    def path(self) -> list[tuple[int, int]]:
        """Return (path, offset) of the best path in each of the last frames, the oldest first.

        path: 0 rigid, 1 loose, 2 escape. offset: in frames of 10 ms, positive: later than sent.
        """
        settings = self._settings
        scores, escape = self._kept[-1]
        mode, at = divmod(int(scores.argmax()), scores.shape[1])
        if escape >= scores[mode, at]:
            mode = _ESCAPE
        found = [(mode, int(self.offsets[at]))]
        for k in range(len(self._kept) - 2, 0, -1):
            before, before_escape = self._kept[k]
            if mode == _ESCAPE:
                m, d = divmod(int(before.argmax()), before.shape[1])
                if before[m, d] - settings.leave > before_escape:
                    mode, at = m, d
            else:
                mode, at = self._source(before, before_escape, mode, at)
            found.append((mode, int(self.offsets[at])))
        return found[::-1]

    def _source(
        self, before: Array32, before_escape: np.float32, mode: int, at: int
    ) -> tuple[int, int]:
        """Return the (path, index of its offset) from which the best path came to (mode, at).

        before, before_escape: scores one frame earlier; mode: the path, 0 rigid or 1 loose.
        """
        cost, row = self._changes[mode, 0], before[mode]
        down = row[at:] - cost * np.arange(len(row) - at, dtype=np.float32)
        longest = int(down.argmax())
        sources = [
            (down[longest], mode, at + longest),
            (before[1 - mode, at] - self._settings.switch, 1 - mode, at),
        ]
        if at:
            sources.append((row[at - 1] - cost, mode, at - 1))
        if mode == _RIGID:
            sources.append((before_escape - self._settings.resume, _ESCAPE, at))
        _, mode, at = max(sources, key=lambda source: source[0])
        return mode, at


#: (start_s, end_s, events): from when until when these are spoken, and nothing else.
Stretch = tuple[float, float, tuple[PhonemeEvent, ...]]


class UnitFollower:
    """The units of one stretch of sound, moved to where they are heard; times are sound time.

    Until something is heard of the sound, the units are believed as they were sent.
    """

    def __init__(self, start_s: float, settings: UnitSettings = FOLLOWED) -> None:
        """Begin where the sound begins. `end_s` is set once it is known where it ends."""
        self._settings = settings
        self._search = OffsetSearch(settings)
        self._start_s = start_s
        self.end_s = math.inf
        self._units: tuple[PhonemeEvent, ...] = ()
        self._starts_s: list[float] = []
        self._first_cell = self._n_next = math.floor(start_s * _FRAMES_PER_S + 0.5)
        self._cells = np.zeros(0, np.int64)
        self._path: list[tuple[int, int]] = []
        self._offsets: deque[int] = deque(maxlen=_REPORTED_FRAMES)

    @property
    def is_believed(self) -> bool:
        """Whether the units move the mouth now, rather than what is heard."""
        return not self._path or self._path[-1][0] != _ESCAPE

    @property
    def shifted_s(self) -> float:
        """How much later than sent the units sound: the median of the last half second."""
        return float(np.median(self._offsets)) / _FRAMES_PER_S if self._offsets else 0.0

    def tell(self, units: Sequence[PhonemeEvent]) -> None:
        """Store all units around the present, in place of those sent before; all have ends."""
        self._units = tuple(units)
        self._starts_s = [unit.start_s for unit in units]
        self._cells = np.zeros(0, np.int64)

    def hear(self, heard: FramePosteriors) -> None:
        """Search the units in the next frames of the sound, given by their posteriors.

        Posteriors at another rate than 100 a second, or without the head that is listened to, are
        ignored.
        """
        settings = self._settings
        if heard.frames_per_s != _FRAMES_PER_S or settings.delay not in heard.delays:
            return
        head = heard.delays.index(settings.delay)
        classes = log_class_posteriors(heard.values[:, head])
        classes -= classes.max(axis=1, keepdims=True)
        np.maximum(classes, np.float32(settings.lowest), out=classes)
        first = heard.first_frame - settings.delay
        for frame, row in enumerate(classes, first):
            if self._n_next <= frame < self.end_s * _FRAMES_PER_S:
                self._n_next = frame + 1
                classes_sent = self._classes(frame)
                agreement = row[np.maximum(classes_sent, 0)]
                agreement[classes_sent == _UNKNOWN] = -settings.unknown
                self._search.push(agreement)
                self._path = self._search.path()
        if self._path and self.is_believed:
            self._offsets.append(self._path[-1][1])

    def stretches(self, from_s: float, until_s: float) -> list[Stretch]:
        """Return what the units say between two times, in order; elsewhere what is heard counts."""
        frames = [
            (frame, mode, offset)
            for frame, (mode, offset) in enumerate(self._path, self._n_next - len(self._path))
            if frame + 1 > from_s * _FRAMES_PER_S
        ]
        found: list[Stretch] = []
        for is_heard, run in groupby(frames, key=lambda each: each[1] == _ESCAPE):
            if not is_heard:
                found += self._along([(frame, offset) for frame, _, offset in run])
        if self.is_believed:
            offset = self._path[-1][1] if self._path else 0
            now_s = self._n_next / _FRAMES_PER_S if self._path else self._start_s
            found += self._moved(now_s, until_s, offset / _FRAMES_PER_S)
        if found and found[0][0] <= from_s:
            # A unit that is being spoken stays one.
            began_s = max(self._start_s, found[0][2][0].start_s)
            found[0] = (began_s, *found[0][1:])
        return _joined(found, self._start_s, min(until_s, self.end_s))

    def _along(self, path: Sequence[tuple[int, int]]) -> list[Stretch]:
        """Return the stretches of sound in which units are late by one and the same offset.

        path: (frame, offset) of each frame of sound; offset: frames that the sound is later than
        the times that were sent.
        """
        found: list[Stretch] = []
        for offset, run in groupby(path, key=lambda each: each[1]):
            frames = [frame for frame, _ in run]
            first_s, end_s = frames[0] / _FRAMES_PER_S, (frames[-1] + 1) / _FRAMES_PER_S
            found += self._moved(first_s, end_s, offset / _FRAMES_PER_S)
        return found

    def _moved(self, from_s: float, until_s: float, by_s: float) -> list[Stretch]:
        """Return the units, and silences between them, `by_s` later, from one time to another."""
        first = max(0, bisect_right(self._starts_s, from_s - by_s) - 1)
        found: list[Stretch] = []
        before_s = self._start_s + by_s if first == 0 else -math.inf
        for unit in self._units[first:]:
            event = unit.later(by_s)
            end_s = math.inf if event.end_s is None else event.end_s
            if 0.0 < event.start_s - before_s <= _GAP_S:
                silence = PhonemeEvent(SILENCE, before_s, event.start_s)
                found.append((before_s, event.start_s, (silence,)))
            if event.start_s >= until_s:
                break
            found.append((event.start_s, end_s, (event,)))
            before_s = end_s
        cut = [(max(a, from_s), min(b, until_s), events) for a, b, events in found]
        return [each for each in cut if each[0] < each[1]]

    def _classes(self, frame: int) -> NDArray[np.int64]:
        """Return the class sent at each offset for the sound's frame `frame`."""
        reach = self._settings.reach
        first = frame - reach
        if not self._first_cell <= first <= self._first_cell + len(self._cells) - 2 * reach - 1:
            self._lay_out(first)
        at = first - self._first_cell
        return self._cells[at : at + 2 * reach + 1][::-1]

    def _lay_out(self, first_cell: int) -> None:
        """Write the class of each frame from `first_cell` on, a second more than is in reach."""
        self._first_cell = first_cell
        n_cells = 2 * self._settings.reach + 1 + _FRAMES_PER_S
        self._cells = np.full(n_cells, _UNKNOWN)
        start = math.floor(self._start_s * _FRAMES_PER_S + 0.5) - first_cell
        self._cells[: max(0, start)] = VISEME_OF[SILENCE]
        times_s = first_cell / _FRAMES_PER_S, (first_cell + n_cells) / _FRAMES_PER_S
        for start_s, end_s, (event,) in self._moved(*times_s, 0.0):
            cells = slice(*(round(t * _FRAMES_PER_S) - first_cell for t in (start_s, end_s)))
            self._cells[cells] = VISEME_OF[event.phoneme]


def _joined(stretches: Sequence[Stretch], from_s: float, until_s: float) -> list[Stretch]:
    """Return the stretches between two times, those that touch as one.

    What is spoken twice, where the offset changes within a unit, is one event.
    """
    joined: list[Stretch] = []
    for start_s, end_s, events in stretches:
        start_s, end_s = max(start_s, from_s), min(end_s, until_s)
        if end_s <= start_s:
            continue
        (event,) = events
        if not joined or joined[-1][1] < start_s - 1e-6:
            joined.append((start_s, end_s, (replace(event, end_s=end_s),)))
            continue
        first_s, _, before = joined[-1]
        if before[-1].phoneme == event.phoneme:
            before, event = before[:-1], replace(before[-1], end_s=end_s)
        else:
            event = replace(event, start_s=start_s, end_s=end_s)
        joined[-1] = (first_s, end_s, (*before, event))
    return joined
