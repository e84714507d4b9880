"""Phonemes with times in JSON: rows as neural synthesisers give them, and `lines align -o`."""

import unicodedata
from collections.abc import Mapping, Sequence

from lipsync.errors import shown
from lipsync.ipa import phones_of_ipa
from lipsync.phoneme_files.labels import Label, events_of, seconds
from lipsync.phoneme_files.viseme_files import PlacedRow, Row
from lipsync.phonemes import SILENCE, VISEME_OF, PhonemeEvent
from lipsync.textgrid import LabelError

_NAMES = ("phoneme", "phonemes", "symbol")
_STARTS = ("start", "start_s", "start_ts", "start_time")
_ENDS = ("end", "end_s", "end_ts", "end_time")
_DURATIONS = ("duration", "duration_s")
_SAMPLES = "num_samples"
_RATES = ("sample_rate", "sample_rate_hz")
_RATES_HZ = range(4000, 400_001)
#: Pauses by name, and Piper's marks of beginning and end; punctuation is a pause as well.
_PAUSES = frozenset((SILENCE, "sil", "sp", "pau", "", "^", "$"))


def is_phone_tiers(document: Row) -> bool:
    """What `lipservo lines align -o NAME.json` writes."""
    return "phones" in document


def tier_phonemes(document: Row, name: str) -> tuple[PhonemeEvent, ...]:
    """`{"phones": [[label, start_s, end_s], ...]}`: ARPAbet without stress; "" is silence."""
    rows = document["phones"]
    if not isinstance(rows, list):
        raise LabelError(f"{name}: phones must be a list of [label, start_s, end_s]")
    labels = []
    for index, row in enumerate(rows):
        place = f"phones[{index}]"
        if not isinstance(row, list) or len(row) != 3:
            raise LabelError(f"{name}: {place}: {shown(row)} is not [label, start_s, end_s]")
        phone = row[0] or SILENCE
        if not isinstance(phone, str) or phone not in VISEME_OF:
            raise LabelError(
                f"{name}: {place}: {shown(row[0])} is no phoneme; "
                "use ARPAbet in upper case without stress, SIL for silence"
            )
        start_s, end_s = (seconds(value, 1.0, name, place) for value in row[1:])
        labels.append(Label((phone,), start_s, end_s, place))
    return events_of(labels, name)


def is_aligned(rows: Sequence[PlacedRow]) -> bool:
    """Rows that name a phoneme each."""
    return bool(rows) and all(any(key in row for key in _NAMES) for _, row in rows)


def aligned_phonemes(
    rows: Sequence[PlacedRow], document: Mapping[str, object], name: str
) -> tuple[PhonemeEvent, ...]:
    """Rows of a phoneme (IPA or ARPAbet) with start and end, duration, or number of samples.

    Times are in seconds; samples are counted at the `sample_rate` beside the rows. Rows without a
    start follow each other. A phoneme of several letters is split as lipsync/ipa.yaml says.
    """
    labels: list[Label] = []
    reached_s = 0.0
    for place, row in rows:
        start = _value(row, _STARTS)
        start_s = reached_s if start is None else seconds(start, 1.0, name, place)
        end_s = _row_end_s(row, start_s, document, name, place)
        labels.append(Label(_phones(_value(row, _NAMES), name, place), start_s, end_s, place))
        reached_s = end_s if end_s is not None else start_s
    return events_of(labels, name)


def _row_end_s(
    row: Row, start_s: float, document: Mapping[str, object], name: str, place: str
) -> float | None:
    end = _value(row, _ENDS)
    if end is not None:
        return seconds(end, 1.0, name, place)
    duration = _value(row, _DURATIONS)
    if duration is not None:
        return start_s + seconds(duration, 1.0, name, place)
    if _SAMPLES in row:
        rate_hz = _value(document, _RATES)
        if (
            isinstance(rate_hz, bool)
            or not isinstance(rate_hz, int)
            or rate_hz not in range(4000, 400_001)
        ):
            raise LabelError(
                f"{name}: {place}: samples are counted, and no sample_rate (4000 to 400000) "
                "stands beside the rows"
            )
        return start_s + seconds(row[_SAMPLES], 1.0 / rate_hz, name, place)
    if _value(row, _STARTS) is None:
        raise LabelError(f"{name}: {place}: no time; give start and end, duration, or num_samples")
    return None


def _value(row: Mapping[str, object], keys: tuple[str, ...]) -> object:
    return next((row[key] for key in keys if row.get(key) is not None), None)


def _phones(symbol: object, name: str, place: str) -> tuple[str, ...]:
    if not isinstance(symbol, str):
        raise LabelError(f"{name}: {place}: {shown(symbol)} is no phoneme; write it as text")
    if symbol in _PAUSES or all(unicodedata.category(sign).startswith("P") for sign in symbol):
        return (SILENCE,)
    arpabet = symbol.rstrip("012")
    if arpabet in VISEME_OF:
        return (arpabet,)
    return phones_of_ipa(symbol).phones
