"""Takes of scans in a folder, with their files: sound, words, labels, markers.

The phonemes of a take and their times are from its labels, else its text, else recognised.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lipservo_lab.scans.scan import SCAN_ENDINGS, ScanError
from lipservo_lab.video.clip_labels import label_clip
from lipsync.audio.file import read_speech
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.phoneme_files.reader import has_phones, read_phonemes
from lipsync.textgrid import Interval, read_tiers

_SOUND_ENDINGS = (".wav", ".flac")


@dataclass(frozen=True, slots=True)
class Take:
    """Scans in order of time, and the take's files; None for a missing one.

    text: its words. labels: a TextGrid with phones. markers: a CSV file of named points.
    """

    name: str
    scans: tuple[Path, ...]
    sound: Path | None = None
    text: str | None = None
    labels: Path | None = None
    markers: Path | None = None


def find_takes(folder: Path, template: Path | None = None) -> tuple[Take, ...]:
    """Return a take for every sub-folder with scans, or else the folder itself as one take.

    Takes are in order of names, scans in order of the numbers in their names. A sub-folder NAME may
    have NAME.wav or .flac, NAME.txt, NAME.TextGrid and NAME.markers.csv beside it; a folder that is
    one take has them inside. template: a file that is not a scan of a take, wherever it is. Raises
    ScanError for a folder that is missing, without scans, or with a single one.
    """
    if not folder.is_dir():
        raise ScanError(f"{folder}: no such folder; give one of scans (.ply, .obj)")
    subfolders = sorted(subfolder for subfolder in folder.iterdir() if subfolder.is_dir())
    takes = [_take(subfolder, folder, subfolder.name, template) for subfolder in subfolders]
    takes = [take for take in takes if take.scans]
    if not takes:
        takes = [_take(folder, folder, folder.resolve().name, template)]
    n_scans = sum(len(take.scans) for take in takes)
    if n_scans == 0:
        raise ScanError(f"{folder}: holds no scan; looked for {' '.join(SCAN_ENDINGS)}")
    if n_scans == 1:
        raise ScanError(f"{folder}: holds one scan; motion needs several")
    return tuple(takes)


def _take(scans: Path, beside: Path, name: str, template: Path | None) -> Take:
    """Return a take: its scans in numerical order, and the files NAME.* that lie in `beside`.

    template: a scan that is not part of the take. Raises ScanError for a text that is not UTF-8.
    """
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
        text_line = text.read_text(encoding="utf-8").strip() if text.is_file() else None
    except (OSError, UnicodeDecodeError) as error:
        raise ScanError(f"{text}: cannot be read as text (UTF-8): {error}") from error
    return Take(
        name,
        tuple(sorted(found, key=lambda path: _numerical_key(path.stem))),
        next((sound for sound in sounds if sound.is_file()), None),
        text_line or None,
        _if_file(beside / f"{name}.TextGrid"),
        _if_file(beside / f"{name}.markers.csv"),
    )


def _if_file(path: Path) -> Path | None:
    """Return the path if it is a file, else None."""
    return path if path.is_file() else None


def _numerical_key(name: str) -> tuple[tuple[int, str], ...]:
    """Return a sort key that puts scan_9 before scan_10."""
    parts = re.split(r"(\d+)", name)
    return tuple((int(part), "") if part.isdigit() else (-1, part) for part in parts)


#: Allowed difference of sound and scans, as in the reader of a corpus.
_LENGTH_TOLERANCE_S = 0.25


@dataclass(frozen=True, slots=True)
class TakeSound:
    """Samples (n,) at 16 kHz, tiers of a TextGrid, and their source: labels, text or recognised."""

    samples: NDArray[np.float32]
    tiers: dict[str, tuple[Interval, ...]]
    source: str


def take_sound(take: Take, rate_hz: float) -> TakeSound:
    """Return the sound and labels of a take.

    Raises ScanError for a take without sound, for a sound that is not as long as the scans, and for
    labels without phones; UserError for a sound, labels or text that cannot be used.
    """
    if take.sound is None:
        raise ScanError(
            f"no sound {take.name}.wav or .flac, which a corpus needs; put it there, or give "
            "-o FILE.npz for motion alone"
        )
    samples = read_speech(take.sound)
    sound_s, scans_s = len(samples) / SAMPLE_RATE_HZ, len(take.scans) / rate_hz
    if abs(sound_s - scans_s) > _LENGTH_TOLERANCE_S:
        raise ScanError(
            f"{sound_s:.2f} s of sound, {len(take.scans)} scans at {rate_hz:g} a second are "
            f"{scans_s:.2f} s; would --rate-hz {len(take.scans) / sound_s:.3g} be right?"
        )
    if take.labels is None:
        text_line = label_clip(samples, take.text)
        tiers = {name: tier for name, tier in text_line.tiers().items() if tier}
        return TakeSound(samples, tiers, text_line.source)
    labels = read_tiers(take.labels)
    if not has_phones(labels):
        raise ScanError(f"{take.labels}: no tier 'phones'")
    events = read_phonemes(take.labels, sound_s)
    phones = tuple((event.phoneme, event.start_s, event.end_s or event.start_s) for event in events)
    return TakeSound(samples, labels | {"phones": phones}, "labels")
