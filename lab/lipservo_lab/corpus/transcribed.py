"""Corpora of speech with known words, in one of four layouts (docs/recognition.md).

1. LibriSpeech's own: anywhere below the folder `*.trans.txt` with one utterance a line, its name
   first, SPEAKER-CHAPTER-NUMBER WORDS..., and the sounds beside it, NAME.flac.
2. The same in two places: `transcripts.txt` and `audio/NAME.*`. 3. grid_s1's:
`labels/NAME.TextGrid` with a tier `words` and maybe one `phones`, and `audio/NAME.*`;
   all of one speaker, who has the folder's name.
4. `NAME.txt` beside `NAME.*`, also of one speaker.

Sounds may have any ending that libsndfile reads. `speakers.csv`: the speakers of a corpus, a line
each, with what is known of the voice.
"""

import csv
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from lipsync.errors import UserError
from lipsync.phoneme_files.reader import has_phones
from lipsync.textgrid import read_tiers

#: Labels of silence in the tier of words.
_NO_WORD = ("", "sil", "sp")


class TranscriptError(UserError):
    """A folder cannot be used as a corpus; the message is one line: what, where, what to do."""


@dataclass(frozen=True, slots=True)
class TranscribedUtterance:
    """One recording and its words.

    speaker: in LibriSpeech's layout the name up to the first hyphen. labels: a TextGrid with a tier
    `phones`; None if the phones are not labelled.
    """

    name: str
    speaker: str
    text: str
    sound: Path
    labels: Path | None = None


def read_transcribed(folder: Path) -> tuple[TranscribedUtterance, ...]:
    """Read every utterance of a corpus, in the order of its transcripts or of its label files.

    Raises TranscriptError for a folder without transcripts, a line or a text without words, a name
    that is listed twice, and an utterance without a sound file; LabelError for a label file that
    cannot be read.
    """
    path = folder / "transcripts.txt"
    if path.is_file():
        listed = [(path, folder / "audio")]
    elif (folder / "labels").is_dir():
        return _read_labelled(folder)
    else:
        listed = [(each, each.parent) for each in sorted(folder.rglob("*.trans.txt"))]
    if not listed and (texts := sorted(folder.glob("*.txt"))):
        return _read_pairs(folder, texts)
    if not listed:
        raise TranscriptError(
            f"{path}: no such file, and no *.trans.txt, labels/ or NAME.txt either; give a folder "
            "laid out like LibriSpeech or grid_s1, or NAME.txt beside each NAME.wav "
            "(docs/recognition.md, Corpora)"
        )
    utterances: dict[str, TranscribedUtterance] = {}
    for transcripts, sound_folder in listed:
        _add_listed(utterances, transcripts, sound_folder)
    if not utterances:
        raise TranscriptError(f"{listed[0][0]}: holds no utterance")
    return tuple(utterances.values())


def _add_listed(
    utterances: dict[str, TranscribedUtterance], path: Path, sound_folder: Path
) -> None:
    """Add the utterances of one list of transcripts.

    path: the list. sound_folder: of their sounds. Raises TranscriptError for a line without words
    or sound, and for a name that occurs twice.
    """
    sounds = {sound.stem: sound for sound in sorted(sound_folder.glob("*"))}
    for number, line in enumerate(_text_of(path).splitlines(), start=1):
        name, _, text = line.strip().partition(" ")
        if not name:
            continue
        if not text.strip():
            raise TranscriptError(f"{path}, line {number}: {name!r} has no words")
        if name in utterances:
            raise TranscriptError(f"{path}, line {number}: {name!r} comes twice")
        if name not in sounds:
            raise TranscriptError(f"{path}, line {number}: no sound {sound_folder / name}.*")
        speaker = name.split("-")[0]
        utterances[name] = TranscribedUtterance(name, speaker, text.strip(), sounds[name])


def _read_labelled(folder: Path) -> tuple[TranscribedUtterance, ...]:
    """Read the utterances of one speaker's folder with `labels/` and `audio/`.

    Raises TranscriptError for labels without words or sound.
    """
    sounds = {sound.stem: sound for sound in sorted((folder / "audio").glob("*"))}
    utterances = []
    for path in sorted((folder / "labels").glob("*.TextGrid")):
        tiers = read_tiers(path)
        text = " ".join(word for word, _, _ in tiers.get("words", ()) if word not in _NO_WORD)
        if not text:
            raise TranscriptError(f"{path}: no words in a tier 'words'")
        if path.stem not in sounds:
            raise TranscriptError(f"{path}: no sound audio/{path.stem}.*")
        labels = path if has_phones(tiers) else None
        sound = sounds[path.stem]
        utterances.append(
            TranscribedUtterance(path.stem, folder.resolve().name, text, sound, labels)
        )
    if not utterances:
        raise TranscriptError(f"{folder / 'labels'}: holds no TextGrid")
    return tuple(utterances)


def _read_pairs(folder: Path, texts: list[Path]) -> tuple[TranscribedUtterance, ...]:
    """Read utterances whose text is in a file beside the sound.

    Raises TranscriptError for a text without words or sound.
    """
    sounds = {each.stem: each for each in sorted(folder.glob("*")) if each.suffix != ".txt"}
    utterances = []
    for path in texts:
        if path.stem not in sounds:
            raise TranscriptError(f"{path}: no sound {path.stem}.* beside it")
        text = " ".join(_text_of(path).split())
        if not text:
            raise TranscriptError(f"{path}: holds no words; write what is said in the sound")
        speaker = folder.resolve().name
        utterances.append(TranscribedUtterance(path.stem, speaker, text, sounds[path.stem]))
    return tuple(utterances)


def _text_of(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise TranscriptError(f"{path}: cannot be read as text (UTF-8): {error}") from error


def read_names(listed: str) -> frozenset[str]:
    """Read names of utterances from `FILE`, one a line, or a list in `FILE.json:KEY`.

    Raises TranscriptError for a missing file or key, and for a list of anything but names.
    """
    file, _, key = listed.partition(".json:")
    path = Path(f"{file}.json") if key else Path(listed)
    try:
        text = path.read_text(encoding="utf-8")
        names = json.loads(text)[key] if key else text.split()
    except (OSError, UnicodeDecodeError) as error:
        raise TranscriptError(f"{path}: no readable list of names ({error})") from error
    except (ValueError, LookupError, TypeError) as error:
        raise TranscriptError(f"{path}: not JSON that has a list under {key!r}") from error
    if not isinstance(names, list) or not names or not all(isinstance(n, str) for n in names):
        raise TranscriptError(f"{listed}: not a list of names; write one a line, or FILE.json:KEY")
    return frozenset(names)


def of_names(
    utterances: tuple[TranscribedUtterance, ...], names: frozenset[str]
) -> tuple[TranscribedUtterance, ...]:
    """Return the utterances of these names; TranscriptError for an unknown name."""
    _refuse_unknown(names, utterances)
    return tuple(utterance for utterance in utterances if utterance.name in names)


def without_names(
    utterances: tuple[TranscribedUtterance, ...], names: frozenset[str]
) -> tuple[TranscribedUtterance, ...]:
    """Return the utterances without those named; TranscriptError for an unknown name."""
    _refuse_unknown(names, utterances)
    return tuple(utterance for utterance in utterances if utterance.name not in names)


def _refuse_unknown(names: frozenset[str], utterances: tuple[TranscribedUtterance, ...]) -> None:
    """Raise TranscriptError for an unknown name: a misspelt one would not be left out."""
    if missing := sorted(names - {utterance.name for utterance in utterances}):
        raise TranscriptError(
            f"{len(missing)} of {len(names)} names are not in the corpus, such as {missing[0]!r}"
        )


def of_speakers(
    utterances: tuple[TranscribedUtterance, ...], speakers: frozenset[str], limit: int | None
) -> tuple[TranscribedUtterance, ...]:
    """Return the first `limit` utterances (None: all) of each of `speakers` (empty: of all).

    Raises TranscriptError for a speaker who is not in the corpus.
    """
    known = {utterance.speaker for utterance in utterances}
    if missing := sorted(speakers - known):
        raise TranscriptError(f"no speaker {', '.join(missing)}; known: {', '.join(sorted(known))}")
    chosen, counts = [], dict.fromkeys(known, 0)
    for utterance in utterances:
        if speakers and utterance.speaker not in speakers:
            continue
        counts[utterance.speaker] += 1
        if limit is None or counts[utterance.speaker] <= limit:
            chosen.append(utterance)
    return tuple(chosen)


#: Name of the file in a corpus's folder, and of its first column.
SPEAKERS_FILE = "speakers.csv"
_SPEAKER = "speaker"


def read_speakers(path: Path) -> dict[str, tuple[str, ...]]:
    """Read a CSV table of speakers; return the groups of each speaker, by name.

    Groups are the values of the other columns: `0006,child,f` under `speaker,group,gender` is in
    "child", "f" and "child f". Raises TranscriptError for a file without a column `speaker`, and
    for a speaker who is listed twice.
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
            raise TranscriptError(f"{path}, line {number}: speaker {name!r} is empty or twice")
        speakers[name] = _groups({k: v for k, v in row.items() if k and k != _SPEAKER})
    return speakers


def _groups(columns: Mapping[str, str | None]) -> tuple[str, ...]:
    """Return the values of a row, and all of them joined; empty values are left out."""
    values = [value.strip() for value in columns.values() if value and value.strip()]
    return (*values, " ".join(values)) if len(values) > 1 else tuple(values)
