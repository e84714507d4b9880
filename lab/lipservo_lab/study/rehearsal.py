"""Simulated studies, from sheets to report.

They show how often intervals hold the truth, and which differences a study of a size finds.
Nothing is filmed: simulated raters (`simulated_raters.py`) answer the items of real sheets; their
answers are lines of a file, and are counted and reported as those of people.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from lipservo_lab.study.answers import line_of, parse_answers
from lipservo_lab.study.counted import Counted, counted
from lipservo_lab.study.estimates import Figure, preferred, rated, strengths, words_read
from lipservo_lab.study.sheets import Key, Sentence, Size, Study, make_study, sentences_needed
from lipservo_lab.study.shown_methods import METHODS
from lipservo_lab.study.simulated_raters import (
    LAZY,
    Character,
    Taste,
    even_taste,
    simulated_records,
    strengths_of,
)
from lipsync.arrays import Array

Track = Callable[[int], Iterable[int]]
#: Words possible at each of six places, as in the sentences of GRID.
_WORDS: Final = (
    ("bin", "lay", "place", "set"), ("blue", "green", "red", "white"), ("at", "by", "in", "with"),
    tuple("abcdefghijklmnopqrstuvxyz"), tuple("0123456789"), ("again", "now", "please", "soon"),
)  # fmt: skip
_SECONDS: Final = 3.0
#: Number of raters whose mean is taken for the true share of words.
_MANY_READERS: Final = 1000
#: Differences of methods from the reference, in points before rounding, for which power is
#: estimated; the reference has _NATURAL.
_DIFFERENCES: Final = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.3)
_NATURAL: Final = 3.9


@dataclass(frozen=True, slots=True)
class Crew:
    """Number of simulated raters of each character."""

    honest: int
    alike: int = 0
    random: int = 0
    hasty: int = 0
    inverted: int = 0

    @property
    def characters(self) -> tuple[Character, ...]:
        """The character of each rater, in a random but fixed order."""
        kinds: tuple[Character, ...] = ("honest", *LAZY, "inverted")
        counts = {kind: getattr(self, kind) for kind in kinds}
        every = [kind for kind, n in counts.items() for _ in range(n)]
        order = np.random.default_rng(len(every)).permutation(len(every))
        return tuple(every[i] for i in order)


def trial_study(methods: Sequence[str], size: Size, seed: int = 0) -> tuple[Study, Key]:
    """Return a study of made-up sentences, and its key. Raises StudyError."""
    numbers = np.random.default_rng(seed)
    sentences = [
        Sentence(f"s{n}", tuple(str(numbers.choice(place)) for place in _WORDS), _SECONDS)
        for n in range(sentences_needed(size, len(methods)))
    ]
    return make_study(methods, sentences, size, f"trial {seed}", vocabulary=_WORDS)


def simulated_study(
    study: Study, key: Key, taste: Taste, characters: Sequence[Character], seed: int
) -> Counted:
    """Simulate raters' answers, as lines of a file, and return which of them count."""
    numbers = np.random.default_rng(seed)
    records = simulated_records(study, key, taste, characters, numbers)
    content = b"".join(map(line_of, records))
    return counted(study, key, parse_answers(Path("simulated"), content, study.identity))


def coverage_figures(
    n_studies: int, crew: Crew, size: Size, advance: Callable[[int, int], None]
) -> dict[str, Any]:
    """Simulate many studies; return how often intervals hold the truth, and who is left out.

    Every study has other raters, sentences and answers of the same population. advance: called with
    the number of studies done, and of all.
    """
    methods = tuple(METHODS)
    study, key = trial_study(methods, size)
    taste = even_taste(methods)
    truth = _truth(study, key, taste)
    is_held: dict[str, list[bool]] = {name: [] for name in truth}
    n_left_out: Counter[tuple[Character, bool]] = Counter()
    ranks: list[float] = []
    for seed in range(n_studies):
        advance(seed, n_studies)
        found = simulated_study(study, key, taste, crew.characters, seed)
        for number, character in enumerate(crew.characters):
            n_left_out[character, f"{character}-{number}" in found.left_out] += 1
        ratings, pairs = rated(found.tables, 0, seed), preferred(found.tables, 0, seed)
        words = words_read(found.tables, 0, seed)[0]
        estimated = {
            "ratings": ratings.own, "rating_differences": ratings.less_reference[1:],
            "strengths": pairs.own, "strength_differences": pairs.less_reference[1:],
            "words": words.own,
        }  # fmt: skip
        for name, figures in estimated.items():
            is_held[name] += [_holds(f, t) for f, t in zip(figures, truth[name], strict=True)]
        means = [figure.value for figure in ratings.own]
        ranks.append(
            float(np.corrcoef(np.argsort(np.argsort(means)), -np.arange(len(means)))[0, 1])
        )
    all_held = [held for values in is_held.values() for held in values]
    return {
        "coverage": _share(all_held),
        "coverage_of": {name: _share(values) for name, values in is_held.items()},
        "lazy_excluded": _left_share(n_left_out, LAZY),
        "lazy_excluded_of": {kind: _left_share(n_left_out, (kind,)) for kind in LAZY},
        "honest_kept": 1.0 - (_left_share(n_left_out, ("honest",)) or 0.0),
        "inverted_found": _left_share(n_left_out, ("inverted",)),
        "taste_found_r": round(float(np.mean(ranks)), 4),
        "studies": n_studies,
        "raters": len(crew.characters),
        "intervals": len(all_held),
    }


def _truth(study: Study, key: Key, taste: Taste) -> dict[str, Array]:
    """Return the true figures of methods for a taste, by name.

    The shares of words are those of a large simulated crowd, since a wrong word may be right by
    chance.
    """
    means = np.array([taste.mean_rating(method) for method in key.methods])
    odds = strengths(1e6 * strengths_of(taste, key.methods))
    crowd = simulated_study(study, key, taste, Crew(_MANY_READERS).characters, 0)
    shares = words_read(crowd.tables, 0)[0]
    return {
        "ratings": means,
        "rating_differences": means[1:] - means[0],
        "strengths": odds,
        "strength_differences": odds[1:] - odds[0],
        "words": np.array([figure.value for figure in shares.own]),
    }


def _holds(figure: Figure, truth: float) -> bool:
    """Return whether the interval of a figure contains the truth; False without an interval."""
    if figure.low is None or figure.high is None:
        return False
    return figure.low <= truth <= figure.high


def _share(values: Sequence[bool]) -> float:
    return round(float(np.mean(values)), 4)


def _left_share(n_of: Counter[tuple[Character, bool]], kinds: Sequence[Character]) -> float | None:
    """Return the share of raters of some characters that was left out; None without such raters.

    n_of: number of raters by character and by whether they were left out.
    """
    left, stayed = (sum(n_of[kind, is_out] for kind in kinds) for is_out in (True, False))
    return round(left / (left + stayed), 4) if left + stayed else None


def power_rows(
    raters: Sequence[int], n_methods: int, size: Size, n_studies: int, track: Track
) -> list[dict[str, Any]]:
    """Return for each number of raters how often differences from the reference are found.

    A difference is found if its interval does not contain 0. smallest_seen: the difference, in
    points of the scale, that is found in four of five studies; None if none of those tried is.
    track: wraps the seeds of the studies, for progress.
    """
    methods = tuple(f"method {n}" for n in range(n_methods))
    differences_of = np.array([0.0, *_DIFFERENCES, *[_DIFFERENCES[-1]] * n_methods][:n_methods])
    # With few methods the differences are tried in several studies.
    turns = [differences_of] if n_methods > len(_DIFFERENCES) else _in_turns(n_methods)
    study, key = trial_study(methods, size)
    rows = []
    for n_raters in raters:
        is_found: dict[float, list[bool]] = {}
        for turn in turns:
            natural = dict(zip(methods, (_NATURAL - turn).tolist(), strict=True))
            taste = Taste(natural, dict.fromkeys(methods, 0.3))
            means = np.array([taste.mean_rating(method) for method in methods])
            for seed in track(n_studies):
                found = simulated_study(study, key, taste, Crew(n_raters).characters, seed)
                differences = rated(found.tables, 0, seed).less_reference
                for figure, gap in zip(differences[1:], (means[0] - means)[1:], strict=True):
                    is_seen = figure.high is not None and not _holds(figure, 0.0)
                    is_found.setdefault(round(float(gap), 3), []).append(is_seen)
        power = {gap: _share(values) for gap, values in sorted(is_found.items())}
        rows.append({"raters": n_raters, "seen": power, "smallest_seen": _smallest(power)})
    return rows


def _in_turns(n_methods: int) -> list[Array]:
    """Return the differences dealt to studies of few methods, (n_methods,) each, 0 first."""
    n_each = n_methods - 1
    parts = [_DIFFERENCES[i : i + n_each] for i in range(0, len(_DIFFERENCES), n_each)]
    return [np.array([0.0, *part, *[part[-1]] * (n_each - len(part))]) for part in parts]


_POWER: Final = 0.8


def _smallest(power: dict[float, float]) -> float | None:
    """Return the difference found with a power of 0.8, interpolated linearly; None: none is.

    power: share of studies that find it, by difference.
    """
    gaps, shares = list(power), list(power.values())
    if not shares or max(shares) < _POWER:
        return None
    first = next(n for n, share in enumerate(shares) if share >= _POWER)
    if first == 0:
        return gaps[0]
    low, high = shares[first - 1], shares[first]
    between = (_POWER - low) / (high - low)
    return round(gaps[first - 1] + between * (gaps[first] - gaps[first - 1]), 2)
