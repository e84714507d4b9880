"""festival speaks English with diphone voices, and tells where each of its segments ends.

The command runs a Scheme program: the text becomes an utterance, of which wave and segments are
saved. For training and scoring only: it takes half a second to start.
"""

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import soundfile

from lipsync.text_to_speech.flite import segments
from lipsync.text_to_speech.spoken_text import (
    DEFAULT_VOICE,
    SpokenText,
    SynthesisError,
    UnspeakableTextError,
    Voice,
)
from lipsync.text_to_speech.timed_phones import phoneme_events
from lipsync.text_to_speech.written_text import checked_text

_LANGUAGE = "en-us"
_TIMEOUT_S = 60.0
_DIPHONES = "_diphone"


class Festival:
    """The `Synthesizer` festival. Raises SynthesisError where it is not installed."""

    longest_text = 2000

    def __init__(self) -> None:
        found = shutil.which("festival")
        if found is None:
            raise SynthesisError(
                "festival is not installed: `apt install festival festvox-kdlpc16k`"
            )
        self._command = found
        self._voices: tuple[str, ...] | None = None

    def languages(self) -> tuple[str, ...]:
        """American English alone."""
        return (_LANGUAGE,)

    def voices(self) -> tuple[str, ...]:
        """The diphone voices that are installed, as `kal` and `ked`."""
        if self._voices is None:
            listed = self._run("(print (voice.list))").strip("() \n").split()
            diphone = (voice for voice in listed if voice.endswith(_DIPHONES))
            self._voices = tuple(sorted(voice.removesuffix(_DIPHONES) for voice in diphone))
        return self._voices

    def speak(self, text: str, voice: Voice = DEFAULT_VOICE) -> SpokenText:
        """See `Synthesizer`; a process of its own for each text. No times of words."""
        written = checked_text(text, self.longest_text)
        if voice.name not in self.voices():
            raise SynthesisError(
                f"festival has no voice {voice.name!r}; it has: {', '.join(self.voices())} "
                "(`apt install festvox-kdlpc16k` brings ked)"
            )
        quoted = written.replace("\\", " ").replace('"', " ")
        stretch = DEFAULT_VOICE.rate_wpm / voice.rate_wpm
        with tempfile.TemporaryDirectory(prefix="lipservo-festival-") as folder:
            sound, ends = Path(folder) / "sound.wav", Path(folder) / "segments"
            self._run(
                f"(voice_{voice.name}{_DIPHONES})"
                f"(Parameter.set 'Duration_Stretch {stretch:.4f})"
                f'(set! spoken (SynthText "{quoted}"))'
                f'(utt.save.wave spoken "{sound}")'
                f'(utt.save.segs spoken "{ends}")'
            )
            try:
                samples, sample_rate_hz = soundfile.read(sound, dtype="float32")
                printed = ends.read_text("utf-8")
            except (soundfile.LibsndfileError, OSError, RuntimeError):
                raise UnspeakableTextError(
                    f"festival said nothing of {written[:40]!r}; write English words"
                ) from None
        timed = segments(_as_flite_prints(printed), len(samples) / sample_rate_hz)
        return SpokenText(np.clip(samples, -1.0, 1.0), sample_rate_hz, phoneme_events(timed), ())

    def _run(self, program: str) -> str:
        try:
            done = subprocess.run(
                [self._command, "--pipe"],
                input=program.encode(),
                capture_output=True,
                env={**os.environ, "LC_ALL": "C"},
                timeout=_TIMEOUT_S,
                check=False,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise SynthesisError(f"festival failed: {error}"[:200]) from None
        return done.stdout.decode("utf-8", "replace")


def _as_flite_prints(segment_file: str) -> str:
    """`0.2200 100 pau`, a line a segment after one with #, as `pau:0.2200 ...`."""
    lines = segment_file.partition("#")[2].split("\n")
    fields = [line.split() for line in lines if line.strip()]
    return " ".join(f"{name}:{end}" for end, _, name in fields)
