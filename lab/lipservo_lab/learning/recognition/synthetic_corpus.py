"""Synthetic voices as corpora: texts spoken, with the phone times that the voice itself tells.

A folder laid out like grid_s1 a voice, called as the voice: `audio/NAME.flac`,
`labels/NAME.TextGrid`. Whatever reads a corpus takes the tier `phones` for the reference, so that
nothing here depends on forced alignment.

festival speaks English with diphone voices, and tells where each of its segments ends.

The command runs a Scheme program: the text becomes an utterance, of which wave and segments are
saved. For training and scoring only: it takes half a second to start.
"""

import os
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import soundfile

from lipsync.errors import UserError
from lipsync.output_file import written_whole
from lipsync.text_to_speech.espeak import Espeak
from lipsync.text_to_speech.flite import Flite, segments
from lipsync.text_to_speech.synthesis import (
    DEFAULT_VOICE,
    SynthesisError,
    SynthesizedSpeech,
    Synthesizer,
    UnspeakableTextError,
    Voice,
    checked_text,
    phoneme_events,
)
from lipsync.textgrid import write_tiers

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

    def speak(self, text: str, voice: Voice = DEFAULT_VOICE) -> SynthesizedSpeech:
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
        return SynthesizedSpeech(
            np.clip(samples, -1.0, 1.0), sample_rate_hz, phoneme_events(timed), ()
        )

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


_SYNTHESIZERS: Mapping[str, Callable[[], Synthesizer]] = MappingProxyType(
    {"espeak": Espeak, "flite": Flite, "festival": Festival}
)
#: Words a minute, and for espeak-ng the pitch, of voices that train.
_RATES_WPM, _PITCHES = (125, 230), (15, 85)


class SyntheticVoiceError(UserError):
    """A voice that is not there; the message is one line."""


@dataclass(frozen=True, slots=True)
class SyntheticVoice:
    """One voice of a synthesiser, written SYNTHESISER:VOICE; espeak-ng's voices are languages."""

    synthesizer: str
    voice: str

    @property
    def folder_name(self) -> str:
        """What its corpus, and so its speaker, is called."""
        return f"{self.synthesizer}-{self.voice}"

    def at(self, rate_wpm: int, pitch: int) -> Voice:
        """The voice as the synthesiser wants it; only espeak-ng has a choice of pitch."""
        if self.synthesizer == "espeak":
            return Voice(self.voice, "", rate_wpm, pitch)
        return replace(Voice(name=self.voice), rate_wpm=rate_wpm)


def read_voices(listed: str) -> tuple[SyntheticVoice, ...]:
    """`espeak:en-us,flite:awb,festival:ked`. Raises SyntheticVoiceError for another form."""
    voices = []
    for each in listed.split(","):
        synthesizer, _, voice = each.strip().partition(":")
        if synthesizer not in _SYNTHESIZERS or not voice:
            raise SyntheticVoiceError(
                f"{each.strip()!r} is no SYNTHESISER:VOICE; synthesisers: "
                f"{', '.join(_SYNTHESIZERS)}; for example flite:awb"
            )
        voices.append(SyntheticVoice(synthesizer, voice))
    return tuple(voices)


def write_voice(
    voice: SyntheticVoice,
    texts: Sequence[str],
    folder: Path,
    *,
    seed: int | None,
    progress: Callable[[], None] = lambda: None,
) -> Path:
    """Speak the texts into a corpus below `folder`; its own folder.

    What is there already stays. seed: of the rate and pitch of each text, None for those that the
    voice was made with. A text that the voice cannot speak is left out. Raises SynthesisError where
    the synthesiser or the voice is not there.
    """
    corpus = folder / voice.folder_name
    for part in ("audio", "labels"):
        (corpus / part).mkdir(parents=True, exist_ok=True)
    synthesizer = _SYNTHESIZERS[voice.synthesizer]()
    for number, text in enumerate(texts):
        name = f"{voice.folder_name}-{number:04d}"
        labels = corpus / "labels" / f"{name}.TextGrid"
        if not labels.exists():
            rate_wpm, pitch = 175, 50
            if seed is not None:
                rng = np.random.default_rng([seed, number])
                rate_wpm, pitch = int(rng.integers(*_RATES_WPM)), int(rng.integers(*_PITCHES))
            _speak(synthesizer, voice.at(rate_wpm, pitch), text, corpus, name)
        progress()
    return corpus


def _speak(synthesizer: Synthesizer, voice: Voice, text: str, corpus: Path, name: str) -> None:
    try:
        spoken = synthesizer.speak(text.lower(), voice)
    except UnspeakableTextError:
        return
    with written_whole(corpus / "audio" / f"{name}.flac") as path:
        soundfile.write(path, spoken.samples, spoken.sample_rate_hz, format="FLAC")
    phones = tuple((e.phoneme, e.start_s, e.end_s or e.start_s) for e in spoken.phonemes)
    # One interval for all words: the times of words are needed by nobody here.
    whole = ((text, 0.0, spoken.duration_s),)
    write_tiers(corpus / "labels" / f"{name}.TextGrid", {"words": whole, "phones": phones})
