"""Known phonemes from a file, whoever wrote it: the format is told by what is in it."""

import json
from os import PathLike
from pathlib import Path

from lipsync.errors import UserError
from lipsync.phoneme_files.formats import (
    PlacedRow,
    aligned_phonemes,
    azure_phonemes,
    head_tts_phonemes,
    is_aligned,
    is_azure,
    is_head_tts,
    is_phone_tiers,
    is_polly,
    polly_phonemes,
    tier_phonemes,
)
from lipsync.phonemes import PhonemeEvent
from lipsync.recognition.scripted import read_phonemes
from lipsync.textgrid import LabelError, is_textgrid

#: An hour of phonemes in JSON is about 4 MB.
_LARGEST_BYTES = 64 * 2**20
_KNOWN = (
    "known are: TextGrid, Polly speech marks, Azure viseme events, HeadTTS, "
    "rows of phoneme with start and end, and phones as `lipservo lines align -o` writes them"
)
#: Where a document may hold its rows.
_ROWS = ("phonemes", "alignments", "visemes", "events", "tokens")


def read_known_phonemes(path: str | PathLike[str]) -> tuple[PhonemeEvent, ...]:
    """The phonemes of a file in one of the formats of docs/speech.md.

    In order, from 0 on, without gaps (silence between) and each with its end. Raises LabelError,
    in one line: which file, where in it, what is allowed.
    """
    path = Path(path)
    try:
        if path.stat().st_size > _LARGEST_BYTES:
            raise LabelError(f"{path}: larger than 64 MiB; give the phonemes of one recording")
        content = path.read_bytes()
    except OSError as error:
        raise LabelError(f"{path}: cannot be read ({error.strerror}); give a file") from None
    if is_textgrid(content[:200]):
        return read_phonemes(path)
    return phonemes_in(content, str(path))


def phonemes_in(content: bytes, name: str) -> tuple[PhonemeEvent, ...]:
    """The same from the content of a file of JSON; `name` is told in errors."""
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise LabelError(f"{name}: neither a TextGrid nor text in UTF-8; {_KNOWN}") from None
    document, rows = _parsed(text, name)
    if is_head_tts(document):
        return head_tts_phonemes(document, name)
    if is_phone_tiers(document):
        return tier_phonemes(document, name)
    if is_polly(rows):
        return polly_phonemes(rows, name)
    if is_azure(rows):
        return azure_phonemes(rows, name)
    if is_aligned(rows):
        return aligned_phonemes(rows, document, name)
    raise LabelError(f"{name}: JSON of an unknown kind; {_KNOWN}")


def _parsed(text: str, name: str) -> tuple[dict[str, object], list[PlacedRow]]:
    """The document, {} where it is a list or lines, and the objects in it with their places."""
    try:
        document = _json(text)
    except _NotJsonError:
        return {}, _lines(text, name)
    if isinstance(document, dict):
        inner = document.get("data")
        if isinstance(inner, dict):
            document = inner
        for key in _ROWS:
            rows = document.get(key)
            if isinstance(rows, list) and rows and all(isinstance(row, dict) for row in rows):
                return document, [(f"{key}[{index}]", row) for index, row in enumerate(rows)]
        return document, [("line 1", document)]
    if isinstance(document, list) and all(isinstance(row, dict) for row in document):
        return {}, [(f"[{index}]", row) for index, row in enumerate(document)]
    raise LabelError(f"{name}: JSON of an unknown kind; {_KNOWN}")


def _lines(text: str, name: str) -> list[PlacedRow]:
    rows: list[PlacedRow] = []
    for number, line in enumerate(text.split("\n"), start=1):
        if not line.strip():
            continue
        try:
            row = _json(line)
        except _NotJsonError:
            row = None
        if not isinstance(row, dict):
            raise LabelError(f"{name}: line {number}: no JSON object; {_KNOWN}")
        rows.append((f"line {number}", row))
    if not rows:
        raise LabelError(f"{name}: empty; {_KNOWN}")
    return rows


class _NotJsonError(UserError):
    pass


def _json(text: str) -> object:
    try:
        return json.loads(text)
    # Numbers of thousands of digits are a ValueError, brackets in thousands a RecursionError.
    except (ValueError, RecursionError):
        raise _NotJsonError from None
