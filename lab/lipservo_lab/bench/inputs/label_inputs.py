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
#: Shapes of github.com/DanielSWolf/rhubarb-lip-sync, with the phone that each is to be read as.
_SHAPES: Final = {"A": "P", "B": "S", "C": "EH", "D": "AA", "E": "AO", "F": "UW", "G": "F"}
Row = tuple[str, float, float]


def _draw_phones(rng: np.random.Generator) -> list[Row]:
    """Draw 4 to 12 phones, with some pauses; return (phone, start in s, end in s) of each.

    Times are whole hundredths of a second; neighbours differ.
    """
    start_s = 0.1
    rows: list[Row] = []
    names = list(_IPA)
    for _ in range(int(rng.integers(4, 13))):
        candidates = [name for name in names if not rows or name != rows[-1][0]]
        end_s = round(start_s + 0.01 * float(rng.integers(5, 30)), 2)
        rows.append((str(rng.choice(candidates)), start_s, end_s))
        start_s = round(end_s + 0.01 * float(rng.integers(5, 30)) * bool(rng.random() < 0.2), 2)
    return rows


def _sound_s(rows: Sequence[Row]) -> float:
    return round(rows[-1][2] + 0.2, 2)


def _right(rows: Sequence[Row]) -> list[tuple[str, float, float]]:
    """Return the rows as they are to be read: times in ms, in which the tolerance is given."""
    return [(label, 1e3 * start_s, 1e3 * end_s) for label, start_s, end_s in rows]


def _read(text: str | bytes, sound_s: float, tier: str = "") -> tuple[object, Sequence[str]]:
    """Read a label file by our reader; return its words (s), else its phones (ms), and its notes.

    sound_s: length of the sound. tier: name of the tier that is wanted; empty: not given.
    """
    content = text if isinstance(text, bytes) else text.encode()
    labels = labels_in(content, LabelFile(Path("odd"), tier), sound_s)
    if labels.words:
        return [(w.label.strip(), w.start_s, w.end_s) for w in labels.words], labels.notes
    phones = [e for e in labels.phones if e.phoneme != "SIL"]
    return [(e.phoneme, 1e3 * e.start_s, 1e3 * (e.end_s or 0.0)) for e in phones], labels.notes


def _filled(rows: Sequence[Row], end_s: float) -> list[Row]:
    """Return the rows with rows of an empty label between, so that they fill 0 to `end_s`."""
    filled: list[Row] = []
    end_of_last_s = 0.0
    for row in rows:
        filled += [("", end_of_last_s, row[1])] if row[1] > end_of_last_s else []
        filled.append(row)
        end_of_last_s = row[2]
    return [*filled, ("", end_of_last_s, end_s)]


def _textgrid(tiers: dict[str, Sequence[Row]], end_s: float) -> str:
    """Return a Praat TextGrid (long form) of interval tiers; pauses are empty intervals."""
    lines = ['File type = "ooTextFile"', 'Object class = "TextGrid"', "", "xmin = 0"]
    lines += [f"xmax = {end_s}", "tiers? <exists>", f"size = {len(tiers)}", "item []:"]
    for number, (name, rows) in enumerate(tiers.items(), 1):
        intervals = _filled(rows, end_s)
        lines += [f"    item [{number}]:", '        class = "IntervalTier"']
        lines += [f'        name = "{name}"', "        xmin = 0", f"        xmax = {end_s}"]
        lines += [f"        intervals: size = {len(intervals)}"]
        for n, (label, start_s, row_end_s) in enumerate(intervals, 1):
            lines += [f"        intervals [{n}]:", f"            xmin = {start_s!r}"]
            lines += [f"            xmax = {row_end_s!r}", f'            text = "{label}"']
    return "\n".join(lines) + "\n"


def _with_stress(rng: np.random.Generator, rows: Sequence[Row]) -> list[Row]:
    """Return the rows with labels in a drawn case, and a drawn stress digit, or none, on vowels."""
    case = (str.upper, str.lower, str.title)[int(rng.integers(3))]
    digit = str(rng.choice(["", "0", "1", "2"]))
    return [(case(x) + digit * (x in _VOWELS), s, e) for x, s, e in rows]


def _csv(rows: Sequence[Row]) -> str:
    lines = [f"{s},{e},{label},phones,mary" for label, s, e in rows]
    return "\n".join(["Begin,End,Label,Type,Speaker", "0.1,0.9,word,words,mary", *lines, ""])


def _gentle(rows: Sequence[Row]) -> str:
    """Return Gentle's JSON; phones without a pause between make a word."""
    words: list[list[Row]] = []
    for row in rows:
        if words and words[-1][-1][2] == row[1]:
            words[-1].append(row)
        else:
            words.append([row])
    entries = [
        {"case": "success", "word": "w", "start": word[0][1], "end": word[-1][2]}
        | {"phones": [{"duration": round(e - s, 4), "phone": f"{x.lower()}_I"} for x, s, e in word]}
        for word in words
    ]
    return json.dumps({"transcript": "w", "words": entries})


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
    """Return a maker of label files in one of `_FORMATS`, to be read as the phones written."""

    def make(rng: np.random.Generator, _folder: Path) -> OddInput:
        rows = _draw_phones(rng)
        written = _with_stress(rng, rows) if name not in ("Gentle", "HTK") else rows
        text = _FORMATS[name](written)
        sound_s = 9.0 if name == "HTK" else _sound_s(rows)
        return OddInput(text[:200], lambda: _read(text, sound_s), _right(rows), tolerance=1.1)

    return make


def _arpabet_textgrid(rng: np.random.Generator, _folder: Path) -> OddInput:
    """Write a TextGrid in ARPAbet, with a drawn name of its one tier."""
    rows = _draw_phones(rng)
    tier = str(rng.choice(["phones", "phone", "mary - phones", "Mary"]))
    text = _textgrid({tier: _with_stress(rng, rows)}, _sound_s(rows))
    return OddInput(text, lambda: _read(text, _sound_s(rows)), _right(rows), tolerance=1.1)


def _ipa_textgrid(rng: np.random.Generator, _folder: Path) -> OddInput:
    """Write a TextGrid in IPA, AA and IY sometimes with a length mark, beside a tier of words."""
    rows = _draw_phones(rng)
    spelt = [
        (_IPA[x] + "\u02d0" * bool(x in ("AA", "IY") and rng.random() < 0.5), s, e)
        for x, s, e in rows
    ]
    text = _textgrid({"words": [("word", 0.1, 0.3)], "phones": spelt}, _sound_s(rows))
    return OddInput(text, lambda: _read(text, _sound_s(rows)), _right(rows), tolerance=1.1)


def _two_speakers(rng: np.random.Generator, _folder: Path) -> OddInput:
    """Write a TextGrid of two speakers; to be refused unless the tier is named."""
    rows, other = _draw_phones(rng), _draw_phones(rng)
    end_s = max(_sound_s(rows), _sound_s(other))
    text = _textgrid({"ann - phones": other, "bob - phones": rows}, end_s)
    tier = str(rng.choice(["", "bob - phones"]))
    right = _right(rows) if tier else REFUSED
    return OddInput(text, lambda: _read(text, _sound_s(rows), tier), right, tolerance=1.1)


def _nearly_equal_edges(rng: np.random.Generator, _folder: Path) -> OddInput:
    """Write labels whose edges differ by up to 0.4 ms, one of no length, times with exponents."""
    rows = _draw_phones(rng)
    shifted = [(x, s + float(rng.uniform(-4e-4, 4e-4)), e) for x, s, e in rows]
    index = int(rng.integers(len(shifted)))
    shifted.insert(index, ("AA", rows[index][1], rows[index][1]))
    text = "".join(f"{s:.9e}\t{e:.9e}\t{label}\n" for label, s, e in shifted)
    return OddInput(text, lambda: _read(text, _sound_s(rows)), _right(rows), tolerance=1.1)


def _overlapping(rng: np.random.Generator, _folder: Path) -> OddInput:
    """Write a label file in which one phone ends 20 ms after the next begins: to be refused."""
    rows = _draw_phones(rng)
    index = int(rng.integers(len(rows) - 1))
    label, start_s, _ = rows[index]
    rows[index] = (label, start_s, rows[index + 1][1] + 0.02)
    name = str(rng.choice(["MFA's CSV", "Audacity", "lines recognize", "MFA's JSON"]))
    text = _FORMATS[name](rows)
    return OddInput(text, lambda: _read(text, _sound_s(rows)), REFUSED)


def _milliseconds(rng: np.random.Generator, _folder: Path) -> OddInput:
    """Write times in milliseconds where the format has seconds: to be refused."""
    rows = _draw_phones(rng)
    in_ms = [(x, round(1e3 * s), round(1e3 * e)) for x, s, e in rows]
    formats = {k: v for k, v in _FORMATS.items() if k != "HTK"}
    formats["TextGrid"] = lambda r: _textgrid({"phones": r}, 1e3 * _sound_s(rows))
    text = formats[str(rng.choice(list(formats)))](in_ms)
    return OddInput(text[:300], lambda: _read(text, _sound_s(rows)), REFUSED)


def _cut_off(rng: np.random.Generator, _folder: Path) -> OddInput:
    """Cut a label file in its first three quarters: to be refused, or reported."""
    rows = _draw_phones(rng)
    sound_s = _sound_s(rows)
    formats = {
        k: v for k, v in _FORMATS.items() if k not in ("HTK", "CTM", "Audacity", "MFA's CSV")
    }
    formats["TextGrid"] = lambda r: _textgrid({"phones": r}, sound_s)
    text = formats[str(rng.choice(list(formats)))](rows)
    text = text[: int(rng.integers(20, 3 * len(text) // 4))]
    return OddInput(text, lambda: _read(text, sound_s), REFUSED, may_refuse=True)


def _whisperx_words(rng: np.random.Generator, _folder: Path) -> OddInput:
    """Write WhisperX's words, in half of the files one without a time, which is to be reported."""
    rows = [(f"word{n}", s, e) for n, (_, s, e) in enumerate(_draw_phones(rng))]
    words: list[dict[str, object]] = [{"word": w, "start": s, "end": e} for w, s, e in rows]
    is_untimed = bool(rng.random() < 0.5)
    if is_untimed:
        words.insert(int(rng.integers(len(words))), {"word": "42"})
    text = json.dumps({"segments": [{"start": 0.0, "end": 9.0, "words": words}]})
    odd = OddInput(text[:200], lambda: _read(text, _sound_s(rows)), rows, reported=is_untimed)
    return replace(odd, tolerance=1e-3)


def _rhubarb(rng: np.random.Generator, _folder: Path) -> OddInput:
    """Write a file of Rhubarb's mouth shapes; each is to be read as the phone that looks alike."""
    rows = _draw_phones(rng)
    shapes = [str(rng.choice(list(_SHAPES)))]
    while len(shapes) < len(rows):
        shapes.append(str(rng.choice([x for x in _SHAPES if x != shapes[-1]])))
    cues = _filled([(x, s, e) for x, (_, s, e) in zip(shapes, rows, strict=True)], _sound_s(rows))
    text = "".join(f"{s:.2f}\t{x or 'X'}\n" for x, s, _ in cues) + f"{cues[-1][2]:.2f}\tX\n"
    right = [(_SHAPES[x], s, e) for x, (_, s, e) in zip(shapes, _right(rows), strict=True)]
    return OddInput(text, lambda: _read(text, _sound_s(rows)), right, tolerance=1.1)


def _random_bytes(rng: np.random.Generator, _folder: Path) -> OddInput:
    content = b"\xff\xfe\xfd" + rng.bytes(int(rng.integers(1, 400)))
    return OddInput(content.hex(), lambda: _read(content, 2.0), REFUSED)


LABEL_KINDS: Final[dict[str, Maker]] = {
    **{f"labels: {name}": _of_format(name) for name in _FORMATS},
    "labels: TextGrid, ARPAbet": _arpabet_textgrid,
    "labels: TextGrid, IPA": _ipa_textgrid,
    "labels: two speakers": _two_speakers,
    "labels: edges of nanoseconds": _nearly_equal_edges,
    "labels: overlap": _overlapping,
    "labels: milliseconds": _milliseconds,
    "labels: cut": _cut_off,
    "labels: words": _whisperx_words,
    "labels: Rhubarb": _rhubarb,
    "labels: noise": _random_bytes,
}
