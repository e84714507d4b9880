"""Timings in the messages of speech synthesisers and aligners, as units that a face understands.

A message as its vendor documents it, parsed from JSON, becomes words, phonemes or visemes with
times in seconds. A table lists the keys, and envelopes are searched, so that an event, a whole
answer and a file of many are read alike: docs/text.md has an example of each. Only the standard
library is needed.
"""

import reprlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final, Literal, NamedTuple

from lipservo_client.alphabet import VendorError, alphabet_of
from lipservo_client.blendshapes import DEFAULT_RATE_HZ, mouth_rows
from lipservo_client.protocol import SpeechUnits

Kind = Literal["word", "phoneme", "viseme"]
_PLURAL: Final[dict[Kind, Literal["words", "phonemes", "visemes"]]] = {
    "word": "words",
    "phoneme": "phonemes",
    "viseme": "visemes",
}

#: Ten minutes of fast speech in phonemes, as much as a face takes at once.
MOST_UNITS: Final = 12_000
#: No speech in one message is longer; more is another unit or a mistake.
_LONGEST_S: Final = 24 * 3600.0
#: Objects nested deeper than this are in no vendor's documentation.
_DEEPEST: Final = 12
#: Times are rounded to so many digits, the 100 ns of Azure, so that 0.3 s + 0.05 s is 0.35 s.
_DIGITS: Final = 7
#: Starts may decrease by so much, since vendors round and overlap words; a unit that starts earlier
#: belongs to another piece of sound.
_MOST_DISORDER_S: Final = 0.05
_MS, _TICK_S = 1e-3, 1e-7


class TimedUnit(NamedTuple):
    """A word, phoneme or viseme as its vendor writes it, with times in s; end_s None: not known."""

    label: str
    start_s: float
    end_s: float | None


@dataclass(frozen=True, slots=True)
class VendorUnits:
    """Units of one kind in the order in which they are spoken, with starts that never decrease.

    alphabet: of their labels, as a face knows it: `arpabet`, `ipa`, `misaki`, `voicevox`, or that
    of the visemes, `azure`, `polly`, `ovr`, `inworld`, `rhubarb`; None: for words, and for visemes
    written as phonemes. untimed: words that stand in the message without a time.
    """

    kind: Kind
    units: tuple[TimedUnit, ...]
    alphabet: str | None = None
    untimed: tuple[str, ...] = ()

    def stream_units(self, rate_hz: int) -> SpeechUnits:
        """Return the units with times in samples, for a stream's `tell`, beside `alphabet`.

        A unit that overlaps the next ends where the next begins. A blank label, a pause, is left
        out: a face refuses it.
        """
        starts_s = (*(each.start_s for each in self.units[1:]), _LONGEST_S)
        return _PLURAL[self.kind], [
            (each.label, round(each.start_s * rate_hz), _sample(each.end_s, rate_hz, next_s))
            for each, next_s in zip(self.units, starts_s, strict=True)
            if each.label.strip()
        ]


@dataclass(frozen=True, slots=True)
class _Shape:
    """The keys under which a vendor writes units: lower case, without underscores.

    Where an attribute has several keys, the first that a message contains counts; the values are
    one unit's, or lists of equal length. lasts: key of a duration. type: required value of the
    message's `type`. unit_s: seconds per unit of its times.
    """

    kind: Literal["word", "phoneme", "viseme", "character"]
    label: str
    start: str = ""
    end: str = ""
    lasts: str = ""
    unit_s: float = 1.0
    type: str = ""
    alphabet: str = ""


_START, _END = "start starts starttime", "end ends endtime"
_DURATION: Final = "duration durations"
#: Counted at the `sample_rate` beside or above them.
_SAMPLES: Final = "numsamples"
_OFFSET: Final = "audiooffset offset"
_SHAPES: Final = (
    # elevenlabs.io/docs/api-reference/text-to-speech/convert-with-timestamps; its WebSocket
    _Shape("character", "characters", "characterstarttimesseconds", "characterendtimesseconds"),
    _Shape("character", "chars", "charstarttimesms", "", "chardurationsms charsdurationsms", _MS),
    # docs.inworld.ai/tts/capabilities/timestamps
    _Shape("character", "characters", "characterstarttimeseconds", "characterendtimeseconds"),
    _Shape("word", "words", "wordstarttimeseconds", "wordendtimeseconds"),
    _Shape("phoneme", "phonesymbol", "starttimeseconds", "", "durationseconds"),
    _Shape("viseme", "visemesymbol", "starttimeseconds", "", "durationseconds", alphabet="inworld"),
    # github.com/met4citizen/HeadTTS
    _Shape("viseme", "visemes", "vtimes", "", "vdurations", _MS, alphabet="ovr"),
    _Shape("word", "words", "wtimes", "", "wdurations", _MS),
    # docs.aws.amazon.com/polly/latest/dg/output.html
    _Shape("viseme", "value", "time", unit_s=_MS, type="viseme", alphabet="polly"),
    _Shape("word", "value", "time", unit_s=_MS, type="word"),
    # learn.microsoft.com/azure/ai-services/speech-service/how-to-speech-synthesis-viseme
    _Shape("viseme", "visemeid", _OFFSET, unit_s=_TICK_S, alphabet="azure"),
    _Shape("word", "text", _OFFSET, "", _DURATION, _TICK_S),
    # cloud.google.com/text-to-speech/docs/reference/rest/v1beta1/text/synthesize; marks are words
    _Shape("word", "markname", "timeseconds"),
    # dev.hume.ai/docs/text-to-speech-tts/timestamps
    _Shape("word", "text", "begin", "end", unit_s=_MS, type="word"),
    _Shape("phoneme", "text", "begin", "end", unit_s=_MS, type="phoneme"),
    # Kokoro's tokens (github.com/hexgrad/kokoro), in misaki's letters
    _Shape("word", "text", "startts", "endts"),
    _Shape("phoneme", "phonemes", "startts", "endts", alphabet="misaki"),
    # github.com/DanielSWolf/rhubarb-lip-sync; rows without a type, unlike Polly's
    _Shape("viseme", "value", "start", "end", type="none", alphabet="rhubarb"),
    # moras of an audio query of VOICEVOX (voicevox.github.io/voicevox_engine/api)
    _Shape("phoneme", "consonant", lasts="consonantlength", alphabet="voicevox"),
    _Shape("phoneme", "vowel", lasts="vowellength", alphabet="voicevox"),
    # Cartesia (docs.cartesia.ai/api-reference/tts/websocket), Piper's alignments
    # (github.com/OHF-Voice/piper1-gpl), ours, and whatever else is as plain
    _Shape("phoneme", "phoneme phonemes symbol phones phone", _START, _END, _DURATION),
    _Shape("viseme", "viseme visemes", _START, _END, _DURATION),
    _Shape("word", "word words", _START, _END, _DURATION),
)
_PLAIN_WORD: Final = _SHAPES[-1]
#: Of Azure's boundaries: no words.
_UNSAID: Final = ("punctuation", "sentence")


def vendor_units(
    message: object, from_s: float = 0.0, alphabet: str = ""
) -> tuple[VendorUnits, ...]:
    """Return all timed units in a message, the most precise kind first: phonemes, visemes, words.

    () for a message without times; every stream has some. message: parsed JSON of a vendor, or a
    list of several messages, whose characters are joined to words across their borders. from_s:
    seconds added to the message's times, where these count from the beginning of a piece of sound
    and not of the stream. alphabet: of phonemes for which the message names none; "": ARPAbet if
    all of them are, else IPA. Raises VendorError for a malformed message.
    """
    collector = _UnitCollector(from_s)
    for node, here in _objects_in(message, _Here()):
        for shape in _SHAPES:
            collector.add_units(shape, node, here)
    return collector.units(alphabet)


_Node = Mapping[str, object]


@dataclass(frozen=True, slots=True)
class _Here:
    """The path (`place`) of an object in a message, and the values that objects around it state.

    They apply to units in the object that state none: sample rate, alphabet; start: of the word
    that contains a phoneme; speed: by which durations are divided (VOICEVOX). depth: of nesting.
    """

    place: str = ""
    rate_hz: object = None
    alphabet: str = ""
    start: object = None
    speed: object = 1.0
    depth: int = 0

    def inside(self, node: _Node, step: str) -> "_Here":
        """Return the path of the value at `step` in `node`. VendorError if nested too deep."""
        place = f"{self.place}{step}".lstrip(".")[:200]
        if self.depth >= _DEEPEST:
            raise VendorError(f"{place}: nested too deep for a vendor's message")
        rate_hz = node.get("samplerate", node.get("sampleratehz", self.rate_hz))
        alphabet = str(node.get("alphabet", self.alphabet))[:40]
        start, speed = node.get("start", self.start), node.get("speedscale", self.speed)
        return _Here(place, rate_hz, alphabet, start, speed, self.depth + 1)


def _objects_in(value: object, here: _Here) -> Iterator[tuple[_Node, _Here]]:
    """Yield every object in `value` with its path, keys in lower case without underscores.

    Blendshapes, and lists of [label, start, end], are yielded as objects with lists of values.
    Raises VendorError for a malformed one, or objects nested too deep.
    """
    if isinstance(value, list):
        for number, each in enumerate(value):
            yield from _objects_in(each, here.inside({}, f"[{number}]"))
    elif isinstance(value, dict):
        node = {_key(key): each for key, each in value.items()}
        # Times that are in an object of their own belong to the unit beside it.
        if isinstance(time := node.get("time"), dict):
            node |= {_key(key): each for key, each in time.items()}
        yield node, here.inside(node, "")
        # VOICEVOX: the silence before the first phoneme.
        if "accentphrases" in node:
            silence = {"vowel": "pau", "vowellength": node.get("prephonemelength", 0.0)}
            yield silence, here.inside(node, ".prePhonemeLength")
        for key, each in value.items():
            if node.get(_DUPLICATE_OF.get(_key(key), "")):
                continue
            inner = here.inside(node, f".{key}")
            if _key(key) == "blendshapes" and isinstance(each, list):
                yield _visemes_of_blendshapes(each, node, inner), inner
            elif isinstance(each, list) and each and all(isinstance(row, list) for row in each):
                yield _columns_of_rows(_key(key), each, inner.place), inner
            else:
                yield from _objects_in(each, inner)


def _key(key: object) -> str:
    return str(key).replace("_", "").lower()


#: A key is skipped if the other is beside it, which has the same units: ElevenLabs, WhisperX.
_DUPLICATE_OF: Final = {"normalizedalignment": "alignment", "wordsegments": "segments"}


def _visemes_of_blendshapes(frames: list[object], node: _Node, here: _Here) -> _Node:
    """Return frames of blendshapes as visemes: for each run of frames the most similar phone.

    node: the object that contains the frames (Azure's viseme type FacialExpression) and their rate,
    `fps`. Raises VendorError for a malformed frame, rate or first frame's number.
    """
    rate_hz, first = node.get("fps", DEFAULT_RATE_HZ), node.get("frameindex", 0)
    if not isinstance(rate_hz, int | float) or not 10 <= rate_hz <= 1000:
        raise VendorError(f"{here.place or 'message'}: fps must be 10 to 1000")
    if not isinstance(first, int) or not 0 <= first < _LONGEST_S * rate_hz:
        raise VendorError(f"{here.place or 'message'}: FrameIndex must be a frame's number")
    try:
        rows = mouth_rows(frames, float(rate_hz), first)
    except ValueError as error:
        raise VendorError(f"{here.place or 'message'}: {error}") from None
    visemes, starts, ends = ([row[column] for row in rows] for column in range(3))
    return {"visemes": visemes, "start": starts, "end": ends}


def _columns_of_rows(key: str, rows: list[list[object]], place: str) -> _Node:
    """Return rows of [label, start, end] as one object: labels under `key`, starts and ends.

    place: names the rows in a VendorError.
    """
    if any(len(row) != 3 for row in rows):
        raise VendorError(f"{place}: each row must be [label, start, end]")
    labels, starts, ends = (list(column) for column in zip(*rows, strict=True))
    return {key: labels, "start": starts, "end": ends}


@dataclass(slots=True)
class _UnitCollector:
    """A collection of the units found so far in a message, by kind and alphabet.

    from_s: seconds added to the message's times.
    """

    from_s: float
    _units_of: dict[tuple[Kind, str], list[TimedUnit]] = field(default_factory=dict)
    _characters: list[TimedUnit] = field(default_factory=list)
    _untimed: list[str] = field(default_factory=list)

    def add_units(self, shape: _Shape, node: _Node, here: _Here) -> None:
        """Add the units of the object `node`, if it has the shape's keys. Raises VendorError.

        here: the object's path, and the values stated around it.
        """
        label, *times = (_first_value(node, each) for each in (shape.label, shape.start, shape.end))
        lasts, unit_s = _first_value(node, shape.lasts), shape.unit_s
        if lasts is None and shape.kind == "phoneme" and _SAMPLES in node:
            lasts, unit_s = node[_SAMPLES], 1.0 / _sample_rate_hz(here)
        # Start or duration may be missing, as the shape has it; a word without both is kept aside.
        is_timed = lasts is not None or (times[0] is not None and (shape.end or not shape.lasts))
        is_type = shape.type in ("", str(node.get("type")).lower())
        if shape is _PLAIN_WORD and isinstance(label, str) and times == [None, None] == [lasts] * 2:
            self._untimed.append(label.strip()[:40])
        if label is None or not (is_timed and is_type and _is_spoken(node)):
            return
        if isinstance(label, list) and any(isinstance(each, dict | list) for each in label):
            return  # units of their own, further in
        if shape.alphabet == "voicevox":
            unit_s /= max(0.01, _seconds(here.speed, 1.0, here.place))
        # One list for each of label, start, end, duration: of one unit's value, or of many units.
        columns = [each if isinstance(each, list) else [each] for each in (label, *times, lasts)]
        n = len(columns[0])
        lengths = [len(each) for each in columns if each != [None]]
        if any(length != n for length in lengths):
            raise VendorError(f"{here.place or 'message'}: its lists differ in length: {lengths}")
        kind: Kind = "word" if shape.kind == "character" else shape.kind
        alphabet = {"word": "", "phoneme": here.alphabet, "viseme": here.alphabet}[kind]
        rows = self._characters
        if shape.kind != "character":
            rows = self._units_of.setdefault((kind, shape.alphabet or alphabet), [])
        # A unit without a start begins where the one before ends, but not before its word.
        last_end_s = (rows[-1].end_s or rows[-1].start_s) if rows else self.from_s
        if times[0] is None and not isinstance(here.start, list | None):
            last_end_s = max(last_end_s, self.from_s + _seconds(here.start, 1.0, here.place))
        unit_rows = zip(*(each if len(each) == n else each * n for each in columns), strict=True)
        for number, (name, *values) in enumerate(unit_rows):
            place = f"{here.place}[{number}]" if n > 1 else here.place or "message"
            text = _label(name, kind, place)
            if text is not None and (shape.kind != "word" or text.strip()):
                start_s, end_s = self._times(values, unit_s, last_end_s, place)
                rows.append(TimedUnit(text, start_s, end_s))
                last_end_s = start_s if end_s is None else end_s

    def _times(
        self, values: list[object], unit_s: float, last_end_s: float, place: str
    ) -> tuple[float, float | None]:
        """Return start and end in s of a unit's values [start, end, duration]; end None if unknown.

        unit_s: seconds per unit of the values; last_end_s: end of the unit before, in s, which is
        the start where none is given; place: names the unit in a VendorError.
        """
        start, end, lasts = values
        start_s, end_s = last_end_s, None
        if start is not None:
            start_s = self.from_s + _seconds(start, unit_s, place)
        if end is not None:
            end_s = self.from_s + _seconds(end, unit_s, place)
        elif lasts is not None:
            end_s = start_s + _seconds(lasts, unit_s, place)
        if end_s is None:
            return round(start_s, _DIGITS), None
        if end_s < start_s:
            raise VendorError(
                f"{place}: ends at {end_s:.3f} s, before it begins at {start_s:.3f} s"
            )
        return round(start_s, _DIGITS), round(end_s, _DIGITS)

    def units(self, given: str) -> tuple[VendorUnits, ...]:
        """Return the units by kind, phonemes first.

        given: alphabet of phonemes that name none; "": as their labels are written.
        """
        order: tuple[Kind, ...] = ("phoneme", "viseme", "word")
        self._units_of.setdefault(("word", ""), []).extend(_words_of(self._characters))
        found = sorted(self._units_of.items(), key=lambda item: order.index(item[0][0]))
        units = []
        for (kind, alphabet), rows in found:
            if rows and kind == "phoneme":
                alphabet = alphabet or given or alphabet_of(rows)
            untimed = self._untimed if kind == "word" else ()
            units += [VendorUnits(kind, _in_order(rows, kind), alphabet or None, tuple(untimed))]
        return tuple(each for each in units if each.units)


def _in_order(rows: list[TimedUnit], kind: Kind) -> tuple[TimedUnit, ...]:
    """Return units of one kind whose starts do not decrease.

    Where the end is None, a phoneme or viseme ends at the next start, and a word keeps None.
    Visemes and words end where the next one starts at the latest: their vendors let them overlap.
    Starts that decrease by less than 50 ms are sorted; raises VendorError for others.
    """
    if len(rows) > MOST_UNITS:
        raise VendorError(f"more than {MOST_UNITS} {kind}s; send them in pieces")
    for number, (unit, following) in enumerate(pairwise(rows)):
        if following.start_s < unit.start_s - _MOST_DISORDER_S:
            raise VendorError(
                f"{kind} {number + 2} begins at {following.start_s:.3f} s, before the previous one "
                f"at {unit.start_s:.3f} s; put them in order of time; pieces of a stream each "
                "start where their sound begins"
            )
    rows = sorted(rows, key=lambda unit: unit.start_s)
    ordered = []
    for unit, following in pairwise(rows):
        end_s = unit.end_s
        if end_s is None and kind != "word":
            end_s = following.start_s
        if end_s is not None and kind != "phoneme":
            end_s = min(end_s, following.start_s)
        ordered.append(unit._replace(end_s=end_s))
    return (*ordered, *rows[-1:])


def _words_of(characters: Iterable[TimedUnit]) -> Iterator[TimedUnit]:
    """Yield the words that characters form between white space, from first start to last end."""
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


def _sample(time_s: float | None, rate_hz: int, latest_s: float) -> int | None:
    return None if time_s is None else round(min(time_s, latest_s) * rate_hz)


def _first_value(node: _Node, keys: str) -> object:
    return next((node[key] for key in keys.split() if node.get(key) is not None), None)


def _is_spoken(node: _Node) -> bool:
    return not str(node.get("boundarytype", node.get("type"))).lower().startswith(_UNSAID)


def _label(value: object, kind: Kind, place: str) -> str | None:
    """Return the name of a phoneme, viseme or word; None where it is not spoken (punctuation).

    value: text, an object that has the text, or the number of a viseme. Raises VendorError, which
    names `place`, for a value of another type.
    """
    if isinstance(value, dict):  # Azure's, on its WebSocket
        node = {_key(key): each for key, each in value.items()}
        return _label(node.get("text"), kind, place) if _is_spoken(node) else None
    if isinstance(value, bool) or not isinstance(value, str | int if kind == "viseme" else str):
        raise VendorError(f"{place}: {reprlib.repr(value)} is not a {kind}")
    return str(value)


def _seconds(value: object, unit_s: float, place: str) -> float:
    """Return a time of `unit_s` units in s. VendorError, which names `place`, if it is invalid."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise VendorError(f"{place}: time {reprlib.repr(value)} is not a number")
    # Compared before it is multiplied: an integer may be too long for a float.
    if not 0 <= value <= _LONGEST_S / unit_s:
        raise VendorError(f"{place}: time {reprlib.repr(value)} must be 0 to 24 hours")
    return float(value) * unit_s


def _sample_rate_hz(here: _Here) -> float:
    """Return the sample rate stated around an object. VendorError for none, or an invalid one."""
    rate_hz = here.rate_hz
    if isinstance(rate_hz, int) and not isinstance(rate_hz, bool) and 4000 <= rate_hz <= 400_000:
        return float(rate_hz)
    raise VendorError(
        f"{here.place}: its times are samples, so it needs a sample_rate (4000 to 400000)"
    )
