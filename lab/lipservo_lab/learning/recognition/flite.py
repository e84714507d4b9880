"""The synthesiser flite: English, small; the times of its stops include their closures already.

The command `flite -psdur` prints each segment with the time of its end, in seconds.
"""

import os
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
import soundfile

from lipsync.phonemes import PHONEMES, SILENCE
from lipsync.text_to_speech.synthesis import (
    DEFAULT_VOICE,
    SynthesisError,
    SynthesizedSpeech,
    TimedPhones,
    UnspeakableTextError,
    Voice,
    checked_text,
    phoneme_events,
)

#: flite's segments that are not phonemes of ours by the same name: reduced vowels, flaps, pauses.
_PHONE_OF: Mapping[str, str] = MappingProxyType(
    {"ax": "AH", "axr": "ER", "ix": "IH", "ux": "UW", "dx": "D", "el": "L", "em": "M", "en": "N"}
    | {"nx": "N", "hv": "HH", "pau": SILENCE, "ssil": SILENCE, "h#": SILENCE, "brth": SILENCE}
)
_BEST_VOICE = "slt"
#: A voice that can only speak the time of day.
_TALKING_CLOCK = "awb_time"
_LANGUAGE = "en-us"
_RATES_WPM = range(80, 401)
#: A text of `longest_text` takes about two seconds; longer than this, and flite hangs.
_TIMEOUT_S = 60.0


class Flite:
    """The speech `Synthesizer` flite. Raises SynthesisError where it is not installed.

    It gives no times of words, and has one pitch for each voice.
    """

    longest_text = 5000

    def __init__(self) -> None:
        found = shutil.which("flite")
        if found is None:
            raise SynthesisError("flite is not installed: `apt install flite`")
        self._command = found

    def languages(self) -> tuple[str, ...]:
        """Return the languages that flite speaks: American English alone."""
        return (_LANGUAGE,)

    def voices(self) -> tuple[str, ...]:
        """Return the voices that `flite -lv` lists but the talking clock, in alphabetical order."""
        names = self._run("-lv").partition(":")[2].split()
        return tuple(sorted(set(names) - {_TALKING_CLOCK}))

    def speak(self, text: str, voice: Voice = DEFAULT_VOICE) -> SynthesizedSpeech:
        """Return a text's speech with phoneme times, by a run of flite. Raises SynthesisError."""
        written = checked_text(text, self.longest_text)
        self._check_voice(voice)
        name = voice.name or _BEST_VOICE
        stretch = DEFAULT_VOICE.rate_wpm / voice.rate_wpm
        with tempfile.TemporaryDirectory(prefix="lipservo-flite-") as folder:
            sound = Path(folder) / "sound.wav"
            printed = self._run(
                *("-voice", name, "--setf", f"duration_stretch={stretch:.4f}"),
                *("-psdur", "-o", os.fspath(sound), "-t", written),
            )
            try:
                samples, sample_rate_hz = soundfile.read(sound, dtype="float32")
            except (soundfile.LibsndfileError, RuntimeError) as error:
                raise SynthesisError(f"flite wrote no sound; try another voice ({error})") from None
        timed = segments(printed, len(samples) / sample_rate_hz)
        if all(each.phones == (SILENCE,) for each in timed):
            raise UnspeakableTextError(
                f"{written[:40]!r} holds nothing that flite can speak; write English words"
            )
        events = phoneme_events(timed)
        return SynthesizedSpeech(np.clip(samples, -1.0, 1.0), sample_rate_hz, events, ())

    def _check_voice(self, voice: Voice) -> None:
        """Raise SynthesisError if flite has no such voice, language, rate or pitch."""
        if voice.language != _LANGUAGE:
            raise SynthesisError(f"flite speaks {_LANGUAGE!r} alone, not {voice.language!r}")
        known = self.voices()
        if voice.name and voice.name not in known:
            raise SynthesisError(f"flite has no voice {voice.name!r}; it has: {', '.join(known)}")
        if voice.rate_wpm not in _RATES_WPM:
            raise SynthesisError(f"rate {voice.rate_wpm} is not within 80 to 400 words a minute")
        if voice.pitch != DEFAULT_VOICE.pitch:
            raise SynthesisError("flite has one pitch for each voice; choose another voice")

    def _run(self, *arguments: str) -> str:
        """Run flite and return what it prints.

        Raises SynthesisError where flite fails or takes longer than `_TIMEOUT_S`.
        """
        try:
            finished = subprocess.run(
                [self._command, *arguments],
                capture_output=True,
                stdin=subprocess.DEVNULL,
                timeout=_TIMEOUT_S,
                check=False,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise SynthesisError(f"flite failed: {error}"[:200]) from None
        if finished.returncode != 0:
            raise SynthesisError(f"flite failed with status {finished.returncode}")
        return finished.stdout.decode("utf-8", "replace")


def segments(printed: str, duration_s: float) -> list[TimedPhones]:
    """Return the phones in flite's output `printed`, `pau:0.193 p:0.271 ...`, until `duration_s`.

    Each item is a segment and its end in s. The end of the last pause is up to 0.12 s off, so
    silence is added or cut to reach `duration_s`. Raises SynthesisError for other output.
    """
    phones: list[TimedPhones] = []
    start_s = 0.0
    for item in printed.split():
        segment, _, end = item.rpartition(":")
        phone = _PHONE_OF.get(segment, segment.upper())
        try:
            end_s = min(float(end), duration_s)
        except ValueError:
            phone = ""
        if phone not in PHONEMES:
            raise SynthesisError(f"flite printed {item[:40]!r}, which is no segment and its end")
        if end_s > start_s:
            phones.append(TimedPhones((phone,), start_s, end_s))
            start_s = end_s
    if duration_s > start_s:
        phones.append(TimedPhones((SILENCE,), start_s, duration_s))
    return phones
