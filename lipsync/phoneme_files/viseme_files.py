"""Visemes with times: Amazon Polly's speech marks, Azure's viseme events, HeadTTS.

A viseme names a group of phonemes; visemes.yaml has the phone that stands for each. None of the
three says whether a stop's time is its closure or its burst: times are taken as they are.
"""

from collections.abc import Mapping, Sequence

from lipsync.errors import shown
from lipsync.phoneme_files.labels import Label, events_of, seconds
from lipsync.phoneme_files.viseme_table import viseme_rows
from lipsync.phonemes import PhonemeEvent
from lipsync.textgrid import LabelError

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
