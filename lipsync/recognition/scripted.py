"""Phonemes known beforehand, from a label file or a voice, released as their time comes."""

import math
from collections.abc import Iterable
from dataclasses import replace

from lipsync.phonemes import PhonemeEvent, PhonemeUpdate


class ScriptedPhonemes:
    """A `PhonemeSource` that releases known events only as a perfect recogniser would find them.

    At sound time t it reports the starts before t + `lookahead_s` and the ends up to there; all of
    it is final. Raises ValueError for events out of order or overlapping, and for an event without
    an end that is not the last.
    """

    def __init__(self, events: Iterable[PhonemeEvent], lookahead_s: float = 0.0) -> None:
        """Store the events, in order of time. Raises ValueError as the class says.

        lookahead_s: seconds that phonemes are known before their sound.
        """
        self._events = tuple(events)
        for event, following in zip(self._events, self._events[1:], strict=False):
            if event.end_s is None or not event.start_s < event.end_s <= following.start_s:
                raise ValueError(f"{event} must end before {following} begins")
        self._lookahead_s = lookahead_s
        self._n_over = 0  # events that were reported with their end
        self._known_until_s = 0.0
        self._heard_until_s = 0.0

    @property
    def latency_s(self) -> float:
        """Seconds until a phoneme is final: 0, as scripted phonemes are final at once."""
        return 0.0

    @property
    def heard_until_s(self) -> float:
        """The latest sound time that `updates` was called with, in s."""
        return self._heard_until_s

    def updates(self, until_s: float) -> list[PhonemeUpdate]:
        """Return an update with all that is known at sound time `until_s` and was not before.

        [] if `until_s`, in s, is not later than in an earlier call.
        """
        self._heard_until_s = max(self._heard_until_s, until_s)
        known_until_s = until_s + self._lookahead_s
        if known_until_s <= self._known_until_s:
            return []
        replace_from_s, self._known_until_s = self._known_until_s, known_until_s
        events: list[PhonemeEvent] = []
        for event in self._events[self._n_over :]:
            if event.start_s >= known_until_s:
                break
            is_over = (event.end_s if event.end_s is not None else math.inf) <= known_until_s
            events.append(event if is_over else replace(event, end_s=None))
            self._n_over += is_over
        return [
            PhonemeUpdate(
                replace_from_s=replace_from_s,
                heard_until_s=until_s,
                final_until_s=known_until_s,
                events=tuple(events),
            )
        ]
