"""Labels with times, from any file, as phoneme events: checked, in order, without overlap."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from lipsync.errors import shown
from lipsync.phonemes import SILENCE, PhonemeEvent
from lipsync.textgrid import LabelError

#: A file that tells starts alone does not say how long its last phoneme is.
LAST_PHONEME_S = 0.1
#: Times are rounded to so many digits, the 100 ns of Azure: 0.3 s and 0.05 s more are 0.35 s.
_DIGITS = 7
#: No speech in one file is longer; more is another unit or a mistake.
_LONGEST_S = 24 * 3600.0


@dataclass(frozen=True, slots=True)
class Label:
    """Phones of the inventory that share a stretch of time; `place` is where the file says so.

    phones: none where the label only goes on with the one before. end_s: None where the file tells
    starts alone.
    """

    phones: tuple[str, ...]
    start_s: float
    end_s: float | None
    place: str


def seconds(value: object, unit_s: float, name: str, place: str) -> float:
    """A time of the file in seconds; LabelError unless it is a number from 0 to 24 hours."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise LabelError(f"{name}: {place}: {shown(value)} is no time; write a number")
    # Compared before it is multiplied: an integer may be too long for a float.
    if not 0 <= value <= _LONGEST_S / unit_s:
        raise LabelError(f"{name}: {place}: time {shown(value)} is not within 0 and 24 hours")
    return float(value) * unit_s


def events_of(labels: Sequence[Label], name: str) -> tuple[PhonemeEvent, ...]:
    """The labels as events from 0 on, silence between them.

    Each ends where the next begins at the latest; one without an end ends there, the last of all
    after `LAST_PHONEME_S`, and at once where it is silence. Raises LabelError where a label begins
    before the one before it, ends before it begins, or where there is none.
    """
    if not labels:
        raise LabelError(f"{name}: no phonemes; give a file with at least one")
    events: list[PhonemeEvent] = []
    reached_s = 0.0
    labels = [_rounded(label) for label in labels]
    for index, label in enumerate(labels):
        following_s = labels[index + 1].start_s if index + 1 < len(labels) else math.inf
        if following_s < label.start_s:
            raise LabelError(
                f"{name}: {labels[index + 1].place}: begins at {following_s:.3f} s, before the one "
                f"before it at {label.start_s:.3f} s; put them in order of time"
            )
        end_s = min(_end_s(label, following_s, name), following_s)
        if label.start_s > reached_s:
            _append(events, SILENCE, reached_s, label.start_s)
        _append_shared(events, label, end_s)
        reached_s = max(reached_s, end_s)
    if all(event.phoneme == SILENCE for event in events):
        raise LabelError(f"{name}: nothing but silence; give a file in which something is said")
    return tuple(events)


def _rounded(label: Label) -> Label:
    end_s = None if label.end_s is None else round(label.end_s, _DIGITS)
    return replace(label, start_s=round(label.start_s, _DIGITS), end_s=end_s)


def _end_s(label: Label, following_s: float, name: str) -> float:
    if label.end_s is None:
        last_s = 0.0 if label.phones == (SILENCE,) else LAST_PHONEME_S
        return following_s if math.isfinite(following_s) else label.start_s + last_s
    if label.end_s < label.start_s:
        raise LabelError(
            f"{name}: {label.place}: ends at {label.end_s:.3f} s, before it begins at "
            f"{label.start_s:.3f} s"
        )
    return label.end_s


def _append_shared(events: list[PhonemeEvent], label: Label, end_s: float) -> None:
    if not label.phones:
        # A mark of length, a space: the phoneme before goes on.
        phones: tuple[str, ...] = (events[-1].phoneme if events else SILENCE,)
    else:
        phones = label.phones
    n = len(phones)
    starts_s = [label.start_s + index * (end_s - label.start_s) / n for index in range(n)]
    for phone, start_s, stop_s in zip(phones, starts_s, [*starts_s[1:], end_s], strict=True):
        goes_on = not label.phones
        _append(events, phone, start_s, stop_s, goes_on=goes_on)


def _append(
    events: list[PhonemeEvent], phone: str, start_s: float, end_s: float, *, goes_on: bool = False
) -> None:
    """Add an event unless it has no length; silence, or what goes on, joins its like before it."""
    if end_s <= start_s:
        return
    if events and events[-1].phoneme == phone and (goes_on or phone == SILENCE):
        start_s = events.pop().start_s
    events.append(PhonemeEvent(phone, start_s, end_s))
