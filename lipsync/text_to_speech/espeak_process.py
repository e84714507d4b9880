"""espeak-ng in a process of its own: a text that crashes its C library costs that text only.

espeak-ng 1.51 ends with a segmentation fault at some rare characters (docs/speech.md). In the
process that moves the mouth that would be the end of the face.

The process answers each line of JSON, a request, with a line of JSON, and samples (int16) after it.
"""

import atexit
import json
import subprocess
import sys
import threading
from collections.abc import Mapping
from dataclasses import asdict
from functools import cache
from typing import IO, Any, Final

import numpy as np

from lipsync.text_to_speech.espeak_library import (
    PhonemeMark,
    Synthesis,
    WordMark,
    load_library,
)
from lipsync.text_to_speech.synthesis import SynthesisError, Voice

#: The longest text, five minutes of speech, takes about two; later there is no answer.
_LONGEST_S: Final = 30.0
_FULL_SCALE: Final = 32768.0


class EspeakProcess:
    """One process of espeak-ng, started again when it was lost; there is one a process (`espeak`).

    Raises SynthesisError where espeak-ng is not installed.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._child = _started()
        self._languages = tuple(self._request({"languages": True})[0]["languages"])

    @property
    def pid(self) -> int:
        """Of the process that speaks just now."""
        return self._child.pid

    def languages(self) -> tuple[str, ...]:
        """The tags of all languages, in alphabetical order."""
        return self._languages

    def synthesize(self, text: str, voice: Voice) -> Synthesis:
        """Speak a text without control characters in a language of `languages()`.

        Raises SynthesisError, also for a text at which espeak-ng crashes or hangs.
        """
        answer, sound = self._request({"text": text, "voice": asdict(voice)})
        samples = np.frombuffer(sound, np.int16).astype(np.float32) / np.float32(_FULL_SCALE)
        marks = tuple(_mark(each) for each in answer["marks"])
        return Synthesis(samples, answer["sample_rate_hz"], marks)

    def close(self) -> None:
        """End the process; a later text starts it again."""
        self._child.kill()
        self._child.communicate()

    def _request(self, request: Mapping[str, object]) -> tuple[dict[str, Any], bytes]:
        with self._lock:
            if self._child.poll() is not None:
                self._child = _started()
            late = threading.Timer(_LONGEST_S, self._child.kill)
            late.start()
            try:
                answer, sound = _exchange(self._child, request)
            except (OSError, ValueError):
                self.close()
                raise SynthesisError(
                    "espeak-ng crashes or hangs at this text; leave out its unusual characters"
                ) from None
            finally:
                late.cancel()
        if "error" in answer:
            raise SynthesisError(answer["error"])
        return answer, sound


_starting: Final = threading.Lock()


def espeak() -> EspeakProcess:
    """The one of this process, started at the first call."""
    with _starting:
        return _started_once()


@cache
def _started_once() -> EspeakProcess:
    process = EspeakProcess()
    atexit.register(process.close)
    return process


def _started() -> "subprocess.Popen[bytes]":
    # A session of its own: Ctrl-C is for the face. It ends with the pipe, whatever ends us.
    return subprocess.Popen(
        [sys.executable, "-m", __name__],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def _exchange(
    child: "subprocess.Popen[bytes]", request: Mapping[str, object]
) -> tuple[dict[str, Any], bytes]:
    """Raises OSError or ValueError when the process ends before its answer does."""
    assert child.stdin is not None
    assert child.stdout is not None
    child.stdin.write(json.dumps(request).encode() + b"\n")
    child.stdin.flush()
    answer: dict[str, Any] = json.loads(child.stdout.readline())
    sound = child.stdout.read(answer["n_bytes"])
    if len(sound) < answer["n_bytes"]:
        raise ValueError("the answer is cut off")
    return answer, sound


def _mark(mark: Mapping[str, Any]) -> PhonemeMark | WordMark:
    return PhonemeMark(**mark) if "ipa" in mark else WordMark(**mark)


def _serve(requests: IO[bytes], answers: IO[bytes]) -> None:
    try:
        library = load_library()
    except SynthesisError as error:
        library, missing = None, str(error)
    for line in requests:
        request, sound = json.loads(line), b""
        try:
            if library is None:
                raise SynthesisError(missing)
            answer: dict[str, object]
            if "languages" in request:
                answer = {"languages": library.languages()}
            else:
                spoken = library.synthesize(request["text"], Voice(**request["voice"]))
                sound = np.round(spoken.samples * _FULL_SCALE).astype(np.int16).tobytes()
                marks = [asdict(mark) for mark in spoken.marks]
                answer = {"sample_rate_hz": spoken.sample_rate_hz, "marks": marks}
        except SynthesisError as error:
            answer = {"error": str(error)}
        answers.write(json.dumps({**answer, "n_bytes": len(sound)}).encode() + b"\n" + sound)
        answers.flush()


if __name__ == "__main__":
    _serve(sys.stdin.buffer, sys.stdout.buffer)
