"""Which raters of a study count, and their answers as arrays of ratings, pairs and words read.

The rules for leaving raters out are fixed before anyone has answered; none depends on what a rater
thinks of our method. Only `inverted` uses opinions: a rater whose ratings fall where those of all
others together rise.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from scipy.stats import pearsonr

from lipservo_lab.study.answers import Answers, RaterRecord
from lipservo_lab.study.sheets import FIRST, Clip, Key, Study
from lipsync.arrays import Array, Indices

Reason = Literal["left", "unfinished", "checks", "alike", "hasty", "inverted"]
#: Text of each reason in the report.
REASONS: Final[Mapping[Reason, str]] = {
    "left": "took their answers back",
    "unfinished": "did less than half",
    "checks": "got half of the checks wrong, or more",
    "alike": "gave nine of ten ratings the same point",
    "hasty": "answered one of ten clips, or more, before it could have ended",
    "inverted": "rates against all others together (r < 0, p < .01): read the scale backwards",
}
_LEAST_DONE = _WRONG_CHECKS = 0.5
_ALIKE, _HASTY = 0.9, 0.1
_NAMES = ("zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")
_DIGITS: Final = {str(n): name for n, name in enumerate(_NAMES)}
#: With fewer answers no share is tested.
_FEWEST = 8
_INVERTED_P = 0.01


@dataclass(frozen=True, slots=True)
class Tables:
    """Answers as arrays, one row each, of indices into `raters`, `sentences` and `methods`.

    ratings: rater, sentence, method; points: of each rating. pairs: rater, sentence, the chosen
    method, the other one. readings: rater, sentence, method; words: for each reading the words read
    correctly, the words of the sentence, and the words that would be correct by chance: the mean
    over all other sentences that are read, compared with the same answer.
    """

    methods: tuple[str, ...]
    raters: tuple[str, ...]
    sentences: tuple[str, ...]
    ratings: Indices
    points: Array
    pairs: Indices
    readings: Indices
    words: Array


@dataclass(frozen=True, slots=True)
class Counted:
    """The answers that are reported.

    tables: of the raters who count. all_tables: of all raters but those who left or did not finish,
    so that the report shows what difference the rules make. left_out: reason by rater.
    """

    tables: Tables
    all_tables: Tables
    left_out: Mapping[str, Reason]
    n_raters: int


def counted(study: Study, key: Key, answers: Answers) -> Counted:
    """Decide for every rater whether to count them, and collect the answers as tables."""
    left_out = {
        name: reason
        for name, rater in answers.raters.items()
        if (reason := _carelessness(study, rater)) is not None
    }
    careful = {name: r for name, r in answers.raters.items() if name not in left_out}
    for name in _inverted(tables_of(study, key, careful)):
        left_out[name] = "inverted"
    kept = {name: r for name, r in careful.items() if name not in left_out}
    finished = {
        name: r
        for name, r in answers.raters.items()
        if left_out.get(name) not in ("left", "unfinished")
    }
    return Counted(
        tables_of(study, key, kept), tables_of(study, key, finished), left_out, len(answers.raters)
    )


def _carelessness(study: Study, rater: RaterRecord) -> Reason | None:
    """Return the first reason not to count a rater, by that rater alone; None: there is none."""
    items = study.sheets[rater.sheet]
    if rater.has_left:
        return "left"
    if len(rater.answers) < _LEAST_DONE * len(items):
        return "unfinished"
    points: list[int] = []
    is_in_time: list[bool] = []
    checks: list[bool] = []
    for number, record in rater.answers.items():
        item = items[number]
        if item.kind == "check":
            checks.append(record["answer"] == item.expected)
        if item.kind == "rating":
            points.append(record["answer"])
        if item.clips:
            shown_s = sum(study.duration_s[clip] for clip in item.clips)
            is_in_time.append(float(record["seconds"]) >= shown_s)
    if checks and checks.count(False) >= _WRONG_CHECKS * len(checks) and checks.count(False) > 1:
        return "checks"
    if len(points) >= _FEWEST and max(map(points.count, points)) >= _ALIKE * len(points):
        return "alike"
    if len(is_in_time) >= _FEWEST and is_in_time.count(False) >= _HASTY * len(is_in_time):
        return "hasty"
    return None


def _inverted(tables: Tables) -> list[str]:
    """Return raters whose ratings fall where the means of all others rise.

    By a correlation below 0 with p < .01, over that rater's ratings.
    """
    n_methods, found = len(tables.methods), []
    raters, methods = tables.ratings[:, 0], tables.ratings[:, 2]
    sums, counts = np.zeros((2, len(tables.raters), n_methods))
    np.add.at(sums, (raters, methods), tables.points)
    np.add.at(counts, (raters, methods), 1.0)
    for number, name in enumerate(tables.raters):
        is_own = raters == number
        others = counts.sum(axis=0) - counts[number]
        if is_own.sum() < _FEWEST or (others == 0).any():
            continue
        means = (sums.sum(axis=0) - sums[number]) / others
        others_means, points = means[methods[is_own]], tables.points[is_own]
        if np.ptp(points) and np.ptp(others_means):
            correlation = pearsonr(points, others_means, alternative="less")
            if correlation.pvalue < _INVERTED_P:
                found.append(name)
    return found


def tables_of(study: Study, key: Key, raters: Mapping[str, RaterRecord]) -> Tables:
    """Return the answers of some raters about clips as the arrays of `Tables`.

    raters: by name. key: which method and sentence a clip shows. Checks without clips are left
    out. Raises KeyError or IndexError for answers that do not belong to this study.
    """
    names = tuple(raters)
    sentences = tuple(sorted({clip.sentence for clip in key.clips.values()}))
    method_of = {m: n for n, m in enumerate(key.methods)}
    sentence_of = {s: n for n, s in enumerate(sentences)}
    read = _read_sentences(study, key)
    ratings, points, pairs, readings, words = [], [], [], [], []
    for number, rater in enumerate(raters.values()):
        for index, record in rater.answers.items():
            item, answer = study.sheets[rater.sheet][index], record["answer"]
            if not item.clips:
                continue
            clips = [key.clips[name] for name in item.clips]
            first = (number, sentence_of[clips[0].sentence], method_of[clips[0].method])
            if item.kind == "rating":
                ratings.append(first)
                points.append(answer)
            elif item.kind == "pair":
                chosen, other = clips if answer == FIRST else clips[::-1]
                pairs.append((*first[:2], method_of[chosen.method], method_of[other.method]))
            else:
                readings.append(first)
                words.append(_words_read(answer, clips[0], read))
    return Tables(
        key.methods,
        names,
        sentences,
        np.array(ratings, dtype=np.int64).reshape(-1, 3),
        np.array(points, dtype=np.float64),
        np.array(pairs, dtype=np.int64).reshape(-1, 4),
        np.array(readings, dtype=np.int64).reshape(-1, 3),
        np.array(words, dtype=np.float64).reshape(-1, 3),
    )


def _read_sentences(study: Study, key: Key) -> dict[str, list[str]]:
    """Return the words of every sentence that is shown without sound, by sentence."""
    clips = {
        clip
        for sheet in study.sheets
        for item in sheet
        if item.kind == "reading"
        for clip in item.clips
    }
    return {
        key.clips[name].sentence: words_in(" ".join(key.clips[name].words))
        for name in sorted(clips)
    }


def _words_read(
    answer: str, clip: Clip, sentences: Mapping[str, Sequence[str]]
) -> tuple[int, int, float]:
    """Return words read correctly, words of the sentence, and words correct by chance.

    answer: as typed. sentences: words of all sentences shown without sound.
    """
    typed = words_in(answer)
    others = [words for name, words in sentences.items() if name != clip.sentence]
    by_chance = [words_in_order(typed, words) for words in others]
    chance = float(np.mean(by_chance)) if by_chance else 0.0
    sentence_words = sentences[clip.sentence]
    return words_in_order(typed, sentence_words), len(sentence_words), chance


def words_in(text: str) -> list[str]:
    """Return the words of a text for comparison: lower case, no punctuation, digits by name."""
    return [_DIGITS.get(word, word) for word in re.findall(r"[\w']+", text.lower())]


def words_in_order(typed: Sequence[str], sentence_words: Sequence[str]) -> int:
    """Return how many words were read correctly, in order: the longest common subsequence."""
    # lengths[n]: of the words typed so far and the first n words of the sentence.
    lengths = [0] * (len(sentence_words) + 1)
    for word in typed:
        before = 0
        for n, other in enumerate(sentence_words, 1):
            diagonal, before = before, lengths[n]
            lengths[n] = diagonal + 1 if word == other else max(lengths[n], lengths[n - 1])
    return lengths[-1]
