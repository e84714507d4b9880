"""What is said in a stream of sound, as far as whoever speaks tells: one type for all that do.

Voice agents, speech synthesisers, label files and scripted lines know text, words, phonemes or
visemes; with times or without; before their sound, with it or after it; and may correct
themselves. Times are numbers of samples of the stream, the one clock that a sound and its words
share.
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
#: A paragraph; a stream sends the next one as the next unit.
LONGEST_LABEL: Final = 2_000


class SpokenTextError(UserError):
    """Units that cannot be what is said: which, where, and what to do."""


@dataclass(frozen=True, slots=True)
class SpokenUnit:
    """A piece of text, a word, a phoneme or a viseme; samples of the stream, None: not known."""

    label: str
    start_sample: int | None = None
    end_sample: int | None = None


@dataclass(frozen=True, slots=True)
class SpokenText:
    """Units of one kind in the order in which they are said.

    Raises SpokenTextError for a label that is empty, too long or no phoneme, for more than
    `MOST_UNITS`, and for times that are negative or go back.
    """

    kind: UnitKind
    units: tuple[SpokenUnit, ...]
    sample_rate_hz: int

    def __post_init__(self) -> None:
        if self.sample_rate_hz <= 0:
            raise SpokenTextError(f"sample_rate_hz is {self.sample_rate_hz}, not the sound's")
        if len(self.units) > MOST_UNITS:
            raise SpokenTextError(f"{len(self.units)} {self.kind}s; at most {MOST_UNITS} at once")
        newest = 0
        for number, unit in enumerate(self.units):
            place = f"{self.kind} {number}"
            if not unit.label or len(unit.label) > LONGEST_LABEL:
                raise SpokenTextError(f"{place}: 1 to {LONGEST_LABEL} characters, please")
            if self.kind in ("phoneme", "viseme") and unit.label not in VISEME_OF:
                raise SpokenTextError(f"{place}: {unit.label!r} is no phoneme of ARPAbet's")
            for sample in (unit.start_sample, unit.end_sample):
                if sample is not None and sample < newest:
                    raise SpokenTextError(f"{place}: sample {sample} is before {newest}")
                newest = newest if sample is None else sample

    @property
    def is_timed(self) -> bool:
        """Whether every unit has both of its times."""
        return all(None not in (unit.start_sample, unit.end_sample) for unit in self.units)

    def revised(self, later: "SpokenText") -> "SpokenText":
        """The units with those of a later message: appended, or in place of all from its start on.

        The newest `MOST_UNITS` are kept. Raises SpokenTextError for another kind or rate, or where
        the result goes back in time.
        """
        if (later.kind, later.sample_rate_hz) != (self.kind, self.sample_rate_hz):
            raise SpokenTextError(
                f"{later.kind}s at {later.sample_rate_hz} Hz do not revise {self.kind}s at "
                f"{self.sample_rate_hz} Hz"
            )
        start = later.units[0].start_sample if later.units else None
        kept = self.units if start is None else tuple(_before(self.units, start))
        return replace(self, units=(*kept, *later.units)[-MOST_UNITS:])

    def events(self) -> tuple[PhonemeEvent, ...]:
        """The phonemes in seconds of the stream; SpokenTextError without times, or for words."""
        if self.kind not in ("phoneme", "viseme") or not self.is_timed:
            raise SpokenTextError(f"{self.kind}s without times move no mouth by themselves")
        rate_hz = self.sample_rate_hz
        return tuple(
            PhonemeEvent(unit.label, (unit.start_sample or 0) / rate_hz, unit.end_sample / rate_hz)
            for unit in self.units
            if unit.end_sample is not None
        )


def _before(units: Sequence[SpokenUnit], start_sample: int) -> Sequence[SpokenUnit]:
    """Units up to the first that is known to begin at or after a sample; an overlap is cut."""
    for number, unit in enumerate(units):
        if unit.start_sample is not None and unit.start_sample >= start_sample:
            units = units[:number]
            break
    if units and (units[-1].end_sample or 0) > start_sample:
        return [*units[:-1], replace(units[-1], end_sample=start_sample)]
    return units
