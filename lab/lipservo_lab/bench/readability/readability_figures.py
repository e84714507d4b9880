"""The figures of `lipservo bench readability`: each method, look-ahead and reader, by split.

The picture of `lipservo bench readability`; needs matplotlib, the extra `plots`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import cast

import numpy as np

from lipservo.runtime.servos.assembly import Face
from lipservo.settings.motion_names import DEFAULT_STRATEGY
from lipservo.terminal.output import Advance
from lipservo.terminal.pictures import save_picture, without_screen
from lipservo_lab.bench.motion_figures import (
    PHONEMES_RECOGNIZED,
    PHONEMES_TEXT,
    PHONEMES_TRUE,
    Row,
    Track,
    live_listener,
    question,
)
from lipservo_lab.bench.readability.left_out_reading import pooled
from lipservo_lab.bench.readability.robot_lips import ROBOT, calibrated_robot, shown_markers_mm
from lipservo_lab.corpus.utterance import Corpus, Utterance, speech_frames
from lipservo_lab.evaluation.motion.methods import Heard, Method
from lipservo_lab.evaluation.motion.motion_scores import Listen, Part, check_scorable, true_phonemes
from lipservo_lab.evaluation.motion.offline_methods import OfflineMethod, OfflineModels
from lipservo_lab.evaluation.readability.readers import (
    COMPONENT_READER,
    LIP_READER,
    READERS,
    Fold,
    Motions,
    ReaderKind,
    known_fold,
    new_word_folds,
    read_words,
    slotted,
)
from lipservo_lab.evaluation.readability.reading_scores import (
    KNOWN,
    ReadingScore,
    known_score,
    made_faces,
    new_word_score,
    percentiles,
    recorded_motions,
    seen_motions,
)
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipsync.arrays import Array
from lipsync.motion.finishing import DEFAULT_LOOKAHEAD_S
from lipsync.motion.live_synthesizer import LIVE_STRATEGY, UNIT_STRATEGY
from lipsync.motion.tick_plan import TICK_S
from lipsync.offline.line_methods import PLANNED_METHODS, LineMethod
from lipsync.recognition.network import DEFAULT_WEIGHTS

RECORDED = "recorded"
#: Whose face is read: the model's own, or the robot's.
OWN_FACE = "model"
HEADLINE_LOOKAHEAD_MS = round(DEFAULT_LOOKAHEAD_S * 1e3)


@dataclass(frozen=True, slots=True)
class ReadingQuestion:
    """What is to be read: the motion of which methods, made from which phonemes.

    robot: whether the robot plays the motion too. line_methods: methods of `lipservo lines render`
    without their models yet. weights: of the recogniser, a name or a file.
    """

    methods: tuple[Method, ...]
    lookaheads_ms: tuple[int, ...]
    phonemes: tuple[str, ...]
    robot: bool
    line_methods: tuple[LineMethod, ...] = ()
    weights: str = DEFAULT_WEIGHTS


def reading_question(
    strategies: str, lookaheads: str, phonemes: str, *, robot: bool
) -> ReadingQuestion:
    """Parse the options of `bench readability`; raise BenchError for an unknown name.

    strategies, lookaheads (ms), phonemes: lists with commas between.
    """
    named = list(dict.fromkeys(text.strip() for text in strategies.split(",")))
    line_methods = tuple(name for name in PLANNED_METHODS if name in named)
    kinds = tuple(dict.fromkeys(text.strip() for text in phonemes.split(",")))
    # Without a live one look-aheads and phonemes are checked all the same.
    live: list[str | None] = [name for name in named if name not in line_methods]
    reading = [question(name, lookaheads, kind, None) for name in live or [None] for kind in kinds]
    methods = {each.methods[0].name: each.methods[0] for each in reading} if live else {}
    return ReadingQuestion(
        tuple(methods.values()), reading[0].lookaheads_ms, kinds, robot, line_methods
    )


def with_line_methods(
    reading: ReadingQuestion, models_of: Callable[[], OfflineModels]
) -> ReadingQuestion:
    """Return the question with its methods for whole lines made ready.

    models_of: called only where there are any.
    """
    if not reading.line_methods:
        return reading
    models = models_of()
    methods = tuple(OfflineMethod(name, models) for name in reading.line_methods)
    return replace(reading, methods=(*reading.methods, *methods), line_methods=())


@dataclass(frozen=True, slots=True)
class _Split:
    """One part of the corpus with its model, and what each kind of reader needs, by its name.

    read: sentences that are read. recorded: motion of all sentences. folds: trained readers.
    """

    part: Part
    model: TrainedModel
    read: tuple[Utterance, ...]
    recorded: Mapping[str, Motions]
    folds: Mapping[str, tuple[Fold, ...]]

    def score(self, kind: ReaderKind, seen: Motions) -> ReadingScore:
        """Let readers of one kind read the motion `seen`, by sentence; return the score."""
        recorded = self.recorded[kind.name]
        readings = read_words(self.folds[kind.name], seen, recorded)
        if self.part.words is None:
            return known_score(readings)
        return new_word_score(readings, self.part.words)


def reading_rows(
    corpus: Corpus,
    parts: Iterable[Part],
    model_of: Callable[[Part], TrainedModel],
    reading: ReadingQuestion,
    track: Track,
    advance: Advance,
    *,
    is_pooled: bool = False,
) -> list[Row]:
    """Return the scores of words read off recorded and made motion, a row for each kind of reader.

    model_of: returns the model of a part, which has not learned the sentences that are read. track,
    advance: for progress bars. is_pooled: the parts are folds of one question; rows are means.
    """
    listeners: dict[str, Listen] = {
        PHONEMES_TRUE: true_phonemes,
        PHONEMES_RECOGNIZED: OnceListener(live_listener(weights=reading.weights)),
        PHONEMES_TEXT: OnceListener(live_listener(with_text=True, weights=reading.weights)),
    }
    rows: list[Row] = []
    for part in parts:
        split = _prepare_split(part, model_of(part), corpus)
        rows += [_row(split, kind, split.recorded[kind.name]) for kind in READERS]
        for phonemes in reading.phonemes:
            rows += _method_rows(split, reading, phonemes, listeners[phonemes], track)
        if reading.robot and part.split == KNOWN:
            rows += _robot_rows(split, reading, listeners, track, advance)
    rows = pooled(rows) if is_pooled else rows
    _compare_strategies(rows)
    return rows


def _compare_strategies(rows: Sequence[Row]) -> None:
    """Add to all rows by how much recorded pieces of motion (AnimPhos) change the score.

    `less_expected`, with a 95 % interval: score of the strategy with AnimPhos less that of the
    strategy without, on the same samples of sentences; None for rows of other strategies. Removes
    the samples from all rows.
    """
    same = itemgetter("split", "face", "phonemes", "lookahead_ms", "reader")
    expected = {same(row): row for row in rows if row["strategy"] == LIVE_STRATEGY}
    for row in rows:
        other = expected.get(same(row)) if row["strategy"] == UNIT_STRATEGY else None
        change, interval = None, None
        if other is not None:
            change = cast(float, row["score"]) - cast(float, other["score"])
            interval = percentiles(cast(Array, row["samples"]) - cast(Array, other["samples"]))
        row |= {"less_expected": change, "less_expected_95": interval}
    for row in rows:
        del row["samples"]


def headline(rows: Sequence[Row]) -> dict[str, object]:
    """Return the main scores by split: of recorded motion, and the default strategy at 100 ms.

    Keys begin with `robot_` for the robot's lips, read by `LIP_READER`; the model's own face is
    read by `COMPONENT_READER`. gap_r_...: of the sentences with known words.
    """
    scores: dict[str, object] = {}
    for row in rows:
        split, phonemes = row["split"], row["phonemes"]
        if row["strategy"] not in (RECORDED, DEFAULT_STRATEGY):
            continue
        if row["lookahead_ms"] not in (None, HEADLINE_LOOKAHEAD_MS):
            continue
        key = f"{RECORDED}_{split}" if phonemes is None else f"{split}_{phonemes}"
        if row["face"] == OWN_FACE and row["reader"] == COMPONENT_READER.name:
            scores[key] = row["score"]
            if split == KNOWN and phonemes is not None:
                scores[f"gap_r_{phonemes}"] = row["gap_r"]
        elif row["face"] == ROBOT and row["reader"] == LIP_READER.name:
            scores[f"robot_{key}"] = row["score"]
    return scores


def _prepare_split(part: Part, model: TrainedModel, corpus: Corpus) -> _Split:
    """Return a part with recorded motion and trained readers of each kind."""
    sentences = slotted(check_scorable(model, corpus))
    recorded = {kind.name: recorded_motions(model, sentences, kind) for kind in READERS}
    folds = {}
    for kind in READERS:
        seen = recorded[kind.name]
        if part.words is None:
            folds[kind.name] = known_fold(kind, sentences, part.test, seen)
        else:
            folds[kind.name] = new_word_folds(kind, sentences, part.words, seen, part.test)
    read = tuple(u for fold in folds[READERS[0].name] for u in fold.sentences)
    return _Split(part, model, read, recorded, folds)


def _method_rows(
    split: _Split, reading: ReadingQuestion, phonemes: str, listen: Listen, track: Track
) -> Iterator[Row]:
    """Yield a row for each method, look-ahead and kind of reader, of faces made by the method.

    A method that does not look ahead makes its faces once, for all look-aheads. phonemes: the
    source's name in the rows, whose phonemes `listen` returns.
    """
    what = f"{split.part.split}, {phonemes}"
    for method in reading.methods:
        faces: Motions | None = None
        for lookahead_ms in reading.lookaheads_ms:
            if faces is None or method.looks_ahead:
                sentences = track(f"{what}, {method.name}", list(split.read))
                faces = made_faces(split.model, sentences, method, lookahead_ms / 1e3, listen)
            gap_r = _gap_r(split, faces)
            for kind in READERS:
                seen = seen_motions(split.model, faces, kind)
                yield _row(split, kind, seen, phonemes, method.name, lookahead_ms, gap_r=gap_r)


def _gap_r(split: _Split, faces: Motions) -> float:
    """Return the correlation of made and recorded lip gaps, in the frames of `bench motion`.

    faces: (n_frames, n_components) by sentence. 0 for a gap that does not move.
    """
    made_mm, recorded_mm = [], []
    for utterance in split.read:
        gaps_mm = split.model.lip_gaps_mm(split.model.markers_mm(faces[utterance.name]))
        scored = speech_frames(utterance, split.part.words)[: len(gaps_mm)]
        made_mm.append(gaps_mm[: len(scored)][scored])
        recorded_mm.append(split.model.lip_gaps_mm(utterance.markers_mm)[: len(scored)][scored])
    gaps_mm = np.array([np.concatenate(made_mm), np.concatenate(recorded_mm)])
    is_moving = gaps_mm.std(axis=1).min() > 1e-6
    return float(np.corrcoef(gaps_mm).flat[1]) if is_moving else 0.0


def _robot_rows(
    split: _Split,
    reading: ReadingQuestion,
    listeners: Mapping[str, Listen],
    track: Track,
    advance: Advance,
) -> Iterator[Row]:
    """Yield rows of motion played by the robot: recorded, and by the default strategy.

    The latter only if it is among the methods.
    """
    robot = calibrated_robot(split.model)
    readers_view = partial(_seen_of_robot, split, robot, advance)
    rate_hz = split.read[0].frame_rate_hz
    recorded = {u.name: split.model.coefficients(u.markers_mm) for u in split.read}
    for kind, seen in readers_view(recorded, rate_hz).items():
        yield _row(split, kind, seen, face=ROBOT)
    ours = next((m for m in reading.methods if m.name == DEFAULT_STRATEGY), None)
    if ours is None:
        return
    for phonemes in reading.phonemes:
        sentences = track(f"{ROBOT}, {phonemes}", list(split.read))
        faces = made_faces(
            split.model, sentences, ours, DEFAULT_LOOKAHEAD_S, listeners[phonemes], 1.0 / TICK_S
        )
        for kind, seen in readers_view(faces, 1.0 / TICK_S).items():
            yield _row(split, kind, seen, phonemes, ours.name, HEADLINE_LOOKAHEAD_MS, face=ROBOT)


def _seen_of_robot(
    split: _Split, robot: Face, advance: Advance, faces: Motions, rate_hz: float
) -> dict[ReaderKind, Motions]:
    """Let the robot play sentences; return what each kind of reader sees of it.

    faces: (n, n_components) at `rate_hz`, by sentence.
    """
    shown_mm = shown_markers_mm(
        robot, faces, rate_hz, split.read[0].frame_rate_hz, partial(advance, f"{ROBOT} plays")
    )
    return {
        kind: {name: kind.view(split.model, each) for name, each in shown_mm.items()}
        for kind in READERS
    }


def _row(
    split: _Split,
    kind: ReaderKind,
    seen: Motions,
    phonemes: str | None = None,
    strategy: str = RECORDED,
    lookahead_ms: int | None = None,
    *,
    face: str = OWN_FACE,
    gap_r: float | None = None,
) -> Row:
    """Let readers of one kind read the motion `seen`; return the row of their score.

    The other arguments say what motion it is: phonemes, lookahead_ms, gap_r are None for recorded
    motion; face: `OWN_FACE` or the robot.
    """
    scored = split.score(kind, seen)
    return {
        "split": split.part.split,
        "face": face,
        "phonemes": phonemes,
        "strategy": strategy,
        "lookahead_ms": lookahead_ms,
        "reader": kind.name,
        "score": scored.score,
        "score_95": list(scored.interval),
        "samples": scored.samples,
        "shares": scored.shares,
        "whole_sentences": scored.whole_sentences,
        "gain": scored.gain,
        "gap_r": gap_r,
        "sentences": scored.n_sentences,
    }


@dataclass(slots=True)
class OnceListener:
    """A listener that recognises every sentence once, and keeps the result."""

    listen: Listen
    heard: dict[str, Heard] = field(default_factory=dict)

    def __call__(self, utterance: Utterance) -> Heard:
        """Return the phonemes recognised at the first call."""
        if utterance.name not in self.heard:
            self.heard[utterance.name] = self.listen(utterance)
        return self.heard[utterance.name]


#: What is drawn into the folder.
PICTURES = ("readability.png",)
_COLOURS = {"true": "tab:blue", "recognized": "tab:orange", "text": "tab:green", None: "0.4"}


def draw_readability(folder: Path, rows: Sequence[Row]) -> None:
    """Draw the scores at 100 ms look-ahead as bars with intervals, a panel a split and reader."""
    without_screen()
    from matplotlib import pyplot as plt

    shown = [r for r in rows if r["lookahead_ms"] in (None, HEADLINE_LOOKAHEAD_MS)]
    splits = list(dict.fromkeys(str(r["split"]) for r in shown))
    readers = list(dict.fromkeys(str(r["reader"]) for r in shown))
    n_bars = max(sum(r["split"] == s and r["reader"] == readers[0] for r in shown) for s in splits)
    figure, axes = plt.subplots(
        len(readers), len(splits), sharex=True, squeeze=False,
        figsize=(4.0 * len(splits), len(readers) * (1.0 + 0.3 * n_bars)), layout="constrained",
    )  # fmt: skip
    for axes_row, reader in zip(axes, readers, strict=True):
        for axis, split in zip(axes_row, splits, strict=True):
            panel_rows = [r for r in shown if r["split"] == split and r["reader"] == reader]
            scores = np.array([r["score"] for r in panel_rows], dtype=np.float64)
            ends = np.array([r["score_95"] for r in panel_rows], dtype=np.float64)
            axis.barh(
                range(len(panel_rows)), scores, xerr=np.abs(ends.T - scores), capsize=3,
                color=[_COLOURS[_phonemes_of(r)] for r in panel_rows],
            )  # fmt: skip
            axis.set_yticks(range(len(panel_rows)), [_bar_label(r) for r in panel_rows], fontsize=8)
            axis.invert_yaxis()
            axis.set_title(f"{split}, reader of {reader}", fontsize=10)
            axis.set_xlim(0.0, 1.0)
    for axis in axes[-1]:
        axis.set_xlabel("read right")
    save_picture(figure, folder / PICTURES[0])
    plt.close(figure)


def _phonemes_of(row: Row) -> str | None:
    return None if row["phonemes"] is None else str(row["phonemes"])


def _bar_label(row: Row) -> str:
    names = [str(row["strategy"])]
    if row["strategy"] != RECORDED:
        names.append(str(row["phonemes"]))
    if row["face"] != "model":
        names.append(str(row["face"]))
    return ", ".join(names)
