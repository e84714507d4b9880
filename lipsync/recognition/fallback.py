"""Fallback levels: the recogniser that takes over when one fails or is too slow.

Levels from the best down: network, pocketsphinx, energy (the jaw only), neutral. A level that
raises, or takes longer than the sound lasts, is left until `reset`; the next one takes over at the
block that the last one was not fed. The neutral level, a closed mouth, cannot fail.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from lipsync.arrays import Array
from lipsync.audio_block import BLOCK_S, AudioBlock
from lipsync.phonemes import Hearing, Listener, LiveRecognizer, PhonemeUpdate, ServoListener
from lipsync.recognition.energy_recognizer import NeutralRecognizer
from lipsync.recognition.streaming import PreparingRecognizer

#: A level is too slow when it took longer than this share of the last second of sound.
LAG_SHARE = 0.8
_JUDGED_S = 1.0


@dataclass(frozen=True, slots=True)
class FallbackLevel:
    """A recogniser that can be made when it is needed."""

    name: str
    make: Callable[[], LiveRecognizer]


class FallbackRecognizer:
    """A `PreparingRecognizer` that falls back to the next level instead of failing.

    latency_s: no level may need longer. timer_s: seconds on a clock, to find a level too slow; None
    where nobody waits for it, and sound may be prepared ahead of its time.
    """

    def __init__(
        self,
        levels: Sequence[FallbackLevel],
        latency_s: float,
        timer_s: Callable[[], float] | None = None,
    ) -> None:
        self._levels = tuple(levels)
        self._latency_s = latency_s
        self._timer_s = timer_s
        self._first = self._current = 0
        self._final_until_s = 0.0
        self._forget()
        self._recognizer = self._made(0)
        self._first = self._current

    @property
    def latency_s(self) -> float:
        """At sound time t the phonemes before t - latency_s are settled."""
        return self._latency_s

    @property
    def ahead_s(self) -> float:
        """How much sound `prepare` is best given at once; 0 where each block's time is judged."""
        if self._timer_s is not None or not isinstance(self._recognizer, PreparingRecognizer):
            return 0.0
        return self._recognizer.ahead_s

    @property
    def level(self) -> str:
        """The name of the level in use."""
        return self._levels[self._current].name if self._current < len(self._levels) else "neutral"

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why each level was left, in order."""
        return tuple(self._reasons)

    @property
    def hears(self) -> Hearing | None:
        """What the level in use believes about the sound; None where it does not say."""
        return self._recognizer.hears if isinstance(self._recognizer, Listener) else None

    def note_servo_speeds(self, sound_s: float, speeds_deg_s: Array) -> None:
        """Tell the level in use, where it can do anything with it; never raises for it."""
        if not isinstance(self._recognizer, ServoListener):
            return
        try:
            self._recognizer.note_servo_speeds(sound_s, speeds_deg_s)
        except Exception as error:  # as in feed
            self._fall_back(f"{type(error).__name__}: {error}")

    def reset(self) -> None:
        """Back to the best level that could be made, ready for a new stream at sound time 0."""
        if self._current == self._first:
            self._forget()
            self._recognizer.reset()
            return
        self._forget()
        self._recognizer = self._made(self._first)

    def feed(self, block: AudioBlock) -> None:
        """Feed the next block; never raises for what a level raises."""
        began_s = None if self._timer_s is None else self._timer_s()
        try:
            self._recognizer.feed(block)
        except Exception as error:  # whatever it is, the mouth must not stay open for it
            self._fall_back(f"{type(error).__name__}: {error}")
            self.feed(block)
            return
        if began_s is not None and self._timer_s is not None:
            self._judge(self._timer_s() - began_s, len(block.samples) / block.sample_rate_hz)

    def prepare(self, blocks: Sequence[AudioBlock]) -> None:
        """Let the level in use work on blocks that will be fed next; never raises for it."""
        if not isinstance(self._recognizer, PreparingRecognizer):
            return
        try:
            self._recognizer.prepare(blocks)
        except Exception as error:  # as in feed
            self._fall_back(f"{type(error).__name__}: {error}")

    def updates(self) -> list[PhonemeUpdate]:
        """What became known; nothing that was final before changes, whichever level found it."""
        try:
            updates = self._recognizer.updates()
        except Exception as error:  # as in feed
            self._fall_back(f"{type(error).__name__}: {error}")
            return []
        kept = [_after(update, self._final_until_s) for update in updates]
        for update in kept:
            self._final_until_s = max(self._final_until_s, update.final_until_s)
        return kept

    def _forget(self) -> None:
        self._reasons: list[str] = []
        self._final_until_s = 0.0
        self._costs_s: deque[tuple[float, float]] = deque(maxlen=round(_JUDGED_S / BLOCK_S))

    def _judge(self, cost_s: float, sound_s: float) -> None:
        self._costs_s.append((cost_s, sound_s))
        heard_s = sum(sound for _, sound in self._costs_s)
        spent_s = sum(cost for cost, _ in self._costs_s)
        if heard_s >= 0.99 * _JUDGED_S and spent_s > LAG_SHARE * heard_s:
            self._fall_back(f"took {spent_s:.2f} s for {heard_s:.2f} s of sound")

    def _fall_back(self, reason: str) -> None:
        self._reasons.append(f"{self.level}: {reason}")
        self._costs_s.clear()
        self._recognizer = self._made(self._current + 1)

    def _made(self, index: int) -> LiveRecognizer:
        """The recogniser of the first level from `index` down that can be made."""
        for current in range(index, len(self._levels)):
            self._current = current
            try:
                recognizer = self._levels[current].make()
            except Exception as error:  # a missing library, damaged weights
                self._reasons.append(f"{self.level}: {error}")
                continue
            if recognizer.latency_s <= self._latency_s + 1e-9:
                return recognizer
            self._reasons.append(f"{self.level}: needs {recognizer.latency_s} s")
        self._current = len(self._levels)
        return NeutralRecognizer()


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
