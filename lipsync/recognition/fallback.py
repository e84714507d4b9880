"""The ladder of recognisers: one that fails is replaced by the next, and tried again later.

Levels from the best down: network, energy (the jaw only), neutral (a closed mouth; cannot fail). A
level that raises is left at once, a slow one once there is a backlog (`Pace`); the next one is fed
the last 3 s of sound, and goes on from there. Where a clock is given, better levels are tried
beside the one in use (`Trial`), and take over in a pause. Why so: docs/decisions/ears.md.
A busy computer makes any recogniser late for a moment, so a single slow second decides nothing.
"""

import logging
import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from statistics import median
from typing import Final, TypeVar

from lipsync.arrays import Array
from lipsync.audio_block import BLOCK_S, AudioBlock
from lipsync.phonemes import (
    SILENCE,
    Hearing,
    Listener,
    LiveRecognizer,
    PhonemeUpdate,
    ServoListener,
)
from lipsync.recognition.energy_recognizer import NeutralRecognizer
from lipsync.recognition.streaming import PreparingRecognizer
from lipsync.recognition.text_decoder import MovedBy, TextError, TextFollower
from lipsync.spoken_text import PronouncedWord

Result = TypeVar("Result")

#: So much sound may wait for a recogniser without being called a backlog.
_BACKLOG_S = 0.3
#: A recogniser that takes so long for a second of sound will not catch up, whatever the computer
#: does besides, and eight blocks at once will not help either. It is left at once.
_HOPELESS_SHARE = 3.0
_TRIED_SHARE = 0.5  # a level that is tried needs time to spare, beside the one in use
#: In a backlog so many blocks are worked on at once, at a third of the cost.
_AT_ONCE = 8
#: So long a backlog may last, of at least so many steps, if the recogniser had this share of the
#: time: where it had less, all else is as late, and a cheaper one would not be heard any sooner.
_PATIENCE_S, _FEWEST_BEHIND, _BLAMED_SHARE = 6.0, 32, 0.5
#: So many steps are remembered, and so many needed: the first of a process pays for tables that are
#: made once, and other programs interrupt one step in many, for milliseconds.
_REMEMBERED, _FEWEST, _FEWEST_TRIED = 9, 5, 3
#: A step feeds a level that is tried so many blocks at the most, and no new one after so long.
_TRIED_IN_A_STEP, _TRIED_FOR_S = 24, 0.015
#: A try that has not caught up after this has failed.
_LONGEST_TRY_S = 3.0
#: Without a pause for so long a level takes over while somebody speaks.
_LONGEST_WITHOUT_PAUSE_S = 8.0
#: Silence that has lasted so long is a pause: the mouth is on its way to rest (decoder.py).
_PAUSE_S = 0.2


class Pace:
    """A check that a recogniser is fast enough: call `note` each step, then `why_replace`."""

    def __init__(self) -> None:
        self._shares: deque[float] = deque(maxlen=_REMEMBERED)
        self._behind_since_s: float | None = None
        self._n_behind = 0
        self._spent_s = 0.0  # since then

    @property
    def share(self) -> float:
        """Seconds of work per second of sound: median of the last 9 steps, 0 before the first."""
        return median(self._shares) if self._shares else 0.0

    @property
    def may_hurry(self) -> bool:
        """Whether several blocks may be fed at once: a second of sound costs less than 3 s."""
        return len(self._shares) >= _FEWEST_TRIED and self.share < _HOPELESS_SHARE

    @property
    def is_too_slow_to_be_tried(self) -> bool:
        """Whether a second of sound costs over 0.5 s, too much beside the recogniser in use."""
        return len(self._shares) >= _FEWEST_TRIED and self.share > _TRIED_SHARE

    def note(self, cost_s: float, sound_s: float) -> None:
        """Add a step that cost `cost_s` seconds by the clock for `sound_s` seconds of sound."""
        self._spent_s += cost_s
        if sound_s > 0.0:
            self._shares.append(cost_s / sound_s)

    def why_replace(self, now_s: float, waiting_s: float) -> str | None:
        """Return in words why the recogniser should be replaced; None if not (yet).

        now_s: by the clock. waiting_s: seconds of sound that wait after the step noted last.
        """
        if waiting_s <= _BACKLOG_S:
            self._behind_since_s, self._n_behind = None, 0
            return None
        if self._behind_since_s is None:
            self._behind_since_s, self._spent_s = now_s, 0.0
        self._n_behind += 1
        if len(self._shares) >= _FEWEST and self.share > _HOPELESS_SHARE:
            return f"takes {self.share:.1f} s for a second of sound, {waiting_s:.1f} s wait"
        behind_s = now_s - self._behind_since_s
        is_to_blame = self._spent_s > _BLAMED_SHARE * behind_s
        if self._n_behind >= _FEWEST_BEHIND and behind_s >= _PATIENCE_S and is_to_blame:
            return f"did not catch up in {behind_s:.1f} s, {waiting_s:.1f} s of sound wait"
        return None


class LadderLevel:
    """A named recogniser of the ladder (best first); inputs and results are in sound time.

    The recogniser counts time from where it was begun, lest it fills the hours before with silence.
    """

    def __init__(self, name: str, recognizer: LiveRecognizer) -> None:
        """Wrap a recogniser called `name`, which counts from sound time 0 until `begin`."""
        self.name = name
        self.pace = Pace()
        self._recognizer = recognizer
        self._listener = recognizer if isinstance(recognizer, Listener) else None
        self._follower = recognizer if isinstance(recognizer, TextFollower) else None
        self._offset_s = 0.0
        self.is_pause = True  # whether silence has lasted for a while, by the newest update

    @property
    def ahead_s(self) -> float:
        """Seconds of sound to give `prepare` at once; 0 if the recogniser cannot prepare."""
        preparing = self._recognizer
        return preparing.ahead_s if isinstance(preparing, PreparingRecognizer) else 0.0

    @property
    def hearing(self) -> Hearing | None:
        """The recogniser's sound class: speech, noise, silence; None if it reports no class."""
        return None if self._listener is None else self._listener.hearing

    def begin(self, sound_s: float) -> None:
        """Reset the recogniser for a new stream, whose first block is at `sound_s` or later."""
        self._recognizer.reset()
        self.pace = Pace()
        self._offset_s = sound_s
        self.is_pause = True

    def note_servo_speeds(self, sound_s: float, speeds_deg_s: Array) -> None:
        """Pass the servos' speeds (n_servos,), deg/s, to a recogniser that can use them."""
        if isinstance(self._recognizer, ServoListener):
            self._recognizer.note_servo_speeds(sound_s - self._offset_s, speeds_deg_s)

    @property
    def moved_by(self) -> MovedBy | None:
        """`text` if the final phonemes are from a given text, `sound` if heard; None if unknown."""
        return self._follower.moved_by if self._follower is not None else "sound"

    @property
    def saying(self) -> tuple[tuple[str, ...], int]:
        """The words around the one being spoken, and its index among them; ((), 0) without text."""
        return ((), 0) if self._follower is None else self._follower.saying

    def forget(self) -> None:
        """Drop the words given by `tell` that are not spoken yet."""
        if self._follower is not None:
            self._follower.forget()

    def tell(self, words: Sequence[PronouncedWord], behind_s: float) -> None:
        """Give a recogniser that follows text words whose sound began `behind_s` seconds ago."""
        if self._follower is None:
            return
        shifted = [
            word if word.start_s is None else replace(word, start_s=word.start_s - self._offset_s)
            for word in words
        ]
        self._follower.tell(shifted, behind_s)

    def prepare(self, blocks: Sequence[AudioBlock]) -> None:
        """Let the recogniser compute ahead on the next blocks; do nothing if it cannot."""
        if isinstance(self._recognizer, PreparingRecognizer):
            self._recognizer.prepare([self._in_recognizer_time(block) for block in blocks])

    def feed(self, blocks: Iterable[AudioBlock]) -> None:
        """Feed blocks to the recogniser in order, one by one."""
        for block in blocks:
            self._recognizer.feed(self._in_recognizer_time(block))

    def updates(self) -> list[PhonemeUpdate]:
        """Return the recogniser's updates since the last call, in sound time."""
        updates = self._recognizer.updates()
        if updates:
            self.is_pause = _ends_in_pause(updates[-1])
        if self._offset_s != 0.0:
            updates = [_shift_update(update, self._offset_s) for update in updates]
        return updates

    def _in_recognizer_time(self, block: AudioBlock) -> AudioBlock:
        """Return the block with its start counted from where the recogniser was begun."""
        if self._offset_s == 0.0:
            return block
        return AudioBlock(block.samples, block.start_s - self._offset_s, block.sample_rate_hz)


class Trial:
    """A trial of a recogniser beside the one in use, on the last seconds of sound and new sound.

    Call `add` and `go_on` in each step; then read `failed`, and `is_ready`: it has caught up,
    and there is a pause. Memory is bounded: a trial that falls behind has failed.
    """

    def __init__(self, level: LadderLevel, recent: Iterable[AudioBlock], now_s: float) -> None:
        """Start a trial at clock time `now_s`; `recent`: the sound before, at least one block."""
        self.level = level
        self.failed = False
        self.is_ready = False
        self._waiting = deque(recent)
        self._began_s = now_s
        self._ready_since_s: float | None = None
        level.begin(self._waiting[0].start_s)

    def add(self, blocks: Iterable[AudioBlock]) -> None:
        """Add the newest blocks to those that wait to be fed to the recogniser on trial."""
        self._waiting.extend(blocks)

    def go_on(self, timer_s: Callable[[], float]) -> None:
        """Feed waiting blocks for up to 15 ms by the clock `timer_s`; set `failed` or `is_ready`.

        Failed: over 6 s of sound wait, it did not catch up in the first 3 s, or it is slow.
        """
        began_s = now_s = timer_s()
        n_fed = 0
        while self._waiting and n_fed < _TRIED_IN_A_STEP and now_s < began_s + _TRIED_FOR_S:
            n = _AT_ONCE if self.level.pace.may_hurry and len(self._waiting) >= _AT_ONCE else 1
            n_fed += n
            now_s = _feed_and_time(self.level, list(islice(self._waiting, n)), timer_s, now_s)
            for _ in range(n):
                self._waiting.popleft()
        self.level.updates()
        if self._waiting:
            waits_long = len(self._waiting) * BLOCK_S > 2.0 * _LONGEST_TRY_S
            is_late = self._ready_since_s is None and now_s > self._began_s + _LONGEST_TRY_S
            self.failed = waits_long or is_late or self.level.pace.is_too_slow_to_be_tried
            return
        if self._ready_since_s is None:
            self._ready_since_s = now_s
        caught_up_for_s = now_s - self._ready_since_s
        self.is_ready = self.level.is_pause or caught_up_for_s > _LONGEST_WITHOUT_PAUSE_S


def _feed_and_time(
    level: LadderLevel, blocks: Sequence[AudioBlock], timer_s: Callable[[], float], began_s: float
) -> float:
    """Feed blocks to a level, note the time since `began_s` as its cost; return the time now, s."""
    if len(blocks) > 1:
        level.prepare(blocks)
    level.feed(blocks)
    now_s = timer_s()
    level.pace.note(now_s - began_s, blocks[-1].end_s - blocks[0].start_s)
    return now_s


def _shift_update(update: PhonemeUpdate, by_s: float) -> PhonemeUpdate:
    """Return the update with all its times moved later by `by_s` seconds."""
    return PhonemeUpdate(
        update.replace_from_s + by_s,
        update.heard_until_s + by_s,
        update.final_until_s + by_s,
        tuple(event.later(by_s) for event in update.events),
        *(each and each.later(by_s) for each in (update.posteriors, update.evidence)),
    )


def _ends_in_pause(update: PhonemeUpdate) -> bool:
    """Return whether the last phoneme is silence that has lasted for at least 0.2 s."""
    if not update.events:
        return False
    last = update.events[-1]
    return last.phoneme == SILENCE and last.start_s <= update.heard_until_s - _PAUSE_S


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
#: A level left after so long in use did well: the wait before the next try starts anew.
_KEPT_S = 30.0


@dataclass(frozen=True, slots=True)
class FallbackLevel:
    """The name of a recogniser, and the function that makes it."""

    name: str
    make: Callable[[], LiveRecognizer]


class FallbackRecognizer:
    """A ladder of recognisers (levels), the best first: one that fails is replaced by the next.

    All levels are made at the beginning, so that nothing is loaded while a face runs. latency_s: a
    level that needs longer is not used. timer_s: a clock in s, to find that a level is too slow,
    and to try better ones again; None in offline use, where sound may be prepared ahead of time.
    """

    def __init__(
        self,
        levels: Sequence[FallbackLevel],
        latency_s: float,
        timer_s: Callable[[], float] | None = None,
    ) -> None:
        """Make all `levels`, and begin the best usable one; parameters as in the class."""
        self._latency_s = latency_s
        self._timer_s = timer_s
        self._levels: list[LadderLevel] = []
        # For each level in words: why it cannot be used, or was left last; None: it is usable.
        self._why_not: list[str | None] = []
        for level in levels:
            self._add_level(level)
        self._levels.append(LadderLevel("neutral", NeutralRecognizer()))
        self._why_not.append(None)
        self._usable = tuple(n for n, reason in enumerate(self._why_not) if reason is None)
        self._final_until_s = 0.0
        self._recent: deque[AudioBlock] = deque(maxlen=round(WARM_UP_S / BLOCK_S))
        self.reset()

    @property
    def latency_s(self) -> float:
        """Seconds until a phoneme is final: at sound time t, those before t - latency_s are."""
        return self._latency_s

    @property
    def ahead_s(self) -> float:
        """Seconds of sound to give `prepare` at once; 0 where a clock times each block."""
        return 0.0 if self._timer_s is not None else self._level.ahead_s

    @property
    def level(self) -> str:
        """The name of the recogniser in use."""
        return self._level.name

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why each better recogniser is not in use, the best first; () if the best is in use."""
        better = zip(self._levels, self._why_not[: self._current], strict=False)
        return tuple(f"{level.name}: {reason}" for level, reason in better)

    @property
    def hearing(self) -> Hearing | None:
        """The class of the sound (speech, noise, silence) by the recogniser in use, or None."""
        return self._level.hearing

    @property
    def moved_by(self) -> MovedBy | None:
        """`text` if the final phonemes are from a given text, `sound` if heard; None if unknown."""
        return self._level.moved_by

    @property
    def saying(self) -> tuple[tuple[str, ...], int]:
        """The words around the one being spoken, and its index among them; ((), 0) without text."""
        return self._level.saying

    def forget(self) -> None:
        """Drop the words given to the recogniser in use by `tell` that are not spoken yet."""
        self._or_fall_back(self._level.forget)

    def tell(self, words: Sequence[PronouncedWord], behind_s: float = 0.0) -> None:
        """Give the recogniser in use the next words of a text. Raises TextError for too many.

        behind_s: seconds of their sound fed already. Any other error replaces the recogniser.
        """
        try:
            self._level.tell(words, behind_s)
        except TextError:
            raise
        except Exception as error:  # whatever a recogniser raises
            self._fall_back(_describe(error))

    def note_servo_speeds(self, sound_s: float, speeds_deg_s: Array) -> None:
        """Pass the servos' speeds (n_servos,), deg/s, to the recognisers in use and on trial."""
        self._or_fall_back(lambda: self._level.note_servo_speeds(sound_s, speeds_deg_s))
        try:
            if self._trial is not None:
                self._trial.level.note_servo_speeds(sound_s, speeds_deg_s)
        except Exception:  # whatever a recogniser raises
            self._end_trial(_LONGEST_WAIT_S)

    def reset(self) -> None:
        """Switch to the best usable recogniser, ready for a new stream at sound time 0."""
        self._current = self._usable[0]
        self._final_until_s = 0.0
        self._recent.clear()
        self._trial: Trial | None = None
        self._next_trial = 0
        self._wait_s = _FIRST_WAIT_S
        self._calm_since_s = self._try_at_s = self._best_left_s = 0.0
        self._switched_s = -math.inf
        self._level.begin(0.0)

    def feed(self, block: AudioBlock) -> None:
        """Feed the next block; a recogniser that raises is replaced by the next lower one."""
        self.feed_all((block,))

    def feed_all(self, blocks: Sequence[AudioBlock]) -> None:
        """Feed all blocks that have come, the oldest first; a recogniser that raises is replaced.

        With a clock, of a backlog of more than 3 s the oldest blocks are dropped.
        """
        if self._timer_s is None:
            for block in blocks:
                self._feed_in_use((block,), lambda: 0.0, 0.0)
        elif blocks:
            self._feed_on_clock(blocks, self._timer_s)

    def prepare(self, blocks: Sequence[AudioBlock]) -> None:
        """Let the recogniser in use compute ahead on the next blocks; replace it if it raises."""
        self._or_fall_back(lambda: self._level.prepare(blocks))

    def updates(self) -> list[PhonemeUpdate]:
        """Return the recogniser's new updates, final phonemes unchanged; [] if it raises."""
        updates = self._or_fall_back(self._level.updates) or []
        revisable = [_without_final_part(update, self._final_until_s) for update in updates]
        for update in revisable:
            self._final_until_s = max(self._final_until_s, update.final_until_s)
        return revisable

    @property
    def _level(self) -> LadderLevel:
        return self._levels[self._current]

    def _or_fall_back(self, call: Callable[[], Result]) -> Result | None:
        """Return the result of a call of the recogniser in use; None: it raised, is replaced."""
        try:
            return call()
        except Exception as error:  # whatever a recogniser raises
            self._fall_back(_describe(error))
            return None

    def _add_level(self, level: FallbackLevel) -> None:
        """Make and add the recogniser `level`; one that cannot be made is marked unusable."""
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

    def _feed_on_clock(self, blocks: Sequence[AudioBlock], timer_s: Callable[[], float]) -> None:
        """Feed blocks, in a backlog several at once; replace a recogniser that is too slow.

        timer_s: a clock in s. The backlog is the sound not fed yet plus the time since this call.
        Too slow: the backlog is over 0.3 s, and a second of sound costs over 3 s of work, or the
        backlog lasts 6 s (`Pace.why_replace`).
        """
        end_s = blocks[-1].end_s
        if end_s - blocks[0].start_s > LONGEST_WAITING_S:
            blocks = [block for block in blocks if block.end_s > end_s - LONGEST_WAITING_S]
        began_s = now_s = timer_s()
        waiting_s, n_fed = end_s - blocks[0].start_s, 0
        while n_fed < len(blocks):
            if waiting_s > _BACKLOG_S:
                self._calm_since_s = now_s
            hurries = len(blocks) - n_fed >= _AT_ONCE and self._level.pace.may_hurry
            chunk = blocks[n_fed : n_fed + (_AT_ONCE if hurries else 1)]
            now_s = self._feed_in_use(chunk, timer_s, now_s)
            n_fed += len(chunk)
            waiting_s = end_s - chunk[-1].end_s + now_s - began_s
            pace = self._level.pace
            reason = pace.why_replace(now_s, waiting_s)
            # Never to `neutral` for slowness: late phonemes are better than a closed mouth.
            if reason is not None and any(n > self._current for n in self._usable[:-1]):
                is_slow = pace.share > _TRIED_SHARE
                self._fall_back(reason, _LONGEST_WAIT_S if is_slow else _LONGEST_WAIT_BUSY_S)
                now_s = timer_s()
        if self._current > self._usable[0]:
            self._try_better(blocks, timer_s, now_s)

    def _feed_in_use(
        self, blocks: Sequence[AudioBlock], timer_s: Callable[[], float], now_s: float
    ) -> float:
        """Feed blocks to the recogniser in use, or the next that works; return the time now, s."""
        while True:
            try:
                now_s = _feed_and_time(self._level, blocks, timer_s, now_s)
                break
            except Exception as error:  # whatever it is, the mouth must not stay open for it
                self._fall_back(_describe(error), next_s=blocks[0].start_s)
        self._recent.extend(blocks)
        return now_s

    def _fall_back(
        self, reason: str, longest_wait_s: float = _LONGEST_WAIT_S, next_s: float = 0.0
    ) -> None:
        """Replace the recogniser in use by the next lower one that works; the last one stays.

        The next one is fed the last seconds of sound first. reason: in words. longest_wait_s: limit
        in s of the doubling wait until a better one is tried. next_s: next block's sound time.
        """
        left_index = self._current
        if left_index == self._usable[-1]:
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
            except Exception as error:  # whatever a recogniser raises
                reason = _describe(error)
        name, why = self._levels[left_index].name, self._why_not[left_index]
        _LOG.warning("recogniser %s left: %s; %s takes over", name, why, self.level)
        if self._timer_s is not None:
            now_s = self._timer_s()
            if left_index == self._usable[0]:
                self._best_left_s = now_s
            did_well = now_s >= self._switched_s + _KEPT_S
            self._wait_s = _FIRST_WAIT_S if did_well else min(2.0 * self._wait_s, longest_wait_s)
            self._try_at_s = now_s + self._wait_s

    def _try_better(
        self, heard: Sequence[AudioBlock], timer_s: Callable[[], float], now_s: float
    ) -> None:
        """Start a trial if due, or feed the running one the blocks `heard`; switch if ready."""
        try:
            if self._trial is not None:
                self._trial.add(heard)
            elif now_s >= max(self._try_at_s, self._calm_since_s + _CALM_S):
                better = [n for n in self._usable if n < self._current]
                index = better[self._next_trial % len(better)]
                self._trial = Trial(self._levels[index], self._recent, now_s)
            else:
                return
            self._trial.go_on(timer_s)
        except Exception:  # whatever a recogniser raises
            self._end_trial(_LONGEST_WAIT_S)
            return
        if self._trial.failed:
            is_slow = self._trial.level.pace.is_too_slow_to_be_tried
            self._end_trial(_LONGEST_WAIT_S if is_slow else _LONGEST_WAIT_BUSY_S)
        elif self._trial.is_ready:
            self._switch_to(self._trial.level, timer_s())

    def _end_trial(self, longest_wait_s: float) -> None:
        """Drop a failed trial; try again after twice the last wait, at most `longest_wait_s`."""
        self._trial = None
        self._next_trial += 1
        self._wait_s = min(2.0 * self._wait_s, longest_wait_s)
        if self._timer_s is not None:
            self._try_at_s = self._timer_s() + self._wait_s

    def _switch_to(self, level: LadderLevel, now_s: float) -> None:
        """Switch to `level` after its trial: it provides all phonemes that are not final yet."""
        self._trial = None
        self._current = self._levels.index(level)
        self._next_trial = 0
        self._switched_s = now_s
        self._try_at_s = now_s + self._wait_s
        away_s = now_s - self._best_left_s
        duration = f" after {away_s:.1f} s" if self._current == self._usable[0] else ""
        _LOG.info("recogniser %s is back%s", level.name, duration)


def _describe(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"


def _without_final_part(update: PhonemeUpdate, final_until_s: float) -> PhonemeUpdate:
    """Return the update without what it says about times before `final_until_s`."""
    if update.replace_from_s >= final_until_s:
        return update
    return replace(
        update,
        replace_from_s=final_until_s,
        heard_until_s=max(update.heard_until_s, final_until_s),
        final_until_s=max(update.final_until_s, final_until_s),
        events=tuple(e for e in update.events if e.end_s is None or e.end_s > final_until_s),
    )
