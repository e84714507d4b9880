"""The phonemes of the last and the next seconds of a stream, as revised by their source."""

import math
from bisect import bisect_right
from dataclasses import replace

from lipsync.phonemes import PhonemeEvent, PhonemeUpdate


class PhonemeTimeline:
    """The events of all updates so far, in order of time, not overlapping, with bounded memory.

    `apply` replaces older events by those of an update. Events that an earlier update called final
    stay, whatever a later one contains; events more than `horizon_s` seconds before the end of the
    sound heard are dropped.
    """

    def __init__(self, horizon_s: float = 5.0) -> None:
        # More than the longest display delay; a caller that needs less calls `forget_before`.
        self._horizon_s = horizon_s
        self._events: list[PhonemeEvent] = []
        self._final_until_s = 0.0
        self._forgotten_until_s = 0.0

    @property
    def events(self) -> tuple[PhonemeEvent, ...]:
        """All stored events, in order of time; only the last may have no end."""
        return tuple(self._events)

    @property
    def final_until_s(self) -> float:
        """The time in s before which no event changes again."""
        return self._final_until_s

    def event_at(self, time_s: float) -> PhonemeEvent | None:
        """Return the event that includes `time_s`, or None where no event does."""
        index = bisect_right(self._events, time_s, key=_start_s) - 1
        is_within = index >= 0 and time_s < _end_s(self._events[index])
        return self._events[index] if is_within else None

    def events_after(self, time_s: float) -> tuple[PhonemeEvent, ...]:
        """Return the events that start later than `time_s`, in order."""
        return tuple(self._events[bisect_right(self._events, time_s, key=_start_s) :])

    def apply(self, update: PhonemeUpdate) -> None:
        """Replace the events from the update's `replace_from_s` on by its own, except final ones.

        An event that continues across that time keeps its earlier start. Raises ValueError for an
        update whose events are out of order, overlap, or are open before the last.
        """
        _refuse_disorder(update)
        from_s = max(update.replace_from_s, self._final_until_s, self._forgotten_until_s)
        continuing = self._drop_after(from_s)
        for event in update.events:
            if _end_s(event) <= from_s:
                continue
            if event.start_s >= from_s:
                self._events.append(event)
            elif continuing is not None and continuing.phoneme == event.phoneme:
                self._events[-1] = replace(event, start_s=continuing.start_s)
            else:
                self._events.append(replace(event, start_s=from_s))
        self._final_until_s = max(self._final_until_s, update.final_until_s)
        if math.isfinite(update.heard_until_s):
            self.forget_before(update.heard_until_s - self._horizon_s)

    def forget_before(self, time_s: float) -> None:
        """Drop the events that end at or before `time_s`; later updates do not restore them."""
        self._forgotten_until_s = max(self._forgotten_until_s, time_s)
        n_old = 0
        while n_old < len(self._events) and _end_s(self._events[n_old]) <= time_s:
            n_old += 1
        del self._events[:n_old]

    def _drop_after(self, time_s: float) -> PhonemeEvent | None:
        """Drop all events, and parts of events, after `time_s`.

        Return the event that reached `time_s`, cut there; None if no event did.
        """
        while self._events and self._events[-1].start_s >= time_s:
            self._events.pop()
        if not self._events or _end_s(self._events[-1]) < time_s:
            return None
        self._events[-1] = replace(self._events[-1], end_s=time_s)
        return self._events[-1]


def _start_s(event: PhonemeEvent) -> float:
    return event.start_s


def _end_s(event: PhonemeEvent) -> float:
    return math.inf if event.end_s is None else event.end_s


def _refuse_disorder(update: PhonemeUpdate) -> None:
    """Raise ValueError if events overlap, are out of order, or are open before the last."""
    for event, following in zip(update.events, update.events[1:], strict=False):
        if not _end_s(event) <= following.start_s:
            raise ValueError(f"{following} begins before {event} ends")
    for event in update.events:
        if not event.start_s < _end_s(event):
            raise ValueError(f"{event} ends before it begins")
