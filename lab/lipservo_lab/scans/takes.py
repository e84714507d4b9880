"""Which takes of scans a folder holds, and what lies beside them: sound, words, labels, markers."""

import re
from dataclasses import dataclass
from pathlib import Path

from lipservo_lab.scans.scan import SCAN_ENDINGS, ScanError

_SOUND_ENDINGS = (".wav", ".flac")


@dataclass(frozen=True, slots=True)
class Take:
    """Scans in order of time; None for what is not there.

    text: what is said. labels: a TextGrid with phones. markers: where named points were seen.
    """

    name: str
    scans: tuple[Path, ...]
    sound: Path | None = None
    text: str | None = None
    labels: Path | None = None
    markers: Path | None = None


def find_takes(folder: Path, template: Path | None = None) -> tuple[Take, ...]:
    """Every sub-folder with scans, else the folder itself as one take, in order of their names.

    Scans are in order of the numbers in their names. Beside the sub-folder NAME may lie NAME.wav or
    .flac, NAME.txt, NAME.TextGrid and NAME.markers.csv; of a folder that is one take they lie in
    it. template: no scan of a take, wherever it lies. Raises ScanError for a folder that is not
    there, without scans, or with a single one.
    """
    if not folder.is_dir():
        raise ScanError(f"{folder}: no such folder; give one with a scan (.ply, .obj) a picture")
    inner = sorted(each for each in folder.iterdir() if each.is_dir())
    takes = [_take(each, folder, each.name, template) for each in inner]
    takes = [take for take in takes if take.scans]
    if not takes:
        takes = [_take(folder, folder, folder.resolve().name, template)]
    n_scans = sum(len(take.scans) for take in takes)
    if n_scans == 0:
        raise ScanError(f"{folder}: holds no scan; looked for {' '.join(SCAN_ENDINGS)}")
    if n_scans == 1:
        raise ScanError(f"{folder}: one scan only; motion needs a sequence of them")
    return tuple(takes)


def _take(scans: Path, beside: Path, name: str, template: Path | None) -> Take:
    found = [
        path
        for path in scans.iterdir()
        if path.is_file()
        and path.suffix.lower() in SCAN_ENDINGS
        and (template is None or not template.exists() or not path.samefile(template))
    ]
    sounds = [beside / f"{name}{ending}" for ending in _SOUND_ENDINGS]
    text = beside / f"{name}.txt"
    try:
        said = text.read_text(encoding="utf-8").strip() if text.is_file() else None
    except (OSError, UnicodeDecodeError) as error:
        raise ScanError(f"{text}: cannot be read as text (UTF-8): {error}") from error
    return Take(
        name,
        tuple(sorted(found, key=lambda path: _in_order(path.stem))),
        next((each for each in sounds if each.is_file()), None),
        said or None,
        _there(beside / f"{name}.TextGrid"),
        _there(beside / f"{name}.markers.csv"),
    )


def _there(path: Path) -> Path | None:
    return path if path.is_file() else None


def _in_order(name: str) -> tuple[tuple[int, str], ...]:
    """scan_9 before scan_10."""
    parts = re.split(r"(\d+)", name)
    return tuple((int(part), "") if part.isdigit() else (-1, part) for part in parts)
