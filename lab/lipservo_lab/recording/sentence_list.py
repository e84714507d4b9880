"""The sentences that a person reads, and which of them a folder already has recordings of."""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from lipsync.errors import UserError
from lipsync.recognition.alignment import words_of

#: Longer sentences are not spoken in one breath; and a take's sound is kept in memory.
LONGEST_WORDS = 40
#: Files of a take; the text is written last, so that it shows that the others are complete.
ENDINGS = (".mkv", ".wav", ".txt")


class SentenceError(UserError):
    """A list of sentences, or a folder of recordings, that cannot be used; one line."""


@dataclass(frozen=True, slots=True)
class Sentence:
    """A sentence to read.

    name: of its files.
    """

    name: str
    text: str


def shipped_sentences() -> tuple[Sentence, ...]:
    """Return sixty sentences with every phoneme of English and most successions of two."""
    text = (files("lipservo.config") / "sentences.txt").read_text(encoding="utf-8")
    return _sentences(text, "sentences.txt")


def read_sentences(path: Path) -> tuple[Sentence, ...]:
    """Read sentences, one a line; skip empty lines and those with #. Raises SentenceError.

    Sentences are named s001, s002 and so on, in their order.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise SentenceError(f"{path}: cannot be read as text (UTF-8): {error}") from error
    return _sentences(text, str(path))


def recorded_names(folder: Path, sentences: Sequence[Sentence]) -> set[str]:
    """Return the names of sentences whose recordings in the folder are complete.

    Raises SentenceError if a file of that name is of another sentence.
    """
    names = set()
    for sentence in sentences:
        paths = [folder / f"{sentence.name}{ending}" for ending in ENDINGS]
        if not all(path.is_file() for path in paths):
            continue
        sentence_text = paths[-1].read_text(encoding="utf-8", errors="replace").strip()
        if sentence_text != sentence.text:
            raise SentenceError(
                f"{paths[-1]}: holds another sentence than this list ({sentence_text[:40]!r}); "
                "record another list into another folder"
            )
        names.add(sentence.name)
    return names


def _sentences(text: str, where: str) -> tuple[Sentence, ...]:
    """Return the sentences of a text, one a line, named s001, s002, ...; skip lines with `#`.

    where: file name for error messages. Raises SentenceError: no words, too many, no sentence.
    """
    found: list[Sentence] = []
    for number, line in enumerate(text.splitlines(), start=1):
        sentence_text = " ".join(line.split())
        if not sentence_text or sentence_text.startswith("#"):
            continue
        words = words_of(sentence_text)
        if not words:
            raise SentenceError(f"{where}, line {number}: holds no words")
        if len(words) > LONGEST_WORDS:
            raise SentenceError(
                f"{where}, line {number}: {len(words)} words; {LONGEST_WORDS} at most, so that it "
                "can be read in one go"
            )
        found.append(Sentence(f"s{len(found) + 1:03}", sentence_text))
    if not found:
        raise SentenceError(f"{where}: holds no sentence; write one a line")
    return tuple(found)
