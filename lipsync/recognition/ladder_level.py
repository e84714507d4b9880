"""One level of the ladder at work: its own time, how it keeps up, and a try beside the one in use.

Whether a level keeps up is judged by what it takes itself and by what waits, not by one second: a
computer that is busy for a moment makes any recogniser late, and a fast one catches up afterwards.
"""

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from itertools import islice
from statistics import median

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
from lipsync.recognition.streaming import PreparingRecognizer

#: So much sound may wait for a recogniser without being called a backlog.
BACKLOG_S = 0.3
#: A recogniser that takes so long for a second of sound will not catch up, whatever the computer
#: does besides, and eight blocks at once will not help either. It is left at once.
_HOPELESS_SHARE = 3.0
#: A level that is tried needs time to spare: the one in use goes on beside it.
TRIED_SHARE = 0.5
#: In a backlog so many blocks are worked on at once, at a third of the cost (decisions/0038).
AT_ONCE = 8
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
    """Follows one recogniser: `note` what each step took, then ask `failing`."""

    def __init__(self) -> None:
        self._shares: deque[float] = deque(maxlen=_REMEMBERED)
        self._behind_since_s: float | None = None
        self._n_behind = 0
        self._spent_s = 0.0  # since then

    @property
    def share(self) -> float:
        """Seconds that a second of sound takes: the median of the last steps, 0 before the first.

        Of a computer that is busy it tells little, as a step is shorter than a time slice.
        """
        return median(self._shares) if self._shares else 0.0

    @property
    def may_hurry(self) -> bool:
        """Whether several blocks at once would not take too long."""
        return len(self._shares) >= _FEWEST_TRIED and self.share < _HOPELESS_SHARE

    @property
    def is_too_slow_to_be_tried(self) -> bool:
        """Whether it is known to need more than `TRIED_SHARE`."""
        return len(self._shares) >= _FEWEST_TRIED and self.share > TRIED_SHARE

    def note(self, cost_s: float, sound_s: float) -> None:
        """A step took `cost_s` by the clock for `sound_s` of sound."""
        self._spent_s += cost_s
        if sound_s > 0.0:
            self._shares.append(cost_s / sound_s)

    def failing(self, now_s: float, waiting_s: float) -> str | None:
        """Why this recogniser should be left, in words; None: it keeps up, or may yet.

        waiting_s: of the sound that has come, what was not recognised after the step just noted.
        """
        if waiting_s <= BACKLOG_S:
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
    """A recogniser with a name; sound time in and out, whenever it was begun.

    The recogniser itself counts from there: one that begins after hours would otherwise fill the
    hours with silence, frame by frame.
    """

    def __init__(self, name: str, recognizer: LiveRecognizer) -> None:
        self.name = name
        self.pace = Pace()
        self._recognizer = recognizer
        self._offset_s = 0.0
        #: Whether silence has lasted for a while, by the newest update.
        self.is_pause = True

    @property
    def ahead_s(self) -> float:
        """How much sound `prepare` is best given at once; 0: it cannot prepare."""
        preparing = self._recognizer
        return preparing.ahead_s if isinstance(preparing, PreparingRecognizer) else 0.0

    @property
    def hears(self) -> Hearing | None:
        """What it believes about the sound; None where it does not say."""
        return self._recognizer.hears if isinstance(self._recognizer, Listener) else None

    def begin(self, sound_s: float) -> None:
        """Forget everything; the next block is at `sound_s` or later."""
        self._recognizer.reset()
        self.pace = Pace()
        self._offset_s = sound_s
        self.is_pause = True

    def note_servo_speeds(self, sound_s: float, speeds_deg_s: Array) -> None:
        """The robot's servos turned so fast; nothing for one that cannot use it."""
        if isinstance(self._recognizer, ServoListener):
            self._recognizer.note_servo_speeds(sound_s - self._offset_s, speeds_deg_s)

    def prepare(self, blocks: Sequence[AudioBlock]) -> None:
        """Work on blocks that will be fed next; nothing for one that cannot."""
        if isinstance(self._recognizer, PreparingRecognizer):
            self._recognizer.prepare([self._of_its_own_time(block) for block in blocks])

    def feed(self, blocks: Iterable[AudioBlock]) -> None:
        """Feed blocks in order, one by one."""
        for block in blocks:
            self._recognizer.feed(self._of_its_own_time(block))

    def updates(self) -> list[PhonemeUpdate]:
        """What became known since the last call, in sound time."""
        updates = self._recognizer.updates()
        if updates:
            self.is_pause = _ends_in_pause(updates[-1])
        if self._offset_s != 0.0:
            updates = [_later(update, self._offset_s) for update in updates]
        return updates

    def _of_its_own_time(self, block: AudioBlock) -> AudioBlock:
        if self._offset_s == 0.0:
            return block
        return AudioBlock(block.samples, block.start_s - self._offset_s, block.sample_rate_hz)


class Trial:
    """A level that is tried beside the one in use: with the last seconds of sound and what comes.

    `go_on` in each step, after `add`; then look whether it failed, or is ready to take over: it
    has caught up, and it hears a pause. Memory is bounded: a try that falls behind has failed.
    """

    def __init__(self, level: LadderLevel, recent: Iterable[AudioBlock], now_s: float) -> None:
        """recent: the sound before, at least one block."""
        self.level = level
        self.failed = False
        self.is_ready = False
        self._waiting = deque(recent)
        self._began_s = now_s
        self._ready_since_s: float | None = None
        level.begin(self._waiting[0].start_s)

    def add(self, blocks: Iterable[AudioBlock]) -> None:
        """The sound that has just come."""
        self._waiting.extend(blocks)

    def go_on(self, timer_s: Callable[[], float]) -> None:
        """Feed a part of what waits. Raises what the level raises."""
        began_s = now_s = timer_s()
        n_fed = 0
        while self._waiting and n_fed < _TRIED_IN_A_STEP and now_s < began_s + _TRIED_FOR_S:
            n = AT_ONCE if self.level.pace.may_hurry and len(self._waiting) >= AT_ONCE else 1
            n_fed += n
            chunk = list(islice(self._waiting, n))
            now_s = fed(self.level, chunk, timer_s, now_s)
            for _ in range(n):
                self._waiting.popleft()
        self.level.updates()
        if self._waiting:
            since_s = self._began_s if self._ready_since_s is None else self._ready_since_s
            waits_long = len(self._waiting) * BLOCK_S > 2.0 * _LONGEST_TRY_S
            is_late = self._ready_since_s is None and now_s > since_s + _LONGEST_TRY_S
            self.failed = waits_long or is_late or self.level.pace.is_too_slow_to_be_tried
            return
        if self._ready_since_s is None:
            self._ready_since_s = now_s
        goes_on_s = now_s - self._ready_since_s
        self.is_ready = self.level.is_pause or goes_on_s > _LONGEST_WITHOUT_PAUSE_S


def fed(
    level: LadderLevel, blocks: Sequence[AudioBlock], timer_s: Callable[[], float], before_s: float
) -> float:
    """Feed blocks that follow each other, several at once where there are several; the time then.

    before_s: the time now. What it took is noted in the level's pace.
    """
    if len(blocks) > 1:
        level.prepare(blocks)
    level.feed(blocks)
    now_s = timer_s()
    level.pace.note(now_s - before_s, blocks[-1].end_s - blocks[0].start_s)
    return now_s


def _later(update: PhonemeUpdate, by_s: float) -> PhonemeUpdate:
    return PhonemeUpdate(
        update.replace_from_s + by_s,
        update.heard_until_s + by_s,
        update.final_until_s + by_s,
        tuple(
            replace(
                event,
                start_s=event.start_s + by_s,
                end_s=None if event.end_s is None else event.end_s + by_s,
            )
            for event in update.events
        ),
    )


def _ends_in_pause(update: PhonemeUpdate) -> bool:
    if not update.events:
        return False
    last = update.events[-1]
    return last.phoneme == SILENCE and last.start_s <= update.heard_until_s - _PAUSE_S
