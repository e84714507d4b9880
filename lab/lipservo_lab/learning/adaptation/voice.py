"""Minutes of one voice with its text, read and checked before the network adapts to that voice.

A forced aligner lays any text over any sound for which it finds a way, so every alignment is scored
(`goodness_of_pronunciation`), labels of the user too. Sentences that were not spoken so are
left out; where they are many, the folder is refused.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from lipservo.terminal.output import Advance
from lipservo_lab.corpus.alignment_cache import (
    LABELLED,
    AlignedUtterance,
    align_corpus,
)
from lipservo_lab.corpus.transcribed import TranscribedUtterance
from lipservo_lab.counted_progress import counting
from lipservo_lab.learning.recognition.augmentation import LabelledSamples
from lipservo_lab.learning.recognition.training_data import read_labelled
from lipsync.arrays import Array32
from lipsync.audio.file import read_speech
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.errors import UserError
from lipsync.recognition.alignment import LEAST_SCORE, goodness_of_pronunciation
from lipsync.textgrid import LabelError

#: Less of a voice is hardly learned from, and leaves too little to grade it on.
LEAST_S = 120.0
#: What is kept for grading: every fifth text, and at least so much.
_HELD_OUT_STEP, LEAST_HELD_OUT_S = 5, 20.0
#: Left out at most: of true texts of 64 native sentences none is, of 60 learners' seven, of others'
#: texts on native sentences all (docs/recognition.md, Does the text match the sound).
MOST_LEFT_OUT = 0.34


class VoiceError(UserError):
    """A folder is no voice to learn; the message is one line: what, where, what to do."""


@dataclass(frozen=True, slots=True)
class Sentence:
    """One recording with the phoneme of every 10 ms.

    duration_s: of the recording as it was, without the silence that `speech` has at its end.
    is_reference: whether its labels are good enough to grade recognition on; those of an alignment
    that only succeeded with wider beams are not.
    """

    name: str
    text: str
    speech: LabelledSamples
    duration_s: float
    is_reference: bool


@dataclass(frozen=True, slots=True)
class Voice:
    """Sentences that the network adapts to, sentences to grade it on, and those left out.

    left_out: the reason by the sentence's name.
    """

    learned: tuple[Sentence, ...]
    held_out: tuple[Sentence, ...]
    left_out: Mapping[str, str]

    @property
    def learned_s(self) -> float:
        """Seconds of the sentences that the network adapts to."""
        return sum(sentence.duration_s for sentence in self.learned)

    @property
    def held_out_s(self) -> float:
        """Seconds of the sentences to grade on."""
        return sum(sentence.duration_s for sentence in self.held_out)


def only_speaker(
    utterances: tuple[TranscribedUtterance, ...], speaker: str | None
) -> tuple[TranscribedUtterance, ...]:
    """Return the utterances of one speaker.

    speaker: None where the corpus has only one. Raises VoiceError for a speaker that the corpus
    does not have, and for None where it has several.
    """
    names = sorted({utterance.speaker for utterance in utterances})
    if speaker is None and len(names) > 1:
        raise VoiceError(f"{len(names)} speakers; choose one with --speaker: {', '.join(names)}")
    chosen = tuple(utterance for utterance in utterances if speaker in (None, utterance.speaker))
    if not chosen:
        raise VoiceError(f"no speaker {speaker}; known: {', '.join(names)}")
    return chosen


def read_voice(
    utterances: tuple[TranscribedUtterance, ...],
    advance: Advance = lambda _what, _done, _all: None,
    n_processes: int = 1,
) -> Voice:
    """Read, align and split the utterances of one speaker.

    advance: called with "aligning", utterances done and all utterances. Raises SoundError for a
    file that is no sound, LabelError for labels that cannot be used, and VoiceError for less than
    two minutes, for texts that are not what is spoken, and for too few different texts.
    """
    samples_of = {each.name: read_speech(each.sound) for each in utterances}
    check_length(sum(len(samples) for samples in samples_of.values()) / SAMPLE_RATE_HZ)
    count = counting(advance, "aligning", len(utterances))
    aligned = align_corpus(utterances, None, n_processes=n_processes, progress=count)
    _refuse_bad_labels(utterances, aligned)
    left_out = {
        name: reason
        for name, each in aligned.items()
        if (reason := why_left_out(each, samples_of[name]))
    }
    _refuse_other_texts(len(utterances), left_out)
    sentences = [
        Sentence(
            each.name,
            each.text,
            read_labelled(each, aligned[each.name]),
            len(samples_of[each.name]) / SAMPLE_RATE_HZ,
            aligned[each.name].beams in ("default", LABELLED),
        )
        for each in utterances
        if each.name not in left_out
    ]
    learned, held_out = split_sentences(sentences)
    return Voice(learned, held_out, left_out)


def check_length(duration_s: float) -> None:
    """Raise VoiceError for less than two minutes of speech."""
    if duration_s < LEAST_S:
        raise VoiceError(
            f"needs at least {LEAST_S / 60:.0f} minutes of speech, has {duration_s:.0f} s; "
            "record more sentences"
        )


def why_left_out(aligned: AlignedUtterance, samples: Array32) -> str:
    """Return why an utterance is not learned from, in one line; "" if it is learned from.

    An utterance is left out if it could not be aligned, or if its text scores too low.

    Parameters
    ----------
    aligned : AlignedUtterance
        Its alignment.
    samples : Array32
        (n,) at 16 kHz.

    Returns
    -------
    str
        The aligner's error, or the score of the text below `LEAST_SCORE`; "" if neither.
    """
    if aligned.error:
        return aligned.error
    score = aligned.score
    if score is None:
        score = goodness_of_pronunciation(samples, aligned.events())
    return "" if score >= LEAST_SCORE else f"not what is said: its text scores {score:.2f}"


def split_sentences(
    sentences: Sequence[Sentence],
) -> tuple[tuple[Sentence, ...], tuple[Sentence, ...]]:
    """Split sentences into those to adapt to and those to grade on; no text is in both.

    Every fifth text is held out, and more texts if these last less than 20 s together. Held out are
    only sentences with `is_reference`; others of the same text are in neither part. Raises
    VoiceError if all texts last less than 20 s, or if less is left to adapt to than is held out.
    """
    texts = list(dict.fromkeys(_text_key(each.text) for each in sentences if each.is_reference))
    # Texts 5, 10 and so on first; the others follow in case these last less than 20 s.
    by_turn = sorted(range(len(texts)), key=lambda number: (number + 1) % _HELD_OUT_STEP)
    held_texts: set[str] = set()
    held_s = 0.0
    n_usual = len(texts) // _HELD_OUT_STEP
    for number, index in enumerate(by_turn):
        if number >= n_usual and held_s >= LEAST_HELD_OUT_S:
            break
        held_texts.add(texts[index])
        held_s += sum(
            each.duration_s
            for each in sentences
            if each.is_reference and _text_key(each.text) == texts[index]
        )
    held_out = tuple(s for s in sentences if _text_key(s.text) in held_texts and s.is_reference)
    learned = tuple(s for s in sentences if _text_key(s.text) not in held_texts)
    if held_s < LEAST_HELD_OUT_S or sum(s.duration_s for s in learned) < held_s:
        raise VoiceError(
            f"only {len(texts)} different texts can be used, too few to grade on others than are "
            "learned; give at least 20 different sentences, each in a file of its own"
        )
    return learned, held_out


def _text_key(text: str) -> str:
    """Return a key that is equal for texts which differ in case and spaces alone."""
    return " ".join(text.lower().split())


def _refuse_bad_labels(
    utterances: Sequence[TranscribedUtterance], aligned: Mapping[str, AlignedUtterance]
) -> None:
    """Raise LabelError for the first utterance whose own label file cannot be used.

    A person has written these labels and can correct them, so the utterance is not left out
    silently.
    """
    for utterance in utterances:
        if utterance.labels is not None and aligned[utterance.name].error:
            raise LabelError(aligned[utterance.name].error)


def _refuse_other_texts(n_all: int, left_out: Mapping[str, str]) -> None:
    """Raise VoiceError if more than a share of `MOST_LEFT_OUT` of all sentences was left out.

    left_out: reason by sentence.
    """
    if len(left_out) > MOST_LEFT_OUT * n_all:
        name, reason = next(iter(left_out.items()))
        raise VoiceError(
            f"the text is not what is said in {len(left_out)} of {n_all} sounds "
            f"({name}: {reason}); check that each text belongs to its sound and that "
            "somebody speaks there"
        )
