"""Who speaks in a corpus: `speakers.csv`, a line a speaker, with what is known of the voice."""

import csv
from collections.abc import Mapping
from pathlib import Path

from lipservo_lab.corpus.transcribed import TranscriptError

#: What the file is called in a corpus's folder, and its first column.
SPEAKERS_FILE = "speakers.csv"
_SPEAKER = "speaker"


def read_speakers(path: Path) -> dict[str, tuple[str, ...]]:
    """The groups that each speaker is in, by the speaker's name: what the other columns hold.

    `0006,child,f` under `speaker,group,gender` is in "child", "f" and "child f". Raises
    TranscriptError for a file without that column, and for a speaker who is there twice.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise TranscriptError(f"{path}: cannot be read as a table of speakers ({error})") from error
    if not rows or not rows[0].get(_SPEAKER):
        raise TranscriptError(
            f"{path}: no table of speakers; its first line is like speaker,group,gender"
        )
    speakers: dict[str, tuple[str, ...]] = {}
    for number, row in enumerate(rows, start=2):
        name = (row[_SPEAKER] or "").strip()
        if not name or name in speakers:
            raise TranscriptError(f"{path}, line {number}: speaker {name!r} is there twice or not")
        speakers[name] = _groups({k: v for k, v in row.items() if k and k != _SPEAKER})
    return speakers


def _groups(columns: Mapping[str, str | None]) -> tuple[str, ...]:
    values = [value.strip() for value in columns.values() if value and value.strip()]
    return (*values, " ".join(values)) if len(values) > 1 else tuple(values)
