"""What is said in a stream of sound, as far as its sender knows: one type for every sender.

Voice agents, speech synthesisers, label files and scripted lines know text, words, phonemes or
visemes; with times or without; before their sound, with it or after it; and may correct
themselves. Times are numbers of samples of the stream, the one clock that a sound and its words
share. In JSON, as on a voice agent's connection (docs/agents.md), units are objects with the fields
of `SpokenUnit`.
"""

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
#: The last unit of all, whose end is not known, lasts so long: the longest vowels do.
_OPEN_S: Final = 0.3


class SpokenTextError(UserError):
    """Units that cannot be what is said: which, where, and what to do."""


@dataclass(frozen=True, slots=True)
class SpokenUnit:
    """A piece of text, a word, a phoneme or a viseme; samples of the stream, None: not known.

    Without an end it lasts until the next one begins.
    """

    label: str
    start_sample: int | None = None
    end_sample: int | None = None


@dataclass(frozen=True, slots=True)
class SpokenText:
    """Units of one kind in the order in which they are said.

    Raises SpokenTextError for a label that is empty, too long or no phoneme, for more than
    `MOST_UNITS` or `MOST_CHARACTERS`, and for times that are negative, overlap or go back.
    """

    kind: UnitKind
    units: tuple[SpokenUnit, ...]
    sample_rate_hz: int

    def __post_init__(self) -> None:
        if self.sample_rate_hz <= 0:
            raise SpokenTextError(f"sample_rate_hz is {self.sample_rate_hz}, not the sound's")
        if len(self.units) > MOST_UNITS:
            raise SpokenTextError(f"{len(self.units)} {self.kind}s; at most {MOST_UNITS} at once")
        longest = LONGEST_TEXT if self.kind == "text" else LONGEST_LABEL
        newest = 0
        for number, unit in enumerate(self.units):
            place = f"{self.kind} {number}"
            if not 0 < len(unit.label) <= longest:
                raise SpokenTextError(
                    f"{place}: {len(unit.label)} characters; 1 to {longest} are possible"
                )
            if self.moves_mouth and unit.label not in VISEME_OF:
                raise SpokenTextError(
                    f"{place}: {unit.label!r} is no phoneme of ARPAbet in upper case without "
                    "stress; name the alphabet that it is of"
                )
            for sample in (unit.start_sample, unit.end_sample):
                if sample is not None and sample < newest:
                    raise SpokenTextError(
                        f"{place}: sample {sample} is before {newest}; times may not run backwards"
                    )
                newest = newest if sample is None else sample
        n_characters = sum(len(unit.label) for unit in self.units)
        if n_characters > MOST_CHARACTERS:
            raise SpokenTextError(
                f"{n_characters} characters; at most {MOST_CHARACTERS} at once, send the rest later"
            )

    @property
    def moves_mouth(self) -> bool:
        """Whether the units are shapes of a mouth, rather than to be found in the sound."""
        return self.kind in ("phoneme", "viseme")

    @property
    def is_timed(self) -> bool:
        """Whether it is known when each unit begins."""
        return all(unit.start_sample is not None for unit in self.units)

    def revised(self, later: "SpokenText") -> "SpokenText":
        """The units with those of a later message: appended, or in place of all from its start on.

        The newest are kept where they become too many. Raises SpokenTextError for another kind or
        rate, or where the result goes back in time.
        """
        if (later.kind, later.sample_rate_hz) != (self.kind, self.sample_rate_hz):
            raise SpokenTextError(
                f"{later.kind}s at {later.sample_rate_hz} Hz do not revise {self.kind}s at "
                f"{self.sample_rate_hz} Hz"
            )
        start = later.units[0].start_sample if later.units else None
        kept = self.units if start is None else _before(self.units, start)
        units = [*kept, *later.units][-MOST_UNITS:]
        n_too_many = sum(len(unit.label) for unit in units) - MOST_CHARACTERS
        n_dropped = 0
        while n_too_many > 0:
            n_too_many -= len(units[n_dropped].label)
            n_dropped += 1
        return replace(self, units=tuple(units[n_dropped:]))

    def events(self) -> tuple[PhonemeEvent, ...]:
        """The phonemes in seconds of the stream; SpokenTextError without times, or for words.

        Units that take no time are left out.
        """
        if not (self.moves_mouth and self.is_timed):
            raise SpokenTextError(f"{self.kind}s without times move no mouth by themselves")
        rate_hz = self.sample_rate_hz
        open_samples = round(_OPEN_S * rate_hz)
        events = []
        for unit, after in zip(self.units, (*self.units[1:], None), strict=True):
            start = unit.start_sample or 0
            next_start = start + open_samples if after is None else after.start_sample or 0
            end = next_start if unit.end_sample is None else unit.end_sample
            if end > start:
                events.append(PhonemeEvent(unit.label, start / rate_hz, end / rate_hz))
        return tuple(events)


def _before(units: Sequence[SpokenUnit], start_sample: int) -> Sequence[SpokenUnit]:
    """Units up to the first that is known to begin at or after a sample; an overlap is cut.

    Nothing is before the first sample, whether its time is known or not.
    """
    if start_sample == 0:
        return ()
    for number, unit in enumerate(units):
        if unit.start_sample is not None and unit.start_sample >= start_sample:
            units = units[:number]
            break
    if units and (units[-1].end_sample or 0) > start_sample:
        return [*units[:-1], replace(units[-1], end_sample=start_sample)]
    return units
