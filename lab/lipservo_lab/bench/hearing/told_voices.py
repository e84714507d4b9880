"""Voices whose text is known: how well it is followed in their sound, by their own phoneme times.

Nothing but the words is given, without times, before the sound; what the recogniser settles is
compared with the voice's own times. Languages are espeak-ng's own, at a rate and a pitch of its own
for each sentence, and the phonemes given are those that espeak-ng says at the usual rate.
"""

import difflib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from itertools import pairwise
from types import MappingProxyType
from typing import Final

import numpy as np
import soxr
import yaml

from lipservo_lab.corpus.alignment_cache import PHONEME_INDEX
from lipservo_lab.evaluation.recognition.recognition_scores import Score
from lipservo_lab.evaluation.recognition.stream_observers import Labels, UpdateLog
from lipsync.audio_block import BLOCK_S, SAMPLE_RATE_HZ
from lipsync.errors import UserError
from lipsync.phonemes import SILENCE, PhonemeEvent
from lipsync.recognition.network_recognizer import NetworkRecognizer
from lipsync.recognition.streaming import RecognizerStream, blocks_of
from lipsync.spoken_text import PronouncedWord
from lipsync.text_to_speech.pronunciation import pronounced
from lipsync.text_to_speech.synthesis import (
    SynthesisError,
    SynthesizedSpeech,
    UnspeakableTextError,
    Voice,
)
from lipsync.text_to_speech.synthesizers import synthesizer_for

_HOP: Final = round(BLOCK_S * SAMPLE_RATE_HZ)
#: Silence after the sound, until all is settled.
_TAIL_S: Final = 0.5
_CLOSING: Final = ("P", "B", "M")
#: Of the rates and pitches of the languages.
_RATES_WPM, _PITCHES = (140, 210), (20, 80)
#: espeak-ng's name of a language, where it is another: its `zh` reads characters, and lacks most.
_VOICE_OF: Final = MappingProxyType({"zh": "cmn-latn-pinyin"})


class LanguageError(UserError):
    """A language of which no sentences are kept; the message is one line."""


@cache
def language_sentences() -> Mapping[str, tuple[str, ...]]:
    """Return the sentences of each language, by its tag, such as "de"."""
    text = (files("lipservo_lab.bench.hearing") / "language_sentences.yaml").read_text("utf-8")
    return MappingProxyType(
        {tag: tuple(sentences) for tag, sentences in yaml.safe_load(text).items()}
    )


def read_languages(listed: str) -> tuple[str, ...]:
    """Return the language tags of a list with commas between; an empty list means all.

    Raises LanguageError for a language without sentences.
    """
    known = language_sentences()
    chosen = tuple(tag.strip() for tag in listed.split(",") if tag.strip())
    for tag in chosen:
        if tag not in known:
            raise LanguageError(
                f"--languages {tag}: there are no sentences in it; use {', '.join(known)}"
            )
    return chosen or tuple(known)


def sentences_of(tag: str) -> list[tuple[str, Voice]]:
    """Return a language's sentences, and the voice of espeak-ng that says each."""
    sentences = []
    for number, text in enumerate(language_sentences()[tag]):
        rng = np.random.default_rng([0, number])
        rate_wpm, pitch = int(rng.integers(*_RATES_WPM)), int(rng.integers(*_PITCHES))
        sentences.append((text, Voice(_VOICE_OF.get(tag, tag), "", rate_wpm, pitch)))
    return sentences


@dataclass(slots=True)
class Followed:
    """How well the recogniser has found a voice's phones: scores of frames, errors of beginnings.

    errors_ms: of phones that were found: found beginning less the voice's own; closing_errors_ms:
    of P, B and M alone. n_phones: phones spoken, found or not.
    """

    score: Score = field(default_factory=Score)
    errors_ms: list[float] = field(default_factory=list)
    closing_errors_ms: list[float] = field(default_factory=list)
    n_phones: int = 0

    def add(self, found: Sequence[PhonemeEvent], spoken: Sequence[PhonemeEvent]) -> None:
        """Count one sentence: labels of its frames, and beginnings of the phones that match.

        found: recognised; spoken: as the voice reports them.
        """
        n_frames = round((spoken[-1].end_s or 0.0) / BLOCK_S)
        self.score.add(_frame_labels(found, n_frames), _frame_labels(spoken, n_frames))
        ours, theirs = (
            [each for each in events if each.phoneme != SILENCE] for events in (found, spoken)
        )
        self.n_phones += len(theirs)
        matcher = difflib.SequenceMatcher(
            a=[each.phoneme for each in ours],
            b=[each.phoneme for each in theirs],
            autojunk=False,
        )
        for i, j, n in matcher.get_matching_blocks():
            for phone, true_phone in zip(ours[i : i + n], theirs[j : j + n], strict=True):
                error_ms = 1e3 * (phone.start_s - true_phone.start_s)
                self.errors_ms.append(error_ms)
                if true_phone.phoneme in _CLOSING:
                    self.closing_errors_ms.append(error_ms)

    def figures(self) -> dict[str, float]:
        """Return the figures by name.

        `found`: share of phones that were found; `boundary_ms_...`: error of their beginnings.
        """
        sizes_ms, score_figures = np.abs(self.errors_ms or [np.nan]), self.score.figures()
        return {
            **self.score.bilabials.figures("closure"),
            **{name: score_figures[name] for name in ("viseme_all", "viseme_speech", "per")},
            "found": len(self.errors_ms) / max(1, self.n_phones),
            "boundary_ms_p50": float(np.percentile(sizes_ms, 50)),
            "boundary_ms_p90": float(np.percentile(sizes_ms, 90)),
            "closing_onset_ms_p50": float(np.median(np.abs(self.closing_errors_ms or [np.nan]))),
        }


def followed_voice(
    synthesizer: str,
    sentences: Iterable[tuple[str, Voice]],
    make: Callable[[], NetworkRecognizer],
    *,
    tells: bool = True,
    progress: Callable[[], None] = lambda: None,
) -> Followed:
    """Recognise texts spoken by a synthesiser; return how well their phones are found.

    sentences: each text, and the voice that says it. make: makes a recogniser for each text. tells:
    give it the text beforehand; else the sound alone. progress: called before each text. Texts that
    the voice cannot speak are left out. Raises SynthesisError where the voice is missing or reports
    no times; PronunciationError.
    """
    speaker, counted = synthesizer_for(synthesizer), Followed()
    for text, voice in sentences:
        progress()
        try:
            spoken = speaker.speak(text, voice)
        except UnspeakableTextError:
            continue
        if not spoken.phonemes:
            raise SynthesisError(f"{synthesizer} gives no phoneme times; use espeak")
        words = pronounced(text, voice.language) if tells else ()
        counted.add(_recognize_live(make(), spoken, words), spoken.phonemes)
    return counted


def _recognize_live(
    recognizer: NetworkRecognizer, spoken: SynthesizedSpeech, words: Sequence[PronouncedWord]
) -> list[PhonemeEvent]:
    """Return the final phonemes of a sound played live, with its words given beforehand."""
    samples = soxr.resample(spoken.samples, spoken.sample_rate_hz, SAMPLE_RATE_HZ)
    n_tail = round((recognizer.latency_s + _TAIL_S) * SAMPLE_RATE_HZ)
    padded = np.concatenate((samples, np.zeros(n_tail, np.float32))).astype(np.float32)
    recognizer.tell(words)
    log = UpdateLog()
    RecognizerStream(recognizer, (log,)).run(blocks_of(padded[: len(padded) // _HOP * _HOP], _HOP))
    return list(log.timeline.events)


def _frame_labels(events: Sequence[PhonemeEvent], n_frames: int) -> Labels:
    """Return phoneme numbers of frames, (n_frames,); frames without an event are silence."""
    labels = np.full(n_frames, PHONEME_INDEX[SILENCE])
    ends_s = [following.start_s for _, following in pairwise(events)] + [n_frames * BLOCK_S]
    for event, next_s in zip(events, ends_s, strict=True):
        end_s = next_s if event.end_s is None else event.end_s
        labels[round(event.start_s / BLOCK_S) : round(end_s / BLOCK_S)] = PHONEME_INDEX[
            event.phoneme
        ]
    return labels
