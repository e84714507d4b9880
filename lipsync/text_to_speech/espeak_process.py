"""espeak-ng in a process of its own: a text that crashes its C library costs that text only.

espeak-ng 1.51 ends with a segmentation fault at some rare characters (docs/speech.md). In the
process that moves the mouth that would be the end of the face.
"""

import threading
from dataclasses import asdict
from functools import cache
from typing import Final

import numpy as np

from lipsync.text_to_speech.espeak_library import (
    PhonemeMark,
    Synthesis,
    WordMark,
    load_library,
)
from lipsync.text_to_speech.synthesis import Voice
from lipsync.text_to_speech.voice_process import Request, VoiceProcess, serve

_FULL_SCALE: Final = 32768.0


class EspeakProcess:
    """A child process with espeak-ng, started again when it ended; `espeak` returns the only one.

    Raises SynthesisError where espeak-ng is not installed.
    """

    def __init__(self) -> None:
        self._process = VoiceProcess(
            __name__,
            "espeak-ng crashes or hangs at this text; leave out its unusual characters",
        )
        self._languages = tuple(self._process.request({"languages": True})[0]["languages"])

    @property
    def pid(self) -> int | None:
        """The id of the child process that was started last; None before the first start."""
        return self._process.pid

    def languages(self) -> tuple[str, ...]:
        """Return the tags of all languages of espeak-ng, in alphabetical order."""
        return self._languages

    def synthesize(self, text: str, voice: Voice) -> Synthesis:
        """Return sound and marks of a text without control characters.

        voice: its `language` is one of `languages()`. Raises SynthesisError, also for a text at
        which espeak-ng crashes or hangs.
        """
        answer, sound = self._process.request({"text": text, "voice": asdict(voice)})
        samples = np.frombuffer(sound, np.int16).astype(np.float32) / np.float32(_FULL_SCALE)
        marks = tuple(
            PhonemeMark(**each) if "ipa" in each else WordMark(**each) for each in answer["marks"]
        )
        return Synthesis(samples, answer["sample_rate_hz"], marks)

    def close(self) -> None:
        """Kill the child process; the next text starts it again."""
        self._process.close()


_starting: Final = threading.Lock()


def espeak() -> EspeakProcess:
    """Return the one `EspeakProcess` of the calling process, created at the first call."""
    with _starting:
        return _single_process()


@cache
def _single_process() -> EspeakProcess:
    return EspeakProcess()


def _languages_or_speech(request: Request) -> tuple[dict[str, object], bytes]:
    """Return the answer to a request for the languages or for speech, and the speech's bytes.

    Raises SynthesisError if there is no library or it fails.
    """
    library = _library()
    if "languages" in request:
        return {"languages": library.languages()}, b""
    spoken = library.synthesize(request["text"], Voice(**request["voice"]))
    sound = np.round(spoken.samples * _FULL_SCALE).astype(np.int16).tobytes()
    marks = [asdict(mark) for mark in spoken.marks]
    return {"sample_rate_hz": spoken.sample_rate_hz, "marks": marks}, sound


_library = cache(load_library)


if __name__ == "__main__":
    serve(_languages_or_speech)
