"""The figures of `lipservo bench motion`: every method against recorded faces."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path

from lipservo_lab.corpus.utterance import Corpus, Utterance, speech_frames
from lipservo_lab.evaluation.motion.as_printed import PrintedMethod
from lipservo_lab.evaluation.motion.methods import (
    RANDOM_UNITS,
    Heard,
    Method,
    PublishedMethod,
    SplineMethod,
    all_methods,
)
from lipservo_lab.evaluation.motion.motion_scores import (
    Listen,
    Part,
    Scores,
    add_scores,
    check_scorable,
    read_parts,
    seen_in_training,
    true_phonemes,
    words_part,
)
from lipservo_lab.evaluation.motion.offline_methods import (
    ContextVisemeMethod,
    OfflineMethod,
    OfflineModels,
    RecordedVisemes,
)
from lipservo_lab.evaluation.motion.paper_tables import animpho_use, count_misses, paper_tables
from lipservo_lab.evaluation.motion.recovery import recovery_rows
from lipservo_lab.evaluation.motion.timing import method_times
from lipservo_lab.evaluation.recognition.heard_motion import recognize_file
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipsync.animpho.selection import STRATEGIES
from lipsync.errors import UserError
from lipsync.motion.live_synthesizer import LIVE_STRATEGY, UNIT_STRATEGY
from lipsync.offline.line_methods import PLANNED_METHODS
from lipsync.phonemes import LiveRecognizer, PhonemeEvent
from lipsync.recognition.network import DEFAULT_WEIGHTS, LATENCY_S, find_weights
from lipsync.recognition.network_recognizer import NetworkRecognizer
from lipsync.text_to_speech.pronunciation import pronounced

Row = dict[str, object]
Train = Callable[[Corpus], TrainedModel]
Track = Callable[[str, list[Utterance]], Iterable[Utterance]]

PHONEMES_TRUE, PHONEMES_RECOGNIZED = "true", "recognized"
#: Recognised where the words are known beforehand, and followed in the sound.
PHONEMES_TEXT = "text"
#: Catmull-Rom through the means of viseme classes, beside the one through recorded examples.
CLASS_MEANS = "catmull-rom-means"
#: Sentences that speed is measured on: the first of a split's first part.
_TIMED = 90
#: Methods whose self-correction is measured, where they are asked for.
_RECOVERING = ("priority", LIVE_STRATEGY, UNIT_STRATEGY)


class BenchError(UserError):
    """A request that the bench cannot fulfil."""


@dataclass(frozen=True, slots=True)
class Question:
    """What is to be scored: methods, look-aheads, and where their phonemes come from.

    phonemes: one of PHONEMES_TRUE, _RECOGNIZED, _TEXT. words: score these alone; None: all.
    """

    methods: tuple[Method, ...]
    lookaheads_ms: tuple[int, ...]
    phonemes: str
    words: frozenset[str] | None


def question(
    strategies: str | None,
    lookaheads: str,
    phonemes: str,
    words: str | None,
    *,
    published_derivatives: bool = False,
    random_units: bool = False,
) -> Question:
    """Parse the options of `bench motion`; raise BenchError for an unknown name or a bad number.

    strategies, words: names with commas between; None: all. lookaheads: ms, with commas between.
    published_derivatives: the two strategies of Wei and Deng use equation (5) of their paper as
    printed. random_units: add the methods that draw recorded pieces of motion (AnimPhos) at random.
    """
    methods = all_methods()
    for name, method in methods.items():
        if isinstance(method, PublishedMethod):
            methods[name] = replace(method, published_derivatives=published_derivatives)
    names = list(methods) if strategies is None else [n.strip() for n in strategies.split(",")]
    if unknown := [name for name in names if name not in methods]:
        raise BenchError(f"unknown strategy {unknown[0]!r}; use one of {', '.join(methods)}")
    phoneme_sources = (PHONEMES_TRUE, PHONEMES_RECOGNIZED, PHONEMES_TEXT)
    if phonemes not in phoneme_sources:
        raise BenchError(f"--phonemes {phonemes}: use one of {', '.join(phoneme_sources)}")
    try:
        lookaheads_ms = tuple(int(text) for text in lookaheads.split(","))
    except ValueError:
        raise BenchError(f"look-ahead {lookaheads!r}: give whole ms, such as 0,100,200") from None
    if not all(0 <= ms <= 1000 for ms in lookaheads_ms):
        raise BenchError(f"look-ahead {lookaheads!r}: 0 to 1000 ms are possible")
    named = None if words is None else frozenset(w.strip() for w in words.split(",") if w.strip())
    if named is not None and not named:
        raise BenchError("--words names no word")
    scored = tuple(methods[name] for name in dict.fromkeys(names))
    if random_units:
        scored += RANDOM_UNITS
    return Question(scored, lookaheads_ms, phonemes, named)


def with_offline_methods(
    question: Question, models: OfflineModels, visemes: RecordedVisemes | None
) -> Question:
    """Return the question with the methods added that use a whole line, not a live stream.

    visemes: recorded phones for the paper's Catmull-Rom method; None: leave that method out, since
    no sentence that trained the face model is at hand. With it, `catmull-rom` names the paper's
    method, and our baseline of that name, through means of viseme classes, is renamed
    `CLASS_MEANS`.
    """
    methods: list[Method] = [OfflineMethod(name, models) for name in PLANNED_METHODS]
    if visemes is not None:
        question = replace(question, methods=tuple(map(_renamed_class_means, question.methods)))
        methods.insert(0, ContextVisemeMethod(visemes))
    return replace(question, methods=(*question.methods, *methods))


def _renamed_class_means(method: Method) -> Method:
    return replace(method, name=CLASS_MEANS) if isinstance(method, SplineMethod) else method


def score_model(model: TrainedModel, corpus: Corpus, question: Question, track: Track) -> list[Row]:
    """Score a model on sentences that it was not trained on; a row for each method and look-ahead.

    Raises BenchError where no sentence contains any of the question's words.
    """
    utterances = check_scorable(model, corpus)
    if question.words is not None and not any(
        speech_frames(u, question.words).any() for u in utterances
    ):
        raise BenchError(f"{corpus.name}: no sentence holds {', '.join(sorted(question.words))}")
    whole_folder = Part("given", frozenset(), frozenset(u.name for u in utterances), question.words)
    return _split_rows([(model, whole_folder)], corpus, question, track)


def paper_rows(model: TrainedModel, unseen: Corpus, corpus: Corpus) -> dict[str, list[Row]]:
    """Return rows of Table 2 and Figure 6 of Wei and Deng, by the live recogniser.

    unseen: the sentences that are scored. corpus: if it holds sentences that the model was trained
    on, the paper's method as printed is built from these and scored as well.
    """
    utterances = check_scorable(model, unseen)
    taught = bool(seen_in_training(model, corpus.utterances))
    printed = PrintedMethod.of(model, corpus.labelled()) if taught else None
    return paper_tables(model, utterances, live_listener(), printed)


def recovery(model: TrainedModel, unseen: Corpus, corpus: Corpus, question: Question) -> list[Row]:
    """Return how much of a wrong phoneme's deviation is left in it and in each phoneme after it.

    unseen: sentences that the model has not learned. corpus: all recordings, for what a phoneme
    that truly differs leaves behind there (coarticulation). [] if the question has no method of
    `_RECOVERING`.
    """
    methods = [m for m in question.methods if m.name in _RECOVERING]
    if not methods:
        return []
    tested, recorded = check_scorable(model, unseen), corpus.labelled().utterances
    return recovery_rows(model, tested, recorded, methods, question.lookaheads_ms)


@dataclass(frozen=True, slots=True)
class CrossValidation:
    """The rows of all splits; the first trained model and the sentences that it has not seen."""

    rows: list[Row]
    model: TrainedModel
    unseen: Corpus


def cross_validate(
    folder: Path, corpus: Corpus, question: Question, train: Train, track: Track
) -> CrossValidation:
    """Train a model on the training part of each split, and score it on the rest.

    folder: has `splits.json`, which is read unless the question names words; then one model is
    trained on the sentences without them. Raises BenchError where nothing is left to train or
    score.
    """
    labelled = corpus.labelled()
    if question.words is not None:
        parts = [words_part("words", labelled, question.words)]
        if not parts[0].train:
            named = " or ".join(map(repr, sorted(question.words)))
            raise BenchError(
                f"{corpus.name}: every labelled sentence holds {named}, so none is left to train "
                "on; name rarer words, or give a model with --model"
            )
    else:
        parts = read_parts(folder, labelled)
    rows: list[Row] = []
    first: TrainedModel | None = None
    for split in dict.fromkeys(part.split for part in parts):
        trained = [(train(labelled.keep(set(p.train))), p) for p in parts if p.split == split]
        first = first or trained[0][0]
        rows += _split_rows(trained, labelled, question, track)
    if first is None:
        raise BenchError(f"{folder / 'splits.json'}: names no sentences to score")
    return CrossValidation(rows, first, labelled.keep(set(parts[0].test)))


@dataclass(slots=True)
class _RememberingListener:
    """A recogniser that keeps its results.

    sentences: the phonemes of every sentence; first: all that was heard of the first `_TIMED`.
    """

    listen: Listen
    sentences: list[tuple[PhonemeEvent, ...]] = field(default_factory=list)
    first: list[Heard] = field(default_factory=list)

    def __call__(self, utterance: Utterance) -> Heard:
        heard = self.listen(utterance)
        self.sentences.append(heard.events)
        if len(self.first) < _TIMED:
            self.first.append(heard)
        return heard


def _split_rows(
    trained: Sequence[tuple[TrainedModel, Part]], corpus: Corpus, question: Question, track: Track
) -> list[Row]:
    """Return the rows of one split, one for each method and look-ahead.

    trained: the split's models, each with the part that it is scored on; a row pools all parts.
    Miss rates and computing times are taken with the phonemes that the methods got.
    """
    scores = Scores()
    listen: Listen = true_phonemes
    if question.phonemes != PHONEMES_TRUE:
        listen = live_listener(with_text=question.phonemes == PHONEMES_TEXT)
    listeners = []
    for model, part in trained:
        listeners.append(_RememberingListener(listen))
        add_scores(
            scores,
            model,
            corpus.keep(set(part.test)).utterances,
            question.methods,
            question.lookaheads_ms,
            words=part.words,
            listen=listeners[-1],
            progress=partial(track, f"scoring {part.split}"),
        )
    model, part = trained[0]
    rows, animpho_counts = [], {}
    if RANDOM_UNITS[0] in question.methods:
        animpho_counts = animpho_use(model, corpus.keep(set(part.test)).utterances)
    for method in question.methods:
        miss_rate = _pooled_miss_rate(method, [m for m, _ in trained], listeners)
        for lookahead_ms in question.lookaheads_ms:
            times = method_times(method, model, listeners[0].first, lookahead_ms / 1e3)
            rows.append(
                {
                    "strategy": method.name,
                    "lookahead_ms": lookahead_ms,
                    "split": part.split,
                    "phonemes": question.phonemes,
                    **scores.row(method.name, lookahead_ms),
                    "miss_rate": miss_rate,
                    "ms_per_phoneme_p95": times and times.phoneme_p95_ms,
                    "ms_per_frame_p95": times and times.frame_p95_ms,
                    "timed_sentences": times and len(listeners[0].first),
                    **(animpho_counts if method.name == UNIT_STRATEGY else {}),
                }
            )
    return rows


def _pooled_miss_rate(
    method: Method, models: Sequence[TrainedModel], listeners: Sequence[_RememberingListener]
) -> float | None:
    """Return the share of misses of AnimPho selection (see `count_misses`) over all parts.

    listeners: with the phonemes of each model's part. None for methods without a selection.
    """
    strategy = STRATEGIES.get(method.name)
    if strategy is None:
        return None
    counts = [
        count_misses(model.animphos, strategy, heard.sentences)
        for model, heard in zip(models, listeners, strict=True)
    ]
    return sum(misses for misses, _ in counts) / max(1, sum(total for _, total in counts))


def live_listener(
    *, with_text: bool = False, weights: str = DEFAULT_WEIGHTS
) -> Callable[[Utterance], Heard]:
    """Return a function that runs the live recogniser on a sentence's sound.

    The recogniser is made at the first call. with_text: it gets the words beforehand, without their
    times. weights: a name or a file.
    """

    def listen(utterance: Utterance) -> Heard:
        text = " ".join(word.text for word in utterance.words) if with_text else ""
        heard = recognize_file(recognizer(), utterance.sound_path, pronounced(text))
        return replace(heard, sound_path=utterance.sound_path)

    @cache
    def recognizer() -> LiveRecognizer:
        return NetworkRecognizer(find_weights(weights), LATENCY_S)

    return listen
