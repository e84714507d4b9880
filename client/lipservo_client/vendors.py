"""What speech synthesisers tell of what they say, as units that a face understands.

A message as its vendor documents it, parsed from JSON, becomes words, phonemes or visemes with
times in seconds. Which keys hold what is a table, and envelopes are walked through, so that an
event, a whole answer and a file of many are read alike: docs/text.md has an example of each.
The standard library is all that it needs.
"""

import math
import reprlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final, Literal, NamedTuple

Kind = Literal["word", "phoneme", "viseme"]

#: Ten minutes of fast speech in phonemes, as much as a face takes at once.
MOST_UNITS: Final = 12_000
#: No speech in one message is longer; more is another unit or a mistake.
_LONGEST_S: Final = 24 * 3600.0
#: Messages lie deeper in their envelopes than this in no documentation.
_DEEPEST: Final = 12
#: Times are rounded to so many digits, the 100 ns of Azure: 0.3 s and 0.05 s more are 0.35 s.
_DIGITS: Final = 7
_MS, _TICK_S = 1e-3, 1e-7


class VendorError(ValueError):
    """A message that cannot be used: where in it, what, and what to do, in one line."""


class TimedUnit(NamedTuple):
    """A word, a phoneme or a viseme as its vendor writes it; seconds, None: not known."""

    label: str
    start_s: float
    end_s: float | None


@dataclass(frozen=True, slots=True)
class VendorUnits:
    """Units of one kind in the order in which they are said, none beginning before the last.

    alphabet: of their labels, as a face knows it: `ipa` (ARPAbet too), or whose visemes they are,
    `azure`, `polly`, `ovr`, `inworld`; "" of words.
    """

    kind: Kind
    units: tuple[TimedUnit, ...]
    alphabet: str = ""


@dataclass(frozen=True, slots=True)
class _Shape:
    """Where a message has its units: keys in lower case without underscores, the first that is
    there.

    The values are one unit's, or lists of as many. lasts: a duration. type: what the message's
    `type` must say. unit_s: of its times.
    """

    kind: Literal["word", "phoneme", "viseme", "character"]
    label: tuple[str, ...]
    start: tuple[str, ...] = ()
    end: tuple[str, ...] = ()
    lasts: tuple[str, ...] = ()
    unit_s: float = 1.0
    type: str = ""
    alphabet: str = ""


_STARTS = ("start", "starts", "startts", "starttime")
_ENDS = ("end", "ends", "endts", "endtime")
_DURATIONS = ("duration", "durations")
#: Counted at the `sample_rate` beside or above them.
_SAMPLES: Final = "numsamples"
_OFFSETS = ("audiooffset", "offset")
_SHAPES: Final = (
    # elevenlabs.io/docs/api-reference/text-to-speech/convert-with-timestamps; its WebSocket
    _Shape("character", ("characters",), ("characterstarttimesseconds",), ("characterendtimesseconds",)),
    _Shape("character", ("chars",), ("charstarttimesms",), lasts=("chardurationsms", "charsdurationsms"), unit_s=_MS),
    # docs.inworld.ai/tts/capabilities/timestamps
    _Shape("word", ("words",), ("wordstarttimeseconds",), ("wordendtimeseconds",)),
    _Shape("character", ("characters",), ("characterstarttimeseconds",), ("characterendtimeseconds",)),
    _Shape("phoneme", ("phonesymbol",), ("starttimeseconds",), lasts=("durationseconds",)),
    _Shape("viseme", ("visemesymbol",), ("starttimeseconds",), lasts=("durationseconds",), alphabet="inworld"),
    # github.com/met4citizen/HeadTTS
    _Shape("viseme", ("visemes",), ("vtimes",), lasts=("vdurations",), unit_s=_MS, alphabet="ovr"),
    _Shape("word", ("words",), ("wtimes",), lasts=("wdurations",), unit_s=_MS),
    # docs.aws.amazon.com/polly/latest/dg/output.html
    _Shape("viseme", ("value",), ("time",), unit_s=_MS, type="viseme", alphabet="polly"),
    _Shape("word", ("value",), ("time",), unit_s=_MS, type="word"),
    # learn.microsoft.com/azure/ai-services/speech-service/how-to-speech-synthesis-viseme
    _Shape("viseme", ("visemeid",), _OFFSETS, unit_s=_TICK_S, alphabet="azure"),
    _Shape("word", ("text",), _OFFSETS, lasts=_DURATIONS, unit_s=_TICK_S),
    # cloud.google.com/text-to-speech/docs/reference/rest/v1beta1/text/synthesize: marks named as words
    _Shape("word", ("markname",), ("timeseconds",)),
    # dev.hume.ai/docs/text-to-speech-tts/timestamps
    _Shape("word", ("text",), ("begin",), ("end",), unit_s=_MS, type="word"),
    _Shape("phoneme", ("text",), ("begin",), ("end",), unit_s=_MS, type="phoneme"),
    # Kokoro's tokens (github.com/hexgrad/kokoro); their phonemes as the next
    _Shape("word", ("text",), ("startts",), ("endts",)),
    # Cartesia (docs.cartesia.ai/api-reference/tts/websocket), Piper's alignments
    # (github.com/OHF-Voice/piper1-gpl), ours, and whatever else is as plain
    _Shape("phoneme", ("phoneme", "phonemes", "symbol", "phones"), _STARTS, _ENDS, _DURATIONS),
    _Shape("viseme", ("viseme", "visemes"), _STARTS, _ENDS, _DURATIONS),
    _Shape("word", ("word", "words"), _STARTS, _ENDS, _DURATIONS),
)  # fmt: skip
#: Of Azure's boundaries: no words.
_UNSAID: Final = ("punctuation", "sentence")


def vendor_units(message: object, from_s: float = 0.0) -> tuple[VendorUnits, ...]:
    """All that a message tells, the most precise kind first: phonemes, visemes, words.

    message: parsed JSON of a vendor, or a list of several. from_s: added to its times, where they
    are counted from the beginning of a piece of sound and not of the stream. Raises VendorError.
    """
    found = _Found(from_s)
    for node, place, rate_hz, alphabet in _nodes(message, "", None, "", 0):
        for shape in _SHAPES:
            found.take(shape, node, place, rate_hz, alphabet)
    units = found.units()
    if not units:
        raise VendorError(
            "no times of words, phonemes or visemes; docs/text.md shows what each vendor sends"
        )
    return units


_Node = Mapping[str, object]


def _nodes(
    value: object, place: str, rate_hz: object, alphabet: str, depth: int
) -> Iterator[tuple[_Node, str, object, str]]:
    """Every object in the message with its place, and the sample rate and set that hold there."""
    if depth > _DEEPEST:
        raise VendorError(f"{place[:60]}: nested deeper than any vendor's message")
    if isinstance(value, list):
        for number, each in enumerate(value):
            if isinstance(each, dict | list):
                yield from _nodes(each, f"{place}[{number}]", rate_hz, alphabet, depth + 1)
    elif isinstance(value, dict):
        node = _plain(value)
        rate_hz = node.get("samplerate", node.get("sampleratehz", rate_hz))
        alphabet = str(node.get("alphabet", alphabet))[:20]
        yield node, place, rate_hz, alphabet
        for key, each in value.items():
            is_again = _key(key) == "normalizedalignment" and node.get("alignment")
            if isinstance(each, dict | list) and not is_again:
                inner = f"{place}.{key}" if place else str(key)
                yield from _nodes(each, inner, rate_hz, alphabet, depth + 1)


def _key(key: object) -> str:
    return str(key).replace("_", "").lower()


def _plain(value: Mapping[object, object]) -> _Node:
    """An object with its keys as `_Shape` has them; rows of [label, start, end] are three lists."""
    node = {_key(key): each for key, each in value.items()}
    if isinstance(time := node.get("time"), dict):
        node |= {_key(key): each for key, each in time.items()}
    for name in ("phones", "phonemes", "visemes", "words"):
        rows = node.get(name)
        if isinstance(rows, list) and rows and all(isinstance(row, list) for row in rows):
            if any(len(row) != 3 for row in rows):
                raise VendorError(f"{name}: rows must be [label, start, end]")
            return {
                **node,
                **dict(zip((name, "start", "end"), map(list, zip(*rows)), strict=True)),
            }
    return node


@dataclass(slots=True)
class _Found:
    from_s: float
    _of: dict[tuple[Kind, str], list[TimedUnit]] = field(default_factory=dict)

    def take(self, shape: _Shape, node: _Node, place: str, rate_hz: object, alphabet: str) -> None:
        """Add the units of an object that has the shape."""
        label = _first(node, shape.label)
        start, end = _first(node, shape.start), _first(node, shape.end)
        lasts, unit_s = _first(node, shape.lasts), shape.unit_s
        if lasts is None and shape.kind == "phoneme" and _SAMPLES in node:
            lasts, unit_s = node[_SAMPLES], 1.0 / _rate(rate_hz, place)
        if label is None or (start is None and lasts is None):
            return
        if shape.lasts and not shape.end and lasts is None:
            return
        if shape.type and shape.type != str(node.get("type")).lower():
            return
        columns = [
            each if isinstance(each, list) else [each] for each in (label, start, end, lasts)
        ]
        n = len(columns[0])
        if any(len(column) not in (n, 1 if column == [None] else n) for column in columns):
            lengths = ", ".join(str(len(column)) for column in columns if column != [None])
            raise VendorError(f"{place or 'message'}: lists of {lengths} values; as many of each")
        kind: Kind = "word" if shape.kind == "character" else shape.kind
        rows = self._of.setdefault(
            (kind, shape.alphabet or (alphabet if kind == "viseme" else "")), []
        )
        if len(rows) + n > MOST_UNITS:
            raise VendorError(f"more than {MOST_UNITS} {kind}s; send them in pieces")
        found = self._rows(columns, unit_s, rows, place)
        rows += _words(found) if shape.kind == "character" else found

    def _rows(
        self, columns: list[list[object]], unit_s: float, before: list[TimedUnit], place: str
    ) -> Iterator[TimedUnit]:
        labels, starts, ends, lasts = (
            column if len(column) == len(columns[0]) else column * len(columns[0])
            for column in columns
        )
        reached_s = (before[-1].end_s or before[-1].start_s) if before else self.from_s
        for number, label in enumerate(labels):
            where = f"{place}[{number}]" if len(labels) > 1 else place or "message"
            text = _label(label, where)
            if text is None:
                continue
            start_s = reached_s
            if starts[number] is not None:
                start_s = self.from_s + _seconds(starts[number], unit_s, where)
            end_s = None
            if ends[number] is not None:
                end_s = self.from_s + _seconds(ends[number], unit_s, where)
            elif lasts[number] is not None:
                end_s = start_s + _seconds(lasts[number], unit_s, where)
            start_s = round(start_s, _DIGITS)
            end_s = None if end_s is None else round(end_s, _DIGITS)
            if end_s is not None and end_s < start_s:
                raise VendorError(
                    f"{where}: ends at {end_s:.3f} s, before it begins at {start_s:.3f} s"
                )
            reached_s = start_s if end_s is None else end_s
            yield TimedUnit(text, start_s, end_s)

    def units(self) -> tuple[VendorUnits, ...]:
        """In order of kind; each unit ends where the next begins at the latest."""
        order: tuple[Kind, ...] = ("phoneme", "viseme", "word")
        found = sorted(self._of.items(), key=lambda item: order.index(item[0][0]))
        return tuple(
            VendorUnits(kind, _without_overlap(rows, kind), alphabet)
            for (kind, alphabet), rows in found
            if rows
        )


def _without_overlap(rows: list[TimedUnit], kind: Kind) -> tuple[TimedUnit, ...]:
    """Phonemes and visemes without an end end where the next begins; words before them may pause."""
    cut = []
    for number, (unit, following) in enumerate(pairwise(rows)):
        if following.start_s < unit.start_s:
            raise VendorError(
                f"{kind} {number + 2} begins at {following.start_s:.3f} s, before the one before "
                f"it at {unit.start_s:.3f} s; put them in order of time, pieces of a stream each "
                "from where its sound begins"
            )
        end_s = unit.end_s
        if end_s is None and kind != "word":
            end_s = following.start_s
        cut.append(unit._replace(end_s=None if end_s is None else min(end_s, following.start_s)))
    return (*cut, rows[-1])


def _words(characters: Iterator[TimedUnit]) -> Iterator[TimedUnit]:
    """Characters joined from one white space to the next."""
    word: TimedUnit | None = None
    for each in characters:
        if each.label.isspace():
            if word is not None:
                yield word
            word = None
        elif word is None:
            word = each
        else:
            word = TimedUnit(word.label + each.label, word.start_s, each.end_s)
    if word is not None:
        yield word


def _first(node: _Node, keys: tuple[str, ...]) -> object:
    return next((node[key] for key in keys if node.get(key) is not None), None)


def _label(value: object, place: str) -> str | None:
    """Of a unit; None for a boundary that is none of a word."""
    if isinstance(value, dict):
        node = _plain(value)
        kind = str(node.get("boundarytype")).lower()
        return None if kind.startswith(_UNSAID) else _label(node.get("text"), place)
    if isinstance(value, bool) or not isinstance(value, str | int):
        raise VendorError(f"{place}: {reprlib.repr(value)} is no word, phoneme or viseme")
    return str(value)


def _seconds(value: object, unit_s: float, place: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise VendorError(f"{place}: {reprlib.repr(value)} is no time; write a number")
    # Compared before it is multiplied: an integer may be too long for a float.
    if not (0 <= value <= _LONGEST_S / unit_s and math.isfinite(value)):
        raise VendorError(f"{place}: time {reprlib.repr(value)} is not within 0 and 24 hours")
    return float(value) * unit_s


def _rate(rate_hz: object, place: str) -> float:
    if (
        isinstance(rate_hz, bool)
        or not isinstance(rate_hz, int)
        or rate_hz not in range(4000, 400_001)
    ):
        raise VendorError(
            f"{place}: samples are counted, and no sample_rate (4000 to 400000) stands beside them"
        )
    return float(rate_hz)
