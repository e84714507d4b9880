"""Raters of known taste, who answer a study as people do: for rehearsals, power and coverage.

How natural a clip looks to a rater is a sum of independent normal parts: of its method, of the
rater, of the sentence, of this rater for this method, of this sentence for this method, and of the
moment. It is rounded to the scale; of a pair the clip that looks better is chosen.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from scipy.stats import norm

from lipservo_lab.study.answers import Record, first_record, now
from lipservo_lab.study.sheets import FIRST, POINTS, SECOND, Item, Key, Study
from lipsync.arrays import Array

Character = Literal["honest", "alike", "random", "hasty", "inverted"]
#: Characters that do not do what they were asked.
LAZY: Final[tuple[Character, ...]] = ("alike", "random", "hasty")
#: Share of checks ("choose 2") that an honest rater overlooks.
_OVERLOOKS: Final = 0.02
_READS_S: Final = 2.0


@dataclass(frozen=True, slots=True)
class Taste:
    """What a population of raters thinks of methods.

    natural: mean of each method on the scale of 1 to 5, before rounding. reads: chance that a word
    of a method's clip is read correctly. The others are standard deviations of the parts, in
    points.
    """

    natural: Mapping[str, float]
    reads: Mapping[str, float]
    rater: float = 0.5
    sentence: float = 0.2
    rater_method: float = 0.3
    sentence_method: float = 0.2
    moment: float = 0.8

    def mean_rating(self, method: str) -> float:
        """Return the true mean rating of a method, over all raters and sentences."""
        spread = np.sqrt(
            self.rater**2
            + self.sentence**2
            + self.rater_method**2
            + self.sentence_method**2
            + self.moment**2
        )
        edges = np.arange(1, POINTS) + 0.5
        return 1.0 + float(norm.sf((edges - self.natural[method]) / spread).sum())

    def preferred(self, one: str, other: str) -> float:
        """Return how often one method is chosen over another, over all raters and sentences."""
        spread = np.sqrt(2.0 * (self.rater_method**2 + self.sentence_method**2 + self.moment**2))
        return float(norm.cdf((self.natural[one] - self.natural[other]) / spread))


def even_taste(methods: Sequence[str], best: float = 4.2, worst: float = 1.8) -> Taste:
    """Return a taste with methods in even steps; of the worst no word is read."""
    steps = np.linspace(0.0, 1.0, len(methods))
    natural = {m: float(best + (worst - best) * s) for m, s in zip(methods, steps, strict=True)}
    return Taste(natural, {m: float(0.6 * (1.0 - s)) for m, s in zip(methods, steps, strict=True)})


def simulated_records(
    study: Study,
    key: Key,
    taste: Taste,
    characters: Sequence[Character],
    numbers: np.random.Generator,
) -> Iterator[Record]:
    """Yield the records of simulated raters, one each character, as `AnswerFile` writes them."""
    time_text = now()
    yield {**first_record(study.identity), "simulated": True}
    population = _Population(study, key, taste, numbers)
    for count, character in enumerate(characters):
        name, sheet = f"{character}-{count}", count % len(study.sheets)
        yield {"kind": "join", "rater": name, "sheet": sheet, "at": time_text}
        rater = population.rater(character)
        for number, item in enumerate(study.sheets[sheet]):
            answer, seconds = rater.answer(item)
            yield {
                "kind": "answer", "rater": name, "number": number, "answer": answer,
                "seconds": seconds, "plays": 1, "at": time_text,
            }  # fmt: skip


class _Population:
    """A population of raters: what its members share about sentences and methods.

    of_sentence, of_both: parts of a rating, in points, by sentence, and by sentence and method.
    """

    def __init__(self, study: Study, key: Key, taste: Taste, numbers: np.random.Generator) -> None:
        self.study, self.key, self.taste, self.numbers = study, key, taste, numbers
        sentences = {clip.sentence for clip in key.clips.values()}
        self.of_sentence = {s: numbers.normal(0, taste.sentence) for s in sorted(sentences)}
        self.of_both = {
            (s, m): numbers.normal(0, taste.sentence_method)
            for s in sorted(sentences)
            for m in key.methods
        }
        self.words = sorted({word for clip in key.clips.values() for word in clip.words})

    def rater(self, character: Character) -> "_Rater":
        return _Rater(self, character)


class _Rater:
    """One simulated rater, with parts of the rating that only this rater has."""

    def __init__(self, population: _Population, character: Character) -> None:
        self._all, self._character = population, character
        numbers, taste = population.numbers, population.taste
        self._own = float(numbers.normal(0, taste.rater))
        self._of_method = {m: numbers.normal(0, taste.rater_method) for m in population.key.methods}
        self._always = int(numbers.integers(1, POINTS + 1))

    def answer(self, item: Item) -> tuple[int | str, float]:
        """Return the answer to an item, and after how many seconds it comes."""
        numbers = self._all.numbers
        shown_s = sum(self._all.study.duration_s[clip] for clip in item.clips)
        seconds = round(shown_s + numbers.gamma(2.0, _READS_S / 2.0), 2)
        if self._character == "hasty":
            seconds = round(float(numbers.uniform(0.2, 0.6)), 2)
        is_careless = self._character in LAZY
        match item.kind:
            case "sound":
                return int(item.expected or 0), seconds
            case "check":
                is_read = not is_careless and numbers.random() > _OVERLOOKS
                return (int(item.expected or 0) if is_read else self._careless_point()), seconds
            case "reading":
                return ("" if is_careless else self._read_words(item.clips[0])), seconds
            case "pair":
                first = is_careless and numbers.random() < 0.5
                if not is_careless:
                    first = self._rate_clip(item.clips[0]) > self._rate_clip(item.clips[1])
                return (FIRST if first else SECOND), seconds
        if is_careless:
            return self._careless_point(), seconds
        point = int(np.clip(np.floor(self._rate_clip(item.clips[0]) + 0.5), 1, POINTS))
        return (POINTS + 1 - point if self._character == "inverted" else point), seconds

    def _careless_point(self) -> int:
        """Return the point of a rater who does not look: always the same, or random."""
        if self._character == "alike":
            return self._always
        return int(self._all.numbers.integers(1, POINTS + 1))

    def _rate_clip(self, name: str) -> float:
        """Return how natural a clip looks to this rater now, in points before rounding."""
        clip, every = self._all.key.clips[name], self._all
        shared = every.of_sentence[clip.sentence] + every.of_both[clip.sentence, clip.method]
        own = self._own + self._of_method[clip.method]
        moment = every.numbers.normal(0, every.taste.moment)
        return float(every.taste.natural[clip.method] + shared + own + moment)

    def _read_words(self, name: str) -> str:
        """Return the words that this rater reads; each is wrong with the chance of its method."""
        clip, numbers = self._all.key.clips[name], self._all.numbers
        reads = self._all.taste.reads[clip.method]
        return " ".join(
            word if numbers.random() < reads else str(numbers.choice(self._all.words))
            for word in clip.words
        )


def strengths_of(taste: Taste, methods: Sequence[str]) -> Array:
    """Return how often the row's method is chosen over the column's, 0 to 1; 0 for itself.

    Parameters
    ----------
    taste : Taste
        Of the raters.
    methods : Sequence[str]
        n names.

    Returns
    -------
    Array
        (n, n).
    """
    return np.array([[0.0 if a == b else taste.preferred(a, b) for b in methods] for a in methods])
