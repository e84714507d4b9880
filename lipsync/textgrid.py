"""Reading and writing of Praat TextGrids: labelled intervals by tier."""

import re
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any, Final

from praatio import textgrid
from praatio.data_classes.interval_tier import IntervalTier
from praatio.utilities.errors import PraatioException
from praatio.utilities.textgrid_io import parseTextgridStr

from lipsync.errors import UserError, shown
from lipsync.output_file import written_whole


class LabelError(UserError):
    """Error for a label file that cannot be used; the message is one line: what, where, remedy."""


#: Label, start and end in s.
Interval = tuple[str, float, float]

#: Times with exponents: Praat writes very small ones so, and praatio does not read them.
_EXPONENT: Final = re.compile(r"(?m)^(\s*x(?:min|max) ?= ?)([\d.]+[eE][-+]?\d+)(?=\s*$)")
#: Negative times: praatio drops the sign.
_NEGATIVE: Final = re.compile(r"(?m)^\s*(?:xmin|xmax) ?= ?(-[\d.]*[1-9][\d.]*)\s*$")
_WIDE: Final = (b"\xff\xfe", b"\xfe\xff")
_N_TIERS: Final = re.compile(r"<exists>\s*(?:size ?= ?)?(\d+)")
_N_LABELS: Final = re.compile(
    r"(?:intervals|points) ?: ?size ?= ?(\d+)"
    r'|"(?:Interval|Text)Tier"\s+"[^\n]*"\s+\S+\s+\S+\s+(\d+)'
)


def intervals_by_tier(text: str) -> dict[str, tuple[Interval, ...]]:
    """Return a TextGrid's interval tiers by name, each in order and with its empty intervals.

    text: a TextGrid, long, short or as JSON. Labels are stripped of white space. Raises LabelError,
    without the file's name, for a text that is none, that is cut off, or has two tiers of a name.
    """
    text = text.replace("\r\n", "\n")
    if negative := _NEGATIVE.search(text):
        raise LabelError(f"time {negative[1][:20]} s is before the sound begins; correct it")
    text = _EXPONENT.sub(lambda match: f"{match[1]}{float(match[2]):.9f}", text)
    tiers: dict[str, tuple[Interval, ...]] = {}
    try:
        grid = parseTextgridStr(text + "\n", includeEmptyIntervals=True)["tiers"]
        _refuse_cut_off(text, grid)
        for tier in grid:
            if str(tier["class"]).lower().startswith("interval"):
                if tier["name"] in tiers:
                    raise LabelError(f"two tiers are called {shown(tier['name'])}; rename one")
                tiers[str(tier["name"])] = tuple(_interval(*row) for row in tier["entries"])
    except LabelError:
        raise
    # praatio raises these, depending on where in the text it fails.
    except (
        PraatioException,
        AssertionError,
        AttributeError,
        LookupError,
        TypeError,
        ValueError,
    ) as error:
        raise LabelError(
            "not a readable Praat TextGrid; save it again from Praat as text "
            f"({type(error).__name__})"
        ) from error
    return tiers


def _interval(start: object, end: object, label: object) -> Interval:
    """Return (label, start_s, end_s) of an entry. Raises LabelError for impossible times."""
    start_s, end_s = float(str(start)), float(str(end))
    if not 0 <= start_s <= end_s < 1e9:
        raise LabelError(f"{shown(label)}: {shown(start)} to {shown(end)} s cannot be; correct it")
    return str(label).strip(), start_s, end_s


def _refuse_cut_off(text: str, tiers: list[dict[str, Any]]) -> None:
    """Raise LabelError if the text promises more tiers or labels than praatio found."""
    counts = [int(long or short) for long, short in _N_LABELS.findall(text)]
    if (promised := _N_TIERS.search(text)) and min(len(tiers), len(counts)) < int(promised[1]):
        raise LabelError(f"has {len(counts)} of {promised[1]} tiers: it is cut off; save it again")
    for tier, count in zip(tiers, counts, strict=False):
        if (n := len(tier["entries"])) < count:
            reached_s = float(tier["entries"][-1][-2]) if n else 0.0
            raise LabelError(
                f"tier {shown(tier['name'])} has {n} of {count} labels, up to {reached_s:.3f} s of "
                f"{float(tier['xmax']):.3f} s; the file is cut off, save it again"
            )


def read_tiers(path: str | PathLike[str]) -> dict[str, tuple[Interval, ...]]:
    """Return a TextGrid's interval tiers by name, each as (label, start_s, end_s) in order.

    Raises LabelError for a missing file and one that is no TextGrid.
    """
    try:
        return intervals_by_tier(read_text(Path(path)))
    except LabelError as error:
        raise LabelError(f"{path}: {error}") from error


def write_tiers(path: str | PathLike[str], tiers: Mapping[str, tuple[Interval, ...]]) -> None:
    """Write interval tiers, (label, start_s, end_s) by name, as a Praat TextGrid in long form.

    Stretches between intervals get empty labels. The file is written whole or not at all. Raises
    OutputError.
    """
    grid = textgrid.Textgrid()
    file_end_s = max((end_s for tier in tiers.values() for _, _, end_s in tier), default=0.0)
    for name, intervals in tiers.items():
        entries = [(start_s, end_s, label) for label, start_s, end_s in intervals]
        grid.addTier(IntervalTier(name, entries, 0.0, file_end_s))
    with written_whole(Path(path)) as partial:
        grid.save(str(partial), format="long_textgrid", includeBlankSpaces=True)


def is_textgrid(head: bytes) -> bool:
    """Return whether a file's first bytes `head` are of a Praat TextGrid in UTF-8 or UTF-16."""
    return b"ooTextFile" in head.replace(b"\0", b"")


#: An hour of phonemes in JSON is about 4 MB.
_LARGEST_BYTES: Final = 64 * 2**20


def read_text(path: Path) -> str:
    """Return a label file's text. Raises LabelError, without the file's name.

    A pipe or a device is refused: it may have no end.
    """
    try:
        if "\0" in str(path) or (path.exists() and not path.is_file()):
            raise LabelError("cannot be read: not a regular file; save it first")
        if path.stat().st_size > _LARGEST_BYTES:
            raise LabelError("larger than 64 MiB; give labels of one recording only")
        return decode_labels(path.read_bytes())
    except FileNotFoundError:
        raise LabelError("no such file") from None
    except OSError as error:
        raise LabelError(f"cannot be read ({error.strerror}); give a file of labels") from None


def decode_labels(content: bytes) -> str:
    """Return a label file's content as text. Raises LabelError without the file's name."""
    try:
        return content.decode("utf-16" if content[:2] in _WIDE else "utf-8-sig")
    except UnicodeDecodeError:
        raise LabelError("neither a TextGrid nor UTF-8 text; save it again as UTF-8") from None
