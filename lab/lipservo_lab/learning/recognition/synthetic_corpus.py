"""Synthetic voices as corpora: spoken texts, with the phone times that the synthesiser reports.

Each voice gets a folder of its name, laid out like grid_s1: `audio/NAME.flac`,
`labels/NAME.TextGrid`. Readers of a corpus use the tier `phones` as the reference, so that nothing
here depends on forced alignment.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import soundfile

from lipsync.errors import UserError
from lipsync.output_file import written_whole
from lipsync.plugins import SYNTHESIZERS
from lipsync.text_to_speech.synthesis import (
    SynthesisError,
    Synthesizer,
    UnspeakableTextError,
    Voice,
)
from lipsync.text_to_speech.synthesizers import synthesizer_for
from lipsync.textgrid import write_tiers

#: Ranges for voices that train: words a minute, and for espeak-ng the pitch.
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
        """The name of the voice's corpus, and so of its speaker."""
        return f"{self.synthesizer}-{self.voice}"

    def at(self, rate_wpm: int, pitch: int) -> Voice:
        """Return the voice for the synthesiser, at a rate; the pitch only counts for espeak-ng."""
        if self.synthesizer == "espeak":
            return Voice(self.voice, "", rate_wpm, pitch)
        return replace(Voice(name=self.voice), rate_wpm=rate_wpm)


def read_voices(listed: str) -> tuple[SyntheticVoice, ...]:
    """Return the voices in a list such as `espeak:en-us,flite:awb,festival:ked`.

    Raises SyntheticVoiceError for another form or an unknown synthesiser.
    """
    voices = []
    for item in listed.split(","):
        synthesizer, _, voice = item.strip().partition(":")
        if synthesizer not in SYNTHESIZERS.names() or not voice:
            raise SyntheticVoiceError(
                f"{item.strip()!r} is no SYNTHESISER:VOICE; synthesisers: "
                f"{', '.join(SYNTHESIZERS.names())}; for example flite:awb"
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
    """Write a corpus of spoken texts into a folder below `folder`; return the corpus's folder.

    Texts that have labels there already are skipped. seed: draws rate and pitch of each text; None:
    175 words a minute and pitch 50. progress: called after each text. Texts that the voice cannot
    speak are left out. Raises SynthesisError for a synthesiser or voice that is missing or reports
    no times of phonemes.
    """
    corpus = folder / voice.folder_name
    for part in ("audio", "labels"):
        (corpus / part).mkdir(parents=True, exist_ok=True)
    synthesizer = synthesizer_for(voice.synthesizer)
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
    """Write a text's sound and labels into a corpus; write nothing if the voice cannot speak it.

    Raises SynthesisError for a voice that reports no times of phonemes.
    """
    try:
        speech = synthesizer.speak(text.lower(), voice)
    except UnspeakableTextError:
        return
    if not speech.phonemes:
        raise SynthesisError(f"{corpus.name}: the voice gives no phoneme times to learn from")
    with written_whole(corpus / "audio" / f"{name}.flac") as path:
        soundfile.write(path, speech.samples, speech.sample_rate_hz, format="FLAC")
    phones = tuple((e.phoneme, e.start_s, e.end_s or e.start_s) for e in speech.phonemes)
    # One interval for all words: the times of words are needed by nobody here.
    one_interval = ((text, 0.0, speech.duration_s),)
    write_tiers(corpus / "labels" / f"{name}.TextGrid", {"words": one_interval, "phones": phones})
