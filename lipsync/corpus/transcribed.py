"""Corpora of speech with transcripts and no motion: a folder laid out like LibriSpeech's.

`transcripts.txt` holds one utterance a line, its name first: SPEAKER-CHAPTER-NUMBER WORDS...;
the sound is `audio/NAME` with any ending that libsndfile reads.
"""

from dataclasses import dataclass
from pathlib import Path

from lipsync.errors import UserError


class TranscriptError(UserError):
    """A folder cannot be used as a corpus; the message is one line: what, where, what to do."""


@dataclass(frozen=True, slots=True)
class TranscribedUtterance:
    """One recording and what is said in it. speaker: the name up to the first hyphen."""

    name: str
    speaker: str
    text: str
    sound: Path


def read_transcribed(folder: Path) -> tuple[TranscribedUtterance, ...]:
    """Every utterance of the corpus in the order of its transcripts.

    Raises TranscriptError for a folder without transcripts, a line without words, a name that is
    there twice, and an utterance without a sound file.
    """
    path = folder / "transcripts.txt"
    if not path.is_file():
        raise TranscriptError(f"{path}: no such file; give a folder laid out like LibriSpeech")
    sounds = {sound.stem: sound for sound in sorted((folder / "audio").glob("*"))}
    utterances: dict[str, TranscribedUtterance] = {}
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        name, _, text = line.strip().partition(" ")
        if not name:
            continue
        if not text.strip():
            raise TranscriptError(f"{path}, line {number}: {name!r} has no words")
        if name in utterances:
            raise TranscriptError(f"{path}, line {number}: {name!r} is there twice")
        if name not in sounds:
            raise TranscriptError(f"{path}, line {number}: no sound audio/{name}.*")
        speaker = name.split("-")[0]
        utterances[name] = TranscribedUtterance(name, speaker, text.strip(), sounds[name])
    if not utterances:
        raise TranscriptError(f"{path}: holds no utterance")
    return tuple(utterances.values())


def of_speakers(
    utterances: tuple[TranscribedUtterance, ...], speakers: frozenset[str], limit: int | None
) -> tuple[TranscribedUtterance, ...]:
    """The first `limit` utterances (None: all) of each of the speakers (empty: of all).

    Raises TranscriptError for a speaker who is not there.
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
