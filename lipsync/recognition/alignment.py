"""When each phone of a known text is spoken, by forced alignment; and whether it was spoken at all.

Offline, by pocketsphinx. Two passes over the sound: the first finds the words and their
pronunciations, the second the phones. All published figures are against alignments at
pocketsphinx's own beams. Where these lose the way in the second pass, tight ones often do not
(design measurement: 4 failures of 40 utterances against 0); `Alignment.beams` is "tight"
then; the accuracy of such alignments was never compared.

Words that its dictionary lacks are pronounced by gruut's lexicon, else its model, in IPA;
docs/decisions/labels-and-text.md says why.

Forced alignment lays any text over any sound as long as it finds a path. The score is the mean
over frames of log p(aligned phone) - log p(likeliest phone), the "goodness of pronunciation" of
Witt and Young (Speech Communication 30, 2000) with the posteriors of a network: 0 where every
phone aligned is the likeliest, lower the less they agree. docs/recognition.md says how the limits
`LEAST_SCORE` and `DOUBTFUL_SCORE` were found, and how often they err.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from lipsync.errors import UserError, check_extra
from lipsync.phonemes import SILENCE, VISEME_OF, PhonemeEvent
from lipsync.recognition.batch import recording_posteriors
from lipsync.recognition.features import FRAMES_PER_S, HOP
from lipsync.recognition.network import NetworkWeights, load_shipped_weights
from lipsync.text_to_speech.pronunciation import pronounce

if TYPE_CHECKING:
    from pocketsphinx import Decoder

Beams = Literal["default", "tight"]
#: In the order in which they are tried; pocketsphinx's own first.
_BEAMS: Mapping[Beams, Mapping[str, float]] = {
    "default": {},
    "tight": {"beam": 1e-20, "pbeam": 1e-20, "wbeam": 1e-10},
}
_WORD = re.compile(r"[^\W_]+(?:'[^\W_]+)*'?")


class AlignmentError(UserError):
    """Error for sound and text that do not fit each other; the message is one line."""


@dataclass(frozen=True, slots=True)
class Alignment:
    """Phones and words of an utterance with their times, without gaps between the phones.

    words: (word, start_s, end_s), silence left out. beams: the search beams of pocketsphinx that
    found the alignment. guessed: words that pocketsphinx's dictionary lacks.
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
    """Return when each word and each phone of a text is spoken in a sound.

    Parameters
    ----------
    samples : NDArray[np.float32]
        (n,) at 16 kHz in [-1, 1].
    text : str
        English.
    pronouncer : Callable[[str], tuple[str, ...]]
        Returns the phones of a word that pocketsphinx's dictionary lacks.

    Returns
    -------
    Alignment
        Phones and words with times in s, and how they were found.

    Raises
    ------
    PronunciationError
        A word has no pronunciation.
    AlignmentError
        The text has no words, or does not fit the sound.
    MissingExtraError
        The extra `align` is not installed.
    """
    words = words_of(text)
    if not words:
        raise AlignmentError("the text has no words; give the words of the sound")
    check_aligner()
    from pocketsphinx import Decoder

    pcm = np.rint(np.clip(samples, -1.0, 1.0) * np.float32(32767)).astype(np.int16).tobytes()
    reason = ""
    for beams, options in _BEAMS.items():
        # A decoder that was used before aligns every third utterance differently (measured over
        # LibriSpeech), and one that failed does not recover; loading is a sixth of an alignment.
        decoder = Decoder(lm=None, cmn="batch", loglevel="FATAL", **options)
        guessed = _add_missing_words(decoder, words, pronouncer)
        try:
            return _to_alignment(_align_words(decoder, pcm, words), beams, guessed)
        except RuntimeError as error:
            reason = str(error)
    raise AlignmentError(f"the text does not fit the sound ({reason}); check both")


def check_aligner() -> None:
    """Raise MissingExtraError if pocketsphinx, which `align` needs, is not installed."""
    check_extra("pocketsphinx", "finding when each phone of a text is spoken")


def words_of(text: str) -> list[str]:
    """Return the words of a text in lower case, without punctuation."""
    return _WORD.findall(text.lower().replace("\N{RIGHT SINGLE QUOTATION MARK}", "'"))


def _add_missing_words(
    decoder: "Decoder", words: list[str], pronouncer: Callable[[str], tuple[str, ...]]
) -> tuple[str, ...]:
    """Add the words that the decoder's dictionary lacks; return these words.

    pronouncer: returns the phones of such a word.
    """
    missing = tuple(word for word in dict.fromkeys(words) if decoder.lookup_word(word) is None)
    for word in missing:
        decoder.add_word(word, " ".join(pronouncer(word)), False)
    return missing


def _align_words(
    decoder: "Decoder", pcm: bytes, words: list[str]
) -> list[tuple[str, list[tuple[str, int, int]]]]:
    """Align words with int16 sound at 16 kHz, in two passes of the decoder.

    Return (word, [(phone, first frame, n frames), ...]) in order, silences included, frames of
    10 ms. Raises RuntimeError if pocketsphinx finds no alignment.
    """
    decoder.set_align_text(" ".join(words))
    _run_decoder(decoder, pcm)
    # Only now: asked after the second pass, pocketsphinx 5.1.1 crashes.
    if decoder.hyp() is None:
        raise RuntimeError("no way through the words fits the sound")
    decoder.set_alignment()
    _run_decoder(decoder, pcm)
    alignment = decoder.get_alignment()
    if alignment is None:
        raise RuntimeError("the phones do not fit the sound")
    return [(w.name, [(p.name, p.start, p.duration) for p in w]) for w in alignment.words()]


def _run_decoder(decoder: "Decoder", pcm: bytes) -> None:
    """Let the decoder search all of an utterance, int16 samples at 16 kHz."""
    decoder.start_utt()
    decoder.process_raw(pcm, no_search=False, full_utt=True)
    decoder.end_utt()


def _to_alignment(
    segments: list[tuple[str, list[tuple[str, int, int]]]],
    beams: Beams,
    guessed: tuple[str, ...],
) -> Alignment:
    """Return pocketsphinx's segments, in frames of 10 ms, as an alignment in seconds.

    Fillers such as `<sil>` and `[NOISE]` become silence and are left out of the words; successive
    silences are joined.
    """
    phones: list[PhonemeEvent] = []
    words: list[tuple[str, float, float]] = []
    for word, word_phones in segments:
        for name, start, n_frames in word_phones:
            phoneme = name if name in VISEME_OF else SILENCE
            start_s, end_s = start / FRAMES_PER_S, (start + n_frames) / FRAMES_PER_S
            if phones and phoneme == SILENCE == phones[-1].phoneme:
                phones[-1] = PhonemeEvent(SILENCE, phones[-1].start_s, end_s)
            elif n_frames > 0:
                phones.append(PhonemeEvent(phoneme, start_s, end_s))
        if not word.startswith(("<", "[", "+")) and word_phones:
            start, (_, last, n_last) = word_phones[0][1], word_phones[-1]
            name = re.sub(r"\(\d+\)$", "", word)
            words.append((name, start / FRAMES_PER_S, (last + n_last) / FRAMES_PER_S))
    return Alignment(tuple(phones), tuple(words), beams, guessed)


#: A text that scores less was not said.
LEAST_SCORE = -3.0
#: One that scores less was probably not said as it stands: words are missing, or too many.
DOUBTFUL_SCORE = -1.3
#: Nineteen in twenty true texts of native speakers, in words for people.
USUAL_SCORES = "-0.2 to -0.7"
#: A phone that is out of the question counts as this probability: one frame decides nothing.
_SMALLEST = 1e-6


def goodness_of_pronunciation(
    samples: NDArray[np.float32],
    phones: tuple[PhonemeEvent, ...],
    weights: NetworkWeights | None = None,
) -> float:
    """Return the mean over frames of log p(aligned phone) - log p(likeliest phone), 0 or less.

    It is low where the text is not spoken (Witt and Young, Speech Communication 30, 2000). Counted
    are frames in which the alignment or the network has a phone other than silence. Raises
    WeightsError if the shipped weights are damaged.

    Parameters
    ----------
    samples : NDArray[np.float32]
        (n,) at 16 kHz.
    phones : tuple[PhonemeEvent, ...]
        The aligned phones, all with ends.
    weights : NetworkWeights | None
        Of the network that scores; None: the shipped ones.

    Returns
    -------
    float
        The mean in natural logarithms; 0 where no frame counts.
    """
    weights = weights or _shipped()
    posteriors = _late_posteriors(weights, samples)
    index_of = {phoneme: number for number, phoneme in enumerate(weights.phonemes)}
    aligned = np.full(len(posteriors), index_of[SILENCE])
    for event in phones:
        end_s = event.start_s if event.end_s is None else event.end_s
        first, end = round(event.start_s * FRAMES_PER_S), round(end_s * FRAMES_PER_S)
        aligned[first:end] = index_of[event.phoneme]
    logs = np.log(np.maximum(posteriors, np.float32(_SMALLEST)))
    log_ratio = logs[np.arange(len(logs)), aligned] - logs.max(axis=1)
    is_heard = logs.argmax(axis=1) != index_of[SILENCE]
    counts = is_heard | (aligned != index_of[SILENCE])
    return float(log_ratio[counts].mean()) if counts.any() else 0.0


def _late_posteriors(weights: NetworkWeights, samples: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the posteriors (n_frames, n_phonemes) of the head that waits longest.

    Row k is of the 10 ms frame that begins at k * 10 ms, without the head's delay.
    """
    n_frames, delay = max(1, -(-len(samples) // HOP)), weights.delays[-1]
    return recording_posteriors(weights, samples, n_frames + delay)[delay:, -1]


@cache
def _shipped() -> NetworkWeights:
    return load_shipped_weights()
