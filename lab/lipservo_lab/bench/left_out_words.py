"""The figures of `lipservo bench motion --leave-words-out`: every word unseen by its model.

A random split flatters whatever learns the fifty words by heart. Here the words are dealt into ten
folds; a model trained without any sentence that holds a word of a fold moves the mouth in those
words, and every word of the corpus is scored once. The questions: how near, which words fail, and
whether closures of contexts never heard come too early or too late.

Models are kept from one run to the next, under the digest of all that made them: the sentences,
what was heard of them, and the code that learns.
"""

import hashlib
import math
import os
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from itertools import product
from pathlib import Path
from typing import Final

import numpy as np

from lipservo_lab.corpus.utterance import Corpus, CorpusError, Utterance, Word, speech_frames
from lipservo_lab.evaluation.motion.measures import (
    Motion,
    confidence_intervals,
    figures,
    paired_differences,
    sentence_sums,
)
from lipservo_lab.evaluation.motion.methods import REFERENCE, Heard, Method, all_methods
from lipservo_lab.evaluation.motion.motion_scores import Listen, Part, words_part
from lipservo_lab.evaluation.readability.readers import spoken_words
from lipservo_lab.learning.motion.trained_model import TrainedModel, load_trained_model, save_model
from lipservo_lab.video.sound_shift import ShiftCurve, correlation
from lipsync.arrays import Array
from lipsync.face.model import ModelError
from lipsync.motion.tick_plan import TICK_S
from lipsync.phonemes import SILENCE, PhonemeEvent

Row = dict[str, object]
N_FOLDS: Final = 10
#: A word with fewer frames of speech has no line of its own.
LEAST_FRAMES: Final = 300
#: Sounds at the beginning or the end of a word, which meet contexts that training lacks.
BORDER_CLASSES: Final[Mapping[str, tuple[str, ...]]] = {
    "P B M": ("P", "B", "M"),
    "F V": ("F", "V"),
    "rounded": ("W", "R", "SH", "ZH", "CH", "JH", "UW", "UH", "OW", "AO", "OY", "ER"),
    "other vowels": ("IY", "IH", "EH", "AE", "EY", "AA", "AH", "AY", "AW"),
    "other consonants": (
        "T", "D", "N", "S", "Z", "L", "TH", "DH", "K", "G", "NG", "HH", "Y",
    ),
}  # fmt: skip
_CLASS_OF = {phoneme: name for name, members in BORDER_CLASSES.items() for phoneme in members}
#: Our lips are compared with those recorded up to so much earlier and later.
_SHIFTS_S: Array = np.arange(-6, 7, dtype=np.float64) * TICK_S
#: With them a correlation says something of a class.
_LEAST_SHIFTED = 100


def word_folds(corpus: Corpus) -> list[Part]:
    """Divide the corpus's words into `N_FOLDS` folds (fewer, if there are fewer words).

    Each fold has its words, and as training sentences those that contain none of its words. Words
    are dealt to the folds in turn, the most frequent first, so that every fold leaves about as much
    to train on. corpus: labelled. Raises CorpusError if some fold has no training sentence.
    """
    counts = Counter(w.text for u in corpus.utterances for w in spoken_words(u))
    if len(counts) < 2:
        raise CorpusError(f"{corpus.name}: {len(counts)} different words; leaving one out needs 2")
    if not any(speech_frames(u, frozenset(counts)).any() for u in corpus.utterances):
        raise CorpusError(
            f"{corpus.name}: no phone of speech lies in any word; check that both tiers of labels/ "
            "have the same times"
        )
    by_frequency = sorted(counts, key=lambda text: (-counts[text], text))
    n_folds = min(N_FOLDS, len(by_frequency))
    folds = []
    for first in range(n_folds):
        words = frozenset(by_frequency[first::n_folds])
        fold = words_part(f"fold {first + 1}", corpus, words)
        if not fold.train:
            raise CorpusError(
                f"{corpus.name}: every labelled sentence holds one of {', '.join(sorted(words))}, "
                "so their fold has none to train on; leaving words out needs more sentences"
            )
        folds.append(fold)
    return folds


#: Twice as many models as one corpus needs, and some.
_MOST_KEPT: Final = 40
#: The code that learns; another version of it learns another model.
_LEARNING = (
    "lipservo_lab.learning.motion", "lipservo_lab.learning.recognition",
    "lipservo_lab.learning.expectation", "lipservo_lab.baselines",
    "lipsync.expectation", "lipsync.animpho", "lipsync.face",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class KeptModels:
    """A cache of models trained on parts of one corpus: made at the first use, then read from disk.

    heard: phonemes recognised in each sentence, by its name. others: digests of further weights
    that training depends on. Two runs at once may train a model twice; files are written whole.
    """

    folder: Path
    corpus: Corpus
    heard: Mapping[str, Sequence[PhonemeEvent]]
    learn: Callable[[Corpus], TrainedModel]
    others: tuple[str, ...] = ()

    def of(self, part: Part) -> TrainedModel:
        """Return the model trained on the part's sentences, from the cache if it is there.

        Else it is trained and stored first. Raises TrainingError, OutputError.
        """
        training = self.corpus.keep(set(part.train))
        path = self.folder / f"{self._training_digest(training)}.npz"
        try:
            model = load_trained_model(path)
        except ModelError:
            self.folder.mkdir(parents=True, exist_ok=True)
            save_model(self.learn(training), path)
            self._delete_oldest_files()
            # Rounded as in the file, so that the next run gives the same figures.
            return load_trained_model(path)
        os.utime(path)
        return model

    def _training_digest(self, training: Corpus) -> str:
        """Return 24 hex digits of all that training depends on: code, sentences and phonemes."""
        digest = hashlib.sha256(_code_digest())
        digest.update(repr(self.others).encode())
        for u in training.utterances:
            digest.update(repr((u.name, u.weight, u.phones, self.heard.get(u.name))).encode())
            digest.update(np.ascontiguousarray(u.markers_mm).tobytes())
        return digest.hexdigest()[:24]

    def _delete_oldest_files(self) -> None:
        oldest_first = sorted(self.folder.glob("*.npz"), key=lambda path: path.stat().st_mtime)
        for path in oldest_first[:-_MOST_KEPT]:
            path.unlink(missing_ok=True)


def cache_folder() -> Path:
    """Return where models are kept: in the user's cache (XDG Base Directory Specification)."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "lipservo" / "left-out-words"


def _code_digest() -> bytes:
    """Return a digest of the source of all packages in `_LEARNING`, 32 bytes."""
    files = sorted(
        (name, path.name, path.read_bytes())
        for name in _LEARNING
        for path in resources.files(name).iterdir()
        if path.is_file() and path.name.endswith(".py")
    )
    return hashlib.sha256(repr(files).encode()).digest()


@dataclass(slots=True)
class _Lips:
    """Lip gaps (mm) of the same frames: recorded, and ours at each shift of `_SHIFTS_S`.

    seen: arrays (n,), one a spoken word. ours: arrays (n, n_shifts). Both lists only grow.
    """

    seen: list[Array] = field(default_factory=list)
    ours: list[Array] = field(default_factory=list)

    def best_ms(self) -> float | None:
        """Return the shift, ms, at which our gap correlates best with the recorded one.

        Positive: our lips are late. None: fewer than `_LEAST_SHIFTED` frames.
        """
        if sum(map(len, self.seen)) < _LEAST_SHIFTED:
            return None
        seen, ours = np.concatenate(self.seen), np.concatenate(self.ours)
        curve = ShiftCurve(_SHIFTS_S, np.array([correlation(seen, each) for each in ours.T]))
        return round(1e3 * curve.best_s, 1)


_Key = tuple[str, int, str]
_PAIRED = ("ratio", "gap_r", "gap_rmse_mm")  # r alone hides a mouth that opens half as wide


@dataclass(slots=True)
class _Scores:
    """Error sums and lip gaps of spoken words; both dicts only grow.

    Keys: (strategy, look-ahead in ms, name), name being a word, a class of `BORDER_CLASSES` or
    `_ALL`.
    """

    sums: dict[_Key, list[Array]] = field(default_factory=lambda: defaultdict(list))
    lips: dict[_Key, _Lips] = field(default_factory=lambda: defaultdict(_Lips))

    def row(self, strategy: str, lookahead_ms: int, name: str) -> Row:
        """Return the figures of one key, pooled, with 95 % intervals over its spoken words."""
        sums = np.array(self.sums[strategy, lookahead_ms, name])
        pooled = figures(sums.sum(axis=0))
        intervals = confidence_intervals(sums, _PAIRED)
        return {
            "strategy": strategy,
            "lookahead_ms": lookahead_ms,
            **{key: _rounded(pooled[key]) for key in (*_PAIRED, "closure_hits")},
            **{f"{key}_95": list(map(_rounded, ends)) for key, ends in intervals.items()},
            "best_shift_ms": self.lips[strategy, lookahead_ms, name].best_ms(),
            "frames": int(sums[:, 0].sum()),
        }

    def less(self, strategy: str, other: str, lookahead_ms: int) -> Row:
        """Return how much larger a strategy's figures are than another's, on the same spoken words.

        Paired differences over all words, with 95 % intervals.
        """
        ours, theirs = (np.array(self.sums[each, lookahead_ms, _ALL]) for each in (strategy, other))
        differences = paired_differences(ours, theirs, _PAIRED)
        return {
            "strategy": strategy,
            "less": other,
            "lookahead_ms": lookahead_ms,
            **{key: _rounded(value) for key, (value, _) in differences.items()},
            **{f"{key}_95": list(map(_rounded, ends)) for key, (_, ends) in differences.items()},
        }


_ALL = "all"


def left_out_figures(
    corpus: Corpus,
    model_of: Callable[[Part], TrainedModel],
    methods: Sequence[Method],
    lookaheads_ms: Sequence[int],
    listen: Listen,
    limit: int,
    track: Callable[[str, list[Utterance]], Iterable[Utterance]],
) -> dict[str, list[Row]]:
    """Score methods on every word with a model that has not learned it; return tables of rows.

    `all`: all words, for each method and look-ahead. `differences`: each further method less the
    first, paired. `classes`: words that begin or end with a class of sounds. `words`: each word of
    at least `LEAST_FRAMES` frames, the worst gap_r first. The last two have one look-ahead, that in
    the middle of `lookaheads_ms`.

    corpus: labelled. model_of: returns the model of a fold. listen: returns what is heard of a
    sentence. limit: play at most so many sentences of each word. track: iterates with a progress
    bar, given its label. Raises CorpusError.
    """
    scores, folds = _Scores(), word_folds(corpus)
    for part in folds:
        model = model_of(part)
        places = chosen_places(corpus, part, limit)
        utterances = corpus.keep({name for name, _ in places}).utterances
        for utterance in track(f"scoring {part.split}", list(utterances)):
            words = [w for w in spoken_words(utterance) if (utterance.name, w.text) in places]
            _add_sums(scores, model, utterance, words, methods, lookaheads_ms, listen(utterance))
    main_ms = lookaheads_ms[len(lookaheads_ms) // 2]
    names = [method.name for method in methods]
    scored_words = {text for part in folds for text in part.words or ()}
    word_rows = [
        {"word": text, **scores.row(name, main_ms, text)}
        for name in names
        for text in scored_words
        if scores.sums[name, main_ms, text]  # none: too short for a frame, or said in silence
    ]
    return {
        "all": [scores.row(name, ms, _ALL) for name in names for ms in lookaheads_ms],
        "differences": [
            scores.less(name, names[0], ms) for name in names[1:] for ms in lookaheads_ms
        ],
        "classes": [
            {"class": border, **scores.row(name, main_ms, border)}
            for name in names
            for border in BORDER_CLASSES
            if scores.sums[name, main_ms, border]
        ],
        "words": sorted(
            (row for row in word_rows if int(str(row["frames"])) >= LEAST_FRAMES),
            key=lambda row: float(str(row["gap_r"])),
        ),
    }


def chosen_places(corpus: Corpus, part: Part, limit: int) -> set[tuple[str, str]]:
    """Return pairs (sentence, word) of a fold, with at most `limit` sentences for each word.

    Where a word is in more sentences, these are spread evenly over the sorted names.
    """
    chosen: set[tuple[str, str]] = set()
    for text in part.words or ():
        having = sorted(
            u.name for u in corpus.utterances if any(w.text == text for w in spoken_words(u))
        )
        step = max(1.0, len(having) / limit)
        chosen |= {(having[int(n * step)], text) for n in range(min(limit, len(having)))}
    return chosen


def _add_sums(
    scores: _Scores,
    model: TrainedModel,
    utterance: Utterance,
    words: Sequence[Word],
    methods: Sequence[Method],
    lookaheads_ms: Sequence[int],
    heard: Heard,
) -> None:
    """Play a sentence by every method and look-ahead; add the errors in `words` to `scores`."""
    times_s = np.arange(len(utterance.markers_mm)) / utterance.frame_rate_hz
    ticks_s = np.arange(int(times_s[-1] / TICK_S) + 1, dtype=np.float64) * TICK_S
    recorded = Motion(utterance.markers_mm, model.coefficients(utterance.markers_mm))
    # The reference method on the true phonemes: `ratio` is the error relative to its error.
    reference = all_methods()[REFERENCE].faces(model, Heard(utterance.phones), times_s, 0.0)
    ideal = Motion(model.markers_mm(reference), reference)
    seen_mm = model.lip_gaps_mm(utterance.markers_mm)
    word_frames = [(w, speech_frames(utterance, frozenset({w.text}))) for w in words]
    for method, ms in product(methods, lookaheads_ms):
        # A method that does not look ahead gives the same motion for every look-ahead.
        if method.looks_ahead or ms == lookaheads_ms[0]:
            tick_faces = method.faces(model, heard, ticks_s, ms / 1e3)
        ours_mm = model.lip_gaps_mm(model.markers_mm(tick_faces))
        faces = np.stack([np.interp(times_s, ticks_s, column) for column in tick_faces.T], axis=1)
        played = Motion(model.markers_mm(faces), faces)
        for word, in_word in word_frames:
            if not in_word.any():
                continue
            sums = sentence_sums(model, utterance, in_word, recorded, played, ideal)
            # Our gap at every shift around each frame of the word, (n_frames, n_shifts).
            at_s = times_s[in_word][:, None] + _SHIFTS_S
            around_mm = np.interp(at_s, ticks_s, ours_mm)
            for name in (_ALL, word.text, *_border_classes(utterance, word)):
                scores.sums[method.name, ms, name].append(sums)
                lips = scores.lips[method.name, ms, name]
                lips.seen.append(seen_mm[in_word])
                lips.ours.append(around_mm)


def _border_classes(utterance: Utterance, word: Word) -> set[str]:
    """Return the classes, of `BORDER_CLASSES`, of the first and the last sound of a word."""
    inside = [
        phone.phoneme
        for phone in utterance.phones
        if phone.phoneme != SILENCE
        and word.start_s <= (phone.start_s + (phone.end_s or phone.start_s)) / 2.0 < word.end_s
    ]
    return {_CLASS_OF[phoneme] for phoneme in (inside[:1] + inside[-1:])}


def _rounded(value: float) -> float | None:
    return None if math.isnan(value) else round(value, 4)
