"""What is read: known words of held-out sentences, and sets of words that a model never saw."""

import json
from pathlib import Path

from lipservo_lab.corpus.utterance import Corpus, CorpusError
from lipservo_lab.evaluation.motion.splits import Part, words_part

KNOWN = "known"


def reading_parts(folder: Path, corpus: Corpus) -> list[Part]:
    """`known`, the sentences of `random_test`, and `new_a`, `new_b`, ...: the sets of new words.

    corpus: labelled. Raises CorpusError for a missing or damaged splits.json, one whose
    `random_test` holds none or all of the sentences, and a set that leaves none to train on.
    """
    path = folder / "splits.json"
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        random_test = frozenset(map(str, content["random_test"]))
        word_sets = {str(k): frozenset(map(str, v)) for k, v in content["new_words"].items()}
    except FileNotFoundError:
        raise CorpusError(
            f"{path}: no such file; it says which sentences and words are held out "
            "(--words names words instead)"
        ) from None
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise CorpusError(f"{path}: not a usable list of splits ({error})") from error
    names = frozenset(u.name for u in corpus.utterances)
    parts = [Part(KNOWN, names - random_test, names & random_test, None)]
    if not parts[0].test:
        raise CorpusError(f"{path}: its random_test names no labelled sentence of the folder")
    parts += [words_part(f"new_{key.lower()}", corpus, each) for key, each in word_sets.items()]
    for part in parts:
        if not part.train:
            raise CorpusError(f"{path}: split {part.split} leaves no sentence to train on")
    return parts
