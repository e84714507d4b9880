"""Where on a timeline it is known beforehand what is said."""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

from lipsync.phonemes import PhonemeEvent


@dataclass(frozen=True, slots=True)
class Stretch:
    """From `start_s` to `end_s` these phonemes are said; all times are the timeline's."""

    start_s: float
    end_s: float
    events: tuple[PhonemeEvent, ...]


class KnownPhonemes:
    """Stretches in order of time."""

    def __init__(self) -> None:
        self._stretches: deque[Stretch] = deque()

    def add(self, phonemes: Sequence[PhonemeEvent], start_s: float) -> None:
        """What is said from `start_s` on; the times of the phonemes count from there."""
        moved = tuple(
            replace(
                event,
                start_s=event.start_s + start_s,
                end_s=None if event.end_s is None else event.end_s + start_s,
            )
            for event in phonemes
        )
        end_s = moved[-1].end_s
        self._stretches.append(Stretch(start_s, math.inf if end_s is None else end_s, moved))

    def cut(self, end_s: float) -> None:
        """Nothing of it is said from `end_s` on."""
        cut = (replace(each, end_s=min(each.end_s, end_s)) for each in self._stretches)
        self._stretches = deque(each for each in cut if each.end_s > each.start_s)

    def after(self, from_s: float) -> list[Stretch]:
        """The stretches that end after `from_s`."""
        return [each for each in self._stretches if each.end_s > from_s]

    def forget_before(self, time_s: float) -> None:
        """Drop the stretches that end before it."""
        while self._stretches and self._stretches[0].end_s < time_s:
            self._stretches.popleft()
