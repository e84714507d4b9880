"""`lipservo bench motion`: our motion and the baselines against recorded faces.

`lipservo bench motion --video`: our mouth beside faces that anybody filmed.
"""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from lipservo.commands.options import Json, Landmarker, Quiet, SkipBad
from lipservo.settings.motion_names import DEFAULT_STRATEGY
from lipservo.terminal.output import MESSAGES, RESULTS, machine_class, print_json, progress_bar
from lipservo_lab.commands.bench.printing import print_table, with_machine
from lipservo_lab.commands.options import (
    GridCorpus,
    LeaveWordsOut,
    LookaheadsMs,
    OtherWeights,
    Plots,
    WordLimit,
    Words,
)
from lipservo_lab.commands.work_bars import WorkBars, work_bars
from lipsync.errors import UserError, check_extra, check_inputs

if TYPE_CHECKING:
    from lipservo_lab.bench.motion_figures import Question
    from lipservo_lab.evaluation.motion.offline_methods import OfflineModels
    from lipservo_lab.learning.motion.trained_model import TrainedModel


_HEADINGS = {
    "clip": "clip",
    "gap_r": "gap r",
    "loudness_r": "loudness r",
    "best_shift_ms": "best at ms",
    "gap_r_at_best": "gap r there",
    "seconds": "s",
}


def measure_video(
    folder: Path, landmarker: Path | None, model: Path | None, *, as_json: bool, quiet: bool
) -> None:
    """Print how our lip gap, moved by the sound alone, correlates with the filmed one."""
    from lipservo_lab.bench.foreign_faces import foreign_figures
    from lipservo_lab.video.video_clips import find_clips
    from lipsync.video.face_tracker import open_tracker

    began_s = time.perf_counter()
    clips = find_clips(folder)
    check_extra("ai_edge_litert", "bench motion --video")
    tracker = open_tracker(landmarker)
    with progress_bar(quiet=quiet) as advance:
        figures = foreign_figures(clips, tracker, model, advance)
    if as_json:
        duration = {"wall_s": round(time.perf_counter() - began_s, 1)}
        print_json(with_machine({**figures, "default_strategy": DEFAULT_STRATEGY, **duration}))
        return
    rows = cast("list[dict[str, Any]]", figures["clips"])
    heard = [row for row in rows if not row["left_out"]]
    print_table([*heard, {**figures, "clip": "all"}], _HEADINGS)
    for row in rows:
        if row["left_out"]:
            MESSAGES.print(f"left out: {row['clip']}: {row['left_out']}", soft_wrap=True)


#: What is printed of a row, and its heading; all of it together fits 80 columns.
_MOTION_HEADINGS = {
    "split": "split",
    "strategy": "strategy",
    "lookahead_ms": "ms",
    "rmse_mm": "mm",
    "ratio": "ratio",
    "gap_r": "gap r",
    "closure_hits": "closed",
    "false_closures_ratio": "false",
    "acceleration_ratio": "accel",
    "miss_rate": "misses",
    "frames": "frames",
}


def motion(
    corpus: Annotated[
        Path | None, typer.Option(help="One speaker's recordings, a folder as in docs/motion.md.")
    ] = None,
    video: Annotated[
        Path | None,
        typer.Option(
            help="Instead of --corpus: a video, or a folder of videos, of any talkers; their lips "
            "are compared with our mouth, which their sound alone moves."
        ),
    ] = None,
    landmarker: Landmarker = None,
    model: Annotated[
        Path | None,
        typer.Option(
            help="Face model to score on the whole folder (`shipped`: the shipped model); "
            "default: train and score models by the splits in splits.json."
        ),
    ] = None,
    words: Words = None,
    strategy: Annotated[
        str | None,
        typer.Option(
            help="Methods to score, commas between; default: all. With --leave-words-out: default "
            "animpho, and the first method is compared with each of the others."
        ),
    ] = None,
    lookahead_ms: LookaheadsMs = "0,100,200",
    phonemes: Annotated[
        str, typer.Option(help="true (labels), recognized (live) or text (live, given the text).")
    ] = "true",
    random_units: Annotated[
        bool,
        typer.Option("--random-units", help="Also score AnimPhos chosen at random, as a baseline."),
    ] = False,
    published_derivatives: Annotated[
        bool,
        typer.Option(
            "--published-derivatives",
            help="priority and naive: use equation (5) as Wei and Deng print it, with derivatives "
            "per sample; the speed then jumps between phones of different length.",
        ),
    ] = False,
    offline: Annotated[
        bool,
        typer.Option(
            "--offline",
            help="Also score the methods of `lipservo lines render`: model-based (published) and "
            "heard (ours); with --leave-words-out only heard.",
        ),
    ] = False,
    leave_words_out: LeaveWordsOut = False,
    limit: WordLimit = 40,
    plots: Plots = None,
    also: OtherWeights = None,
    skip_bad: SkipBad = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure how near synthesised motion comes to recorded faces, by our methods and by others.

    Methods: cohen-massaro, cohen-massaro-tuned, catmull-rom, mean-face, naive, priority,
    plain-regression, animpho, expected. priority and naive are Wei and Deng's (docs/motion.md, "The
    paper's method"). An AnimPho is a short recorded mouth motion of one phoneme.

    With --video: against faces in any video (docs/own-face.md).
    """
    if (corpus is None) == (video is None):
        raise typer.BadParameter("give --corpus FOLDER or --video FOLDER")
    shipped = None if str(model) == "shipped" else model
    if video is not None:
        measure_video(video, landmarker, shipped, as_json=as_json, quiet=quiet)
        return
    assert corpus is not None
    from lipservo.terminal.pictures import check_folder
    from lipservo_lab.bench import motion_figures as measure
    from lipservo_lab.bench.pictures.line_plots import LINE_PICTURES
    from lipservo_lab.bench.pictures.motion_plots import PICTURES
    from lipservo_lab.learning.motion.trained_model import load_trained_model
    from lipsync.offline.line_methods import DEFAULT_METHOD

    began_s = time.perf_counter()
    if not corpus.is_dir():
        raise UserError(f"{corpus}: no such folder; docs/motion.md says what is in one")
    given = None if model is None else load_trained_model(shipped)
    if offline:
        check_extra("dtaidistance", "bench motion --offline")
    if plots is not None:
        check_folder(plots, (*PICTURES, *LINE_PICTURES) if offline else PICTURES)
    if leave_words_out and strategy is None:
        strategy = DEFAULT_STRATEGY
    question = measure.question(
        strategy,
        lookahead_ms,
        phonemes,
        words,
        published_derivatives=published_derivatives,
        random_units=random_units,
    )
    if leave_words_out:
        if model is not None or words is not None or plots is not None:
            raise typer.BadParameter(
                "--leave-words-out trains models of its own; leave out --model, --words and --plots"
            )
        _measure_left_out(
            corpus, question, limit, also or (),
            with_offline=offline, skip_bad=skip_bad, as_json=as_json, quiet=quiet,
        )  # fmt: skip
        return
    if also:
        raise typer.BadParameter("--also needs --leave-words-out, which trains the models")
    with work_bars(quiet=quiet) as bars:
        answer = _answer(
            corpus, given, question, plots, bars, skip_bad=skip_bad, with_offline=offline
        )
    seconds = time.perf_counter() - began_s
    answer["published_derivatives"] = published_derivatives
    default = DEFAULT_METHOD if offline else DEFAULT_STRATEGY
    answer |= {"default_strategy": default, "machine": machine_class(), "seconds": seconds}
    if as_json:
        print_json(answer)
        return
    _print_answer(answer)
    RESULTS.print(f"default strategy: {default}; {machine_class()}; {seconds:.0f} s")


def _answer(
    folder: Path,
    given: "TrainedModel | None",
    question: "Question",
    plots: Path | None,
    bars: WorkBars,
    *,
    skip_bad: bool,
    with_offline: bool,
) -> dict[str, Any]:
    """Return rows of figures and self-correction; draw pictures on the way.

    plots: folder of the pictures; None: none are drawn.
    """
    from lipservo_lab.bench import motion_figures as measure
    from lipservo_lab.corpus.grid import read_grid
    from lipservo_lab.evaluation.motion.motion_scores import seen_in_training
    from lipservo_lab.learning.motion.model_teacher import ModelTeacher
    from lipsync.markers import MARKERS_47
    from lipsync.recognition.network import DEFAULT_WEIGHTS

    sentences = read_grid(
        folder,
        MARKERS_47 if given is None else given.layout,
        head_reference_mm=None if given is None else given.head_reference_mm,
        skip_bad=skip_bad,
        progress=bars.read,
    )

    rendering: OfflineModels | None = None
    if with_offline:
        from lipservo_lab.bench.offline_models import models_of, visemes_of

        rendering = models_of(sentences, "bench motion --offline")
        known = given is None or bool(seen_in_training(given, sentences.utterances))
        question = measure.with_offline_methods(
            question, rendering, visemes_of(sentences) if known else None
        )
    if given is None:
        teacher = ModelTeacher(sentences.labelled(), DEFAULT_WEIGHTS, bars.track, bars.tell)
        validated = measure.cross_validate(folder, sentences, question, teacher, bars.track)
        rows, model, unseen = validated.rows, validated.model, validated.unseen
    else:
        rows = measure.score_model(given, sentences, question, bars.track)
        model, unseen = given, sentences
        seen = seen_in_training(given, sentences.utterances)
        if seen:
            MESSAGES.print(f"too good: the model has learned {len(seen)} of these sentences")
    bars.tell("self-correction")
    recovery = measure.recovery(model, unseen, sentences, question)
    if plots is not None:
        from lipservo_lab.bench.pictures.motion_plots import draw

        bars.tell("pictures")
        shown = unseen.labelled().utterances
        draw(plots, model, shown[0], recovery)
        if rendering is not None:
            from lipservo_lab.bench.pictures.line_plots import draw_lines

            training = sentences.labelled().keep(set(model.training_sentences)).utterances
            states = rendering.of(model).states
            draw_lines(plots, model, states, training, shown[0], question.methods, rows)
    return {
        "results": rows,
        "recovery": recovery,
        "skipped": list(sentences.skipped),
    }


def _measure_left_out(
    folder: Path,
    question: "Question",
    limit: int,
    others: Sequence[Path],
    *,
    with_offline: bool,
    skip_bad: bool,
    as_json: bool,
    quiet: bool,
) -> None:
    """Print the figures of words that no model was trained on."""
    from lipservo_lab.bench import motion_figures as measure
    from lipservo_lab.bench.left_out_words import (
        left_out_figures,
        word_folds,
    )
    from lipservo_lab.bench.offline_models import models_of
    from lipservo_lab.bench.readability.readability_figures import OnceListener
    from lipservo_lab.bench.readability.reading_models import kept_models
    from lipservo_lab.corpus.grid import read_grid
    from lipservo_lab.evaluation.motion.motion_scores import true_phonemes
    from lipservo_lab.evaluation.motion.offline_methods import OfflineMethod
    from lipsync.markers import MARKERS_47
    from lipsync.offline.line_methods import DEFAULT_METHOD

    began_s = time.perf_counter()
    with work_bars(quiet=quiet) as bars:
        sentences = read_grid(folder, MARKERS_47, skip_bad=skip_bad, progress=bars.read).labelled()
        word_folds(sentences)  # what cannot be left out is refused before the long part
        model_of = kept_models(sentences, bars.track, bars.tell, others)
        listen = true_phonemes
        if question.phonemes != measure.PHONEMES_TRUE:
            with_text = question.phonemes == measure.PHONEMES_TEXT
            listen = OnceListener(measure.live_listener(with_text=with_text))
        methods = list(question.methods)
        if with_offline:
            rendering = models_of(sentences, "bench motion --offline")
            methods.append(OfflineMethod(DEFAULT_METHOD, rendering))
        answer: dict[str, Any] = dict(
            left_out_figures(
                sentences, model_of, methods, question.lookaheads_ms, listen, limit, bars.track
            )
        )
    if not as_json:
        for name, rows in answer.items():
            print_table(rows, title=f"Words left out: {name}")
        return
    answer |= {
        "strategy": ",".join(method.name for method in question.methods),
        "phonemes": question.phonemes,
        "limit": limit,
    }
    print_json(with_machine(answer, began_s))


def _print_answer(answer: Mapping[str, Any]) -> None:
    print_table(answer["results"], _MOTION_HEADINGS, title="Motion")
    print_table(answer["recovery"], title="Left of a phoneme, in itself and in those after it")


def figures(
    corpus: GridCorpus,
    model: Annotated[
        Path,
        typer.Option(
            help="Face model that has not learned all the sentences (`learn face --without`)."
        ),
    ],
    plots: Plots = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Print the tables and draw the figures of Wei and Deng's paper: our values beside theirs.

    Scored are the sentences of the corpus that --model has not learned. For the sentences that the
    model has learned, the command also prints the tables of Edge, Hilton and Jackson's paper. Both
    papers: docs/motion.md, docs/scripted-lines.md.
    """
    from lipservo.terminal.pictures import check_folder
    from lipservo_lab.bench import motion_figures as measure
    from lipservo_lab.bench.pictures.paper_figures import PAPER_PICTURES, draw_paper
    from lipservo_lab.corpus.grid import read_grid
    from lipservo_lab.evaluation.motion.edge_tables import edge_tables
    from lipservo_lab.learning.motion.trained_model import load_trained_model

    check_inputs(corpus, model)
    if plots is not None:
        check_folder(plots, PAPER_PICTURES)
    face = load_trained_model(model)
    with work_bars(quiet=quiet) as bars:
        sentences = read_grid(
            corpus, face.layout, head_reference_mm=face.head_reference_mm, progress=bars.read
        ).labelled()
        bars.tell("the paper's tables")
        unseen = {u.name for u in sentences.utterances} - set(face.training_sentences)
        if not unseen:
            raise UserError(
                f"{model}: has learned every sentence of {corpus}; make one that has not with "
                "`lipservo learn face --without FILE`"
            )
        tables = measure.paper_rows(face, sentences.keep(unseen), sentences)
        if learned := sentences.keep(set(face.training_sentences)).utterances:
            tables |= edge_tables(face, learned)
    if plots is not None:
        draw_paper(plots, tables)
    if as_json:
        print_json(with_machine(tables))
        return
    for name, rows in tables.items():
        print_table(rows, title=f"The paper's {name.replace('_', ' ')}")
