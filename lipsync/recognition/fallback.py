"""The ladder of recognisers: one that fails is left, and tried again when all is quiet.

Levels from the best down: network, energy (the jaw only), neutral. A level that raises is left at
once, one that cannot keep up once there is a backlog (`Pace`); the next one takes over at the block
that the last one was not fed, and has heard the seconds before. Where a clock is given better
levels are tried again beside the one in use (`Trial`), and take over in a pause. The neutral level,
a closed mouth, cannot fail. Why so: docs/decisions/0038.
"""

import logging
import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

from lipsync.arrays import Array
from lipsync.audio_block import BLOCK_S, AudioBlock
from lipsync.phonemes import Hearing, LiveRecognizer, PhonemeUpdate
from lipsync.recognition.energy_recognizer import NeutralRecognizer
from lipsync.recognition.ladder_level import (
    AT_ONCE,
    BACKLOG_S,
    TRIED_SHARE,
    LadderLevel,
    Trial,
    fed,
)

_LOG: Final = logging.getLogger(__name__)
#: Sound that a level has heard before it takes over: the level of the voice and the noise floor are
#: known after it, and every filter is full.
WARM_UP_S = 3.0
#: Of sound that waits longer than this the oldest is left out; a microphone keeps 2 s.
LONGEST_WAITING_S = 3.0
#: There was no backlog for so long when a level is tried again.
_CALM_S = 1.0
#: From leaving a level to the first try; doubled each time that it fails or is soon left again.
_FIRST_WAIT_S = 2.0
#: The longest wait: where the computer was busy, and where the level itself raised or was slow.
_LONGEST_WAIT_BUSY_S, _LONGEST_WAIT_S = 8.0, 300.0
#: A level that was kept so long was rightly taken.
_KEPT_S = 30.0


@dataclass(frozen=True, slots=True)
class FallbackLevel:
    """A recogniser that can be made."""

    name: str
    make: Callable[[], LiveRecognizer]


class FallbackRecognizer:
    """A `PreparingRecognizer` that falls back to the next level instead of failing.

    All levels are made at the beginning, so that nothing is loaded while a face runs. latency_s: no
    level may need longer. timer_s: seconds on a clock, to see that a level does not keep up, and to
    try better ones again; None where nobody waits, and sound may be prepared ahead of its time.
    """

    def __init__(
        self,
        levels: Sequence[FallbackLevel],
        latency_s: float,
        timer_s: Callable[[], float] | None = None,
    ) -> None:
        self._latency_s = latency_s
        self._timer_s = timer_s
        self._levels: list[LadderLevel] = []
        # Why each level cannot be used, or was left last.
        self._why_not: list[str | None] = []
        for level in levels:
            self._add(level)
        self._levels.append(LadderLevel("neutral", NeutralRecognizer()))
        self._why_not.append(None)
        self._usable = tuple(n for n, reason in enumerate(self._why_not) if reason is None)
        self._final_until_s = 0.0
        self._recent: deque[AudioBlock] = deque(maxlen=round(WARM_UP_S / BLOCK_S))
        self._forget()

    @property
    def latency_s(self) -> float:
        """At sound time t the phonemes before t - latency_s are settled."""
        return self._latency_s

    @property
    def ahead_s(self) -> float:
        """How much sound `prepare` is best given at once; 0 where each block's time is judged."""
        return 0.0 if self._timer_s is not None else self._level.ahead_s

    @property
    def level(self) -> str:
        """The name of the level in use."""
        return self._level.name

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why each better level is not in use, the best first; empty while the best is."""
        better = zip(self._levels, self._why_not[: self._current], strict=False)
        return tuple(f"{level.name}: {reason}" for level, reason in better)

    @property
    def hears(self) -> Hearing | None:
        """What the level in use believes about the sound; None where it does not say."""
        return self._level.hears

    def note_servo_speeds(self, sound_s: float, speeds_deg_s: Array) -> None:
        """Pass it to the level in use, and to the one that is tried; never raises for them."""
        try:
            self._level.note_servo_speeds(sound_s, speeds_deg_s)
        except Exception as error:  # as in feed
            self._fall_back(_in_words(error))
        try:
            if self._trial is not None:
                self._trial.level.note_servo_speeds(sound_s, speeds_deg_s)
        except Exception:  # as in feed
            self._end_trial(_LONGEST_WAIT_S)

    def reset(self) -> None:
        """Back to the best level that could be made, ready for a new stream at sound time 0."""
        self._forget()

    def feed(self, block: AudioBlock) -> None:
        """Feed the next block; never raises for what a level raises."""
        self.feed_all((block,))

    def feed_all(self, blocks: Sequence[AudioBlock]) -> None:
        """Feed all blocks that have come, the oldest first; never raises for what a level raises.

        Where a clock is given, of more than `LONGEST_WAITING_S` the oldest are left out.
        """
        if self._timer_s is None:
            for block in blocks:
                self._hear((block,), lambda: 0.0, 0.0)
        elif blocks:
            self._keep_up(blocks, self._timer_s)

    def prepare(self, blocks: Sequence[AudioBlock]) -> None:
        """Let the level in use work on blocks that will be fed next; never raises for it."""
        try:
            self._level.prepare(blocks)
        except Exception as error:  # as in feed
            self._fall_back(_in_words(error))

    def updates(self) -> list[PhonemeUpdate]:
        """What became known; nothing that was final before changes, whichever level found it."""
        try:
            updates = self._level.updates()
        except Exception as error:  # as in feed
            self._fall_back(_in_words(error))
            return []
        kept = [_after(update, self._final_until_s) for update in updates]
        for update in kept:
            self._final_until_s = max(self._final_until_s, update.final_until_s)
        return kept

    @property
    def _level(self) -> LadderLevel:
        return self._levels[self._current]

    def _add(self, level: FallbackLevel) -> None:
        """Make a level; one that cannot be made keeps its place, and is never used."""
        recognizer: LiveRecognizer = NeutralRecognizer()
        reason = None
        try:
            recognizer = level.make()
        except Exception as error:  # a missing library, damaged weights
            reason = str(error)
        if recognizer.latency_s > self._latency_s + 1e-9:
            reason = f"needs {recognizer.latency_s} s"
        self._levels.append(LadderLevel(level.name, recognizer))
        self._why_not.append(reason)
        if reason is not None:
            _LOG.warning("recogniser %s cannot be used: %s", level.name, reason)

    def _forget(self) -> None:
        self._current = self._usable[0]
        self._final_until_s = 0.0
        self._recent.clear()
        self._trial: Trial | None = None
        self._next_tried = 0
        self._wait_s = _FIRST_WAIT_S
        self._calm_since_s = self._try_at_s = self._best_left_s = 0.0
        self._taken_s = -math.inf
        self._level.begin(0.0)

    def _keep_up(self, blocks: Sequence[AudioBlock], timer_s: Callable[[], float]) -> None:
        """`feed_all` by the clock: in a backlog several at once, and away from a level that fails.

        Sound goes on coming meanwhile: what waits is what is left, and as much as time has passed.
        """
        end_s = blocks[-1].end_s
        if end_s - blocks[0].start_s > LONGEST_WAITING_S:
            blocks = [each for each in blocks if each.end_s > end_s - LONGEST_WAITING_S]
        began_s = now_s = timer_s()
        waiting_s, n_fed = end_s - blocks[0].start_s, 0
        while n_fed < len(blocks):
            if waiting_s > BACKLOG_S:
                self._calm_since_s = now_s
            hurries = len(blocks) - n_fed >= AT_ONCE and self._level.pace.may_hurry
            chunk = blocks[n_fed : n_fed + (AT_ONCE if hurries else 1)]
            now_s = self._hear(chunk, timer_s, now_s)
            n_fed += len(chunk)
            waiting_s = end_s - chunk[-1].end_s + now_s - began_s
            pace = self._level.pace
            reason = pace.failing(now_s, waiting_s)
            # The cheapest that hears anything is late rather than replaced by a closed mouth.
            if reason is not None and any(n > self._current for n in self._usable[:-1]):
                is_slow = pace.share > TRIED_SHARE
                self._fall_back(reason, _LONGEST_WAIT_S if is_slow else _LONGEST_WAIT_BUSY_S)
                now_s = timer_s()
        if self._current > self._usable[0]:
            self._try_better(blocks, timer_s, now_s)

    def _hear(
        self, blocks: Sequence[AudioBlock], timer_s: Callable[[], float], now_s: float
    ) -> float:
        """Feed the level in use, or the first below that can; the time then."""
        while True:
            try:
                now_s = fed(self._level, blocks, timer_s, now_s)
                break
            except Exception as error:  # whatever it is, the mouth must not stay open for it
                self._fall_back(_in_words(error), next_s=blocks[0].start_s)
        self._recent.extend(blocks)
        return now_s

    def _fall_back(
        self, reason: str, longest_wait_s: float = _LONGEST_WAIT_S, next_s: float = 0.0
    ) -> None:
        """Leave the level in use for the next one; next_s: of the block that comes next."""
        left = self._current
        if left == self._usable[-1]:
            return  # the neutral one: nothing is below
        self._trial = None
        while True:
            self._why_not[self._current] = reason
            self._current = next(n for n in self._usable if n > self._current)
            try:
                self._level.begin(self._recent[0].start_s if self._recent else next_s)
                self._level.feed(self._recent)
                self._level.updates()
                break
            except Exception as error:  # as in feed
                reason = _in_words(error)
        name, why = self._levels[left].name, self._why_not[left]
        _LOG.warning("recogniser %s left: %s; %s takes over", name, why, self.level)
        if self._timer_s is not None:
            now_s = self._timer_s()
            if left == self._usable[0]:
                self._best_left_s = now_s
            was_kept = now_s >= self._taken_s + _KEPT_S
            self._wait_s = _FIRST_WAIT_S if was_kept else min(2.0 * self._wait_s, longest_wait_s)
            self._try_at_s = now_s + self._wait_s

    def _try_better(
        self, heard: Sequence[AudioBlock], timer_s: Callable[[], float], now_s: float
    ) -> None:
        """Begin a try when it is due, go on with one that was begun, let one that is ready work."""
        try:
            if self._trial is not None:
                self._trial.add(heard)
            elif now_s >= max(self._try_at_s, self._calm_since_s + _CALM_S):
                better = [n for n in self._usable if n < self._current]
                index = better[self._next_tried % len(better)]
                self._trial = Trial(self._levels[index], self._recent, now_s)
            else:
                return
            self._trial.go_on(timer_s)
        except Exception:  # as in feed
            self._end_trial(_LONGEST_WAIT_S)
            return
        if self._trial.failed:
            is_slow = self._trial.level.pace.is_too_slow_to_be_tried
            self._end_trial(_LONGEST_WAIT_S if is_slow else _LONGEST_WAIT_BUSY_S)
        elif self._trial.is_ready:
            self._take(self._trial.level, timer_s())

    def _end_trial(self, longest_wait_s: float) -> None:
        """A try failed: the next level's turn, later."""
        self._trial = None
        self._next_tried += 1
        self._wait_s = min(2.0 * self._wait_s, longest_wait_s)
        if self._timer_s is not None:
            self._try_at_s = self._timer_s() + self._wait_s

    def _take(self, level: LadderLevel, now_s: float) -> None:
        """A level that was tried takes over: what is not final yet is its from here on."""
        self._trial = None
        self._current = self._levels.index(level)
        self._next_tried = 0
        self._taken_s = now_s
        self._try_at_s = now_s + self._wait_s
        away_s = now_s - self._best_left_s
        is_best = self._current == self._usable[0]
        after = f" after {away_s:.1f} s" if is_best else ""
        _LOG.info("recogniser %s is back%s", level.name, after)


def _in_words(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"


def _after(update: PhonemeUpdate, final_until_s: float) -> PhonemeUpdate:
    """The update without what lies before `final_until_s`."""
    if update.replace_from_s >= final_until_s:
        return update
    return replace(
        update,
        replace_from_s=final_until_s,
        heard_until_s=max(update.heard_until_s, final_until_s),
        final_until_s=max(update.final_until_s, final_until_s),
        events=tuple(e for e in update.events if e.end_s is None or e.end_s > final_until_s),
    )
