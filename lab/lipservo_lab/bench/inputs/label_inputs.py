"""Label files of aligners and recognisers, written by their formats' own rules."""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from lipservo_lab.bench.inputs.odd_input import REFUSED, Maker, OddInput
from lipsync.phoneme_files.label_file import LabelFile
from lipsync.phoneme_files.reader import labels_in

#: As the Montreal aligner's dictionaries of US English write them.
_IPA: Final = {
    **{"HH": "h", "AH": "ə", "L": "l", "OW": "ow", "M": "m", "AA": "\u0251", "P": "p", "IY": "i"},
    **{"S": "s", "T": "t", "K": "k", "F": "f", "EY": "ej", "AY": "aj", "AW": "aw", "SH": "ʃ"},
    **{"TH": "θ", "DH": "ð", "NG": "ŋ", "CH": "tʃ", "JH": "dʒ", "N": "n", "B": "b", "D": "d"},
}
_VOWELS: Final = ("AH", "OW", "AA", "IY", "EY", "AY", "AW")
#: github.com/DanielSWolf/rhubarb-lip-sync: shapes that are told, by the phone that looks so here.
_SHAPES: Final = {"A": "P", "B": "S", "C": "EH", "D": "AA", "E": "AO", "F": "UW", "G": "F"}
Row = tuple[str, float, float]


def _rows(rng: np.random.Generator) -> list[Row]:
    """Draw phones with times in hundredths of a second and some pauses; no neighbours are equal."""
    at_s = 0.1
    rows: list[Row] = []
    names = list(_IPA)
    for _ in range(int(rng.integers(4, 13))):
        others = [name for name in names if not rows or name != rows[-1][0]]
        end_s = round(at_s + 0.01 * float(rng.integers(5, 30)), 2)
        rows.append((str(rng.choice(others)), at_s, end_s))
        at_s = round(end_s + 0.01 * float(rng.integers(5, 30)) * bool(rng.random() < 0.2), 2)
    return rows


def _sound_s(rows: Sequence[Row]) -> float:
    return round(rows[-1][2] + 0.2, 2)


def _right(rows: Sequence[Row]) -> list[tuple[str, float, float]]:
    return [(label, 1e3 * start_s, 1e3 * end_s) for label, start_s, end_s in rows]


def _read(text: str | bytes, sound_s: float, tier: str = "") -> tuple[object, Sequence[str]]:
    content = text if isinstance(text, bytes) else text.encode()
    found = labels_in(content, LabelFile(Path("odd"), tier), sound_s)
    if found.words:
        return [(w.label.strip(), w.start_s, w.end_s) for w in found.words], found.notes
    phones = [e for e in found.phones if e.phoneme != "SIL"]
    return [(e.phoneme, 1e3 * e.start_s, 1e3 * (e.end_s or 0.0)) for e in phones], found.notes


def _filled(rows: Sequence[Row], end_s: float) -> list[Row]:
    """Return rows without gaps from 0 to `end_s`: rows with an empty label fill the pauses."""
    full: list[Row] = []
    at_s = 0.0
    for row in rows:
        full += [("", at_s, row[1])] if row[1] > at_s else []
        full.append(row)
        at_s = row[2]
    return [*full, ("", at_s, end_s)]


def _textgrid(tiers: dict[str, Sequence[Row]], end_s: float) -> str:
    """Return a Praat TextGrid (long form) of interval tiers; pauses are empty intervals."""
    lines = ['File type = "ooTextFile"', 'Object class = "TextGrid"', "", "xmin = 0"]
    lines += [f"xmax = {end_s}", "tiers? <exists>", f"size = {len(tiers)}", "item []:"]
    for number, (name, rows) in enumerate(tiers.items(), 1):
        full = _filled(rows, end_s)
        lines += [f"    item [{number}]:", '        class = "IntervalTier"']
        lines += [f'        name = "{name}"', "        xmin = 0", f"        xmax = {end_s}"]
        lines += [f"        intervals: size = {len(full)}"]
        for n, (label, start_s, row_end_s) in enumerate(full, 1):
            lines += [f"        intervals [{n}]:", f"            xmin = {start_s!r}"]
            lines += [f"            xmax = {row_end_s!r}", f'            text = "{label}"']
    return "\n".join(lines) + "\n"


def _stressed(rng: np.random.Generator, rows: Sequence[Row]) -> list[Row]:
    """Return ARPAbet in one case, with stress on all vowels or on none."""
    case = (str.upper, str.lower, str.title)[int(rng.integers(3))]
    digit = str(rng.choice(["", "0", "1", "2"]))
    return [(case(x) + digit * (x in _VOWELS), s, e) for x, s, e in rows]


def _csv(rows: Sequence[Row]) -> str:
    lines = [f"{s},{e},{label},phones,mary" for label, s, e in rows]
    return "\n".join(["Begin,End,Label,Type,Speaker", "0.1,0.9,word,words,mary", *lines, ""])


def _gentle(rows: Sequence[Row]) -> str:
    """A word is what no pause interrupts; Gentle writes none within words."""
    words: list[list[Row]] = []
    for row in rows:
        if words and words[-1][-1][2] == row[1]:
            words[-1].append(row)
        else:
            words.append([row])
    found = [
        {"case": "success", "word": "w", "start": part[0][1], "end": part[-1][2]}
        | {"phones": [{"duration": round(e - s, 4), "phone": f"{x.lower()}_I"} for x, s, e in part]}
        for part in words
    ]
    return json.dumps({"transcript": "w", "words": found})


def _mfa_json(rows: Sequence[Row]) -> str:
    entries = [[s, e, label] for label, s, e in rows]
    tiers = {"phones": {"type": "interval", "entries": entries}}
    return json.dumps({"start": 0, "end": _sound_s(rows), "tiers": tiers})


_FORMATS: Final[dict[str, Callable[[Sequence[Row]], str]]] = {
    "MFA's CSV": _csv,
    "MFA's JSON": _mfa_json,
    "Gentle": _gentle,
    "CTM": lambda rows: "".join(f"a 1 {s} {e - s:.4f} {label}_I .9\n" for label, s, e in rows),
    "HTK": lambda rows: "".join(
        f"{round(s * 1e7)} {round(e * 1e7)} {label or 'sil'}\n" for label, s, e in _filled(rows, 9)
    ),
    "Audacity": lambda rows: "".join(f"{s:.6f}\t{e:.6f}\t{label}\n" for label, s, e in rows),
    "lines recognize": lambda rows: json.dumps({"phones": rows}),
}


def _of_format(name: str) -> Maker:
    """Return a maker of label files of one of `_FORMATS`, to be read as the same phones, in ms."""

    def make(rng: np.random.Generator, _folder: Path) -> OddInput:
        rows = _rows(rng)
        written = _stressed(rng, rows) if name not in ("Gentle", "HTK") else rows
        text = _FORMATS[name](written)
        sound_s = 9.0 if name == "HTK" else _sound_s(rows)
        return OddInput(text[:200], lambda: _read(text, sound_s), _right(rows), tolerance=1.1)

    return make


def _arpabet(rng: np.random.Generator, _folder: Path) -> OddInput:
    rows = _rows(rng)
    name = str(rng.choice(["phones", "phone", "mary - phones", "Mary"]))
    text = _textgrid({name: _stressed(rng, rows)}, _sound_s(rows))
    return OddInput(text, lambda: _read(text, _sound_s(rows)), _right(rows), tolerance=1.1)


def _ipa(rng: np.random.Generator, _folder: Path) -> OddInput:
    """Write a TextGrid in IPA, AA and IY sometimes with a length mark, beside a tier of words."""
    rows = _rows(rng)
    spelt = [
        (_IPA[x] + "\u02d0" * bool(x in ("AA", "IY") and rng.random() < 0.5), s, e)
        for x, s, e in rows
    ]
    text = _textgrid({"words": [("word", 0.1, 0.3)], "phones": spelt}, _sound_s(rows))
    return OddInput(text, lambda: _read(text, _sound_s(rows)), _right(rows), tolerance=1.1)


def _speakers(rng: np.random.Generator, _folder: Path) -> OddInput:
    """Write a TextGrid of two speakers; to be refused unless the tier is named."""
    rows, other = _rows(rng), _rows(rng)
    end_s = max(_sound_s(rows), _sound_s(other))
    text = _textgrid({"ann - phones": other, "bob - phones": rows}, end_s)
    tier = str(rng.choice(["", "bob - phones"]))
    right = _right(rows) if tier else REFUSED
    return OddInput(text, lambda: _read(text, _sound_s(rows), tier), right, tolerance=1.1)


def _nearly(rng: np.random.Generator, _folder: Path) -> OddInput:
    """Edges some hundred nanoseconds apart, labels without length, exponents."""
    rows = _rows(rng)
    moved = [(x, s + float(rng.uniform(-4e-4, 4e-4)), e) for x, s, e in rows]
    at = int(rng.integers(len(moved)))
    moved.insert(at, ("AA", rows[at][1], rows[at][1]))
    track = "".join(f"{s:.9e}\t{e:.9e}\t{label}\n" for label, s, e in moved)
    return OddInput(track, lambda: _read(track, _sound_s(rows)), _right(rows), tolerance=1.1)


def _overlapping(rng: np.random.Generator, _folder: Path) -> OddInput:
    """Write a label file in which one phone ends 20 ms after the next begins: to be refused."""
    rows = _rows(rng)
    at = int(rng.integers(len(rows) - 1))
    label, start_s, _ = rows[at]
    rows[at] = (label, start_s, rows[at + 1][1] + 0.02)
    name = str(rng.choice(["MFA's CSV", "Audacity", "lines recognize", "MFA's JSON"]))
    text = _FORMATS[name](rows)
    return OddInput(text, lambda: _read(text, _sound_s(rows)), REFUSED)


def _milliseconds(rng: np.random.Generator, _folder: Path) -> OddInput:
    rows = _rows(rng)
    in_ms = [(x, round(1e3 * s), round(1e3 * e)) for x, s, e in rows]
    formats = {k: v for k, v in _FORMATS.items() if k != "HTK"}
    formats["TextGrid"] = lambda r: _textgrid({"phones": r}, 1e3 * _sound_s(rows))
    text = formats[str(rng.choice(list(formats)))](in_ms)
    return OddInput(text[:300], lambda: _read(text, _sound_s(rows)), REFUSED)


def _cut(rng: np.random.Generator, _folder: Path) -> OddInput:
    """Cut a label file in its first three quarters: to be refused, or reported."""
    rows = _rows(rng)
    sound_s = _sound_s(rows)
    formats = {
        k: v for k, v in _FORMATS.items() if k not in ("HTK", "CTM", "Audacity", "MFA's CSV")
    }
    formats["TextGrid"] = lambda r: _textgrid({"phones": r}, sound_s)
    text = formats[str(rng.choice(list(formats)))](rows)
    text = text[: int(rng.integers(20, 3 * len(text) // 4))]
    return OddInput(text, lambda: _read(text, sound_s), REFUSED, may_refuse=True)


def _words(rng: np.random.Generator, _folder: Path) -> OddInput:
    """WhisperX, some words without a time: these are passed over with a line."""
    rows = [(f"word{n}", s, e) for n, (_, s, e) in enumerate(_rows(rng))]
    words: list[dict[str, object]] = [{"word": w, "start": s, "end": e} for w, s, e in rows]
    is_untimed = bool(rng.random() < 0.5)
    if is_untimed:
        words.insert(int(rng.integers(len(words))), {"word": "42"})
    text = json.dumps({"segments": [{"start": 0.0, "end": 9.0, "words": words}]})
    read = OddInput(text[:200], lambda: _read(text, _sound_s(rows)), rows, reported=is_untimed)
    return replace(read, tolerance=1e-3)


def _rhubarb(rng: np.random.Generator, _folder: Path) -> OddInput:
    """Write a file of Rhubarb's mouth shapes; each is to be read as the phone that looks alike."""
    rows = _rows(rng)
    shapes = [str(rng.choice(list(_SHAPES)))]
    while len(shapes) < len(rows):
        shapes.append(str(rng.choice([x for x in _SHAPES if x != shapes[-1]])))
    cues = _filled([(x, s, e) for x, (_, s, e) in zip(shapes, rows, strict=True)], _sound_s(rows))
    text = "".join(f"{s:.2f}\t{x or 'X'}\n" for x, s, _ in cues) + f"{cues[-1][2]:.2f}\tX\n"
    right = [(_SHAPES[x], s, e) for x, (_, s, e) in zip(shapes, _right(rows), strict=True)]
    return OddInput(text, lambda: _read(text, _sound_s(rows)), right, tolerance=1.1)


def _noise(rng: np.random.Generator, _folder: Path) -> OddInput:
    content = b"\xff\xfe\xfd" + rng.bytes(int(rng.integers(1, 400)))
    return OddInput(content.hex(), lambda: _read(content, 2.0), REFUSED)


LABEL_KINDS: Final[dict[str, Maker]] = {
    **{f"labels: {name}": _of_format(name) for name in _FORMATS},
    "labels: TextGrid, ARPAbet": _arpabet,
    "labels: TextGrid, IPA": _ipa,
    "labels: two speakers": _speakers,
    "labels: edges of nanoseconds": _nearly,
    "labels: overlap": _overlapping,
    "labels: milliseconds": _milliseconds,
    "labels: cut": _cut,
    "labels: words": _words,
    "labels: Rhubarb": _rhubarb,
    "labels: noise": _noise,
}
