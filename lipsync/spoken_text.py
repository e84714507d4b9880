"""The words, phonemes or visemes of a stream of sound, as far as known: a type for every sender.

Voice agents, speech synthesisers, label files and scripted lines know text, words, phonemes or
visemes; with times or without; before their sound, with it or after it; and may correct
themselves. Times are numbers of samples of the stream, the one clock that a sound and its words
share. In JSON, as on a voice agent's connection (docs/agents.md), units are objects with the fields
of `SpokenUnit`.
"""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

from lipsync.errors import UserError
from lipsync.phonemes import VISEME_OF, PhonemeEvent

#: text: as it is written. phoneme: of our inventory. viseme: a phoneme that looks like it.
UnitKind = Literal["text", "word", "phoneme", "viseme"]

#: Ten minutes of fast speech in phonemes; an hour of a stream keeps its newest.
MOST_UNITS: Final = 12_000
#: Several pages; what is longer is sent in pieces. A word, phoneme or viseme is shorter.
LONGEST_TEXT: Final = 20_000
LONGEST_LABEL: Final = 100
#: Of all units together, as of an hour of speech.
MOST_CHARACTERS: Final = 100_000
#: Duration of a last unit whose end is not known: as long as the longest vowels.
_OPEN_S: Final = 0.3
#: Of units that begin closer together than this only the first counts: no mouth moves faster.
_SHORTEST_S: Final = 0.01


class SpokenTextError(UserError):
    """Error for units that cannot be the text of a stream; the message says why and what to do."""


@dataclass(frozen=True, slots=True)
class SpokenUnit:
    """A piece of text, word, phoneme or viseme, with sample numbers of its stream; None: unknown.

    A unit without an end lasts until the next unit begins.
    """

    label: str
    start_sample: int | None = None
    end_sample: int | None = None


@dataclass(frozen=True, slots=True)
class PronouncedWord:
    """A word with its pronunciations, to be found in its sound by `text_decoder`.

    pronunciations: at least one; phonemes of the inventory without silence, the commonest first.
    start_s: about when the word begins in its stream, None where that is not known.
    """

    label: str
    pronunciations: tuple[tuple[str, ...], ...]
    start_s: float | None = None


@dataclass(frozen=True, slots=True)
class SpokenText:
    """Units of one kind in the order in which they are spoken.

    Creating it raises SpokenTextError for a label that is empty, too long or no phoneme, for more
    than `MOST_UNITS` or `MOST_CHARACTERS`, and for times that are negative, overlap or go back.
    """

    kind: UnitKind
    units: tuple[SpokenUnit, ...]
    sample_rate_hz: int

    def __post_init__(self) -> None:
        """Raise SpokenTextError for units, times or a sample rate that the class does not allow."""
        if self.sample_rate_hz <= 0:
            raise SpokenTextError(f"sample_rate_hz {self.sample_rate_hz} must be above 0")
        if len(self.units) > MOST_UNITS:
            raise SpokenTextError(f"{len(self.units)} {self.kind}s; at most {MOST_UNITS} at once")
        longest = LONGEST_TEXT if self.kind == "text" else LONGEST_LABEL
        newest = 0
        for number, unit in enumerate(self.units):
            place = f"{self.kind} {number}"
            if not 0 < len(unit.label) <= longest:
                raise SpokenTextError(
                    f"{place} has {len(unit.label)} characters; 1 to {longest} are allowed"
                )
            if self.moves_mouth and unit.label not in VISEME_OF:
                raise SpokenTextError(
                    f"{place}: {unit.label!r} is not an ARPAbet phoneme in capitals without "
                    "stress; name the alphabet of these labels"
                )
            for sample in (unit.start_sample, unit.end_sample):
                if sample is not None and sample < newest:
                    raise SpokenTextError(
                        f"{place}: sample {sample} is before {newest}; put them in order of time"
                    )
                newest = newest if sample is None else sample
        if self.n_characters > MOST_CHARACTERS and self.kind == "text":
            raise SpokenTextError(
                f"a text of {self.n_characters} characters is too long; send at most "
                f"{MOST_CHARACTERS} at once"
            )

    @property
    def n_characters(self) -> int:
        """The number of characters of all units' labels."""
        return sum(len(unit.label) for unit in self.units)

    @property
    def moves_mouth(self) -> bool:
        """Whether the units are phonemes or visemes, not text or words to find in the sound."""
        return self.kind in ("phoneme", "viseme")

    @property
    def is_timed(self) -> bool:
        """Whether the start of every unit is known."""
        return all(unit.start_sample is not None for unit in self.units)

    def revised(self, later: "SpokenText") -> "SpokenText":
        """Return a copy with the units of `later` added.

        If the first of them has a start, they replace all units from there on; else they are
        appended. Of too many units the oldest are dropped. Raises SpokenTextError for another kind
        or rate, or where the result goes back in time.
        """
        if (later.kind, later.sample_rate_hz) != (self.kind, self.sample_rate_hz):
            raise SpokenTextError(
                f"{later.kind}s at {later.sample_rate_hz} Hz cannot continue {self.kind}s at "
                f"{self.sample_rate_hz} Hz; send one kind at one rate"
            )
        start = later.units[0].start_sample if later.units else None
        earlier = self.units if start is None else _units_before(self.units, start)
        # The first time given now, and the last one known from earlier units.
        first = next((t for unit in later.units for t in _known_times(unit)), None)
        newest = next((t for unit in reversed(earlier) for t in reversed(_known_times(unit))), 0)
        if first is not None and first < newest:
            raise SpokenTextError(
                f"these {later.kind}s start at sample {first}, before sample {newest}, which was "
                "sent already; to correct what was sent, give the first of them a start time"
            )
        units = (*earlier, *later.units)[-MOST_UNITS:]
        if self.kind == "text":
            while len(units) > 1 and sum(len(unit.label) for unit in units) > MOST_CHARACTERS:
                units = units[1:]
        return _unchecked(self.kind, units, self.sample_rate_hz)

    def is_corrected_by(self, later: "SpokenText") -> bool:
        """Return whether `revised(later)` would replace any of these units."""
        start = later.units[0].start_sample if later.units else None
        return start is not None and len(_units_before(self.units, start)) < len(self.units)

    def events(
        self, from_sample: int = 0, until_sample: int | None = None
    ) -> tuple[PhonemeEvent, ...]:
        """Return the phonemes between two samples of the stream, as events in seconds of it.

        until_sample: None for no limit. Raises SpokenTextError for units without times, and for
        words. Units that last no time are left out.
        """
        if not (self.moves_mouth and (not self.units or self.units[-1].start_sample is not None)):
            raise SpokenTextError(f"{self.kind}s need times to move a mouth (start_sample)")
        first = max(0, bisect_right(self.units, from_sample, key=_start_sample) - 1)
        end = len(self.units)
        if until_sample is not None:
            end = bisect_right(self.units, until_sample, key=_start_sample)
        rate_hz = self.sample_rate_hz
        shortest, open_end = round(_SHORTEST_S * rate_hz), round(_OPEN_S * rate_hz)
        # Units that begin within 10 ms of the one before are merged into it.
        apart: list[SpokenUnit] = []
        for unit in self.units[first:end]:
            if apart and _start_sample(unit) < _start_sample(apart[-1]) + shortest:
                if unit.end_sample is not None and apart[-1].end_sample is not None:
                    apart[-1] = replace(apart[-1], end_sample=unit.end_sample)
            else:
                apart.append(unit)
        events = []
        unit_after = self.units[end] if end < len(self.units) else None
        for unit, next_unit in zip(apart, (*apart[1:], unit_after), strict=True):
            start = _start_sample(unit)
            next_start = start + open_end if next_unit is None else _start_sample(next_unit)
            end_sample = next_start if unit.end_sample is None else unit.end_sample
            if next_unit is not None:
                end_sample = min(end_sample, next_start)
            if end_sample > max(start, from_sample):
                events.append(PhonemeEvent(unit.label, start / rate_hz, end_sample / rate_hz))
        return tuple(events)


def _unchecked(kind: UnitKind, units: tuple[SpokenUnit, ...], sample_rate_hz: int) -> SpokenText:
    """Return a `SpokenText` of units already checked, so that adding one unit costs little."""
    joined = object.__new__(SpokenText)
    fields = {"kind": kind, "units": units, "sample_rate_hz": sample_rate_hz}
    for name, value in fields.items():
        object.__setattr__(joined, name, value)
    return joined


def _known_times(unit: SpokenUnit) -> tuple[int, ...]:
    return tuple(t for t in (unit.start_sample, unit.end_sample) if t is not None)


def _start_sample(unit: SpokenUnit) -> int:
    return unit.start_sample or 0


def _units_before(units: Sequence[SpokenUnit], start_sample: int) -> Sequence[SpokenUnit]:
    """Return the units before `start_sample`; one that lasts beyond it is cut there.

    The result ends at the first unit known to begin at or after that sample. No unit is before
    sample 0, whether its time is known or not.
    """
    if start_sample == 0:
        return ()
    n_kept = len(units)
    for number in range(len(units) - 1, -1, -1):
        unit_start = units[number].start_sample
        if unit_start is not None and unit_start < start_sample:
            break
        n_kept = n_kept if unit_start is None else number
    units = units[:n_kept]
    if units and (units[-1].end_sample or 0) > start_sample:
        return (*units[:-1], replace(units[-1], end_sample=start_sample))
    return units
