"""Phonemes and visemes with times, as each format tells them, checked and brought into order.

JSON rows as neural synthesisers give them and `lines align -o`; Amazon Polly's speech marks,
Azure's viseme events, HeadTTS. A viseme names a group of phonemes; visemes.yaml has the phone that
stands for each. None of the three says whether a stop's time is its closure or its burst: times are
taken as they are.
"""

import math
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from types import MappingProxyType

import yaml

from lipsync.errors import shown
from lipsync.ipa import phones_of_ipa
from lipsync.phonemes import SILENCE, VISEME_OF, PhonemeEvent
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


@cache
def viseme_rows(viseme_set: str) -> Mapping[str, tuple[str, str]]:
    """(phone, reason) by viseme, of the set `polly`, `azure` or `ovr`; numbers as text."""
    text = files("lipsync.phoneme_files").joinpath("visemes.yaml").read_text("utf-8")
    rows = yaml.safe_load(text)[viseme_set]
    return MappingProxyType({str(viseme): (row[0], row[1]) for viseme, row in rows.items()})


_MS, _TICK_S = 1e-3, 1e-7
_AZURE_OFFSETS = ("audioOffset", "AudioOffset", "audio_offset")
_AZURE_IDS = ("visemeId", "VisemeId", "viseme_id")

Row = Mapping[str, object]
#: A JSON object of the file, and where it stands.
PlacedRow = tuple[str, Row]


def is_polly(rows: Sequence[PlacedRow]) -> bool:
    """Speech marks have a time and a type each."""
    return bool(rows) and all("time" in row and "type" in row for _, row in rows)


def polly_phonemes(rows: Sequence[PlacedRow], name: str) -> tuple[PhonemeEvent, ...]:
    """Speech marks of type viseme, times in ms; words, sentences and other types are left out."""
    labels = [
        Label(
            _phone("polly", row.get("value"), name, place),
            seconds(row["time"], _MS, name, place),
            None,
            place,
        )
        for place, row in rows
        if row["type"] == "viseme"
    ]
    if not labels:
        raise LabelError(
            f"{name}: speech marks without visemes; ask Polly for --speech-mark-types viseme"
        )
    return events_of(labels, name)


def is_azure(rows: Sequence[PlacedRow]) -> bool:
    """Viseme events have an offset and a viseme id each, in one of three spellings."""
    return bool(rows) and all(
        any(key in row for key in _AZURE_OFFSETS) and any(key in row for key in _AZURE_IDS)
        for _, row in rows
    )


def azure_phonemes(rows: Sequence[PlacedRow], name: str) -> tuple[PhonemeEvent, ...]:
    """Viseme events, offsets in ticks of 100 ns."""
    return events_of(
        [
            Label(
                _phone("azure", _first(row, _AZURE_IDS), name, place),
                seconds(_first(row, _AZURE_OFFSETS), _TICK_S, name, place),
                None,
                place,
            )
            for place, row in rows
        ],
        name,
    )


def is_head_tts(document: Row) -> bool:
    """HeadTTS answers with lists of the same length: names, times, durations."""
    return all(key in document for key in ("visemes", "vtimes", "vdurations"))


def head_tts_phonemes(document: Row, name: str) -> tuple[PhonemeEvent, ...]:
    """OVR's names in `visemes`, `vtimes` and `vdurations` in ms."""
    columns = [document[key] for key in ("visemes", "vtimes", "vdurations")]
    if not all(isinstance(column, list) for column in columns):
        raise LabelError(f"{name}: visemes, vtimes and vdurations must be lists")
    visemes, times, durations = (list(column) for column in columns if isinstance(column, list))
    if not len(visemes) == len(times) == len(durations):
        raise LabelError(
            f"{name}: {len(visemes)} visemes, {len(times)} vtimes and {len(durations)} vdurations; "
            "there must be as many of each"
        )
    labels = []
    for index, viseme in enumerate(visemes):
        place = f"visemes[{index}]"
        start_s = seconds(times[index], _MS, name, f"vtimes[{index}]")
        end_s = start_s + seconds(durations[index], _MS, name, f"vdurations[{index}]")
        labels.append(Label(_phone("ovr", viseme, name, place), start_s, end_s, place))
    return events_of(labels, name)


def _first(row: Row, keys: tuple[str, ...]) -> object:
    return next(row[key] for key in keys if key in row)


def _phone(viseme_set: str, viseme: object, name: str, place: str) -> tuple[str, ...]:
    rows = viseme_rows(viseme_set)
    known = None if isinstance(viseme, bool | float) else rows.get(str(viseme)[:40])
    if known is None:
        raise LabelError(
            f"{name}: {place}: {shown(viseme)} is no viseme of {viseme_set}; "
            f"it has: {' '.join(rows)}"
        )
    return (known[0],)


_NAMES = ("phoneme", "phonemes", "symbol")
_STARTS = ("start", "start_s", "start_ts", "start_time")
_ENDS = ("end", "end_s", "end_ts", "end_time")
_DURATIONS = ("duration", "duration_s")
_SAMPLES = "num_samples"
_RATES = ("sample_rate", "sample_rate_hz")
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
