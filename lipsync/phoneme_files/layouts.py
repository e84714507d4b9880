"""Formats of label files, recognised by the text alone; docs/text.md lists them.

Every format gives tiers: labels with their times as written, before neighbours are joined and
labels become phonemes.
"""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Literal

from lipservo_client.vendors import Kind, TimedUnit, vendor_units

from lipsync.errors import shown
from lipsync.textgrid import LabelError, intervals_by_tier, is_textgrid


@dataclass(frozen=True, slots=True)
class Tier:
    """Labels of one kind with their times; kind "": phonemes, unless the user says it is words.

    alphabet: "" where the file does not name it. untimed: words without a time.
    """

    name: str
    kind: Kind | Literal[""]
    units: tuple[TimedUnit, ...]
    alphabet: str = ""
    untimed: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Layout:
    """A format with one label a line. row: a regular expression that each line matches.

    Groups of `row`: start; end, or lasts (the duration; with neither, up to the next start); label;
    tier; speaker. unit_s: seconds per unit of the file's times.
    """

    name: str
    row: str
    kind: Kind | Literal[""] = ""
    alphabet: str = ""
    unit_s: float = 1.0


_TIME: Final = r"-?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
#: In order of preference: whole numbers match HTK's row, and Audacity's as well.
LAYOUTS: Final = (
    Layout(
        "Montreal aligner's CSV",
        rf"(?P<start>{_TIME}),(?P<end>{_TIME}),(?P<label>\"[^\"]*\"|[^,]*),(?P<tier>[^,]*)"
        r"(?:,(?P<speaker>.*))?",
    ),
    Layout(
        "NIST's CTM",
        rf"(?P<tier>\S+)\s+\S+\s+(?P<start>{_TIME})\s+(?P<lasts>{_TIME})\s+(?P<label>\S+).*",
    ),
    Layout("HTK", r"(?P<start>\d+)\s+(?P<end>\d+)\s+(?P<label>\S+).*", unit_s=1e-7),
    Layout("Rhubarb's TSV", rf"(?P<start>{_TIME})\s+(?P<label>[A-HX])", "viseme", "rhubarb"),
    Layout("Audacity's label track", rf"(?P<start>{_TIME})\s+(?P<end>{_TIME})(?P<label>(?:\s.*)?)"),
)
#: Lines without a label: headers, comments, and Audacity's frequencies of the label before.
_NO_ROW: Final = re.compile(r"begin,end,label.*|;;.*|\\.*|", re.IGNORECASE)
_NAMES: Final[Mapping[Kind, str]] = {"phoneme": "phones", "viseme": "visemes", "word": "words"}
#: The last word of a tier's name, as in `speaker 1 - phones`.
_KINDS: Final[Mapping[str, Kind]] = {
    **dict.fromkeys(("phones", "phone", "phonemes", "phoneme", "mau"), "phoneme"),
    **dict.fromkeys(("words", "word", "ort"), "word"),
}


def tiers_in(text: str, alphabet: str = "") -> tuple[Tier, ...]:
    """Return the tiers of a file's text.

    alphabet: of phonemes where the file names none; "": not known. Raises LabelError or VendorError
    without the file's name.
    """
    if is_textgrid(text[:200].encode()) or re.match(r'\s*{(?=.*"tiers"\s*:)', text, re.DOTALL):
        tiers = intervals_by_tier(text)
        return tuple(Tier(n, kind_of(n), tuple(map(TimedUnit._make, t))) for n, t in tiers.items())
    numbered = enumerate(map(str.strip, text.splitlines()), start=1)
    lines = [(n, line) for n, line in numbered if not _NO_ROW.fullmatch(line)]
    # Formats that the first line matches; the first of them that all lines match is taken.
    candidates = [each for each in LAYOUTS if lines and re.fullmatch(each.row, lines[0][1])]
    for layout in candidates:
        rows = [(n, re.fullmatch(layout.row, line)) for n, line in lines]
        if all(row for _, row in rows):
            return _tiers_of_rows(layout, [(n, row.groupdict("")) for n, row in rows if row])
    for layout in candidates:
        number, line = next(e for e in lines if not re.fullmatch(layout.row, e[1]))
        raise LabelError(
            f"line {number}: {shown(line)} lacks columns of the lines before; correct it"
        )
    return _tiers_of_json(_parsed_json(text), alphabet)


def kind_of(name: str) -> Kind | Literal[""]:
    """Return what a tier holds, by the last word of its `name`; "" if that word does not say."""
    return _KINDS.get((re.findall(r"\w+", name.lower()) or [""])[-1], "")


def _tiers_of_rows(layout: Layout, rows: list[tuple[int, dict[str, str]]]) -> tuple[Tier, ...]:
    """Return the tiers in the rows of a file, each (line number, the row's groups by name).

    Raises LabelError, with the line, for a time that is negative or an end before its start.
    """
    has_speakers = len({row.get("speaker") for _, row in rows}) > 1
    tiers: dict[str, list[TimedUnit]] = {}
    for (number, row), (_, next_row) in pairwise([*rows, (0, {})]):
        start_s = layout.unit_s * float(row["start"])
        lasts = row.get("lasts")
        end = row.get("end") or next_row.get("start")
        end_s = start_s + float(lasts) if lasts else layout.unit_s * float(end) if end else None
        if start_s < 0 or (end_s or start_s) < start_s:
            raise LabelError(f"line {number}: {start_s:g} to {end_s or 0:g} s cannot be; fix it")
        name = f"{row['speaker']} - {row['tier']}" if has_speakers else row.get("tier", layout.name)
        tiers.setdefault(name, []).append(TimedUnit(row["label"].strip(' \t"'), start_s, end_s))
    return tuple(
        Tier(name, layout.kind or kind_of(name), tuple(units), layout.alphabet)
        for name, units in tiers.items()
    )


def _tiers_of_json(document: object, alphabet: str) -> tuple[Tier, ...]:
    """Return the tiers in a parsed JSON document of a speech service.

    alphabet: of phonemes where the document names none. Raises LabelError or VendorError for a
    document without labels that can be used.
    """
    if isinstance(document, dict) and "facsNames" in document and "weightMat" in document:
        raise LabelError(
            "the file has weights of face shapes (as Audio2Face exports them), not labels; give "
            "the sound itself, or labels of it"
        )
    labels = vendor_units(document, alphabet=alphabet)
    if not labels:
        raise LabelError(f"the file has no times of words, phonemes or visemes; {_KNOWN}")
    return tuple(Tier(_NAMES[u.kind], u.kind, u.units, u.alphabet or "", u.untimed) for u in labels)


def _parsed_json(text: str) -> object:
    """Return the parsed JSON document, or for JSON Lines a dict of parsed lines by `line N`.

    Raises LabelError for an empty text, and for a line that is no JSON.
    """
    if not text.strip():
        raise LabelError(f"the file is empty; {_KNOWN}")
    lines: dict[str, object] = {}
    # Numbers of thousands of digits are a ValueError, brackets in thousands a RecursionError.
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        for number, line in enumerate(text.split("\n"), start=1):
            try:
                lines |= {f"line {number}": json.loads(line)} if line.strip() else {}
            except (ValueError, RecursionError):
                raise LabelError(f"line {number} is neither labels nor JSON; {_KNOWN}") from None
    return lines


_KNOWN: Final = "docs/text.md, Files of labels, lists what is known"
