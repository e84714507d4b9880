"""How well the recogniser recognises languages: espeak-ng speaks them, the times are its own."""

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from types import MappingProxyType

import yaml

from lipservo_lab.corpus.alignment_cache import align_corpus
from lipservo_lab.corpus.transcribed import read_transcribed
from lipservo_lab.evaluation.recognition.benchmark import measure
from lipservo_lab.evaluation.recognition.recognition_scores import Score
from lipservo_lab.learning.recognition.synthetic_corpus import SyntheticVoice, write_voice
from lipsync.errors import UserError
from lipsync.phonemes import LiveRecognizer

#: espeak-ng's name, where it is another: its `zh` reads characters, and lacks most of them.
VOICE_OF = MappingProxyType({"zh": "cmn-latn-pinyin"})
#: Seed of the rate and pitch that are drawn for each sentence.
_SEED = 0


class LanguageError(UserError):
    """A language of which no sentences are kept; the message is one line."""


@cache
def language_sentences() -> Mapping[str, tuple[str, ...]]:
    """Return the sentences of each language, by its tag, such as "de"."""
    text = (
        files("lipservo_lab.bench.hearing").joinpath("language_sentences.yaml").read_text("utf-8")
    )
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


def language_scores(
    languages: Sequence[str],
    make_recognizer: Callable[[], LiveRecognizer],
    folder: Path,
    progress: Callable[[], None] = lambda: None,
) -> dict[str, Score]:
    """Return the recogniser's score on all sentences of each language, spoken by espeak-ng.

    folder: where the sounds are kept; progress: called after each sentence. Raises SynthesisError
    where espeak-ng is not installed.
    """
    scores = {}
    for tag in languages:
        voice = SyntheticVoice("espeak", VOICE_OF.get(tag, tag))
        sentences = language_sentences()[tag]
        utterances = read_transcribed(
            write_voice(voice, sentences, folder, seed=_SEED, progress=progress)
        )
        # The voice's own times: nothing is aligned here.
        labelled = align_corpus(utterances, None, n_processes=1)
        scores[tag] = measure(utterances, labelled, make_recognizer).score
    return scores
