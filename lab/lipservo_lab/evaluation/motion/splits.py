"""Which sentences train and which are scored."""

import json
from dataclasses import dataclass
from pathlib import Path

from lipservo_lab.corpus.utterance import Corpus, CorpusError


@dataclass(frozen=True, slots=True)
class Part:
    """One training and what is scored with it.

    split: the figure it belongs to; words: the words whose frames alone count, None for all.
    """

    split: str
    train: frozenset[str]
    test: frozenset[str]
    words: frozenset[str] | None


def read_parts(folder: Path, corpus: Corpus) -> list[Part]:
    """The splits of a corpus folder's `splits.json`: five folds of `random`, and the new words.

    Raises CorpusError for a missing or damaged file, and one that names none of the sentences.
    """
    path = folder / "splits.json"
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        folds = [frozenset(map(str, fold)) for fold in content["folds"]]
        new_words = {str(k): frozenset(map(str, v)) for k, v in content["new_words"].items()}
    except FileNotFoundError:
        raise CorpusError(
            f"{path}: no such file; without --model the folder's splits.json says what to hold out"
        ) from None
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise CorpusError(f"{path}: not a usable list of splits ({error})") from error
    names = frozenset(u.name for u in corpus.utterances)
    parts = [Part("random", names - fold, names & fold, None) for fold in folds if names & fold]
    if not parts:
        raise CorpusError(f"{path}: none of its folds names a labelled sentence of the folder")
    parts += [words_part(name, corpus, words) for name, words in new_words.items()]
    for part in parts:
        if not part.train:
            raise CorpusError(f"{path}: split {part.split} leaves no sentence to train on")
    return parts


def words_part(split: str, corpus: Corpus, words: frozenset[str]) -> Part:
    """Trained without every sentence that holds any of the words, scored on those words alone."""
    said = {u.name: {w.text for w in u.words} for u in corpus.utterances}
    test = frozenset(name for name, texts in said.items() if texts & words)
    missing = sorted(words - set().union(*said.values()))
    if missing:
        raise CorpusError(f"{corpus.name}: no sentence holds {', '.join(map(repr, missing))}")
    return Part(split, frozenset(said) - test, test, words)
