"""Mouth shapes of cartoons from phonemes, named, timed and written as Rhubarb Lip Sync does.

Shapes and file formats: the README of Rhubarb Lip Sync 1.13
(https://github.com/DanielSWolf/rhubarb-lip-sync), sections "Mouth shapes" and "Output formats".

The rules are in our own words and code. The shapes that a phone may have, and every duration, are
those of Rhubarb Lip Sync 1.13. Differences are noted in the code and in docs/avatars.md: the
nearest of several shapes is found by their openness and rounding, and short shapes go to a
neighbour.
"""

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal
from xml.sax.saxutils import escape

from lipsync.phonemes import SILENCE, PhonemeEvent

Shape = Literal["A", "B", "C", "D", "E", "F", "G", "H", "X"]

#: A closed lips of P B M; B slightly open; C open; D wide open; E slightly rounded; F puckered;
#: G teeth on the lower lip; H tongue raised, for a long L; X at rest.
SHAPES: tuple[Shape, ...] = ("A", "B", "C", "D", "E", "F", "G", "H", "X")
CLOSED_SHAPES: tuple[Shape, ...] = ("A", "X")
#: Characters that XML 1.0 cannot hold.
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
#: Rhubarb's times are whole hundredths of a second.
CENTISECOND_S = 0.01


@dataclass(frozen=True, slots=True)
class MouthCue:
    """A mouth shape, A to H or X, from `start_cs` to `end_cs`, hundredths of a second of sound."""

    shape: Shape
    start_cs: int
    end_cs: int


def centiseconds(time_s: float) -> int:
    """Return a time in s as a whole number of hundredths of a second, rounded to the nearest."""
    return round(time_s / CENTISECOND_S)


def merge_cues(cues: Iterable[MouthCue]) -> list[MouthCue]:
    """Return the cues, in order, with neighbours of equal shape merged and empty cues left out."""
    merged: list[MouthCue] = []
    for cue in cues:
        if cue.end_cs <= cue.start_cs:
            continue
        if merged and merged[-1].shape == cue.shape:
            cue = MouthCue(cue.shape, merged.pop().start_cs, cue.end_cs)
        merged.append(cue)
    return merged


def overwrite_cues(cues: Sequence[MouthCue], new: MouthCue) -> list[MouthCue]:
    """Return the cues with `new` in place of whatever was there between its start and end."""
    before = [MouthCue(cue.shape, cue.start_cs, min(cue.end_cs, new.start_cs)) for cue in cues]
    after = [MouthCue(cue.shape, max(cue.start_cs, new.end_cs), cue.end_cs) for cue in cues]
    return merge_cues([*(cue for cue in before if cue.end_cs > cue.start_cs), new, *after])


def cues_tsv(cues: Sequence[MouthCue]) -> str:
    """Return the cues as text, a line `start TAB shape` each, then the sound's end with shape X.

    Times are in seconds. Raises ValueError for no cues.
    """
    if not cues:
        raise ValueError("there are no mouth cues to write")
    lines = [f"{_seconds(cue.start_cs)}\t{cue.shape}\n" for cue in cues]
    return "".join(lines) + f"{_seconds(cues[-1].end_cs)}\tX\n"


def cues_json(cues: Sequence[MouthCue], sound_name: str, duration_s: float) -> str:
    """Return the cues as JSON text: an object of `metadata` and `mouthCues`, one cue per line.

    sound_name, duration_s: the metadata, the sound file's name and the sound's length.
    """
    rows = (
        f'    {{ "start": {_seconds(cue.start_cs)}, "end": {_seconds(cue.end_cs)}, '
        f'"value": "{cue.shape}" }}'
        for cue in cues
    )
    return (
        '{\n  "metadata": {\n'
        f'    "soundFile": {json.dumps(sound_name)},\n'
        f'    "duration": {_truncated(duration_s)}\n'
        '  },\n  "mouthCues": [\n' + ",\n".join(rows) + "\n  ]\n}\n"
    )


def cues_xml(cues: Sequence[MouthCue], sound_name: str, duration_s: float) -> str:
    """Return the cues as XML text: `rhubarbResult` with `metadata` and `mouthCues`.

    sound_name, duration_s: the metadata, the sound file's name and the sound's length.
    """
    rows = "".join(
        f'    <mouthCue start="{_seconds(cue.start_cs)}" end="{_seconds(cue.end_cs)}">'
        f"{cue.shape}</mouthCue>\n"
        for cue in cues
    )
    return (
        '<?xml version="1.0" encoding="utf-8"?>\n<rhubarbResult>\n  <metadata>\n'
        f"    <soundFile>{escape(_NOT_XML.sub('?', sound_name))}</soundFile>\n"
        f"    <duration>{_truncated(duration_s)}</duration>\n"
        f"  </metadata>\n  <mouthCues>\n{rows}  </mouthCues>\n</rhubarbResult>\n"
    )


def _seconds(time_cs: int) -> str:
    return f"{time_cs // 100}.{time_cs % 100:02d}"


def _truncated(duration_s: float) -> str:
    # Half a nanosecond of grace, or 0.29 s would be cut to 0.28.
    return _seconds(int((duration_s + 5e-10) / CENTISECOND_S))


#: Of each shape how open it is, from 0 (shut) to 1 (wide), and how rounded; only which shape is
#: nearer to which matters.
_PLACES: Mapping[Shape, tuple[float, float]] = {
    "A": (0.0, 0.0), "X": (0.0, 0.0), "G": (0.1, 0.0), "B": (0.3, 0.0), "C": (0.6, 0.0),
    "H": (0.65, 0.0), "D": (1.0, 0.0), "E": (0.5, 0.6), "F": (0.3, 1.5),
}  # fmt: skip
#: The shape to which a mouth relaxes from each shape when no phone asks for one.
_RELAXED: Mapping[Shape, Shape] = {
    "A": "A", "B": "B", "C": "B", "D": "C", "E": "C", "F": "B", "G": "X", "H": "B", "X": "X",
}  # fmt: skip
_ANY = "ABCDEFGHX"
_OPEN = "BCDEFGH"
#: Phones with one rule, whatever their length.
_SHAPES_OF: Mapping[str, str] = {
    SILENCE: "X",
    "AA": "D", "AO": "E", "EH": "C", "AE": "C", "IH": "B", "IY": "B", "UH": "F", "UW": "F",
    "M": "A", "F": "G", "V": "G", "W": "F", "R": "BEF", "Y": "BCF", "N": "BCFH", "NG": "BCEF",
    "CH": "BF", "JH": "BF", "TH": "BF", "DH": "BF", "S": "BF", "Z": "BF", "SH": "BF", "ZH": "BF",
    "HH": _ANY,
}  # fmt: skip
_DIPHTHONGS: Mapping[str, str] = {"EY": "CB", "OW": "EF", "OY": "EB"}
_FIRST_PART = 0.6  # of a diphthong
#: The closure of a stop, and what follows its burst.
_STOPS: Mapping[str, tuple[str, str]] = {
    "P": ("A", _ANY), "B": ("A", _ANY), "T": ("BF", _OPEN), "D": ("BF", _OPEN),
    "K": ("BCEFH", _OPEN), "G": ("BCEFH", _OPEN),
}  # fmt: skip
_VOWELS = frozenset(
    ("AA", "AE", "AH", "AO", "AW", "AY", "EH", "ER", "EY", "IH", "IY", "OW", "OY", "UH", "UW")
)
_LONG_CS, _LONG_AW_CS, _SHORT_ER_CS = 20, 30, 7
#: A stop's closure that lies before its label: half the phone before, within these.
_CLOSURE_CS = (4, 12)
_ANTICIPATED_CS = 20
_HELD_PAUSE_CS, _RELAXED_PAUSE_CS = 12, 35
#: Closed and open stretches last so long at least; they begin earlier for it, by so much at most.
_SHORTEST_STRETCH_CS, _MOST_EARLIER_CS = 8, 6
_SHORTEST_SHAPE_CS = 7
_SHORTEST_TWEEN_CS, _LONGEST_TWEEN_CS = 4, 8
#: Between which two shapes which third is shown, and where: early, on the border, late.
_TWEENS: Mapping[tuple[str, str], tuple[Shape, str]] = {
    ("D", "A"): ("C", "early"), ("D", "B"): ("C", "centred"), ("D", "G"): ("C", "early"),
    ("D", "X"): ("C", "late"), ("C", "F"): ("E", "centred"), ("F", "C"): ("E", "centred"),
    ("D", "F"): ("E", "centred"), ("H", "F"): ("E", "late"), ("F", "H"): ("E", "early"),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class _MouthSpan:
    """A span of time, all or part of a phone, with the shapes (letters) that the mouth may have."""

    shapes: str
    start_cs: int
    end_cs: int
    is_vowel: bool = False

    @property
    def is_anticipated(self) -> bool:
        """Whether the mouth forms this span's shape early: that of a vowel with only one shape."""
        return self.is_vowel and len(self.shapes) == 1


def rule_cues(
    events: Iterable[PhonemeEvent], duration_s: float, *, stops_at_burst: bool = False
) -> list[MouthCue]:
    """Return mouth shapes for phonemes in order, from 0 to the end of the sound, without gaps.

    stops_at_burst: True where stops are labelled from their burst on, as by Rhubarb's recogniser;
    their closure is then put before the label. False where a stop begins with its closure, as with
    our recogniser, speech synthesisers and labels by hand. Empty for a sound of no length.
    """
    end_cs = centiseconds(duration_s)
    if end_cs <= 0:
        return []
    spans = _mouth_spans(events, end_cs, stops_at_burst=stops_at_burst)
    cues = _fill_pauses(_choose_shapes(spans))
    return _add_tweens(_replace_short_shapes(_lengthen_closures(cues)))


def _mouth_spans(
    events: Iterable[PhonemeEvent], total_cs: int, *, stops_at_burst: bool
) -> list[_MouthSpan]:
    """Return the spans of phonemes and of the silences between, from 0 to `total_cs`, without gaps.

    stops_at_burst: as in `rule_cues`: a stop's closure is then put before its label, for half the
    length of the phone before.
    """
    spans: list[_MouthSpan] = []
    now_cs = previous_cs = 0
    for event in events:
        start_cs = min(max(now_cs, centiseconds(event.start_s)), total_cs)
        label_end_cs = total_cs if event.end_s is None else centiseconds(event.end_s)
        end_cs = min(max(start_cs, label_end_cs), total_cs)
        spans.append(_MouthSpan("X", now_cs, start_cs))
        if stops_at_burst and event.phoneme in _STOPS:
            closure_cs = min(max(previous_cs // 2, _CLOSURE_CS[0]), _CLOSURE_CS[1])
            closure_shapes, burst_shapes = _STOPS[event.phoneme]
            spans = _cut_spans_at(spans, max(0, start_cs - closure_cs))
            spans.append(_MouthSpan(closure_shapes, max(0, start_cs - closure_cs), start_cs))
            spans.append(_MouthSpan(burst_shapes, start_cs, end_cs))
        else:
            spans += _phone_spans(event.phoneme, start_cs, end_cs)
        previous_cs, now_cs = end_cs - start_cs, end_cs
    spans.append(_MouthSpan("X", now_cs, total_cs))
    return [span for span in spans if span.end_cs > span.start_cs]


def _cut_spans_at(spans: Sequence[_MouthSpan], time_cs: int) -> list[_MouthSpan]:
    """Return the spans as far as they lie before `time_cs`."""
    return [
        _MouthSpan(span.shapes, span.start_cs, min(span.end_cs, time_cs), span.is_vowel)
        for span in spans
        if span.start_cs < time_cs
    ]


def _phone_spans(phone: str, start_cs: int, end_cs: int) -> list[_MouthSpan]:
    """Return the spans of a phone, two for a diphthong; times in hundredths of a second."""
    shapes = _shapes_of(phone, end_cs - start_cs)
    is_vowel = phone in _VOWELS
    if len(shapes) == 1:
        return [_MouthSpan(shapes[0], start_cs, end_cs, is_vowel)]
    border_cs = start_cs + int(_FIRST_PART * (end_cs - start_cs))
    return [
        _MouthSpan(shapes[0], start_cs, border_cs, is_vowel),
        _MouthSpan(shapes[1], border_cs, end_cs, is_vowel),
    ]


def _shapes_of(phone: str, duration_cs: int) -> tuple[str, ...]:
    """Return the shapes, as letters, that a phone of this length may have, for each of its parts.

    duration_cs: in hundredths of a second. Two parts for a diphthong, else one.
    """
    if phone in _STOPS:
        return (_STOPS[phone][0],)
    if phone in _DIPHTHONGS:
        return tuple(_DIPHTHONGS[phone])
    is_long = duration_cs >= _LONG_CS
    match phone:
        case "AH":
            return ("D",) if is_long else ("C",)
        case "AY":
            return ("D", "B") if is_long else ("C", "B")
        case "AW":
            return ("D", "E") if duration_cs >= _LONG_AW_CS else ("C", "E")
        case "ER":
            return ("BC",) if duration_cs < _SHORT_ER_CS else ("E",)
        case "L":
            return ("H",) if is_long else ("BEFH",)
    return (_SHAPES_OF[phone],)


def _nearest_shape(shape: Shape, allowed: str) -> Shape:
    """Return the allowed shape nearest to `shape` in openness and rounding; of equals the first."""
    return min(
        (each for each in _PLACES if each in allowed),
        key=lambda each: (each != shape, math.dist(_PLACES[shape], _PLACES[each]), each),
    )


def _choose_shapes(spans: Sequence[_MouthSpan]) -> list[MouthCue]:
    """Return cues for spans: each gets that of its shapes nearest to the last shape, relaxed.

    A vowel with only one shape begins early: spans up to 0.2 s before it get their shape nearest to
    the vowel's.
    """
    shapes: list[Shape] = []
    previous: Shape = "X"
    last_vowel = -1
    for i, span in enumerate(spans):
        shape = _nearest_shape(previous, span.shapes)
        shapes.append(shape)
        previous = _RELAXED[shape]
        if not span.is_anticipated:
            continue
        previous = next_shape = shape
        # Back through the spans up to 0.2 s before the vowel, until one cannot have its shape.
        for j in range(i - 1, last_vowel, -1):
            if span.start_cs - spans[j].start_cs > _ANTICIPATED_CS:
                break
            next_shape = shapes[j] = _nearest_shape(next_shape, spans[j].shapes)
            if next_shape != shape:
                break
        last_vowel = i
    return merge_cues(
        MouthCue(shape, s.start_cs, s.end_cs) for shape, s in zip(shapes, spans, strict=True)
    )


def _fill_pauses(cues: Sequence[MouthCue]) -> list[MouthCue]:
    """Return the cues with inner pauses X of up to 0.35 s replaced by the shape before.

    A pause of 0.12 s or more gets that shape relaxed, until it differs from the shape after the
    pause; where it never does, the pause stays X.
    """
    changed = list(cues)
    for i in range(1, len(cues) - 1):
        if cues[i].shape == "X":
            duration_cs = cues[i].end_cs - cues[i].start_cs
            shape = _pause_shape(cues[i - 1].shape, cues[i + 1].shape, duration_cs)
            changed[i] = MouthCue(shape, cues[i].start_cs, cues[i].end_cs)
    return merge_cues(changed)


def _pause_shape(before: Shape, after: Shape, duration_cs: int) -> Shape:
    """Return the shape for a pause inside speech, `duration_cs` hundredths of a second long.

    Below 0.12 s the shape before; up to 0.35 s that shape relaxed, until it differs from the shape
    after; in longer pauses, or where none differs, X.
    """
    if duration_cs < _HELD_PAUSE_CS:
        return before
    if duration_cs <= _RELAXED_PAUSE_CS:
        relaxed = _RELAXED[before]
        while relaxed == after and _RELAXED[relaxed] != relaxed:
            relaxed = _RELAXED[relaxed]
        if relaxed != after:
            return relaxed
    return "X"


def _lengthen_closures(cues: Sequence[MouthCue]) -> list[MouthCue]:
    """Return the cues with closures A below 80 ms begun 60 ms earlier at most, if there is room."""
    changed = list(cues)
    for i in range(len(changed) - 1, 0, -1):
        cue, before = changed[i], changed[i - 1]
        lacking_cs = _SHORTEST_STRETCH_CS - (cue.end_cs - cue.start_cs)
        spare_cs = before.end_cs - before.start_cs - 1
        earlier_cs = min(lacking_cs, _MOST_EARLIER_CS, spare_cs)
        if cue.shape == "A" and earlier_cs > 0:
            border_cs = cue.start_cs - earlier_cs
            changed[i] = MouthCue(cue.shape, border_cs, cue.end_cs)
            changed[i - 1] = MouthCue(before.shape, before.start_cs, border_cs)
    return changed


def _replace_short_shapes(cues: Sequence[MouthCue]) -> list[MouthCue]:
    """Return the cues with open shapes below 70 ms replaced by the open shape after, else before.

    An open mouth between two closures stays, however short: else the closures would be one.
    """
    changed = list(cues)
    while True:
        for i, cue in enumerate(changed):
            if cue.shape in "AX" or cue.end_cs - cue.start_cs >= _SHORTEST_SHAPE_CS:
                continue
            # The neighbour whose shape it gets; none between two closures.
            donor = next((j for j in (i + 1, i - 1) if _is_open(changed, j)), None)
            if donor is not None:
                changed[i] = MouthCue(changed[donor].shape, cue.start_cs, cue.end_cs)
                changed = merge_cues(changed)
                break
        else:
            return changed


def _is_open(cues: Sequence[MouthCue], i: int) -> bool:
    return 0 <= i < len(cues) and cues[i].shape not in "AX"


def _add_tweens(cues: Sequence[MouthCue]) -> list[MouthCue]:
    """Return the cues with a third shape of 40 to 80 ms inserted between pairs of `_TWEENS`.

    It lies before, around or after the border of the two, as the table says, and takes at most a
    third (or a quarter) of the cues that it shortens.
    """
    changed = list(cues)
    for first, second in pairwise(cues):
        if (first.shape, second.shape) not in _TWEENS:
            continue
        shape, place = _TWEENS[first.shape, second.shape]
        first_cs, second_cs = first.end_cs - first.start_cs, second.end_cs - second.start_cs
        room_cs = {
            "early": round(first_cs / 3),
            "centred": round(min(first_cs, second_cs) / 4),
            "late": round(second_cs / 3),
        }[place]
        tween_cs = min(room_cs, _LONGEST_TWEEN_CS)
        if tween_cs < _SHORTEST_TWEEN_CS:
            continue
        back_cs = {"early": tween_cs, "centred": tween_cs // 2, "late": 0}[place]
        start_cs = second.start_cs - back_cs
        changed = overwrite_cues(changed, MouthCue(shape, start_cs, start_cs + tween_cs))
    return changed
