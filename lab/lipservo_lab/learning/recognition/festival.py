"""The synthesiser festival: English by diphone voices, with the time of each phone's end.

The command runs a Scheme program: the text becomes an utterance, of which wave and segments are
saved. A run takes half a second to start, so festival serves training and scoring only. Each voice
also sings (festival's singing mode): each word begins a note further up or down a scale, and its
syllables go on from there.
"""

import os
import re
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import soundfile

from lipservo_lab.learning.recognition.flite import segments
from lipsync.text_to_speech.synthesis import (
    DEFAULT_VOICE,
    SynthesisError,
    SynthesizedSpeech,
    UnspeakableTextError,
    Voice,
    checked_text,
    phoneme_events,
)

_LANGUAGE = "en-us"
_TIMEOUT_S = 60.0
_DIPHONES = "_diphone"
_SUNG = "-sung"
#: C3 to A3 and back, Hz; durations of syllables in turn at the default rate, s.
_NOTES_HZ = (131, 147, 165, 175, 196, 220, 196, 175, 165, 147)
_NOTES_S = (0.4, 0.3, 0.3, 0.6, 0.4, 0.8)
#: No word has more syllables; further notes of a word are not sung.
_MOST_SYLLABLES = 8


class Festival:
    """The `Synthesizer` festival. Raises SynthesisError where it is not installed."""

    longest_text = 2000

    def __init__(self) -> None:
        """Find the command. Raises SynthesisError if festival is not installed."""
        found = shutil.which("festival")
        if found is None:
            raise SynthesisError(
                "festival is not installed: `apt install festival festvox-kdlpc16k`"
            )
        self._command = found
        self._voices: tuple[str, ...] | None = None

    def languages(self) -> tuple[str, ...]:
        """Return the languages that festival speaks here: American English alone."""
        return (_LANGUAGE,)

    def voices(self) -> tuple[str, ...]:
        """Return the installed diphone voices, such as `kal` and `ked`, and each as `ked-sung`."""
        if self._voices is None:
            names = self._run("(print (voice.list))").strip("() \n").split()
            diphone = (voice for voice in names if voice.endswith(_DIPHONES))
            spoken = sorted(voice.removesuffix(_DIPHONES) for voice in diphone)
            self._voices = tuple(name + suffix for suffix in ("", _SUNG) for name in spoken)
        return self._voices

    def speak(self, text: str, voice: Voice = DEFAULT_VOICE) -> SynthesizedSpeech:
        """Return a text's speech with phoneme times, by a run of festival; without times of words.

        Raises SynthesisError for a voice that is missing or if festival fails, and
        UnspeakableTextError for a text without a word that it can speak.
        """
        written = checked_text(text, self.longest_text)
        if voice.name not in self.voices():
            raise SynthesisError(
                f"festival has no voice {voice.name!r}; it has: {', '.join(self.voices())} "
                "(`apt install festvox-kdlpc16k` brings ked)"
            )
        stretch = DEFAULT_VOICE.rate_wpm / voice.rate_wpm
        voice_call = f"(voice_{voice.name.removesuffix(_SUNG)}{_DIPHONES})"
        with tempfile.TemporaryDirectory(prefix="lipservo-festival-") as folder:
            sound, ends = Path(folder) / "sound.wav", Path(folder) / "segments"
            if voice.name.endswith(_SUNG):
                song = Path(folder) / "song.xml"
                song.write_text(_singing_xml(written, stretch), "utf-8")
                speak_call = f"(require 'singing-mode)(tts_file \"{song}\" 'singing)"
            else:
                quoted = written.replace("\\", " ").replace('"', " ")
                duration = f"(Parameter.set 'Duration_Stretch {stretch:.4f})"
                speak_call = f'{duration}(save (SynthText "{quoted}"))'
            self._run(
                f'(define (save utt) (utt.save.wave utt "{sound}")'
                f'(utt.save.segs utt "{ends}") utt)'
                f"(set! tts_hooks (list utt.synth save)){voice_call}{speak_call}"
            )
            try:
                samples, sample_rate_hz = soundfile.read(sound, dtype="float32")
                segment_lines = ends.read_text("utf-8")
            except (soundfile.LibsndfileError, OSError, RuntimeError):
                raise UnspeakableTextError(
                    f"festival said nothing of {written[:40]!r}; write English words"
                ) from None
        timed = segments(_as_flite_prints(segment_lines), len(samples) / sample_rate_hz)
        return SynthesizedSpeech(
            np.clip(samples, -1.0, 1.0), sample_rate_hz, phoneme_events(timed), ()
        )

    def _run(self, program: str) -> str:
        """Run a Scheme program in festival and return what it prints, whatever its exit status.

        Raises SynthesisError where festival cannot be run or takes longer than `_TIMEOUT_S`.
        """
        try:
            finished = subprocess.run(
                [self._command, "--pipe"],
                input=program.encode(),
                capture_output=True,
                env={**os.environ, "LC_ALL": "C"},
                timeout=_TIMEOUT_S,
                check=False,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise SynthesisError(f"festival failed: {error}"[:200]) from None
        return finished.stdout.decode("utf-8", "replace")


def _singing_xml(text: str, stretch: float) -> str:
    """Return a text as XML for festival's singing mode, with eight notes for each word.

    stretch: factor on the durations of notes.
    """
    words = []
    # A full stop would begin another song.
    for number, word in enumerate(re.findall(r"\w[\w']*", text)):
        notes = range(number, number + _MOST_SYLLABLES)
        pitches = ",".join(str(_NOTES_HZ[note % len(_NOTES_HZ)]) for note in notes)
        lengths = ",".join(f"{stretch * _NOTES_S[note % len(_NOTES_S)]:.3f}" for note in notes)
        words.append(
            f'<PITCH FREQ="{pitches}"><DURATION SECONDS="{lengths}">{word}</DURATION></PITCH>\n'
        )
    return (
        '<?xml version="1.0"?>\n'
        '<!DOCTYPE SINGING PUBLIC "-//SINGING//DTD SINGING mark up//EN" "Singing.v0_1.dtd" []>\n'
        f'<SINGING BPM="60">\n{"".join(words)}</SINGING>\n'
    )


def _as_flite_prints(segment_file: str) -> str:
    """Return the segments of a festival file in flite's form, `pau:0.2200 ...`.

    After a line with # the file has a line for each segment, `0.2200 100 pau`: its end in s, a
    colour, its name.
    """
    lines = segment_file.partition("#")[2].split("\n")
    fields = [line.split() for line in lines if line.strip()]
    return " ".join(f"{name}:{end}" for end, _, name in fields)
