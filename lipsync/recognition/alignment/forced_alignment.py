"""Forced alignment: when each phone of a known text is spoken. Offline, by pocketsphinx.

Two passes over the sound: the first finds the words and their pronunciations, the second the
phones. All published figures are against alignments at pocketsphinx's own beams. Where these lose
the way in the second pass, tight ones often do not (design measurement: 4 failures of 40
utterances against 0); such an alignment says so, its accuracy was never compared.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from lipsync.errors import UserError
from lipsync.extras import check_extra
from lipsync.phonemes import SILENCE, VISEME_OF, PhonemeEvent
from lipsync.recognition.alignment.pronunciation import pronounce

if TYPE_CHECKING:
    from pocketsphinx import Decoder

FRAMES_PER_S = 100
Beams = Literal["default", "tight"]
#: In the order in which they are tried; pocketsphinx's own first.
_BEAMS: Mapping[Beams, Mapping[str, float]] = {
    "default": {},
    "tight": {"beam": 1e-20, "pbeam": 1e-20, "wbeam": 1e-10},
}
_WORD = re.compile(r"[^\W_]+(?:'[^\W_]+)*'?")


class AlignmentError(UserError):
    """Sound and text do not go together; the message is one line."""


@dataclass(frozen=True, slots=True)
class Alignment:
    """Phones and words of an utterance, without gaps between the phones.

    words: (word, start_s, end_s), silence left out. guessed: words the dictionary does not hold.
    """

    phones: tuple[PhonemeEvent, ...]
    words: tuple[tuple[str, float, float], ...]
    beams: Beams
    guessed: tuple[str, ...] = ()


def align(
    samples: NDArray[np.float32],
    text: str,
    pronouncer: Callable[[str], tuple[str, ...]] = pronounce,
) -> Alignment:
    """Align samples (n,) at 16 kHz in [-1, 1] with the words of `text`.

    Raises PronunciationError for a word without a pronunciation, AlignmentError for a text without
    words and for sound that the text does not fit, MissingExtraError without the extra `align`.
    """
    words = words_of(text)
    if not words:
        raise AlignmentError("the text holds no words; give what is said in the sound")
    check_aligner()
    from pocketsphinx import Decoder

    pcm = np.rint(np.clip(samples, -1.0, 1.0) * np.float32(32767)).astype(np.int16).tobytes()
    reason = ""
    for beams, options in _BEAMS.items():
        # One that has heard another utterance aligns every third one differently (measured over
        # LibriSpeech), and one that failed does not recover; loading is a sixth of an alignment.
        decoder = Decoder(lm=None, cmn="batch", loglevel="FATAL", **options)
        guessed = _teach(decoder, words, pronouncer)
        try:
            return _alignment(_segments(decoder, pcm, words), beams, guessed)
        except RuntimeError as error:
            reason = str(error)
    raise AlignmentError(f"the text does not fit the sound ({reason}); check both")


def check_aligner() -> None:
    """Raises MissingExtraError where `align` could not work; before a corpus is begun, too."""
    check_extra("pocketsphinx", "finding when each phone of a text is spoken")


def words_of(text: str) -> list[str]:
    """The words of a text in lower case, without punctuation."""
    return _WORD.findall(text.lower().replace("\N{RIGHT SINGLE QUOTATION MARK}", "'"))


def _teach(
    decoder: "Decoder", words: list[str], pronouncer: Callable[[str], tuple[str, ...]]
) -> tuple[str, ...]:
    """Make sure that the decoder knows all words; returns those that had to be guessed."""
    missing = tuple(word for word in dict.fromkeys(words) if decoder.lookup_word(word) is None)
    for word in missing:
        decoder.add_word(word, " ".join(pronouncer(word)), False)
    return missing


def _segments(
    decoder: "Decoder", pcm: bytes, words: list[str]
) -> list[tuple[str, list[tuple[str, int, int]]]]:
    """(word, its phones as (name, first frame, n frames)) in order."""
    decoder.set_align_text(" ".join(words))
    _process(decoder, pcm)
    # Only now: asked after the second pass, pocketsphinx 5.1.1 crashes.
    if decoder.hyp() is None:
        raise RuntimeError("no path through the words")
    decoder.set_alignment()
    _process(decoder, pcm)
    alignment = decoder.get_alignment()
    if alignment is None:
        raise RuntimeError("no alignment of the phones")
    return [(w.name, [(p.name, p.start, p.duration) for p in w]) for w in alignment.words()]


def _process(decoder: "Decoder", pcm: bytes) -> None:
    decoder.start_utt()
    decoder.process_raw(pcm, no_search=False, full_utt=True)
    decoder.end_utt()


def _alignment(
    segments: list[tuple[str, list[tuple[str, int, int]]]],
    beams: Beams,
    guessed: tuple[str, ...],
) -> Alignment:
    phones: list[PhonemeEvent] = []
    words: list[tuple[str, float, float]] = []
    for word, parts in segments:
        for name, start, n_frames in parts:
            phoneme = name if name in VISEME_OF else SILENCE
            start_s, end_s = start / FRAMES_PER_S, (start + n_frames) / FRAMES_PER_S
            if phones and phoneme == SILENCE == phones[-1].phoneme:
                phones[-1] = PhonemeEvent(SILENCE, phones[-1].start_s, end_s)
            elif n_frames > 0:
                phones.append(PhonemeEvent(phoneme, start_s, end_s))
        if not word.startswith(("<", "[", "+")) and parts:
            start, (_, last, n_last) = parts[0][1], parts[-1]
            name = re.sub(r"\(\d+\)$", "", word)
            words.append((name, start / FRAMES_PER_S, (last + n_last) / FRAMES_PER_S))
    return Alignment(tuple(phones), tuple(words), beams, guessed)
