"""Phones with times while they are worked on, and the events and words they become."""

from dataclasses import dataclass

from lipsync.phonemes import SILENCE, PhonemeEvent


@dataclass(slots=True)
class TimedPhones:
    """A phoneme of a voice as phones of the inventory; `word` is the number of its word or -1."""

    phones: tuple[str, ...]
    start_s: float
    end_s: float
    word: int = -1


def phoneme_events(timed: list[TimedPhones]) -> tuple[PhonemeEvent, ...]:
    """One event a phone: those of one phoneme share its time evenly, pauses in a row are one."""
    events: list[PhonemeEvent] = []
    for each in timed:
        n = len(each.phones)
        bounds_s = [each.start_s + index * (each.end_s - each.start_s) / n for index in range(n)]
        for phone, start_s, end_s in zip(
            each.phones, bounds_s, [*bounds_s[1:], each.end_s], strict=True
        ):
            if phone == SILENCE and events and events[-1].phoneme == SILENCE:
                start_s = events.pop().start_s
            events.append(PhonemeEvent(phone, start_s, end_s))
    return tuple(events)


def word_times(timed: list[TimedPhones]) -> dict[int, tuple[float, float]]:
    """The start and end in seconds of each word's phonemes, by the number of the word."""
    times_s: dict[int, tuple[float, float]] = {}
    for each in timed:
        if each.word >= 0:
            start_s, _ = times_s.get(each.word, (each.start_s, 0.0))
            times_s[each.word] = (start_s, each.end_s)
    return times_s
