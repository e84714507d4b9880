"""Texts as they come: without what no synthesiser may see, and cut into pieces to be spoken."""

import re
import unicodedata
from collections.abc import Iterator

from lipsync.text_to_speech.spoken_text import SynthesisError, UnspeakableTextError

#: Control characters (espeak-ng would obey some), half a surrogate pair, unassigned code points.
_NOT_TEXT = ("Cc", "Cs", "Cn")
#: What ends a sentence, with the brackets and quotation marks that close after it.
_SENTENCE_END = re.compile(r"[.!?…;:。！？।]+[\"'”’»)\]]*(?=\s)|[。！？।]|\n\s*\n")
#: A point after such a word ends no sentence: titles, initials, U.S., z.B.
_ABBREVIATION = re.compile(
    r"(?:^|\s)(?:Mrs?|Ms|Dr|St|Prof|Jr|Sr|vs|(?:[A-Za-z]\.)*[A-Z]|[a-z]\.[a-zA-Z])\.$"
)
_PAUSE = re.compile(r"[,–—、，]\s*")
_SPACE = re.compile(r"\s+")


def readable(text: str) -> str:
    """The text with a space for each character that is none, so that positions stay."""
    return "".join(" " if unicodedata.category(each) in _NOT_TEXT else each for each in text)


def checked_text(text: str, longest: int) -> str:
    """The readable text.

    Raises UnspeakableTextError where it is empty, SynthesisError where it is longer than `longest`.
    """
    if len(text) > longest:
        raise SynthesisError(
            f"a text of {len(text)} characters is too long to be spoken at once; "
            f"at most {longest}, or speak it in pieces"
        )
    written = readable(text)
    if not written.strip():
        raise UnspeakableTextError("the text is empty; write what is to be said")
    return written


def pieces(text: str, longest: int) -> Iterator[str]:
    """The text in sentences, in order; one longer than `longest` is cut at a comma or a space.

    White space alone gives no piece. A word longer than `longest` is cut where it must be.
    """
    start = 0
    while start < len(text):
        end = _piece_end(text, start, longest)
        piece = text[start:end].strip()
        if piece:
            yield piece
        start = end


def _piece_end(text: str, start: int, longest: int) -> int:
    window = text[start : start + longest + 1]
    for match in _SENTENCE_END.finditer(window):
        if not _ABBREVIATION.search(window[: match.end()]):
            return start + match.end()
    if len(window) <= longest:
        return len(text)
    for separator in (_PAUSE, _SPACE):
        ends = [match.end() for match in separator.finditer(window[:longest])]
        if ends:
            return start + ends[-1]
    return start + longest
