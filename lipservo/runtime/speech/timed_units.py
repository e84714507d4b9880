"""Units, phonemes or visemes that a client sent with times, moved to where the sound has them."""

from dataclasses import dataclass
from typing import Final

from lipsync.audio.playout import Playout
from lipsync.audio.playout_stream import (
    EventKind,
    KnownStretch,
    MoverReason,
    PlayoutEvent,
    TimedUnits,
)
from lipsync.phonemes import FramePosteriors, PhonemeEvent
from lipsync.recognition.text_decoder import MovedBy
from lipsync.recognition.unit_follower import UnitFollower
from lipsync.spoken_text import SpokenText

#: Units up to this far from the present are given to the follower: more than it ever moves them by;
#: and they are looked up again so often.
_AROUND_S, _LOOKED_UP_S = 3.0, 0.5
#: A stretch of units is kept so long after its sound has ended.
_KEPT_S: Final = 1.0
#: A smaller change of the shift is not reported, nor one that has not stayed within `_SAME_SHIFT_S`
#: for `_HELD_S`.
_NEWS_SHIFT_S, _SAME_SHIFT_S = 0.03, 0.015


@dataclass(slots=True)
class _UnitStretch:
    """The units of a stretch of a stream's sound, and the follower that finds them in the sound.

    looked_up_s: timeline position around which the follower was given units last.
    """

    timed: TimedUnits
    follower: UnitFollower
    looked_up_s: float

    def look_up(self, now_s: float) -> None:
        """Give the follower the units around timeline position `now_s`."""
        self.looked_up_s = now_s
        if self.timed.units is not None:
            self.follower.tell(_events_around(self.timed.units, now_s, self.timed.shift_s))


class FollowedUnits:
    """The timed units of the streams that a playout plays, shifted to where the sound has them."""

    def __init__(self, playout: Playout) -> None:
        """Start without units; those of the streams that `playout` plays are added later."""
        self._playout = playout
        # In order of time; the last is that of the newest sound.
        self._followed: list[_UnitStretch] = []
        # (start_s, end_s, what moves the mouth) of the stretches returned last.
        self._stretches: list[tuple[float, float, MovedBy]] = []
        # (stream, shift in s) reported last; and (shift, timeline position since which it stays).
        self._reported_shift: tuple[str, float] = ("", 0.0)
        self._candidate_shift: tuple[float, float] = (0.0, 0.0)

    @property
    def is_empty(self) -> bool:
        """Whether there are no timed units for the sound of the last second."""
        return not self._followed

    @property
    def is_believed(self) -> bool:
        """Whether the units of the newest sound, if there are any, agree with the recogniser's."""
        return not self._followed or self._followed[-1].follower.is_believed

    @property
    def shifted_s(self) -> float | None:
        """How much later than sent the newest units sound, s; None: none move the mouth."""
        return self._followed[-1].follower.shifted_s if self._stretches and self._followed else None

    def kind_at(self, timeline_s: float) -> MovedBy | None:
        """Return which units, by the last `stretches`, move the mouth at a timeline position.

        None: none do, or the position lies outside the times given to `stretches`.
        """
        return next((kind for a, b, kind in self._stretches if a <= timeline_s < b), None)

    def add_committed(self) -> None:
        """Add the timed units of the sound that the playout has committed; drop units long past."""
        now_s = self._playout.committed_s
        for timed in self._playout.take_timed():
            last = self._followed[-1] if self._followed else None
            # Units of the same sound as before replace them; else a new stretch ends the last one.
            if last is not None and timed.units is not None and last.timed.start_s == timed.start_s:
                last.timed = timed
                last.look_up(now_s)
                continue
            if last is not None:
                last.follower.end_s = min(last.follower.end_s, timed.from_s)
            if timed.units is not None:
                self._followed.append(_UnitStretch(timed, UnitFollower(timed.start_s), now_s))
                self._followed[-1].look_up(now_s)
        self._followed = [each for each in self._followed if each.follower.end_s > now_s - _KEPT_S]
        for each in self._followed[-1:]:
            if now_s >= each.looked_up_s + _LOOKED_UP_S:
                each.look_up(now_s)

    def hear(self, heard: FramePosteriors) -> None:
        """Compare the units with the next frames of recognised sound, to find their shift."""
        for each in self._followed:
            each.follower.hear(heard)

    def newly_shifted(self) -> tuple[str, float] | None:
        """Return (stream, shift) once the newest units' shift has changed and stays; else None.

        Shift: seconds by which units sound later than sent.
        """
        if not self._followed:
            return None
        last, (name, reported_s) = self._followed[-1], self._reported_shift
        if name != last.timed.stream:
            reported_s = 0.0
        # Reported once it is 30 ms off the last report, and has stayed within 15 ms for 0.3 s.
        shifted_s, now_s = last.follower.shifted_s, self._playout.committed_s
        if abs(shifted_s - self._candidate_shift[0]) > _SAME_SHIFT_S:
            self._candidate_shift = shifted_s, now_s
        is_held = now_s >= self._candidate_shift[1] + _HELD_S
        if not is_held or abs(shifted_s - reported_s) < _NEWS_SHIFT_S:
            return None
        self._reported_shift = last.timed.stream, shifted_s
        return self._reported_shift

    def stretches(self, from_s: float, until_s: float) -> list[KnownStretch]:
        """Return the parts between two timeline positions in which units move the mouth.

        Each is (start_s, end_s, events) with the events shifted to the sound. In the other parts
        units do not agree with the sound, or there are none.
        """
        found = [
            (stretch, _MOVER_OF_KIND[each.timed.units.kind])
            for each in self._followed
            if each.timed.units is not None
            for stretch in each.follower.stretches(from_s, until_s)
        ]
        self._stretches = [(start_s, end_s, kind) for (start_s, end_s, _), kind in found]
        return [stretch for stretch, _ in found]


#: What moves the mouth, by the kind of the units.
_MOVER_OF_KIND: Final[dict[str, MovedBy]] = {"phoneme": "phonemes", "viseme": "visemes"}


def _events_around(units: SpokenText, now_s: float, shift_s: float) -> tuple[PhonemeEvent, ...]:
    """Return the units around timeline position `now_s` as events of the timeline."""
    samples = (
        round((now_s + by_s - shift_s) * units.sample_rate_hz) for by_s in (-_AROUND_S, _AROUND_S)
    )
    first, end = (max(0, sample) for sample in samples)
    return tuple(event.later(shift_s) for event in units.events(first, end))


#: Something new that moves the mouth is reported once it has done so for so long; and that a text
#: is not spoken, once it was not found in so much speech.
_HELD_S, _UNSAID_S = 0.3, 1.0


class MoverNews:
    """A reporter, by events of the playout, of how the text and units of a stream are used."""

    def __init__(self, playout: Playout) -> None:
        """Start with nothing reported. playout: its list `events` gets the reports."""
        self._playout = playout
        self._stream: str | None = None
        self._reported: MovedBy | None = None
        # What moves the mouth now, and the timeline position since which it does.
        self._mover_since: tuple[MovedBy | None, float] = (None, 0.0)
        # Seconds of speech that the text did not move; and the timeline position seen last.
        self._unspoken_s: float = 0.0
        self._seen_until_s = 0.0

    def report_shift(self, stream: str, by_s: float) -> None:
        """Report that units of a stream sound `by_s` seconds later than sent."""
        self._append_event("units_shifted", stream, shifted_s=by_s)

    def report_mover(
        self, moved_by: MovedBy | None, *, is_speech: bool, why_sound: MoverReason, are_spoken: bool
    ) -> None:
        """Report what moves the mouth if it has changed for 0.3 s, and a text that is not spoken.

        Call after each commit of sound. moved_by: what moves the mouth; None: not known. why_sound:
        the reason if the sound does; `not_said`: words are known that may come next. are_spoken:
        units sent with times, if there are any, agree with the sound. A text is reported once,
        after 1 s of speech that it did not move.
        """
        stream, now_s = self._playout.speaking, self._playout.committed_s
        passed_s, self._seen_until_s = now_s - self._seen_until_s, now_s
        if stream != self._stream:
            self._stream, self._reported, self._unspoken_s = stream, None, 0.0
            self._mover_since = (None, now_s)
        if stream is None or moved_by is None:
            return
        if moved_by != self._mover_since[0]:
            self._mover_since = moved_by, now_s
        if moved_by != self._reported and now_s >= self._mover_since[1] + _HELD_S:
            self._reported = moved_by
            reason = why_sound if moved_by == "sound" else "told"
            self._append_event("moved_by", stream, moved_by, reason if are_spoken else "not_said")
        if moved_by == "sound" and is_speech and why_sound == "not_said":
            before_s, self._unspoken_s = self._unspoken_s, self._unspoken_s + passed_s
            if before_s < _UNSAID_S <= self._unspoken_s:
                self._append_event("text_dropped", stream)

    def _append_event(
        self,
        kind: EventKind,
        stream: str,
        name: str = "",
        reason: MoverReason = "told",
        shifted_s: float = 0.0,
    ) -> None:
        """Append an event about a stream to the playout's events; nothing if the stream is over.

        name: what moves the mouth; reason: why nothing better does. shifted_s: seconds by which
        units sound later than sent.
        """
        n_played = self._playout.n_played(stream)
        if n_played is None:  # it is over
            return
        position_s = self._playout.position_s
        self._playout.events.append(
            PlayoutEvent(
                kind, stream, position_s, n_played, name=name, reason=reason, shifted_s=shifted_s
            )
        )
