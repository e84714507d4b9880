"""gruut in a process of its own, at low priority, so that its loading, seconds, delays no tick.

A text arrives while a face speaks. In the process that moves the mouth, loading gruut would hold
the interpreter, and its 43 MB would stay.
"""

import os
from functools import cache
from typing import Final

from lipsync.text_to_speech.synthesis import SynthesisError
from lipsync.text_to_speech.voice_process import Request, VoiceProcess, serve

_LOWER_PRIORITY: Final = 10


def written_out(text: str, language: str) -> list[tuple[str, list[str]]]:
    """Return the words of a text as spoken, each with its IPA phonemes.

    Numbers and abbreviations are written out. language: a tag of gruut, such as `en-us`. Raises
    SynthesisError for a text that gruut cannot read.
    """
    answer, _ = _process().request({"text": text, "language": language})
    return [(word, ipa) for word, ipa in answer["words"]]


@cache
def _process() -> VoiceProcess:
    return VoiceProcess(__name__, "this text cannot be read; leave out its unusual characters")


def _read_out(request: Request) -> tuple[dict[str, object], bytes]:
    """Return the spoken words of a request's text, each with its IPA phonemes, and no bytes.

    Runs in the child process. Raises SynthesisError for a text that gruut cannot read.
    """
    from gruut import sentences

    try:
        words = [
            (word.text, list(word.phonemes or ()))
            for sentence in sentences(request["text"], lang=request["language"])
            for word in sentence
            if word.is_spoken
        ]
    except Exception as error:  # a library's own
        raise SynthesisError(f"gruut cannot read this text: {error!r:.200}") from None
    return {"words": words}, b""


if __name__ == "__main__":
    os.nice(_LOWER_PRIORITY)
    serve(_read_out)
