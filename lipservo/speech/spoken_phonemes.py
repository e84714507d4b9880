"""Phonemes of what the robot says: known ones where they are known, recognised ones elsewhere."""

import math
from collections.abc import Iterable
from dataclasses import replace

from lipsync.audio.playing_stream import KnownStretch
from lipsync.audio.playout import Playout
from lipsync.phonemes import Hearing, Listener, LiveRecognizer, PhonemeEvent, PhonemeUpdate
from lipsync.recognition.streaming import RecognizerStream

#: What is known beforehand is told so far ahead of the sound: more than the longest look-ahead
#: that moves a mouth, less than a sentence in every update.
_AHEAD_S = 1.0


class SpokenPhonemes:
    """A `PhonemeSource` of a playout: a recogniser, and what the streams bring with them."""

    def __init__(self, playout: Playout, recognizer: LiveRecognizer) -> None:
        self._playout = playout
        self._recognizer = recognizer
        self._recognition = RecognizerStream(recognizer)

    @property
    def latency_s(self) -> float:
        """At sound time t the phonemes before t - latency_s are settled."""
        return self._recognizer.latency_s

    @property
    def heard_until_s(self) -> float:
        """Sound has been committed until then."""
        return self._playout.committed_s

    @property
    def hears(self) -> Hearing | None:
        """What is believed about the sound; None where the recogniser does not say."""
        return self._recognizer.hears if isinstance(self._recognizer, Listener) else None

    def updates(self, until_s: float) -> list[PhonemeUpdate]:
        """Commit the sound that is due at sound time `until_s`; what became known by it."""
        step = self._recognition.feed(self._playout.blocks(until_s))
        return [
            with_known(update, self._playout.known_phonemes(update.replace_from_s))
            for update in step.updates
        ]


def with_known(update: PhonemeUpdate, stretches: Iterable[KnownStretch]) -> PhonemeUpdate:
    """The update with what is known beforehand in place of what was recognised there.

    stretches: (start_s, end_s, events) in order of time, not overlapping.
    """
    events = list(update.events)
    for start_s, end_s, known in stretches:
        told_until_s = min(end_s, update.heard_until_s + _AHEAD_S)
        near = [event for event in known if event.start_s < told_until_s]
        near = [event for event in near if _end_s(event) > update.replace_from_s]
        # What is said may be cut off within a phoneme, and go on within one.
        said = _cut(near, start_s, end_s)
        # Beyond what is told of a stretch nothing else is, or the two would overlap later.
        after = _cut(events, end_s, math.inf) if told_until_s == end_s else []
        events = [*_cut(events, -math.inf, start_s), *said, *after]
    return replace(update, events=tuple(events))


def _cut(events: Iterable[PhonemeEvent], from_s: float, until_s: float) -> list[PhonemeEvent]:
    """What of the events lies between."""
    found = []
    for event in events:
        start_s, end_s = max(event.start_s, from_s), min(_end_s(event), until_s)
        if end_s > start_s:
            found.append(
                replace(event, start_s=start_s, end_s=None if end_s == math.inf else end_s)
            )
    return found


def _end_s(event: PhonemeEvent) -> float:
    return math.inf if event.end_s is None else event.end_s
