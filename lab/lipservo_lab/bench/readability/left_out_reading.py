"""Reading of words that the model has not learned: the ten folds of words, and one row of them all.

Readers learn every word from recorded faces; what they read is the motion of a model that has not
learned the word.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from typing import Final, cast

import numpy as np

from lipservo_lab.bench.left_out_words import chosen_places, word_folds
from lipservo_lab.bench.motion_figures import Row
from lipservo_lab.corpus.utterance import Corpus
from lipservo_lab.evaluation.motion.motion_scores import Part
from lipservo_lab.evaluation.readability.reading_scores import percentiles
from lipsync.arrays import Array

#: What the row of all folds is called.
LEFT_OUT: Final = "left_out"
_SAME = ("face", "phonemes", "strategy", "lookahead_ms", "reader")
_MEANS = ("score", "samples", "gain", "gap_r")


def left_out_parts(corpus: Corpus, limit: int) -> list[Part]:
    """Return the folds of `word_folds`, tested on at most `limit` sentences of each word.

    Raises CorpusError.
    """
    return [
        replace(part, test=frozenset(name for name, _ in chosen_places(corpus, part, limit)))
        for part in word_folds(corpus)
    ]


def pooled(rows: Sequence[Row]) -> list[Row]:
    """Pool the rows of all folds: return one row for each motion and reader, as `_mean`."""
    rows_of_reader: dict[tuple[object, ...], list[Row]] = defaultdict(list)
    for row in rows:
        rows_of_reader[tuple(row[name] for name in _SAME)].append(row)
    return [_mean(fold_rows) for fold_rows in rows_of_reader.values()]


def _mean(rows: Sequence[Row]) -> Row:
    """Return one row for the rows of all folds: means weighted by each fold's number of words.

    Shares of words are joined, sentences added; all else is the first row's.
    """
    shares = [cast(dict[str, float], row["shares"]) for row in rows]
    # Samples in which a word was not drawn are missing.
    samples = [cast(Array, row["samples"]) for row in rows]
    n_samples = min(map(len, samples))
    values_of = {name: [row[name] for row in rows] for name in _MEANS}
    values_of["samples"] = [each[:n_samples] for each in samples]
    n_words = [len(each) for each in shares]
    means = {
        name: None if values[0] is None else np.average(np.array(values), axis=0, weights=n_words)
        for name, values in values_of.items()
    }
    return {
        **rows[0],
        **{name: value if name == "samples" else _plain(value) for name, value in means.items()},
        "split": LEFT_OUT,
        "score_95": list(percentiles(cast(Array, means["samples"]))),
        "shares": {word: share for each in shares for word, share in each.items()},
        "sentences": sum(cast(int, row["sentences"]) for row in rows),
    }


def _plain(value: Array | None) -> float | None:
    return None if value is None else float(value)
