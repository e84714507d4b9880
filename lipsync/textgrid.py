"""Reading and writing of Praat TextGrids: labelled intervals, and the phonemes of a tier."""

from os import PathLike
from pathlib import Path

from praatio import textgrid
from praatio.data_classes.interval_tier import IntervalTier
from praatio.utilities.errors import PraatioException

from lipsync.errors import UserError
from lipsync.output_file import written_whole
from lipsync.phonemes import SILENCE, VISEME_OF, PhonemeEvent


class LabelError(UserError):
    """Error for a label file that cannot be used; the message is one line: what, where, remedy."""


Interval = tuple[str, float, float]


def read_tier(path: str | PathLike[str], tier: str) -> tuple[Interval, ...]:
    """Return the intervals of `tier` as (label, start_s, end_s), in order, covering the whole file.

    Labels are stripped of white space; stretches without a label are included, with the label "".
    Raises LabelError for a missing file, a file that is no TextGrid, and a missing or point tier.
    """
    tiers = read_tiers(path)
    if tier not in tiers:
        raise LabelError(f"{path}: no interval tier {tier!r}; the file has: {', '.join(tiers)}")
    return tiers[tier]


def read_phonemes(path: str | PathLike[str], tier: str = "phones") -> tuple[PhonemeEvent, ...]:
    """Return the phonemes of a TextGrid's tier; stretches without a label are silence.

    Raises LabelError when the file cannot be read or has a label outside the inventory.
    """
    intervals = read_tier(path, tier)
    for label, start_s, _ in intervals:
        if label and label not in VISEME_OF:
            raise LabelError(
                f"{path}: {label!r} at {start_s:.3f} s in tier {tier!r} is no phoneme; "
                "use ARPAbet in upper case without stress, SIL for silence"
            )
    return tuple(
        PhonemeEvent(label or SILENCE, start_s, end_s) for label, start_s, end_s in intervals
    )


def read_tiers(path: str | PathLike[str]) -> dict[str, tuple[Interval, ...]]:
    """Return a TextGrid's interval tiers by name, each as (label, start_s, end_s) in order.

    Raises LabelError for a missing file and one that is no TextGrid.
    """
    path = Path(path)
    if not path.is_file():
        raise LabelError(f"{path}: no such file; give the path of a Praat TextGrid")
    try:
        grid = textgrid.openTextgrid(str(path), includeEmptyIntervals=True, reportingMode="error")
    # What praatio raises depends on where in the text it loses the thread.
    except (PraatioException, AssertionError, LookupError, ValueError) as error:
        raise LabelError(
            f"{path}: not a readable Praat TextGrid; save it again from Praat as text "
            f"({type(error).__name__})"
        ) from error
    return {
        tier.name: tuple(
            (str(label).strip(), float(start_s), float(end_s))
            for start_s, end_s, label in tier.entries
        )
        for tier in grid.tiers
        if isinstance(tier, IntervalTier)
    }


def write_tiers(path: str | PathLike[str], tiers: dict[str, tuple[Interval, ...]]) -> None:
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
