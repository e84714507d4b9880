"""Who sees what: the sheets of a study, balanced and blind, and the key to what was seen.

A round of ratings is a Latin square: over as many raters as there are methods, every method is seen
once with every sentence of the round. Within a round, methods follow each other as in Williams
("Experimental designs balanced for the estimation of residual effects of treatments", 1949): each
method is as often at each place, and as often after each other one. Comparisons go through all
pairs of methods, each first one way round and then the other. Clips without sound come first, of
sentences that are not heard later.

Raters only get the study, whose clips have hashed names; methods and sentences are in the key.
"""

import hashlib
import itertools
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final, Literal, TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError

from lipsync.arrays import Indices
from lipsync.errors import UserError
from lipsync.output_file import write_whole

T = TypeVar("T")
Kind = Literal["reading", "sound", "rating", "pair", "check"]
POINTS: Final = 5
#: Which clip of a pair was chosen.
FIRST, SECOND = "A", "B"
SERVED: Final = "served"
STUDY_FILE, KEY_FILE, CLIPS = f"{SERVED}/study.json", "key.json", f"{SERVED}/clips"
ANSWERS_FILE, MACHINES_FILE = "answers.jsonl", "machines.jsonl"
#: Names of clips, of 16 hexadecimal digits.
_NAME_BYTES: Final = 8
_FEWEST_BEEPS, _MOST_BEEPS = 2, 5


class StudyError(UserError):
    """A study that cannot be made, served or read; one line."""


@dataclass(frozen=True, slots=True)
class Item:
    """One task of a rater.

    clips: one, or two of a pair, A first; none of a check. expected: the point that a check
    demands, or the number of beeps of a sound check.
    """

    kind: Kind
    clips: tuple[str, ...] = ()
    expected: int | None = None


@dataclass(frozen=True, slots=True)
class Study:
    """What raters get.

    vocabulary: the words possible at each place of a sentence; empty: any. duration_s: of each
    clip, by name. sheets: the items of each rater, in order.
    """

    identity: str
    title: str
    consent: str
    vocabulary: tuple[tuple[str, ...], ...]
    duration_s: dict[str, float]
    sheets: tuple[tuple[Item, ...], ...]


@dataclass(frozen=True, slots=True)
class Clip:
    """What a clip shows.

    words: the words spoken in it.
    """

    method: str
    sentence: str
    words: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Key:
    """What no rater may see.

    clips: by the name that raters get.
    """

    identity: str
    seed: str
    methods: tuple[str, ...]
    clips: dict[str, Clip]


@dataclass(frozen=True, slots=True)
class Size:
    """How much there is to do; ratings, readings and sentences are rounded up to whole rounds.

    ratings, pairs, readings, checks: of each rater. sentences: that are rated. sheets: number of
    different ones; raters beyond that get the first ones again.
    """

    ratings: int = 40
    pairs: int = 20
    readings: int = 10
    sentences: int = 20
    checks: int = 4
    sheets: int = 60

    def rounds(self, n_methods: int) -> tuple[int, int, int]:
        """Return the number of rounds of ratings, rounds of readings, and sets of rated sentences.

        Raises StudyError for a number that no square can balance.
        """
        ratings, readings, sets = (
            math.ceil(n / n_methods) for n in (self.ratings, self.readings, self.sentences)
        )
        if n_methods < 2:
            raise StudyError("--methods: a study compares two methods at least")
        if ratings > sets * n_methods or ((ratings or self.pairs) and not sets):
            raise StudyError(
                f"{self.ratings} ratings: {n_methods} methods of {sets * n_methods} sentences are "
                f"{sets * n_methods**2} clips; ask for fewer --ratings, or more --sentences"
            )
        return ratings, readings, sets


@dataclass(frozen=True, slots=True)
class Sentence:
    """A sentence that may be shown.

    words: the words spoken in it.
    """

    name: str
    words: tuple[str, ...]
    duration_s: float


def sentences_needed(size: Size, n_methods: int) -> int:
    """Return how many sentences a study needs, to rate and to read."""
    _, readings, sets = size.rounds(n_methods)
    return (sets + readings) * n_methods


def make_study(
    methods: Sequence[str],
    sentences: Sequence[Sentence],
    size: Size,
    seed: str,
    *,
    title: str = "Talking faces",
    consent: str = "",
    vocabulary: tuple[tuple[str, ...], ...] = (),
) -> tuple[Study, Key]:
    """Plan a study of the first sentences that it needs; the same seed gives the same study.

    Return what raters get, and the key. Raises StudyError for too few sentences, or a size that no
    square can balance.
    """
    n = len(methods)
    rounds, read_rounds, sets = size.rounds(n)
    needed = sentences_needed(size, n)
    if len(sentences) < needed:
        raise StudyError(
            f"{len(sentences)} sentences are held out, {needed} are needed: {sets * n} to rate, "
            f"{read_rounds * n} to read; ask for fewer --sentences or --readings"
        )
    every = list(sentences[:needed])
    secret = hashlib.blake2s(seed.encode()).digest()
    identity = _hashed(secret, "study")
    name_of = {
        (method, each.name): _hashed(secret, f"{method}/{each.name}")
        for each in every
        for method in methods
    }
    rows = williams(n)
    numbers = np.random.default_rng(list(secret))
    pairs = _Pairs(numbers, n, size.pairs)

    def sheet(rater: int) -> tuple[Item, ...]:
        """Return the items of a rater, in their order: reading, sound check, ratings, pairs.

        Attention checks are mixed in. The same rater and secret always give the same sheet.
        """
        rng = np.random.default_rng([*secret, rater])
        # The raters of one Latin square must have the same order of sentences.
        shared = np.random.default_rng([*secret, 0, rater // n])
        sets_of = [
            [every[i] for i in shared.permutation(n) + first] for first in range(0, len(every), n)
        ]

        def of_round(chosen: Sequence[Sentence], number: int, turn: int) -> list[tuple[str, ...]]:
            """Return the clips of one round, a tuple each, in this rater's order of methods.

            chosen: the sentences of the round. number: of the round. turn: how often these
            sentences were shown before.
            """
            row = rows[(rater + number) % len(rows)]
            return [(name_of[methods[m], chosen[(m + rater + turn) % n].name],) for m in row]

        rating = [of_round(sets_of[each % sets], each, each // sets) for each in range(rounds)]
        reading = [of_round(sets_of[sets + each], each, 0) for each in range(read_rounds)]
        compared_clips = [
            tuple(name_of[methods[m], every[sentence % (sets * n)].name] for m in pair)
            for pair, sentence in pairs.of(rater)
        ]
        listened = [Item("rating", clips) for each in rating for clips in each]
        listened += [Item("pair", clips) for clips in compared_clips]
        beeps = int(rng.integers(_FEWEST_BEEPS, _MOST_BEEPS + 1))
        return (
            *(Item("reading", clips) for each in reading for clips in each),
            *([Item("sound", expected=beeps)] if listened else []),
            *_with_checks(rng, listened, size.checks),
        )

    study = Study(
        identity,
        title,
        consent,
        vocabulary,
        {name_of[m, each.name]: each.duration_s for each in every for m in methods},
        tuple(sheet(rater) for rater in range(size.sheets)),
    )
    clips = {
        name_of[method, each.name]: Clip(method, each.name, each.words)
        for each in every
        for method in methods
    }
    return study, Key(identity, seed, tuple(methods), clips)


def williams(n: int) -> Indices:
    """Return orders of n things, (n, n) or for odd n (2 n, n): balanced for place and neighbour."""
    first = [(i + 1) // 2 if i % 2 else -(i // 2) for i in range(n)]
    rows = (np.array(first)[None] + np.arange(n)[:, None]) % n
    return np.concatenate([rows, rows[:, ::-1]]) if n % 2 else rows


class _Pairs:
    """All pairs of methods in turn, over all raters; then the other way round.

    each: pairs of a rater.
    """

    def __init__(self, numbers: np.random.Generator, n_methods: int, each: int) -> None:
        is_flipped = numbers.integers(2, size=(n_methods, n_methods))
        pairs = [(i, j) if is_flipped[i, j] else (j, i) for j in range(n_methods) for i in range(j)]
        self._pairs = [pairs[k] for k in numbers.permutation(len(pairs))]
        self._each = each

    def of(self, rater: int) -> list[tuple[tuple[int, int], int]]:
        """Return a rater's pairs: methods of A and B, and a number that chooses the sentence.

        The number of the same pair is one higher each time that it comes again.
        """
        found = []
        for count in range(rater * self._each, (rater + 1) * self._each):
            turn, k = divmod(count, len(self._pairs))
            first, second = self._pairs[k]
            found.append(((second, first) if turn % 2 else (first, second), k + turn))
        return found


def _with_checks(numbers: np.random.Generator, items: list[Item], n_checks: int) -> list[Item]:
    """Return the items with checks among them, one at random in each of `n_checks` equal parts."""
    found: list[Item] = []
    borders = np.linspace(0, len(items), n_checks + 1).astype(int)
    for start, end in itertools.pairwise(borders):
        place = int(numbers.integers(start, end)) if end > start else start
        check = Item("check", expected=int(numbers.integers(1, POINTS + 1)))
        found += [*items[start:place], check, *items[place:end]]
    return found or items


def _hashed(secret: bytes, text: str) -> str:
    """Return a name of 16 hexadecimal digits for a text, by a keyed hash."""
    return hashlib.blake2s(text.encode(), key=secret, digest_size=_NAME_BYTES).hexdigest()


_STUDY: Final = TypeAdapter(Study)
_KEY: Final = TypeAdapter(Key)


def write_study(folder: Path, study: Study, key: Key) -> None:
    """Write study and key into a folder; raters only get what is below `served`.

    Raises OutputError.
    """
    (folder / CLIPS).mkdir(parents=True, exist_ok=True)
    write_whole(folder / STUDY_FILE, json.dumps(asdict(study)))
    write_whole(folder / KEY_FILE, json.dumps(asdict(key), indent=1))


def read_study(folder: Path) -> Study:
    """Read what raters get. Raises StudyError."""
    return _read(folder / STUDY_FILE, _STUDY)


def read_key(folder: Path) -> Key:
    """Read what raters must not see. Raises StudyError."""
    return _read(folder / KEY_FILE, _KEY)


def _read(path: Path, adapter: "TypeAdapter[T]") -> T:
    """Read and check a JSON file of a study; raise StudyError that says what is wrong with it."""
    try:
        return adapter.validate_json(path.read_bytes())
    except OSError as error:
        raise StudyError(
            f"{path}: {error.strerror}; `lipservo study make` makes the folder of a study"
        ) from error
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(map(str, first["loc"])) or "the file"
        raise StudyError(f"{path}: {where}: {first['msg']}; make the study anew") from error


def missing_clips(folder: Path, study: Study) -> list[str]:
    """Return the names of clip files that are missing or empty."""
    paths = (folder / CLIPS / f"{name}.mp4" for name in study.duration_s)
    return [path.name for path in paths if not path.is_file() or not path.stat().st_size]
