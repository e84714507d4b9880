"""Tables that turn phoneme and viseme labels of other programs into phones of our inventory.

A viseme covers several phonemes; its row in alphabets.yaml has the one phone that moves the mouth
in their place, and the reason. Phonemes of any language are given in IPA (ipa.yaml), or in a
spelling that is turned into IPA letter by letter: X-SAMPA, misaki, the phoneme alphabet of Kokoro,
and that of VOICEVOX for Japanese. docs/text.md shows the tables.
"""

import re
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import Final

import yaml
from lipservo_client.alphabet import PAUSES, arpabet_phone, is_pause, without_place

from lipsync.errors import UserError, shown
from lipsync.ipa import phones_of_ipa
from lipsync.phonemes import SILENCE, VISEME_OF
from lipsync.spoken_text import SpokenText, SpokenUnit, UnitKind

#: The alphabet of our inventory, also meant where none is named.
ARPABET: Final = "arpabet"
IPA: Final = "ipa"
X_SAMPA: Final = "x-sampa"
#: Alphabets that write IPA in other letters.
_SPELLINGS: Final = (X_SAMPA, "misaki", "voicevox")

#: Marks of X-SAMPA that stand for no letter: `_h`, aspirated.
_MARK: Final = re.compile(r"_[^_\\]\\?")


class AlphabetError(UserError):
    """Error for an unknown alphabet or a label that an alphabet lacks; the message is one line."""


@cache
def _tables() -> Mapping[str, Mapping[str, tuple[str, ...]]]:
    """Return the tables of alphabets.yaml: by alphabet and label, the row of that label.

    A row of a viseme set is (phone, reason); that of a spelling is (IPA,).
    """
    text = files("lipsync").joinpath("alphabets.yaml").read_text("utf-8")
    return MappingProxyType(
        {
            name: MappingProxyType({str(label): tuple(row) for label, row in rows.items()})
            for name, rows in yaml.safe_load(text).items()
        }
    )


@cache
def viseme_sets() -> Mapping[str, Mapping[str, tuple[str, str]]]:
    """Return, by name of the viseme set, a table from viseme label to (phone, reason for it)."""
    sets = {name: rows for name, rows in _tables().items() if name not in (IPA, *_SPELLINGS)}
    return MappingProxyType(
        {
            name: {label: (row[0], row[1]) for label, row in rows.items()}
            for name, rows in sets.items()
        }
    )


def alphabets() -> tuple[str, ...]:
    """Return the names of all alphabets that `phones_of` accepts."""
    return (ARPABET, IPA, *_SPELLINGS, *viseme_sets())


def phones_of(label: str, alphabet: str = ARPABET, *, guesses: bool = True) -> tuple[str, ...]:
    """Return our inventory's phones for one `label` of an `alphabet` ("": ARPAbet, in any case).

    () for a label that is only a mark, such as a length mark, which prolongs the phone before it.
    guesses: whether an IPA letter that ipa.yaml lacks becomes the most similar letter in ipa.yaml,
    or is refused. Raises AlphabetError for an unknown alphabet or label.
    """
    if alphabet in ("", ARPABET):
        if is_pause(label):
            return (SILENCE,)
        phone = arpabet_phone(label)
        if phone is None:
            raise AlphabetError(
                f"{shown(label)} is not an ARPAbet phoneme; write SIL for silence, or name the "
                f"alphabet: {', '.join(alphabets())}"
            )
        return (phone,)
    if alphabet in (IPA, *_SPELLINGS):
        return _phones_of_spelling(label, alphabet, guesses=guesses)
    visemes = viseme_sets().get(alphabet)
    if visemes is None:
        raise AlphabetError(
            f"alphabet {shown(alphabet)} is not known; use one of: {', '.join(alphabets())}"
        )
    if label not in visemes:
        raise AlphabetError(
            f"{shown(label)} is not a viseme of {alphabet}, which has: {' '.join(visemes)}"
        )
    return (visemes[label][0],)


def in_inventory(
    kind: UnitKind, units: Iterable[SpokenUnit], alphabet: str, sample_rate_hz: int
) -> SpokenText:
    """Return `units`, labelled in `alphabet`, as units of phones.

    The phones of a unit share its time evenly. kind: of all units; sample_rate_hz: of the sound,
    whose sample numbers the units' times are. A label without a phone, such as a length mark,
    extends the unit before it. Raises AlphabetError for an unknown label or alphabet, and
    SpokenTextError for units that are too many or out of order.
    """
    found: list[SpokenUnit] = []
    units = tuple(units)
    for number, (unit, next_unit) in enumerate(zip(units, (*units[1:], None), strict=True)):
        try:
            phones = phones_of(unit.label, alphabet)
        except AlphabetError as error:
            raise AlphabetError(f"{kind} {number + 1}: {error}") from None
        if phones:
            found += _split(phones, unit, None if next_unit is None else next_unit.start_sample)
        elif found and unit.end_sample is not None:
            found[-1] = SpokenUnit(found[-1].label, found[-1].start_sample, unit.end_sample)
    return SpokenText(kind, tuple(found), sample_rate_hz)


def _split(phones: tuple[str, ...], unit: SpokenUnit, next_sample: int | None) -> list[SpokenUnit]:
    """Return one unit for each of `phones`, with the time of `unit` divided evenly among them.

    next_sample: start of the next unit, used as the end where `unit` has none; None: not known.
    Without a start the phones have no times; without an end only the first phone is returned.
    """
    end_sample = next_sample if unit.end_sample is None else unit.end_sample
    if unit.start_sample is None:
        return [SpokenUnit(each) for each in phones]
    if end_sample is None or end_sample < unit.start_sample:
        # When the other phones begin is not known.
        return [SpokenUnit(phones[0], unit.start_sample, unit.end_sample)]
    span = end_sample - unit.start_sample
    bounds = [unit.start_sample + round(span * n / len(phones)) for n in range(len(phones) + 1)]
    return [SpokenUnit(each, bounds[n], bounds[n + 1]) for n, each in enumerate(phones)]


def _phones_of_spelling(label: str, alphabet: str, *, guesses: bool) -> tuple[str, ...]:
    """Return the phones for a `label` of IPA or of a spelling that stands for IPA; SIL for a pause.

    guesses: as in `phones_of`. Raises AlphabetError for a letter that would have to be guessed.
    """
    # X-SAMPA writes some vowels as punctuation, which is a pause elsewhere.
    if label.lower() in PAUSES or (alphabet != X_SAMPA and is_pause(label)):
        return (SILENCE,)
    if alphabet == IPA:
        label = without_place(label)
        label = _tables()[IPA].get(label, (label,))[0]
        if (arpabet := label.rstrip("012")) in VISEME_OF:
            return (arpabet,)
    converted = phones_of_ipa(label if alphabet == IPA else _as_ipa(label, alphabet))
    if converted.is_guess and not guesses:
        raise AlphabetError(f"{shown(label)} is not a phoneme of {alphabet}; correct this label")
    return converted.phones


def _as_ipa(label: str, alphabet: str) -> str:
    """Return a label in IPA; letters that the table of its `alphabet` lacks are kept.

    From the left, the longest symbol that the table has is replaced.
    """
    table = _tables()[alphabet]
    longest = max(map(len, table))
    ipa, index = "", 0
    label = _MARK.sub("", label)
    while index < len(label):
        for length in range(min(longest, len(label) - index), 0, -1):
            if (row := table.get(label[index : index + length])) is not None:
                ipa += row[0]
                break
        else:
            length = 1
            ipa += label[index]
        index += length
    return ipa
